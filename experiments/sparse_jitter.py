"""Temporal jitter of the sparse rays, which the paper leaves to future work.

Found: by itself jitter loses in all but three of 18 settings (still; 2 rays gain 0.002
and 0.006 of SSIM, 4 rays 0.001): a traced colour that replaces the history only
flickers more. What helps is that the traced colour joins the history in place of
replacing it. 8 rays gain 0.0006 to 0.0015 of SSIM in motion, 4 rays 0.002 to 0.010, 2
rays 0.013 to 0.045, and 4 rays that join are above 8 that replace on all three scenes
in motion (0.9217 against 0.9181, 0.9654 against 0.9630, 0.9834 against 0.9829). Where
colours join, jitter adds 0.001 to 0.022 to still images of 2 and 4 rays, and nothing to
8 rays or in motion (−0.002 to +0.001).

The n-rooks pattern of the traced pixels stands still (the paper), or moves with the
frame's Halton jitter, round the pixel's edges; see `raytrace.Config.jitter`. 2, 4 and 8
rays a traced pixel at 0.5 rays a pixel, a typical walk and a still camera at 320×180,
against 64 samples a pixel. A traced colour replaces the TAA result (the paper's
resolve), or joins it (the default); see `resolve.Config.traced`.

    python experiments/sparse_jitter.py       # writes results/sparse_jitter.csv, .png
"""

import sys
from dataclasses import replace
from pathlib import Path

import figures
import scenes
import walks
from matplotlib import pyplot as plt

from ataa_jax import resolve
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
COUNTS = (2, 4, 8)
COLUMNS = ("ssim", "mse", "flicker", "rays")
VARIANTS: dict[str, tuple[bool, resolve.Traced]] = {  # name: (jitter, traced)
    "fixed": (False, "replace"),
    "jittered": (True, "replace"),
    "fixed, joined": (False, "join"),
    "jittered, joined": (True, "join"),
}


def shots(name: str) -> dict[str, worlds.Sequence]:
    """Returns a scene's walk, and its camera at rest with time stopped."""
    world = scenes.load(name)
    stopped = replace(world, source=replace(world.source, duration=0.0))
    return {
        "walk": scenes.shot(world, size=walks.SIZE),
        "still": scenes.shot(stopped, "still", size=walks.SIZE),
    }


def measure(walk: walks.Walk) -> dict[tuple[int, str], dict[str, float]]:
    """Returns the scores of TAA alone, of every count and variant, and the truth's."""
    plain = replace(walk.config, adaptive=False)
    found = {
        (0, "taa"): walks.scores(walk, [*walks.antialias(walk, plain, walk.params)])
    }
    for samples in COUNTS:
        for label, (jitter, traced) in VARIANTS.items():
            config = replace(
                walk.config,
                raytrace=replace(walk.config.raytrace, samples=samples, jitter=jitter),
                resolve=replace(walk.config.resolve, traced=traced),
            )
            outputs = [*walks.antialias(walk, config, walk.params)]
            found[samples, label] = walks.scores(walk, outputs)
    found[walks.SAMPLES, "reference"] = {
        "ssim": 1.0,
        "mse": 0.0,
        "flicker": walks.flicker(walk, walk.truth),
        "rays": float(walks.SAMPLES),
    }
    return found


def plot(table: list[tuple], file: Path) -> None:
    """Draws SSIM against flicker: a panel a scene and path, a line a variant."""
    panels = list(dict.fromkeys(row[:2] for row in table))
    figure, axes = plt.subplots(len(panels) // 2, 2, figsize=(10, 10), squeeze=False)
    for axis, panel in zip(axes.flat, panels, strict=True):
        rows = [row for row in table if row[:2] == panel]
        for label in ("taa", *VARIANTS):
            own = [row for row in rows if row[3] == label]
            x, y = ([row[4][c] for row in own] for c in ("flicker", "ssim"))
            axis.plot(x, y, "o-", label=label, ms=4)
            for row in own:
                at = (row[4]["flicker"], row[4]["ssim"])
                axis.annotate(str(row[2] or 1), at, fontsize=7)
        axis.axvline(rows[-1][4]["flicker"], color="gray", ls=":", label="reference's")
        axis.set(title=", ".join(panel), xlabel="flicker", ylabel="SSIM")
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figures.save(figure, file)


def main() -> None:
    """Measures and writes table and plot."""
    names = sys.argv[1:] or scenes.available(SCENES)
    results = Path(__file__).parent / "results"
    file = results / "sparse_jitter.csv"
    for name in names:
        found = []
        for path, shot in shots(name).items():
            for (samples, label), values in measure(walks.draw(shot)).items():
                found.append((name, path, samples, label, values))
                shown = (f"{values[column]:.5g}" for column in COLUMNS)
                print(*found[-1][:4], *shown, flush=True)
        table = [*walks.stored(file, 4, [name]), *found]
        walks.write(file, ["scene", "path", "samples", "variant"], table)
        plot(table, results / "sparse_jitter.png")


if __name__ == "__main__":
    main()
