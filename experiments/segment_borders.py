"""Do the boundaries between segmented regions flicker, and where does ATAA's gain lie?

Paper, section 3: the quality at traced pixels is "comparable to 8x supersampling
everywhere; were it not, the boundaries between segmented regions would flicker".
Typical motion at 320×180, 8 frames after 8 of lead-in, 64 reference samples. TAA,
ATAA 8x within 0.5 rays a pixel, the same without a budget, and *8x everywhere* (ATAA
with every pixel traced that is not FXAA's) are looked at in the same regions of the two
ATAA masks: *border*: within 2 pixels of another class; *changed*: another class than
the frame before's along motion; *TAA*, *ATAA*: inside a class, off its border.
*flicker* is the mean change of colour along motion, whose value in the reference is the
scene's own; *error flicker* is the change of image − reference along motion, which the
scene's own change is not part of. The boundaries flicker of themselves if ATAA's
error flickers more there than that of TAA, which has no boundaries.

Squared error, too, is told apart by place: *edges*: another object, or a depth edge
(Sobel term over 0.1), within 1 px in the G-buffer; *surfaces*: the rest of what is not
sky. Only edges tell of geometric antialiasing; TAA's raster reads filtered mips, traced
pixels and reference read level 0, so that surfaces tell of mip sharpness as well.

Found: without a budget borders do not flicker of themselves: their error flickers 8 to
23 % less than under TAA and −5 to +5 % against 8x everywhere; pixels that change class
flicker 5 to 23 % more than there. With the budget the claim holds against TAA alone (7
to 17 % less): against 8x everywhere borders flicker 8 to 18 % more, changes 15 to 32 %.
Of the squared error that ATAA removes from TAA's within the budget, edges hold 93, 79
and 94 % (built-in scene, Sponza, ship) and surfaces 6, 21 and 5 %; without a budget
surfaces' part of the gain is 16, 38 and 12 %.

    python experiments/segment_borders.py     # writes results/segment_borders.csv, .png
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import figures
import jax.numpy as jnp
import numpy as np
import playback
import scenes
from matplotlib import pyplot as plt
from scipy import ndimage

from ataa_jax import color as colors
from ataa_jax import metrics, pipeline, reference, terms, types, window
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
SIZE = (180, 320)
LEAD_IN, FRAMES = 8, 8
SAMPLES = 64
NEAR_PX = 2
DEPTH_EDGE = 0.1  # the segmentation's own threshold of this term alone
ATAA = {"ataa8": 0.5, "ataa8, no budget": float("inf")}  # rays a pixel
FLICKER_REGIONS = ("border", "changed", "TAA", "ATAA")
ERROR_REGIONS = ("edges", "surfaces", "sky")
COLUMNS = (
    *("scene", "mask_of", "region", "share", "method"),
    *("flicker", "reference_flicker", "error_flicker", "squared_error"),
    "share_of_squared_error",
)
_Row = tuple[str, str, str, float, str, float, float, float, float, float]


@dataclass(frozen=True)
class Run:
    """One method's frames: sRGB images and methods of every pixel."""

    images: np.ndarray  # (frames, h, w, 3)
    masks: np.ndarray  # (frames, h, w)


def render(
    shot: worlds.Sequence,
    drawn: playback.Drawn,
    config: pipeline.Config,
    params: pipeline.Params,
) -> Run:
    """Returns the frames from −1 on: the first is only looked back at."""
    outputs = list(playback.antialias(shot, drawn, config, params))[LEAD_IN - 1 :]
    return Run(
        np.stack([np.asarray(o.image) for o in outputs]),
        np.stack([playback.methods(o) for o in outputs]),
    )


def runs(shot: worlds.Sequence) -> tuple[dict[str, Run], list[types.GBuffer]]:
    """Returns every method's frames, and the G-buffers of the unjittered view."""
    config, params = pipeline.preset("paper", shot.world.scene, SIZE)
    drawn = playback.draw(shot, config, params, range(-LEAD_IN, FRAMES))
    found = {"taa": render(shot, drawn, replace(config, adaptive=False), params)}
    for name, budget in ATAA.items():
        limited = pipeline.with_budget(params, budget)
        found[name] = render(shot, drawn, config, limited)
    free = pipeline.with_budget(params, float("inf"))
    everywhere = pipeline.with_threshold(free, -1.0)  # scores are at least 0
    found["8x everywhere"] = render(shot, drawn, config, everywhere)
    truth = [
        np.asarray(colors.display(reference.reference(shot, k, SAMPLES).color))
        for k in range(-1, FRAMES)
    ]
    found["reference"] = Run(np.stack(truth), np.zeros((FRAMES + 1, *SIZE), int))
    centred = playback.draw(shot, config, params, range(-1, FRAMES), jitter=False)
    return found, [output.gbuffer for _, output in centred]


