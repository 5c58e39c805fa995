"""The paper's grey halo: what should a sparse ray read of a texture?

Found: traced pixels beside TAA's are too dark at level 0 (by 0.002 to 0.004 of luma
with the tuned TAA, 0.012 to 0.018 with UE4's at 0.5 rays a pixel). "half sample", the
default, has the better SSIM (by 0.0005 to 0.0060), squared error, flicker, error in
traced pixels and seam error than level 0, and a weaker halo, on all three scenes, both
budgets and both TAAs; with UE4's at 0.5 rays a pixel 85 to 94 % of the halo stay.
"sample" leaves the weaker halo still in ten settings of twelve, but its squared error
is above level 0's in five. "pixel" does not help on Sponza (SSIM −0.004 to −0.017) nor
on the built-in scene without a budget.

Traced rays read mip level 0 (the paper), or what a rasterizer would at the whole pixel
("pixel"), or their whole share of it ("sample"), or half of that, the default ("half
sample"); see `raytrace.Config.footprint`, and `ray_footprint.py` for the half. A
typical walk at 320×180 against 64 samples a pixel at mip level 0, with a budget of 0.5
sparse rays a pixel and without one; with the tuned TAA, whose raster textures are
sharpened by a mip bias of −2, and with UE4's at bias 0, the paper's case.

A *seam pixel* is traced, with a pixel of TAA's within 2 px of it (5×5); its *step* is
the mean luma of the traced pixels in its 5×5 less that of TAA's there, in sRGB.
``seam`` is the mean |step| less the reference's mean |step| at the same pixels (the
scene's own edges), ``step_error`` the mean |step − reference's step|, ``halo`` the mean
of step − reference's step signed: below 0 the traced side is too dark. All three,
and ``traced_mse``, are of the pixels that every footprint's run gave the same method.

    python experiments/grey_halo.py           # writes results/grey_halo.csv, .png
    python experiments/grey_halo.py sponza    # measures this scene's rows anew
"""

import sys
from dataclasses import replace
from pathlib import Path

import figures
import numpy as np
import scenes
import walks
from matplotlib import pyplot as plt
from scipy.ndimage import uniform_filter

from ataa_jax import metrics, pipeline, types
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
# What the rays read: `raytrace.Config.footprint`, and its scale.
FOOTPRINTS = {
    "level0": ("level0", 1.0),
    "pixel": ("pixel", 1.0),
    "sample": ("sample", 1.0),
    "half sample": ("sample", 0.5),  # the default
}
BUDGETS = (0.5, float("inf"))
# TAA → the preset that has it under the paper's criteria.
TAAS = {"tuned": "paper", "ue4": "ue4"}
REACH = 5  # px: the side of a box that reaches 2 px either way
COLUMNS = (
    *("ssim", "mse", "flicker", "rays"),
    *("traced_mse", "seam", "step_error", "halo"),
)
LUMA = np.array([0.2126, 0.7152, 0.0722])


def steps(
    image: np.ndarray, traced: np.ndarray, untraced: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the luma step at every seam pixel, and where those are."""

    def mean(where: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = uniform_filter(where.astype(float), REACH, mode="constant")
        total = uniform_filter(np.where(where, luma, 0.0), REACH, mode="constant")
        some = share > 0.5 / REACH**2  # at least one pixel, but for rounding
        return total / np.where(some, share, 1.0), some

    luma = image.astype(float) @ LUMA
    inside, _ = mean(traced)
    outside, near = mean(untraced)
    return inside - outside, traced & near


def seams(
    images: np.ndarray, truth: np.ndarray, traced: np.ndarray, untraced: np.ndarray
) -> dict[str, float]:
    """Returns the three measures of the seam, over all frames' seam pixels."""
    found, exact = [], []
    for image, right, inside, outside in zip(
        images, truth, traced, untraced, strict=True
    ):
        step, seam = steps(image, inside, outside)
        found.append(step[seam])
        exact.append(steps(right, inside, outside)[0][seam])
    step, own = np.concatenate(found), np.concatenate(exact)
    return {
        "seam": float(np.abs(step).mean() - np.abs(own).mean()),
        "step_error": float(np.abs(step - own).mean()),
        "halo": float((step - own).mean()),
    }


def measure(walk: walks.Walk, budget: float) -> dict[str, dict[str, float]]:
    """Returns every footprint's scores."""
    params = pipeline.with_budget(walk.params, budget)
    runs = {}
    for name, (footprint, scale) in FOOTPRINTS.items():
        rays = replace(walk.config.raytrace, footprint=footprint, footprint_scale=scale)
        config = replace(walk.config, raytrace=rays)
        runs[name] = list(walks.antialias(walk, config, params))
    methods = np.stack(
        [[np.asarray(o.segmentation.mask) & 0xFFFF for o in r] for r in runs.values()]
    )
    traced = np.all(methods == types.METHOD_ATAA, axis=0)
    untraced = np.all(methods == types.METHOD_TAA, axis=0)
    found = {}
    for footprint, outputs in runs.items():
        images = np.stack([np.asarray(output.image) for output in outputs])
        error = [
            metrics.mean_squared_error(*each)
            for each in zip(images, walk.truth, traced, strict=True)
        ]
        found[footprint] = {
            **walks.scores(walk, outputs),
            "traced_mse": float(np.mean(error)),
            **seams(images, walk.truth, traced, untraced),
        }
    return found


def plot(table: list[tuple], file: Path) -> None:
    """Draws four measures, a group of bars per scene, TAA and budget."""
    keys = list(dict.fromkeys(row[:3] for row in table))
    values = {row[:4]: row[4] for row in table}
    names = [f"{s}\n{p}\n{b:g}".replace("inf", "no cap") for s, p, b in keys]
    figure, axes = plt.subplots(2, 2, figsize=(13, 8))
    for axis, column in zip(
        axes.flat, ("ssim", "traced_mse", "step_error", "halo"), strict=True
    ):
        for number, footprint in enumerate(FOOTPRINTS):
            y = [values.get((*key, footprint), {}).get(column, np.nan) for key in keys]
            if column == "ssim":
                y = np.subtract(y, [values[*key, "level0"][column] for key in keys])
            x = np.arange(len(y)) + 0.2 * (number - 1.5)
            axis.bar(x, y, 0.2, label=footprint)
        axis.set_xticks(range(len(names)), names, fontsize=6)
        title = "ssim less level0's" if column == "ssim" else column
        axis.set_title(title.replace("_", " "))
        axis.grid(axis="y", alpha=0.3)
    axes[0, 0].legend()
    figure.tight_layout()
    figures.save(figure, file)


def main() -> None:
    """Measures and writes table and plot."""
    names = sys.argv[1:] or scenes.available(SCENES)
    results = Path(__file__).parent / "results"
    file = results / "grey_halo.csv"
    for name in names:
        shot = scenes.shot(scenes.load(name), size=walks.SIZE)
        found = []
        for taa, preset in TAAS.items():
            walk = walks.draw(shot, preset)
            for budget in BUDGETS:
                for footprint, values in measure(walk, budget).items():
                    found.append((name, taa, budget, footprint, values))
                    shown = (f"{values[column]:.5g}" for column in COLUMNS)
                    print(*found[-1][:4], *shown, flush=True)
        table = [*walks.stored(file, 4, [name]), *found]
        walks.write(file, ["scene", "taa", "budget", "footprint"], table)
        plot(table, results / "grey_halo.png")


if __name__ == "__main__":
    main()
