"""A capture of a small scene, made by the package's own renderer, and its mistakes."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ataa_jax import capture, color, world
from ataa_jax.capture.conventions import Conventions, Frame
from ataa_jax.capture.record import Capture

SIZE, FRAMES = (54, 96), 6
NEAR, FAR = 0.1, 200.0
Images = list[dict[str, np.ndarray]]


@functools.cache
def built_in() -> world.World:
    """Loads the scene once: another tracer would compile every stage anew."""
    return world.load("builtin")


@functools.cache
def rendered(
    frames: int = FRAMES, size: tuple[int, int] = SIZE, motion: float = 0.03
) -> tuple[Capture, tuple[dict[str, np.ndarray], ...]]:
    """Renders the built-in scene on a walk."""
    shot = world.shot(built_in(), "walk", size, motion=motion)
    meta, drawn = capture.render(shot, frames, reference_samples=16)
    return meta, tuple(drawn)


@dataclass
class Draft:
    """A capture in memory, open to mistakes."""

    meta: Capture
    images: Images

    def write(self, folder: Path) -> Path:
        capture.write(folder, self.meta, self.images)
        return folder

    def declare(self, **values: object) -> "Draft":
        found = replace(self.meta.conventions, **values)  # type: ignore[arg-type]
        self.meta = replace(self.meta, conventions=found)
        return self

    def each(self, change: Callable[[Frame], Frame]) -> "Draft":
        self.meta = replace(self.meta, frames=tuple(map(change, self.meta.frames)))
        return self

    def paint(self, kind: str, change: Callable[[np.ndarray], np.ndarray]) -> "Draft":
        for held in self.images:
            held[kind] = change(held[kind])
        return self

    def uv(self) -> "Draft":
        """Stores motion in UV, and says so."""
        size = np.array([SIZE[1], SIZE[0]], np.float32)
        return self.paint("motion", lambda m: m / size).declare(motion_unit="uv")

    def device(self, far: float = FAR, *, reverse: bool = False) -> "Draft":
        """Stores depth as a forward device has it, and says so."""

        def encode(z: np.ndarray) -> np.ndarray:
            share = 1.0 if np.isinf(far) else far / (far - NEAR)
            d = share * (1.0 - NEAR / z.astype(np.float64))
            return np.where(np.isinf(z), 1.0, np.minimum(d, 1.0)).astype(np.float32)

        self.paint("depth", encode)
        self.each(lambda f: replace(f, near=NEAR, far=far))
        if reverse:
            self.paint("depth", lambda d: np.float32(1.0) - d)
        return self.declare(depth="device reversed" if reverse else "device")

    def blind(self) -> "Draft":
        """Leaves the camera out."""
        return self.each(lambda f: replace(f, pose=None))

    def without(self, *kinds: str) -> "Draft":
        """Leaves images out."""
        for held in self.images:
            for kind in kinds:
                held.pop(kind, None)
        if "reference" in kinds:
            self.meta = replace(self.meta, reference_samples=None)
        return self


def draft(**options: object) -> Draft:
    """Returns a correct capture: Conventions() in everything, no sample images."""
    meta, frames = rendered(**options)  # type: ignore[arg-type]
    images = [dict(held) for held in frames]
    made = Draft(replace(meta, conventions=Conventions()), images)
    return made.without("samples2", "samples4", "samples8")


def displayed(image: np.ndarray) -> np.ndarray:
    return np.asarray(color.display(jnp.asarray(image)))


def tonemapped(image: np.ndarray) -> np.ndarray:
    return np.asarray(color.tonemap(jnp.asarray(image)))