def classes(mask: np.ndarray, before: np.ndarray) -> dict[str, np.ndarray]:
    """Returns the regions of a mask, given the one before, along motion."""
    size = 2 * NEAR_PX + 1
    highest = ndimage.maximum_filter(mask, size, mode="nearest")
    border = highest != ndimage.minimum_filter(mask, size, mode="nearest")
    found = {"border": border, "changed": mask != before}
    for name, method in (("TAA", types.METHOD_TAA), ("ATAA", types.METHOD_ATAA)):
        found[name] = (mask == method) & ~border
    return found


def places(gbuffer: types.GBuffer) -> dict[str, np.ndarray]:
    """Returns geometric edges, surfaces off the edges, and sky."""
    edge = np.asarray(
        (terms.id_edge(gbuffer.object) > 0.0)
        | (terms.depth_edge(gbuffer.depth) > DEPTH_EDGE)
    )
    sky = np.asarray(gbuffer.object) < 0
    return {"edges": edge, "surfaces": ~edge & ~sky, "sky": ~edge & sky}


def back(gbuffer: types.GBuffer, before: np.ndarray) -> np.ndarray:
    """Returns a plane of the frame before, at the nearest pixel along motion."""
    motion = jnp.asarray(gbuffer.motion)
    row, column = window.history_position(motion[..., 0], motion[..., 1])
    return before.reshape(-1)[np.asarray(window.nearest_index(row, column))]


def rows(
    scene: str, found: dict[str, Run], gbuffers: list[types.GBuffer]
) -> Iterator[_Row]:
    """Yields the table: every method in every region, pooled over the frames."""
    exact = found["reference"].images
    pooled: dict[tuple[str, str], list[np.ndarray]] = {}
    change: dict[str, list[np.ndarray]] = {name: [] for name in found}
    error: dict[str, list[np.ndarray]] = {name: [] for name in found}
    valid = []
    for k in range(1, FRAMES + 1):
        gbuffer = gbuffers[k]
        motion = np.asarray(gbuffer.motion)
        valid.append(np.asarray(gbuffer.motion_valid))
        for mask_of in ATAA:
            masks = found[mask_of].masks
            regions = classes(masks[k], back(gbuffer, masks[k - 1]))
            for name, where in (regions | places(gbuffer)).items():
                pooled.setdefault((mask_of, name), []).append(where)
        for name, run in found.items():
            now, then = run.images[k], run.images[k - 1]
            change[name].append(metrics.change_along_motion(now, then, motion))
            wrong, wrong_then = now - exact[k], then - exact[k - 1]
            error[name].append(metrics.change_along_motion(wrong, wrong_then, motion))
    seen = np.stack(valid)
    for (mask_of, region), planes in pooled.items():
        where = np.stack(planes)
        both = where & seen
        if not both.any() or (region in ERROR_REGIONS and mask_of != "ataa8"):
            continue
        for name, run in found.items():
            squared = ((run.images[1:] - exact[1:]) ** 2).mean(axis=-1)
            total = float(squared.sum())
            yield (
                *(scene, mask_of if region in FLICKER_REGIONS else "-", region),
                *(float(where.mean()), name),
                float(np.stack(change[name])[both].mean()),
                float(np.stack(change["reference"])[both].mean()),
                float(np.stack(error[name])[both].mean()),
                float(squared[where].mean()),
                float(squared[where].sum()) / total if total > 0.0 else 0.0,
            )


def main() -> None:
    """Measures and writes table and plot."""
    names = scenes.available(SCENES)
    table: list[_Row] = []
    for name in names:
        shot = scenes.shot(scenes.load(name), size=SIZE)
        for row in rows(name, *runs(shot)):
            table.append(row)
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in row), flush=True)
    playback.write(playback.RESULTS / "segment_borders.csv", COLUMNS, table)
    plot(table, names)


def plot(table: list[_Row], names: list[str]) -> None:
    """Draws error flicker by region of ATAA's mask, and squared error by place."""
    palette = {
        **{"taa": "#2f66cf", "ataa8": "#e0b400", "ataa8, no budget": "#c08a00"},
        "8x everywhere": "#15181c",
    }
    panels = (
        ("ataa8, no budget", FLICKER_REGIONS, 7, "error flicker, no budget"),
        ("-", ERROR_REGIONS, 8, "squared error"),
    )
    figure, axes = plt.subplots(2, len(names), figsize=(11, 6.5), squeeze=False)
    for line, (mask_of, regions, column, label) in enumerate(panels):
        for panel, scene in zip(axes[line], names, strict=True):
            for k, (method, color) in enumerate(palette.items()):
                value = {
                    r[2]: float(str(r[column]))
                    for r in table
                    if r[0] == scene and r[1] == mask_of and r[4] == method
                }
                y = [value.get(region, np.nan) for region in regions]
                x = np.arange(len(regions)) + 0.2 * (k - 1.5)
                panel.bar(x, y, 0.19, color=color, label=method)
            panel.set_xticks(np.arange(len(regions)), regions)
            panel.set_title(scene, fontsize=10)
            panel.grid(axis="y", alpha=0.3)
        axes[line, 0].set_ylabel(label)
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    file = playback.RESULTS / "segment_borders.png"
    figures.save(figure, file, dpi=100)


if __name__ == "__main__":
    main()
