"""2, 4 or 8 rays by score in place of one count for all, and what they count as later.

Found: it does not help; 8 rays for all is the best use of every budget on all three
scenes (at 0.5 rays a pixel SSIM 0.919, 0.963 and 0.983, against 0.900, 0.959 and 0.981
with thirds, 0.874, 0.952 and 0.981 with cover), for two rays are worse than the history
that they replace. A pixel's own count in place of 4 gains 0.0003 to 0.0018 of SSIM with
thirds; 8 rays that count as 8 in place of 4 flicker 3 to 13 % less, and lose 0 to 0.002
of SSIM.

One ray budget (0.25, 0.5, 1 rays a pixel) is spent on 2, 4 or 8 rays at each of the
highest scores (the paper's pipeline: 8x, 4x, 2x), or on a mixture of the three.
"thirds" gives each count a third of the rays, 8 to the highest scores; "cover" gives 2
rays to as many pixels as it can, and what is left to the highest scores, to make 4 of
them and then 8. Where fewer pixels ask than thirds could serve it does as cover does.
The history holds a traced pixel as 2, 4 (`resolve`'s default) or 8 frames, or as its
"own" number of rays. A typical walk at 320×180 against 64 samples a pixel.

    python experiments/adaptive_samples.py    # writes results/adaptive_samples.*
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import figures
import jax
import jax.numpy as jnp
import numpy as np
import scenes
import walks
from matplotlib import pyplot as plt

from ataa_jax import pipeline, raster, raytrace, resolve, segmentation, types
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
BUDGETS = (0.25, 0.5, 1.0)
TOLD_AT = 0.5  # the budget at which every `traced_count` is tried
COUNTS = (2, 4, 8)
COLUMNS = ("ssim", "mse", "flicker", "rays", "traced_share")
OWN = "own"

# Takes the pixels that ask and the rays there are: pixels of 8, of 4 and of 2 rays.
Plan = Callable[[int, int], tuple[int, int, int]]


def uniform(count: int) -> Plan:
    """Returns the plan of one count for all."""

    def plan(asking: int, rays: int) -> tuple[int, int, int]:
        served = min(asking, rays // count)
        return tuple(served if count == each else 0 for each in (8, 4, 2))  # pyright: ignore[reportReturnType]

    return plan


def cover(asking: int, rays: int) -> tuple[int, int, int]:
    """Serves as many pixels as it can, then the best of them better."""
    served = min(asking, rays // 2)
    better = min(served, (rays - 2 * served) // 2)  # 4 for 2
    best = min(better, (rays - 2 * served - 2 * better) // 4)  # 8 for 4
    return best, better - best, served - better


def thirds(asking: int, rays: int) -> tuple[int, int, int]:
    """Spends a third of the rays on each count."""
    shares = rays // 24, rays // 12, rays // 6
    return shares if sum(shares) <= asking else cover(asking, rays)


PLANS: dict[str, Plan] = {
    **{f"{count}": uniform(count) for count in COUNTS},
    "cover": cover,
    "thirds": thirds,
}


class Mixture:
    """Stands in for budget and raytrace stage of `pipeline.antialias`."""

    def __init__(
        self, walk: walks.Walk, plan: Plan, budget: float, traced_count: int | str
    ) -> None:
        """Takes a plan, rays a pixel, and the frames that a traced pixel counts as."""
        self.walk, self.plan, self.traced_count = walk, plan, traced_count
        self.rays = int(budget * walk.shot.size[0] * walk.shot.size[1])
        self.counts = jnp.zeros(walk.shot.size, jnp.float32)
        # `trace` joins the colours itself, each by its pixel's own count.
        self.config = replace(walk.config, resolve=resolve.Config(traced="replace"))
        self.blended: Any = None

    def step(
        self, state: types.State, drawn: raster.RasterOutput, inputs: types.FrameInputs
    ) -> tuple[pipeline.FrameOutput, types.State]:
        """Antialiases one frame."""
        return pipeline.antialias(
            state, drawn, inputs,
            pipeline.with_budget(self.walk.params, float("inf")),
            config=self.config, observe=self.observe,
            trace=lambda _: self.trace(inputs),
        )  # fmt: skip

    def observe(self, stage: str, buffer: Any) -> Any:
        """Spends the budget after segmentation, counts rays after resolve."""
        if stage == "taa":
            self.blended = buffer
        if stage == "segmentation":
            return self.spend(buffer[0])
        if stage == "resolve" and self.traced_count == OWN:
            count = jnp.where(self.counts > 0.0, self.counts, buffer.history.count)
            return eqx.tree_at(lambda b: b.history.count, buffer, count)
        if stage == "resolve":
            told = jnp.float32(self.traced_count)
            count = jnp.where(self.counts > 0.0, told, buffer.history.count)
            return eqx.tree_at(lambda b: b.history.count, buffer, count)
        return buffer

    def spend(self, wanted: types.Segmentation) -> tuple[types.Segmentation, jax.Array]:
        """Gives the highest scores their rays, and the rest to TAA."""
        method, _ = segmentation.unpack_mask(wanted.mask)
        asking = int(jnp.sum(method == types.METHOD_ATAA))
        best, better, others = self.plan(asking, self.rays)
        # Nested, since each call keeps the highest scores.
        self.counts = jnp.zeros_like(self.counts)
        for count, upto in ((2, best + better + others), (4, best + better), (8, best)):
            kept, _ = segmentation.apply_budget(wanted, jnp.int32(upto))
            method, _ = segmentation.unpack_mask(kept.mask)
            self.counts = jnp.where(
                method == types.METHOD_ATAA, jnp.float32(count), self.counts
            )
        return segmentation.apply_budget(wanted, jnp.int32(best + better + others))

    def trace(self, inputs: types.FrameInputs) -> raytrace.RaytraceOutput:
        """Traces each count's pixels, and joins their colours to the TAA result."""
        world = self.walk.shot.world
        traced = [
            raytrace.raytrace(
                world.scene, inputs, self.counts == float(count),
                tracer=world.tracer,
                config=replace(self.walk.config.raytrace, samples=count),
            )
            for count in COUNTS
        ]  # fmt: skip
        # Images are 0 where another count, or none, was traced.
        mixture = jax.tree.map(lambda *parts: sum(parts[1:], parts[0]), *traced)
        shown = resolve.traced_pixel(
            self.blended, mixture.color, self.counts, config=resolve.Config()
        )
        return eqx.tree_at(lambda m: m.color, mixture, shown)


