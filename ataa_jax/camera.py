"""A pinhole camera: rays through pixel positions, and projection back to pixels.

Symbols: ``xy_px`` is a position in the image (x right, y down, pixel centres at +0.5);
a ray's direction has view-space z = −1, so the distance along it *is* linear depth.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ataa_jax.types import Camera

# Below this share of the pixel cone a point counts as behind the camera: with w this
# small the projected position is beyond ±2^20 px and says nothing.
_MIN_DEPTH_RATIO = 2.0**-20


def make(world_from_view: np.ndarray, fov_y: float) -> Camera:
    """Builds a `Camera` from a rigid matrix and a vertical field of view in radians."""
    return Camera(
        world_from_view=jnp.asarray(world_from_view, jnp.float32),
        tan_half_fov_y=jnp.asarray(np.tan(fov_y / 2.0), jnp.float32),
    )


def look_at(
    eye: np.ndarray, target: np.ndarray, up: tuple[float, float, float] = (0, 1, 0)
) -> np.ndarray:
    """Returns the rigid world_from_view, float64 (4, 4), of an eye that sees a target.

    Where the view is along `up`, another up direction is taken in its place.
    """
    eye, target = np.asarray(eye, np.float64), np.asarray(target, np.float64)
    back = eye - target
    back = back / max(np.linalg.norm(back), 1e-30)
    right = np.cross(np.asarray(up, np.float64), back)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross((0.0, 0.0, -1.0) if abs(back[1]) > 0.5 else (1.0, 0, 0), back)
    right = right / np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :4] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return matrix


def pixel_size(camera: Camera, height: int) -> Float[Array, ""]:
    """Returns a pixel's side at unit depth."""
    return 2.0 * camera.tan_half_fov_y / height


def pixel_centres(size: tuple[int, int]) -> Float[Array, "n 2"]:
    """Returns xy_px of every pixel's centre, row-major."""
    height, width = size
    x = jnp.broadcast_to(jnp.arange(width, dtype=jnp.float32) + 0.5, size)
    y = jnp.broadcast_to(jnp.arange(height, dtype=jnp.float32)[:, None] + 0.5, size)
    return jnp.stack([x.reshape(-1), y.reshape(-1)], axis=-1)


def directions(
    camera: Camera, size: tuple[int, int], xy_px: Float[Array, "n 2"]
) -> Float[Array, "n 3"]:
    """Returns world directions through image positions, with view-space z = −1."""
    height, width = size
    step = pixel_size(camera, height)
    x_view = (xy_px[:, 0] - width / 2.0) * step
    y_view = (height / 2.0 - xy_px[:, 1]) * step
    rotation = camera.world_from_view[:3, :3]
    return (
        x_view[:, None] * rotation[:, 0][None, :]
        + y_view[:, None] * rotation[:, 1][None, :]
        - rotation[:, 2][None, :]
    )


def direction_steps(
    camera: Camera, height: int
) -> tuple[Float[Array, " 3"], Float[Array, " 3"]]:
    """Returns how `directions` changes by one pixel to the right and one down."""
    step = pixel_size(camera, height)
    rotation = camera.world_from_view[:3, :3]
    return rotation[:, 0] * step, -rotation[:, 1] * step


def project(
    camera: Camera, size: tuple[int, int], offset_world: Float[Array, "n 3"]
) -> tuple[Float[Array, "n 2"], Bool[Array, " n"]]:
    """Projects points, given *relative to the camera's position*, or directions.

    Args:
        camera: where to project.
        size: image (height, width).
        offset_world: point − camera position (a direction for points at infinity).

    Returns:
        xy_px, finite everywhere, and a flag that the point lies in front of the
        camera (where False, xy_px is meaningless).
    """
    height, width = size
    rotation = camera.world_from_view[:3, :3]
    view = jnp.sum(offset_world[:, :, None] * rotation[None, :, :], axis=1)
    depth = -view[:, 2]
    extent = jnp.max(jnp.abs(view[:, :2]), axis=-1)
    in_front = depth > extent * _MIN_DEPTH_RATIO
    step = pixel_size(camera, height)
    scale = 1.0 / (jnp.where(in_front, depth, 1.0) * step)
    x_px = width / 2.0 + view[:, 0] * scale
    y_px = height / 2.0 - view[:, 1] * scale
    return jnp.stack([x_px, y_px], axis=-1), in_front


def position(camera: Camera) -> Float[Array, " 3"]:
    """Returns the camera's position in the world."""
    return camera.world_from_view[:3, 3]
