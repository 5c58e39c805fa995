"""A pinhole camera: rays through pixel positions, and projection back to pixels.

Symbols: ``x_px, y_px`` is a position in the image (x right, y down, pixel centres at
+0.5); a ray's direction has view-space z = −1, so that distance along it *is* linear
depth.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ataa_jax import vector
from ataa_jax.types import Camera
from ataa_jax.vector import Vec3

# Below this share of the pixel cone a point counts as behind the camera: with w this
# small the projected position is beyond ±2^20 px and says nothing.
_MIN_DEPTH_RATIO = 2.0**-20


def make(world_from_view: np.ndarray, fov_y: float) -> Camera:
    """Builds a `Camera` from a rigid matrix and a vertical field of view in radians."""
    return Camera(
        # JAX would compile a program to convert float64.
        world_from_view=jnp.asarray(np.asarray(world_from_view, np.float32)),
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


def pixel_centres(
    size: tuple[int, int],
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Returns x_px and y_px of every pixel's centre, row-major; (height, width)."""
    height, width = size
    x = jnp.broadcast_to(jnp.arange(width, dtype=jnp.float32)[None, :] + 0.5, size)
    y = jnp.broadcast_to(jnp.arange(height, dtype=jnp.float32)[:, None] + 0.5, size)
    return x.reshape(-1), y.reshape(-1)


def directions(
    camera: Camera,
    size: tuple[int, int],
    x_px: Float[Array, " n"],
    y_px: Float[Array, " n"],
) -> Vec3:
    """Returns world directions through image positions, with view-space z = −1."""
    height, width = size
    step = pixel_size(camera, height)
    right, up, back = _axes(camera)
    return right * ((x_px - width / 2.0) * step) + up * (
        (height / 2.0 - y_px) * step
    ) - back  # fmt: skip


def direction_steps(camera: Camera, height: int) -> tuple[Vec3, Vec3]:
    """Returns how `directions` changes by one pixel to the right and one down."""
    step = pixel_size(camera, height)
    right, up, _ = _axes(camera)
    return right * step, up * -step


def _axes(camera: Camera) -> tuple[Vec3, Vec3, Vec3]:
    """Returns the view's right, up and back directions in the world."""
    m = camera.world_from_view
    right, up, back = (Vec3(m[0, k], m[1, k], m[2, k]) for k in range(3))
    return right, up, back


def project(
    camera: Camera, size: tuple[int, int], offset_world: Vec3
) -> tuple[Float[Array, " n"], Float[Array, " n"], Bool[Array, " n"]]:
    """Projects points, given *relative to the camera's position*, or directions.

    Args:
        camera: where to project.
        size: image (height, width).
        offset_world: point − camera position (a direction for points at infinity).

    Returns:
        x_px and y_px, finite everywhere, and a flag that the point lies in front of
        the camera (where False, the position is meaningless).
    """
    height, width = size
    right, up, back = _axes(camera)
    x_view, y_view = vector.dot(offset_world, right), vector.dot(offset_world, up)
    depth = -vector.dot(offset_world, back)
    extent = jnp.maximum(jnp.abs(x_view), jnp.abs(y_view))
    in_front = depth > extent * _MIN_DEPTH_RATIO
    scale = 1.0 / (jnp.where(in_front, depth, 1.0) * pixel_size(camera, height))
    return width / 2.0 + x_view * scale, height / 2.0 - y_view * scale, in_front


def position(camera: Camera) -> Vec3:
    """Returns the camera's position in the world."""
    m = camera.world_from_view
    return Vec3(m[0, 3], m[1, 3], m[2, 3])
