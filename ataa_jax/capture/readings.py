"""From stored numbers to the package's own: motion, depth and colour by a reading."""

import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax.capture.conventions import (
    CURRENT_MINUS_PREVIOUS,
    Conventions,
    Depth,
    Encoding,
    Frame,
)


def motion_px(
    stored: np.ndarray, conventions: Conventions, size: tuple[int, int]
) -> np.ndarray:
    """Reads stored motion as previous − current position, px, x right, y down.

    Args:
        stored: (..., 2).
        conventions: sign, axes and unit; where it names none, the package's own.
        size: image (height, width).

    Returns:
        float32, the same shape; jitter is not removed.
    """
    motion = stored[..., ::-1] if conventions.motion_axes == "yx" else stored
    height, width = size
    scale = np.ones(2, np.float32)
    if conventions.motion_unit == "uv":
        scale = np.array([width, height], np.float32)
    elif conventions.motion_unit == "ndc":  # −1 to 1 across the image
        scale = np.array([width, height], np.float32) / np.float32(2.0)
    elif conventions.motion_unit == "half px":  # of an image of half the size
        scale = scale * np.float32(2.0)
    if conventions.motion_sign == CURRENT_MINUS_PREVIOUS:
        scale = -scale
    if conventions.motion_y == "up":
        scale = scale * np.array([1.0, -1.0], np.float32)
    return (motion * scale).astype(np.float32)


def sky_motion(then: Frame, now: Frame, size: tuple[int, int]) -> np.ndarray | None:
    """Returns the motion of the infinitely far by the camera, (h, w, 2) px, or None.

    Directions of pixel centres are turned into the view of the frame before; where one
    lies behind it, the motion is NaN.
    """
    if then.pose is None or now.pose is None:
        return None
    (tan_x, tan_y), (then_x, then_y) = tangents(now, size), tangents(then, size)
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    direction = np.stack(
        [
            (2.0 * x / size[1] - 1.0) * tan_x,
            (1.0 - 2.0 * y / size[0]) * tan_y,
            -np.ones(size),
        ],
        axis=-1,
    )
    turn = then.pose.world_from_view[:3, :3].T @ now.pose.world_from_view[:3, :3]
    view = direction @ turn.T
    with np.errstate(divide="ignore", invalid="ignore"):
        at_x = (view[..., 0] / -view[..., 2] / then_x + 1.0) * size[1] / 2.0
        at_y = (1.0 - view[..., 1] / -view[..., 2] / then_y) * size[0] / 2.0
    motion = np.stack([at_x - x, at_y - y], axis=-1)
    return np.where(view[..., 2:] < 0.0, motion, np.nan).astype(np.float32)


def valid_motion(
    motion: np.ndarray, told: np.ndarray | None, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Returns finite motion, and where the previous position lies inside the view."""
    finite = np.asarray(np.isfinite(motion).all(axis=-1))
    motion = np.where(finite[..., None], motion, np.float32(0.0))
    bound = np.float32(4 * max(size))
    motion = np.clip(motion, -bound, bound)
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32) + np.float32(0.5)
    at_x, at_y = x + motion[..., 0], y + motion[..., 1]
    inside = (at_x >= 0) & (at_x <= size[1]) & (at_y >= 0) & (at_y <= size[0])
    valid = finite & inside
    return motion, valid if told is None else valid & told


def linear_depth(
    stored: np.ndarray,
    kind: Depth,
    meta: Frame,
    size: tuple[int, int],
    place_px: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Reads stored depth as distance along the view axis; sky is inf.

    Args:
        stored: (h, w), or of any pixels.
        kind: what it is.
        meta: planes and camera.
        size: image (height, width).
        place_px: the pixels' x and y; None: the whole image's.

    With n and f the planes' distances, a forward device depth is
    d = f (z − n) / (z (f − n)), and 1 − n/z where f is infinite.
    """
    value = stored.astype(np.float64)
    if kind == "linear":
        return np.where(value >= 1e9, np.inf, value).astype(np.float32)
    if kind == "distance":
        return _along_axis(value, meta, size, place_px)
    forward = 1.0 - value if kind == "device reversed" else value
    near, far = meta.near, meta.far
    share = 1.0 if np.isinf(far) else (far - near) / far
    rest = 1.0 - share * forward
    sky = np.asarray((forward >= 1.0) | (rest <= 0.0))
    depth = near / np.where(sky, 1.0, rest)
    return np.where(sky, np.inf, depth).astype(np.float32)


def tangents(meta: Frame, size: tuple[int, int]) -> tuple[float, float]:
    """Returns the tangents of half the fields of view, horizontal and vertical."""
    tan_x, tan_y = (1.0, 1.0) if meta.pose is None else meta.pose.tan_half
    return (tan_y * size[1] / size[0] if np.isnan(tan_x) else tan_x), tan_y


def _along_axis(
    value: np.ndarray,
    meta: Frame,
    size: tuple[int, int],
    place_px: tuple[np.ndarray, np.ndarray] | None,
) -> np.ndarray:
    tan_x, tan_y = tangents(meta, size)
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    if place_px is not None:
        x, y = place_px
    u, v = (2.0 * x / size[1] - 1.0) * tan_x, (2.0 * y / size[0] - 1.0) * tan_y
    depth = value / np.sqrt(1.0 + u * u + v * v)
    return np.where(value >= 1e9, np.inf, depth).astype(np.float32)


def linear_color(stored: np.ndarray, encoding: Encoding) -> np.ndarray:
    """Reads stored colour as linear radiance, float32."""
    value = stored.astype(np.float32)
    if encoding == "linear":
        return value
    image = jnp.asarray(value)
    if encoding in ("srgb", "display"):
        image = colors.srgb_decode(image)
    if encoding in ("tonemapped", "display"):
        image = colors.inverse_tonemap(image)
    return np.asarray(image)


def encoded_color(linear: np.ndarray, encoding: Encoding) -> np.ndarray:
    """Stores linear radiance, the inverse of `linear_color`, float32."""
    image = jnp.asarray(linear, jnp.float32)
    if encoding in ("tonemapped", "display"):
        image = colors.tonemap(image)
    if encoding in ("srgb", "display"):
        image = colors.srgb_encode(image)
    return np.asarray(image)