def measure(
    walk: walks.Walk, plan: Plan, budget: float, traced_count: int | str
) -> dict[str, float]:
    """Returns the scores of one plan."""
    mixture = Mixture(walk, plan, budget, traced_count)
    outputs = [*walks.fold(walk, mixture.step)]
    traced = [int(output.statistics.ataa_pixels) for output in outputs]
    return {
        **walks.scores(walk, outputs),
        "traced_share": float(np.mean(traced)) / walk.truth[0, ..., 0].size,
    }


def plot(table: list[tuple], file: Path) -> None:
    """Draws SSIM over the budget by plan, and by what traced pixels count as."""
    names = list(dict.fromkeys(row[0] for row in table))
    figure, axes = plt.subplots(2, len(names), figsize=(13, 8), squeeze=False)
    for (above, below), name in zip(axes.T, names, strict=True):
        rows = [row for row in table if row[0] == name]
        for plan in PLANS:
            own = [row for row in rows if (str(row[2]), row[3]) == (plan, 4)]
            x, y = [row[1] for row in own], [row[4]["ssim"] for row in own]
            above.plot(x, y, "o-" if plan.isdigit() else "s--", label=plan)
            told = [row for row in rows if (row[1], str(row[2])) == (TOLD_AT, plan)]
            order = sorted(told, key=lambda row: str(row[3]))
            x, y = [str(row[3]) for row in order], [row[4]["ssim"] for row in order]
            below.plot(x, y, "o-" if plan.isdigit() else "s--", label=plan)
        above.set(title=name, xlabel="rays a pixel", ylabel="SSIM")
        below.set(xlabel="a traced pixel counts as (0.5 rays a pixel)", ylabel="SSIM")
        for axis in (above, below):
            axis.grid(alpha=0.3)
    axes[0, 0].legend(title="rays a traced pixel")
    figure.tight_layout()
    figures.save(figure, file)


def settings() -> list[tuple[float, str, int | str]]:
    """Returns budgets, plans and what traced pixels count as.

    Of a uniform plan "own" is its number, and not measured twice.
    """
    found: list[tuple[float, str, int | str]] = []
    for budget in BUDGETS:
        for label in PLANS:
            own = () if label.isdigit() else (OWN,)
            told = (*COUNTS, *own) if budget == TOLD_AT else (4,)
            found += [(budget, label, traced_count) for traced_count in told]
    return found


def main() -> None:
    """Measures and writes table and plot."""
    names = sys.argv[1:] or scenes.available(SCENES)
    results = Path(__file__).parent / "results"
    file = results / "adaptive_samples.csv"
    for name in names:
        walk = walks.draw(scenes.shot(scenes.load(name), size=walks.SIZE))
        found = []
        for budget, label, told in settings():
            values = measure(walk, PLANS[label], budget, told)
            found.append((name, budget, label, told, values))
            shown = (f"{values[column]:.5g}" for column in COLUMNS)
            print(*found[-1][:4], *shown, flush=True)
        table = [*walks.stored(file, 4, [name]), *found]
        walks.write(file, ["scene", "budget", "rays_each", "counts_as"], table)
        plot(table, results / "adaptive_samples.png")


if __name__ == "__main__":
    main()
