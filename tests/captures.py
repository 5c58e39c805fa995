"""A capture of a small scene, made by the package's own renderer, and its mistakes."""

import functools
import shutil
from pathlib import Path

from ataa_jax import capture, world

SIZE, FRAMES = (54, 96), 6


@functools.cache
def rendered(
    frames: int = FRAMES, size: tuple[int, int] = SIZE, motion: float = 0.03
) -> tuple[capture.Capture, tuple[dict, ...]]:
    """Renders the built-in scene on a walk."""
    shot = world.shot(world.load("builtin"), "walk", size, motion=motion)
    meta, drawn = capture.render(shot, frames, reference_samples=16)
    return meta, tuple(drawn)


def copy(source: Path, target: Path) -> Path:
    shutil.copytree(source, target)
    return target
