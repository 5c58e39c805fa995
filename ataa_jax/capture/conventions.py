"""How a capture's numbers are to be read, and what is known of each frame.

Symbols: a *reading* is one set of conventions; a motion vector m of the package is
previous − current position in px, x right, y down, jitter removed.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ataa_jax import color as colors

PREVIOUS_MINUS_CURRENT = "previous - current"
CURRENT_MINUS_PREVIOUS = "current - previous"
SAMPLE_COUNTS = (2, 4, 8, 16)

Encoding = Literal["linear", "srgb", "tonemapped", "display"]
Depth = Literal["linear", "distance", "device", "device reversed"]
Unit = Literal["px", "half px", "uv", "ndc"]


@dataclass(frozen=True)
class Conventions:
    """How the stored numbers are to be read; None: the layout does not say."""

    # linear: radiance; srgb: that, sRGB-encoded; tonemapped: x / (1 + max rgb);
    # display: tone-mapped, then sRGB-encoded.
    color: Encoding = "linear"
    average: colors.Average = "tonemap"  # in which reference and samples are means
    motion_unit: Unit = "px"
    motion_sign: str | None = PREVIOUS_MINUS_CURRENT
    motion_y: Literal["down", "up"] | None = "down"
    motion_axes: Literal["xy", "yx"] = "xy"
    motion_jittered: bool = False  # True: the jitter's change is part of it
    # linear: along the view axis, scene units; distance: along the pixel's ray;
    # device: 0 at the near plane, 1 at the far; device reversed: 1 at the near plane.
    depth: Depth = "linear"
    camera_y: Literal["up", "down"] | None = "up"  # of the camera's second axis
    jitter_stated: bool = True  # False: its signs are inferred from the images


@dataclass(frozen=True, eq=False)
class Pose:
    """The camera of one frame."""

    world_from_view: np.ndarray  # float64 (4, 4), rigid, looks down −z
    tan_half: tuple[float, float]  # of the horizontal (NaN: square pixels) and
    # vertical field of view


@dataclass(frozen=True)
class Layer:
    """Where one image lies: a file of the folder, and its channels in order."""

    file: str
    channels: tuple[str, ...]


@dataclass(frozen=True)
class Frame:
    """One frame's metadata, and where its images lie."""

    number: int  # as the capture counts
    layers: dict[str, Layer]  # color, depth, motion, …, reference, samples2, …
    jitter: tuple[float, float] | None = None  # px from the pixel centre, y down
    cut: bool = False
    pose: Pose | None = None
    near: float = float("nan")
    far: float = float("inf")
    exposure: float = 1.0
