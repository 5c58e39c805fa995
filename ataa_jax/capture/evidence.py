"""Measurements on a capture: which reading of its numbers agrees with its images.

Two kinds of evidence, each on a fixed grid of pixels and all pairs of frames:

- *photometric*: along the right motion, the previous image predicts this one;
- *geometric*: where camera and depth are known, they predict the motion of all that
  stands still, to a hundredth of a pixel.

Symbols: m is stored motion under a reading, p the predicted one, both previous −
current position in px; j the jitter; T the tone map.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax.capture.conventions import (
    CURRENT_MINUS_PREVIOUS,
    PREVIOUS_MINUS_CURRENT,
    Conventions,
    Depth,
    Frame,
)
from ataa_jax.capture.readings import linear_depth, motion_px, tangents
from ataa_jax.capture.record import Capture

# our choice: medians of so many pixels are steady, and 1080p takes milliseconds.
GRID = 16384
# our choice: some 60 bytes a pixel are held, so a gigabyte: 8 frames of 1080p.
MOST_FRAMES, MOST_PIXELS = 24, 1 << 24
_CAP = 0.2  # a pixel's error counts no more: occlusions are no evidence


@dataclass(frozen=True, eq=False)
class Still:
    """One frame's images, made ready."""

    meta: Frame
    color: np.ndarray  # (h, w, 3) as stored
    reference: np.ndarray | None
    depth: np.ndarray  # (h, w) as stored
    motion: np.ndarray  # (h, w, 2) as stored
    luma: np.ndarray  # (h, w) tone-mapped luma: of the reference, where there is one
    color_luma: np.ndarray  # (h, w) of the colour


@dataclass(frozen=True, eq=False)
class Stills:
    """All frames, and the grid of pixels that is looked at."""

    capture: Capture
    frames: list[Still]
    x: np.ndarray  # (n,) column indices
    y: np.ndarray  # (n,) row indices

    @cached_property
    def motions(self) -> list[np.ndarray]:
        """Returns every frame's motion on the grid as stored, (n, 2), finite or NaN."""
        found = []
        for still in self.frames:
            motion = still.motion[self.y, self.x].astype(np.float64)
            finite = np.isfinite(motion).all(axis=-1, keepdims=True)
            found.append(np.where(finite, motion, np.nan))
        return found

    def pairs(self) -> Iterator[tuple[Still, Still]]:
        """Yields (previous, current) of frames without a cut between."""
        for then, now in zip(self.frames, self.frames[1:], strict=False):
            if not now.meta.cut:
                yield then, now


