"""Quality against rays and milliseconds: the price of a ray swept.

    python experiments/pareto.py     # writes results/pareto.csv and pareto.png

Three scenes, walks of typical motion, 12 frames of 320×180 after 8 that are not scored.
The relaxed fit is solved at each price a ray, and spends the rays that are worth it;
its weights and threshold then run hard, in closed loop. At the same rays stand the
paper's equal weights, the best of the grid (`fit_thresholds.py grid`) for these scenes
at 0.5 rays a pixel, random pixels and the oracle mask. Milliseconds are of a whole
frame of the pipeline, tracing with Embree, the median of some: processor time of all
threads, and beside it the clock's.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

import figures
import fit_thresholds
import jax
import jax.numpy as jnp
import numpy as np
import scenes
from matplotlib import pyplot as plt

from ataa_jax import fit as fits
from ataa_jax import pipeline, sampling
from ataa_jax import world as worlds
from ataa_jax.fit import relaxed, score, soft, space, yardsticks
from ataa_jax.stopwatch import Lap, Stopwatch

RESULTS = Path(__file__).parent / "results"
SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
SIZE, FRAMES = (180, 320), 12
PRICES = (0.2, 0.1, 0.05, 0.025, 0.0125, 0.006, 0.003, 0.0015)
TERMS = ("luminance", "depth", "response")
HEAD = (
    "scene", "price", "contender", "rays", "ssim", "frame_processor_ms", "frame_ms",
)  # fmt: skip


def record(name: str) -> tuple[worlds.Sequence, fits.Recording]:
    shot = scenes.shot(scenes.load(name), size=SIZE)
    return shot, fits.record(shot, frames=FRAMES)


def milliseconds(
    shot: worlds.Sequence, config: pipeline.Config, params: pipeline.Params
) -> Lap:
    """Returns the median time of a frame, the first two left out: they compile."""
    jitter = sampling.halton_jitter(config.taa.jitter_length)
    state, times = pipeline.init(SIZE), []
    for index in range(6):
        inputs = shot.inputs(index, jitter[index])
        watch = Stopwatch()
        output, state = pipeline.frame(
            state,
            inputs,
            params,
            scene=shot.world.scene,
            tracer=shot.world.tracer,
            config=config,
        )
        jax.block_until_ready(output.image)
        times.append(watch.lap())
    return Lap(*np.median(times[2:], axis=0))


def sweep(name: str) -> list[tuple]:
    """Returns the rows of one scene."""
    shot, made = record(name)
    plain = fits.Take.of(made)
    take = plain.under(space.switched(plain.config.segmentation, TERMS))
    quantities = space.weights(TERMS)
    start = space.place(made.params, (space.HOLD,), jnp.zeros(1))
    threshold = score.at_budget(take, start, 0.5).threshold
    first = jnp.log(jnp.asarray([1.0] * len(quantities) + [threshold]))
    point, _, _ = fit_thresholds.best_of_grid(SCENES)
    gridded = space.place(made.params, fit_thresholds.SEARCHED, jnp.asarray(point))
    rows = []
    for price in PRICES:
        current, y = start, first
        for _ in range(2):  # record, fit, replay, fit again
            own = space.with_threshold(
                current, jnp.exp(y[-1]), take.config.segmentation
            )
            pixels = relaxed.gather((take,), (own,), TERMS)
            y = soft.at_price(y, pixels, price, take.samples, quantities)
            current = soft.with_weights(current, quantities, jnp.exp(y[:-1]))
        own = space.with_threshold(current, jnp.exp(y[-1]), take.config.segmentation)
        fitted = score.as_is(take, own)
        config = pipeline.Config(
            raster=made.config.raster,
            taa=made.config.taa,
            segmentation=take.config.segmentation,
            raytrace=made.config.raytrace,
        )
        rows.append(
            (name, price, "fitted", fitted.rays, fitted.ssim,
             *_both(milliseconds(shot, config, own)))
        )  # fmt: skip
        if 0.0 < fitted.rays < take.samples:
            equal = score.at_budget(plain, made.params, fitted.rays)
            numbers = space.with_threshold(
                made.params, jnp.float32(equal.threshold), plain.config.segmentation
            )
            ms = _both(milliseconds(shot, made.config, numbers))
            rows.append((name, price, "equal", equal.rays, equal.ssim, *ms))
            none = (float("nan"), float("nan"))
            others = {
                "grid": score.at_budget(take, gridded, fitted.rays),
                "random": yardsticks.random(plain, made.params, fitted.rays),
                "oracle": yardsticks.oracle(plain, made.params, fitted.rays),
            }
            rows += [
                (name, price, contender, found.rays, found.ssim, *none)
                for contender, found in others.items()
            ]
        for each in rows:
            if each[1] == price:
                print(*each, flush=True)
    return rows


def _both(lap: Lap) -> tuple[float, float]:
    return lap.processor_ms, lap.clock_ms


def draw(rows: Sequence[tuple], file: Path) -> None:
    """Draws quality against rays (above) and milliseconds (below), a scene a column."""
    names = list(dict.fromkeys(r[0] for r in rows))
    figure, axes = plt.subplots(
        2, len(names), figsize=(4 * len(names), 6), squeeze=False
    )
    for column, name in enumerate(names):
        for contender in ("oracle", "fitted", "grid", "equal", "random"):
            own = [r for r in rows if r[0] == name and r[2] == contender]
            own.sort(key=lambda r: r[3])
            for line, x in ((0, 3), (1, 5)):
                axes[line][column].plot(
                    [r[x] for r in own], [r[4] for r in own], "o-", label=contender
                )
        axes[0][column].set_title(name)
        axes[0][column].set_xlabel("rays a pixel")
        axes[1][column].set_xlabel("ms a frame, of all threads")
    for line in axes:
        line[0].set_ylabel("SSIM")
    axes[0][0].legend()
    figure.tight_layout()
    figures.save(figure, file, dpi=100)


def main() -> None:
    """Sweeps, writes the table and the figure."""
    rows = [row for name in scenes.available(SCENES) for row in sweep(name)]
    with (RESULTS / "pareto.csv").open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEAD)
        for name, price, contender, rays, ssim, *ms in rows:
            times = [f"{each:.1f}" for each in ms]
            writer.writerow(
                [name, price, contender, f"{rays:.4f}", f"{ssim:.5f}", *times]
            )
    draw(rows, RESULTS / "pareto.png")


if __name__ == "__main__":
    main()
