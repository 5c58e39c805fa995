"""Walks with references: `playback`'s frames, scored against the truth.

A `Walk` holds a sequence's frames and their references, so that a variant costs only
the stages after raster.
"""

import csv
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
import playback
from scenes import other_rows

from ataa_jax import color as colors
from ataa_jax import metrics, pipeline, raster, reference, types
from ataa_jax import world as worlds

SIZE = (180, 320)
LEAD_IN, FRAMES = 8, 8
SAMPLES = 64  # of the reference

# Stands in for `pipeline.antialias`.
Step = Callable[
    [types.State, raster.RasterOutput, types.FrameInputs],
    tuple[pipeline.FrameOutput, types.State],
]


@dataclass(frozen=True)
class Walk:
    """A sequence of frames before antialiasing, the last of them with references."""

    shot: worlds.Sequence
    config: pipeline.Config
    params: pipeline.Params
    drawn: playback.Drawn  # lead-in first
    truth: np.ndarray  # (frames, h, w, 3) sRGB


def draw(shot: worlds.Sequence, preset: str = "tuned") -> Walk:
    """Draws the lead-in and the scored frames of a sequence for a TAA preset."""
    config, params = pipeline.preset(preset, shot.world.scene, shot.size)
    drawn = playback.draw(shot, config, params, range(-LEAD_IN, FRAMES))
    truth = [
        np.asarray(colors.display(reference.reference(shot, index, SAMPLES).color))
        for index in range(FRAMES)
    ]
    return Walk(shot, config, params, drawn, np.stack(truth))


def antialias(
    walk: Walk,
    config: pipeline.Config,
    params: pipeline.Params,
    observe: pipeline.Observe = lambda _, buffer: buffer,
) -> Iterator[pipeline.FrameOutput]:
    """Yields the scored frames of the pipeline."""
    frames = playback.antialias(walk.shot, walk.drawn, config, params, observe)
    return islice(frames, LEAD_IN, None)


def fold(walk: Walk, step: Step) -> Iterator[pipeline.FrameOutput]:
    """Yields the scored frames of anything that goes from frame to frame."""
    state = pipeline.init(walk.shot.size)
    for index, (inputs, drawn) in enumerate(walk.drawn):
        output, state = step(state, drawn, inputs)
        if index >= LEAD_IN:
            yield output


def scores(walk: Walk, outputs: list[pipeline.FrameOutput]) -> dict[str, float]:
    """Returns means over the frames: SSIM, squared error, flicker, rays a pixel."""
    images = [np.asarray(output.image) for output in outputs]
    pixels = walk.shot.size[0] * walk.shot.size[1]
    pairs = list(zip(images, walk.truth, strict=True))
    return {
        "ssim": float(np.mean([metrics.ssim(a, b) for a, b in pairs])),
        "mse": float(np.mean([metrics.mean_squared_error(a, b) for a, b in pairs])),
        "flicker": flicker(walk, images),
        "rays": float(
            np.mean([int(o.statistics.primary_rays) / pixels for o in outputs])
        ),
    }


def stored(file: Path, keys: int, scenes: list[str]) -> list[tuple]:
    """Returns the rows of a table written before, but for some scenes', which are new.

    A row is its first columns, numbers as such, and a dictionary of the others.
    """
    table = other_rows(file, scenes)
    return [
        (
            *(_number(cell) for cell in line[:keys]),
            dict(zip(table[0][keys:], map(float, line[keys:]), strict=True)),
        )
        for line in table[1:]
    ]


def write(file: Path, keys: list[str], table: list[tuple]) -> None:
    """Writes such rows."""
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([*keys, *table[0][-1]])
        for *row, values in table:
            writer.writerow([*row, *(f"{value:.5g}" for value in values.values())])


def _number(cell: str) -> str | int | float:
    for kind in (int, float):
        with suppress(ValueError):
            return kind(cell)
    return cell


def flicker(walk: Walk, images: list[np.ndarray] | np.ndarray) -> float:
    """Returns the mean of `metrics.flicker` from the second frame on."""
    changes = []
    for index in range(1, len(images)):
        gbuffer = walk.drawn[LEAD_IN + index][1].gbuffer
        changes.append(
            metrics.flicker(
                images[index],
                images[index - 1],
                np.asarray(gbuffer.motion),
                np.asarray(gbuffer.motion_valid),
            )
        )
    return float(np.mean(changes))
