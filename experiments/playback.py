"""Frames drawn once and antialiased by many variants, and what their masks share.

Raster does not depend on the stages behind it: variants that differ in segmentation,
resolve or budget get the same draws.
"""

import csv
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ataa_jax import pipeline, raster, sampling, types
from ataa_jax import world as worlds

RESULTS = Path(__file__).parent / "results"

Drawn = list[tuple[types.FrameInputs, raster.RasterOutput]]


def draw(
    shot: worlds.Sequence,
    config: pipeline.Config,
    params: pipeline.Params,
    frames: range,
    *,
    still: bool = False,
    jitter: bool = True,
) -> Drawn:
    """Draws the frames with the preset's jitter; the first one is cut.

    Args:
        shot: the world along a path.
        config: its raster and its TAA's jitter are used.
        params: its raster's are used.
        frames: indices along the path.
        still: stay at the first frame's time and camera, jittering on.
        jitter: False: sample the pixels' centres.
    """
    offsets = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    if not jitter:
        offsets = np.zeros_like(offsets)
    drawn = []
    for count, index in enumerate(frames):
        at = frames.start if still else index
        inputs = shot.inputs(at, offsets[count % len(offsets)])
        if still:
            inputs = types.FrameInputs(
                camera=inputs.camera,
                previous_camera=inputs.camera,
                world_from_group=inputs.world_from_group,
                previous_world_from_group=inputs.world_from_group,
                jitter=inputs.jitter,
                cut=inputs.cut,
            )
        inputs = pipeline.with_cut(inputs, count == 0)
        output = raster.raster(
            shot.world.scene,
            inputs,
            params.raster,
            tracer=shot.world.tracer,
            config=config.raster,
        )
        drawn.append((inputs, output))
    return drawn


def antialias(
    shot: worlds.Sequence,
    drawn: Drawn,
    config: pipeline.Config,
    params: pipeline.Params,
    observe: pipeline.Observe = lambda _, buffers: buffers,
) -> Iterator[pipeline.FrameOutput]:
    """Yields every frame's buffers under one variant, from no history on."""
    state = pipeline.init(shot.size)
    for inputs, raw in drawn:
        output, state = pipeline.antialias(
            state,
            raw,
            inputs,
            params,
            scene=shot.world.scene,
            tracer=shot.world.tracer,
            config=config,
            observe=observe,
        )
        yield output


def methods(output: pipeline.FrameOutput) -> np.ndarray:
    """Returns each pixel's METHOD_*."""
    return np.asarray(output.segmentation.mask) & 0xFFFF


def write(file: Path, head: Iterable[str], table: Iterable[Iterable[object]]) -> None:
    """Writes a table; numbers with five digits."""
    file.parent.mkdir(exist_ok=True)
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(head)
        for row in table:
            writer.writerow(f"{v:.5g}" if isinstance(v, float) else v for v in row)