def gather(capture: Capture) -> Stills:
    """Reads the first frames, as many as memory allows.

    Args:
        capture: what to look at.

    Raises:
        InputError: a file is damaged.
    """
    height, width = capture.size
    step = max(1, int(np.ceil(np.sqrt(height * width / GRID))))
    y, x = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    most = min(MOST_FRAMES, max(3, MOST_PIXELS // (height * width)))
    stills = [_still(capture, k) for k in range(min(len(capture.frames), most))]
    return Stills(capture, stills, x.ravel(), y.ravel())


def _still(capture: Capture, index: int) -> Still:
    raw, meta = capture.raw(index), capture.frames[index]
    whole = replace(capture, first=0)
    truth = whole.reference(index)
    color_luma = tonemapped_luma(capture.linear(raw.color, meta))
    return Still(
        meta=meta,
        color=raw.color,
        reference=capture.pixels(index, "reference"),
        depth=raw.depth,
        motion=raw.motion,
        luma=color_luma if truth is None else tonemapped_luma(truth),
        color_luma=color_luma,
    )


def tonemapped_luma(linear: np.ndarray) -> np.ndarray:
    """Returns luma of T(x), NaN and negatives as 0."""
    image = jnp.asarray(linear, jnp.float32)
    mapped = colors.to_average(image, "tonemap")
    return np.asarray(colors.luma(mapped), np.float32)


def readings(base: Conventions) -> list[Conventions]:
    """Returns every sign, orientation, order of axes and unit."""
    return [
        replace(base, motion_sign=sign, motion_y=y, motion_axes=axes, motion_unit=unit)
        for sign, y, axes, unit in product(
            (PREVIOUS_MINUS_CURRENT, CURRENT_MINUS_PREVIOUS),
            ("down", "up"),
            ("xy", "yx"),
            ("px", "uv", "ndc", "half px"),
        )
    ]


def sample(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Reads an image bilinearly at index positions; NaN outside of it."""
    height, width = image.shape[:2]
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx, fy = x - x0, y - y0
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    bottom = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return np.where(inside, top * (1 - fy) + bottom * fy, np.nan)


def stored_motion(stills: Stills, still: Still) -> np.ndarray:
    """Returns the grid's motion as stored, NaN where it is not finite, (n, 2)."""
    return stills.motions[next(k for k, s in enumerate(stills.frames) if s is still)]


def photometric(
    stills: Stills, reading: Conventions | None, offset: int = 0
) -> np.ndarray:
    """Returns the mean error of every pair, in 1/255 of tone-mapped luma.

    Args:
        stills: the frames.
        reading: of the motion; None: no motion at all.
        offset: the motion is taken from so many frames later.

    Returns:
        (pairs,). A pixel that the motion leads out of the image counts like an
        unrelated one.
    """
    errors = []
    for number, now in enumerate(stills.frames):
        source = number + offset
        if number == 0 or now.meta.cut or not 0 <= source < len(stills.frames):
            continue
        then = stills.frames[number - 1]
        value = now.luma[stills.y, stills.x]
        motion = np.zeros((len(stills.x), 2))
        if reading is not None:
            stored = stored_motion(stills, stills.frames[source])
            motion = motion_px(stored, reading, stills.capture.size).astype(np.float64)
        before = sample(then.luma, stills.x + motion[:, 0], stills.y + motion[:, 1])
        unrelated = np.minimum(np.abs(value - np.roll(value, value.size // 2)), _CAP)
        error = np.minimum(np.abs(before - value), _CAP)
        errors.append(np.where(np.isnan(error), unrelated.mean(), error).mean())
    return 255.0 * np.array(errors)


def predicted(
    stills: Stills, then: Frame, now: Still, depth: np.ndarray, down: float
) -> np.ndarray | None:
    """Returns the motion of still things by camera and depth, (n, 2) px, or None.

    Args:
        stills: the grid.
        then: metadata of the frame before.
        now: this frame.
        depth: (n,) linear, sky inf.
        down: 1.0 where the camera's second axis points up, −1.0 where down.
    """
    if now.meta.pose is None or then.pose is None:
        return None
    height, width = stills.capture.size
    jitter = np.asarray(now.meta.jitter or (0.0, 0.0))
    x, y = stills.x + 0.5 + jitter[0], stills.y + 0.5 + jitter[1]
    tan_x, tan_y = tangents(now.meta, stills.capture.size)
    direction = np.stack(
        [
            (2.0 * x / width - 1.0) * tan_x,
            down * (1.0 - 2.0 * y / height) * tan_y,
            -np.ones_like(x),
        ],
        axis=-1,
    )
    z = depth.astype(np.float64)
    near = np.isfinite(z) & (z > 0.0)
    point = direction * np.where(near, z, 1.0)[:, None]
    world = point @ now.meta.pose.world_from_view[:3, :3].T
    shift = now.meta.pose.world_from_view[:3, 3] - then.pose.world_from_view[:3, 3]
    world = world + np.where(near[:, None], shift, 0.0)  # sky: a direction
    view = world @ then.pose.world_from_view[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        then_x = view[:, 0] / -view[:, 2]
        then_y = view[:, 1] / -view[:, 2]
    tan_x, tan_y = tangents(then, stills.capture.size)
    at_x = (then_x / tan_x + 1.0) * width / 2.0
    at_y = (1.0 - down * then_y / tan_y) * height / 2.0
    result = np.stack([at_x - x, at_y - y], axis=-1)
    return np.where((view[:, 2] < 0.0)[:, None], result, np.nan)


def predictions(
    stills: Stills, kind: Depth, far: float | None, down: float
) -> list[np.ndarray | None]:
    """Returns the predicted motion of every frame; None after a cut or at the start.

    Args:
        stills: the frames.
        kind: how depth is read.
        far: the far plane; None: as the frame says.
        down: see `predicted`.
    """
    found: list[np.ndarray | None] = []
    for number, now in enumerate(stills.frames):
        if number == 0 or now.meta.cut:
            found.append(None)
            continue
        meta = now.meta if far is None else replace(now.meta, far=far)
        with np.errstate(all="ignore"):
            stored = now.depth[stills.y, stills.x]
            place = stills.x + 0.5, stills.y + 0.5
            depth = linear_depth(stored, kind, meta, stills.capture.size, place)
        found.append(
            predicted(stills, stills.frames[number - 1].meta, now, depth, down)
        )
    return found


def residuals(
    stills: Stills,
    reading: Conventions,
    expected: list[np.ndarray | None],
    offset: int = 0,
) -> np.ndarray:
    """Returns the median |m − p| of every frame that has both, px."""
    found = []
    for number, p in enumerate(expected):
        source = number + offset
        if p is None or not 0 <= source < len(stills.frames):
            continue
        if offset and stills.frames[source].meta.cut:
            continue
        m = motion_px(
            stored_motion(stills, stills.frames[source]), reading, stills.capture.size
        )
        found.append(_median(np.linalg.norm(m - p, axis=-1)))
    return np.array(found)


def _median(values: np.ndarray) -> float:
    """Returns the median; a pixel without a value counts as far off."""
    return float(np.median(np.where(np.isnan(values), 1e9, values)))


def offsets(
    stills: Stills, reading: Conventions, expected: list[np.ndarray | None]
) -> list[np.ndarray | None]:
    """Returns the median vector m − p of every frame, (2,) px."""
    found: list[np.ndarray | None] = []
    for now, p in zip(stills.frames, expected, strict=True):
        if p is None:
            found.append(None)
            continue
        m = motion_px(stored_motion(stills, now), reading, stills.capture.size)
        found.append(np.nanmedian(m - p, axis=0))
    return found


def shift(
    image: np.ndarray,
    target: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    motion: np.ndarray | None = None,
) -> np.ndarray:
    """Returns s such that image(p + motion + s) is most like target(p), (2,) px.

    One global shift by least squares on gradients (Lucas and Kanade 1981), four steps;
    pixels that differ by more than the cap are left out.
    """
    s = np.zeros(2)
    m = np.zeros((len(x), 2)) if motion is None else motion
    value = target[y, x]
    for _ in range(4):
        at_x, at_y = x + m[:, 0] + s[0], y + m[:, 1] + s[1]
        here = sample(image, at_x, at_y)
        gx = sample(image, at_x + 0.5, at_y) - sample(image, at_x - 0.5, at_y)
        gy = sample(image, at_x, at_y + 0.5) - sample(image, at_x, at_y - 0.5)
        rest = value - here
        used = np.isfinite(here) & np.isfinite(gx) & np.isfinite(gy)
        used &= np.abs(np.where(used, rest, 1.0)) < _CAP
        if used.sum() < 16:
            return np.zeros(2)
        g = np.stack([gx[used], gy[used]], axis=-1)
        s = s + np.linalg.lstsq(g, rest[used], rcond=None)[0]
        s = np.clip(s, -2.0, 2.0)
    return s


def slope(values: list[np.ndarray], against: list[np.ndarray]) -> float:
    """Returns k of the fit values = k · against, NaN where nothing varies."""
    a, b = np.concatenate(values), np.concatenate(against)
    square = float(b @ b)
    return float(a @ b) / square if square > 1e-6 else float("nan")
