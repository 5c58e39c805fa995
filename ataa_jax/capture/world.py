"""A capture made by the package's own renderer: test data, and a pattern to compare."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import numpy as np

from ataa_jax import pipeline, raster, reference, sampling
from ataa_jax.capture.conventions import Conventions, Frame, Pose
from ataa_jax.capture.record import Capture
from ataa_jax.world import Sequence


def render(
    shot: Sequence,
    frames: int,
    *,
    reference_samples: int = 64,
    samples: tuple[int, ...] = (2, 4, 8),
    center: bool = True,
    progress: Callable[[int], None] = lambda frame: None,
) -> tuple[Capture, Iterator[dict[str, np.ndarray]]]:
    """Renders a sequence as an engine would capture it; see `plain.write`.

    Args:
        shot: the world along a path.
        frames: how many.
        reference_samples: of the truth, a pixel.
        samples: the supersampled images that stand in for rays.
        center: also one sample at the pixel centre, for the methods without history.
        progress: called after every frame.

    Returns:
        Metadata, and an iterator that draws each frame's images.
    """
    config, params = pipeline.preset("tuned", shot.world.scene, shot.size)
    jitter = sampling.halton_jitter(config.taa.jitter_length)
    metas = [_frame(shot, k, jitter[k % len(jitter)]) for k in range(frames)]

    def draw() -> Iterator[dict[str, np.ndarray]]:
        for k in range(frames):
            inputs = shot.inputs(k, jitter[k % len(jitter)])
            out = raster.raster(
                shot.world.scene,
                inputs,
                params.raster,
                tracer=shot.world.tracer,
                config=config.raster,
            )
            g = out.gbuffer
            held = {"color": out.color, "depth": g.depth, "motion": g.motion}
            held["motion_valid"] = g.motion_valid
            if center:
                held["center"] = _samples(shot, k, np.zeros((1, 2), np.float32))
            for count in samples:
                held[f"samples{count}"] = _samples(shot, k, sampling.pattern(count))
            truth = sampling.reference_pattern(reference_samples)
            held["reference"] = _samples(shot, k, truth)
            progress(k)
            yield {kind: np.asarray(image) for kind, image in held.items()}

    capture = Capture(
        name=shot.world.name,
        folder=Path(),
        layout="plain",
        size=shot.size,
        frames=tuple(metas),
        conventions=Conventions(),
        fps=shot.path.fps,
        reference_samples=reference_samples,
        sample_counts=samples,
    )
    return capture, draw()


def _frame(shot: Sequence, frame: int, jitter: np.ndarray) -> Frame:
    pose = shot.pose(frame)
    tan_y = math.tan(pose.fov_y / 2.0)
    aspect = shot.size[1] / shot.size[0]
    return Frame(
        number=frame,
        layers={},
        jitter=(float(jitter[0]), float(jitter[1])),
        cut=frame == 0,
        pose=Pose(np.asarray(pose.world_from_view), (tan_y * aspect, tan_y)),
    )


def _samples(shot: Sequence, frame: int, offsets: np.ndarray) -> jax.Array:
    inputs = shot.inputs(frame)
    return reference.supersample(shot.world, inputs, offsets, shot.size).color
