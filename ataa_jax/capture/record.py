"""What a captured sequence is, whichever layout it came in.

A `Capture` knows for every frame which channels of which files hold what, and by which
`Conventions` they are to be understood. `Capture.draw` gives what the raster stage
would: colour and G-buffer in the package's own conventions.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ataa_jax import color as colors
from ataa_jax.capture import exr
from ataa_jax.capture.conventions import Conventions, Frame, Pose
from ataa_jax.capture.findings import Finding
from ataa_jax.capture.readings import (
    linear_color,
    linear_depth,
    motion_px,
    sky_motion,
    valid_motion,
)
from ataa_jax.errors import InputError
from ataa_jax.raster import RasterOutput
from ataa_jax.raytrace import RaytraceOutput
from ataa_jax.shading import no_rays
from ataa_jax.types import Camera, FrameInputs, GBuffer


@dataclass(frozen=True, eq=False)
class Raw:
    """One frame's images as stored."""

    color: np.ndarray  # (h, w, 3) float32
    depth: np.ndarray  # (h, w) float32
    motion: np.ndarray  # (h, w, 2) float32
    motion_valid: np.ndarray | None  # (h, w) bool


@dataclass(frozen=True, eq=False)
class Capture:
    """A captured sequence."""

    name: str
    folder: Path
    layout: str  # plain, nss or blender
    size: tuple[int, int]  # height, width
    frames: tuple[Frame, ...]
    conventions: Conventions
    fps: float = 30.0
    # Samples a pixel of the reference; None where there is none, 0 where nobody says.
    reference_samples: int | None = None
    # Samples a pixel of the images that stand in for rays, where there are any.
    sample_counts: tuple[int, ...] = ()
    # The reference is this many times as large a side, and averaged down.
    reference_ratio: int = 1
    sky_still: bool = False  # background has no motion vectors of its own
    notes: list[str] = field(default_factory=list)
    contradictions: list[Finding] = field(default_factory=list)  # within the metadata
    first: int = 0  # place in `frames` of the frame that counts as index 0

    def pixels(self, index: int, kind: str) -> np.ndarray | None:
        """Returns one image as stored, float32 (h, w, channels), or None.

        Args:
            index: place in `frames`.
            kind: a key of `Frame.layers`.

        Raises:
            InputError: the file is damaged, lacks a channel or has another size.
        """
        layer = self.frames[index].layers.get(kind)
        if layer is None:
            return None
        file = exr.inside(self.folder, layer.file)
        held = _decoded(file)
        if missing := [name for name in layer.channels if name not in held]:
            raise InputError(
                f"{file} has no channel '{missing[0]}' for {kind}; it has "
                f"{', '.join(sorted(held)[:12])}"
            )
        image = np.stack([held[name] for name in layer.channels], axis=-1)
        ratio = self.reference_ratio if kind == "reference" else 1
        expected = (self.size[0] * ratio, self.size[1] * ratio)
        if image.shape[:2] != expected:
            raise InputError(
                f"{file} is {image.shape[1]}×{image.shape[0]} pixels where the capture "
                f"has {expected[1]}×{expected[0]}: the resolution changes, or {kind} "
                "was rendered at another one; capture all at one size"
            )
        return image.astype(np.float32)

    def raw(self, index: int) -> Raw:
        """Returns the images that every frame must have, as stored."""
        color, depth, motion = (
            self.pixels(index, kind) for kind in ("color", "depth", "motion")
        )
        if color is None or depth is None or motion is None:
            raise InputError(f"capture {self.folder} lacks colour, depth or motion")
        valid = self.pixels(index, "motion_valid")
        return Raw(
            color=color,
            depth=depth[..., 0],
            motion=motion,
            motion_valid=None if valid is None else valid[..., 0] > 0.5,
        )

    def place(self, frame: int) -> int:
        """Returns the place in `frames` of a frame index, which may be negative.

        Raises:
            InputError: the capture has no such frame.
        """
        place = frame + self.first
        if not 0 <= place < len(self.frames):
            raise InputError(
                f"capture {self.folder} has {len(self.frames)} frames; frame {frame} "
                f"after a lead-in of {self.first} is not among them"
            )
        return place

    def draw(
        self, frame: int, *, centred: bool = False
    ) -> tuple[RasterOutput, FrameInputs]:
        """Returns what the raster stage would give, and the frame's inputs.

        Args:
            frame: index, 0 after the lead-in.
            centred: the colour of the pixel centre, where the capture has it.
        """
        index = self.place(frame)
        meta, raw = self.frames[index], self.raw(index)
        center = self.pixels(index, "center") if centred else None
        color = raw.color if center is None else center
        motion = motion_px(raw.motion, self.conventions, self.size)
        if self.conventions.motion_jittered and index > 0:
            motion = motion - self.jitter_change(index)
        zeros = np.zeros(self.size, np.int32)
        depth = linear_depth(raw.depth, self.conventions.depth, meta, self.size)
        if self.sky_still and index > 0:
            sky = sky_motion(self.frames[index - 1], meta, self.size)
            if sky is not None:
                motion = np.where(np.isinf(depth)[..., None], sky, motion)
        motion, valid = valid_motion(motion, raw.motion_valid, self.size)
        drawn = RasterOutput(
            color=jnp.asarray(self.linear(color, meta)),
            gbuffer=GBuffer(
                depth=jnp.asarray(np.where(np.isnan(depth), np.inf, depth)),
                motion=jnp.asarray(motion),
                motion_valid=jnp.asarray(valid),
                normal=jnp.zeros((*self.size, 3), jnp.float32),
                object=jnp.asarray(zeros),
                material=jnp.asarray(zeros),
            ),
            primary_rays=jnp.asarray(self.size[0] * self.size[1], jnp.int32),
            rays=no_rays(None),
        )
        return drawn, self._inputs(index)

    def jitter_change(self, index: int) -> np.ndarray:
        """Returns what jitter left inside a motion vector adds to it, px.

        The sample of the frame before lay at its own jitter: previous − current
        position grows by current − previous jitter.
        """
        now, then = self.frames[index].jitter, self.frames[index - 1].jitter
        change = np.asarray(now or (0.0, 0.0)) - np.asarray(then or (0.0, 0.0))
        return change.astype(np.float32)

    def reference(self, frame: int) -> np.ndarray | None:
        """Returns the supersampled truth as linear radiance, (h, w, 3), or None."""
        index = self.place(frame)
        stored = self.pixels(index, "reference")
        if stored is None:
            return None
        linear = self.linear(stored, self.frames[index])
        if self.reference_ratio == 1:
            return linear
        k = self.reference_ratio
        mapped = np.asarray(
            colors.to_average(jnp.asarray(linear), self.conventions.average)
        )
        mean = mapped.reshape(self.size[0], k, self.size[1], k, 3).mean(axis=(1, 3))
        return np.asarray(
            colors.from_average(jnp.asarray(mean), self.conventions.average)
        )

    def samples(self, frame: int, count: int) -> np.ndarray | None:
        """Returns the image of `count` samples a pixel, linear, or None."""
        index = self.place(frame)
        stored = self.pixels(index, f"samples{count}")
        return None if stored is None else self.linear(stored, self.frames[index])

    def stand_in(self, samples: int) -> tuple[str, str]:
        """Returns which image stands in for rays, and the sentence that says so.

        Raises:
            InputError: the capture has nothing that could.
        """
        if samples in self.sample_counts:
            return f"samples{samples}", (
                f"no ray was traced: traced pixels of ATAA {samples}x show the "
                f"capture's {samples}-sample images; rays are counted as if traced"
            )
        if self.reference_samples is None:
            raise InputError(
                f"capture {self.folder} has neither {samples}-sample images nor a "
                "reference to stand in for rays; use --method taa, fxaa or none"
            )
        count = f"{self.reference_samples}-sample " if self.reference_samples else ""
        return "reference", (
            f"no ray was traced: traced pixels of ATAA {samples}x show the capture's "
            f"{count}reference itself, so their error is 0 and its scores an upper "
            "bound; rays are counted as if traced"
        )

    def trace(
        self, frame: int, samples: int
    ) -> Callable[[Bool[Array, "h w"]], RaytraceOutput]:
        """Returns what takes the ray tracer's place in a frame."""
        kind, _ = self.stand_in(samples)
        image = (
            self.reference(frame)
            if kind == "reference"
            else self.samples(frame, samples)
        )
        if image is None:
            raise InputError(
                f"capture {self.folder}, frame {frame}: its {kind} image is missing"
            )
        color = jnp.asarray(image)

        def traced(wanted: Bool[Array, "h w"]) -> RaytraceOutput:
            return RaytraceOutput(
                color=jnp.where(wanted[..., None], color, 0.0),
                primary_rays=jnp.sum(wanted, dtype=jnp.int32) * samples,
                rays=no_rays(None),
            )

        return traced

    def after(self, lead_in: int) -> "Capture":
        """Returns the capture with its first frames given to the lead-in."""
        return replace(self, first=lead_in)

    def linear(self, stored: np.ndarray, meta: Frame) -> np.ndarray:
        """Returns stored colour as exposed linear radiance."""
        return linear_color(stored, self.conventions.color) * np.float32(meta.exposure)

    def _inputs(self, index: int) -> FrameInputs:
        meta = self.frames[index]
        group = jnp.asarray(np.eye(3, 4, dtype=np.float32)[None])
        return FrameInputs(
            camera=_camera(meta),
            previous_camera=_camera(self.frames[max(index - 1, 0)]),
            world_from_group=group,
            previous_world_from_group=group,
            jitter=jnp.asarray(meta.jitter or (0.0, 0.0), jnp.float32),
            cut=jnp.asarray(meta.cut or index == 0),
        )


def _camera(meta: Frame) -> Camera:
    """Returns the frame's camera; no stage after raster reads it."""
    pose = meta.pose or Pose(np.eye(4), (1.0, 1.0))
    return Camera(
        world_from_view=jnp.asarray(pose.world_from_view, jnp.float32),
        tan_half_fov_y=jnp.asarray(pose.tan_half[1], jnp.float32),
    )


@lru_cache(maxsize=3)
def _cached(file: Path, stamp: tuple[int, int]) -> dict[str, np.ndarray]:
    return exr.read(file)


def _decoded(file: Path) -> dict[str, np.ndarray]:
    """Reads a file, or remembers it: a frame's images often share one."""
    try:
        state = file.stat()
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror})") from None
    return _cached(file, (state.st_mtime_ns, state.st_size))
