"""Terms of the segmentation's criteria: how much a pixel asks for rays, in [0, 1].

Two are the paper's (section 3): the temporal change of luminance, and depth edges. The
others see what those two miss: edges between surfaces of one depth, detail finer than
the 3×3 mean, whose luminance does not change, and what moves behind a transparent
surface. All are dimensionless. Border rule of every 3×3: clamp to edge.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ataa_jax import color as colors
from ataa_jax import vector, window


def inverse_depth(depth: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Returns 1/z: 0 for the sky, for NaN, and for depths that are not positive."""
    positive = depth > 1e-30  # our choice: nearer, 1/z would leave float32
    return jnp.where(positive, 1.0 / jnp.where(positive, depth, 1.0), 0.0)


def luminance(
    color: Float[Array, "h w 3"],
    reprojected: Float[Array, "h w 3"],
    floor: Float[Array, ""],
) -> Float[Array, "h w"]:
    """Returns |m(L) − m(L′)| / max of both, m the 3×3 mean, L tone-mapped luma.

    In [0, 1]; 0 where both means are below the floor.
    """
    now, then = (
        window.mean3x3(window.border(_tonemapped_luma(image)))
        for image in (color, reprojected)
    )
    larger = jnp.maximum(now, then)
    seen = (larger >= floor) & (larger > 0.0)
    return jnp.where(seen, jnp.abs(now - then) / jnp.where(seen, larger, 1.0), 0.0)


def _tonemapped_luma(image: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    return colors.luma_vec(colors.to_average_vec(vector.unstack(image), "tonemap"))


def depth_edge(depth: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Returns |Sobel(1/z)| / (8 · max 1/z), both over the 3×3; 0 where all is sky.

    A plane's 1/z is linear in the image, so its gradient is constant; divided by the
    largest 1/z, the term has no unit. It lies in [0, 1].
    """
    bordered = window.border(inverse_depth(depth))
    largest = window.reduce3x3(bordered, jnp.maximum)
    n = window.neighbours(bordered)
    # Divided before squaring: 1/z² of tiny scenes would leave float32.
    scale = jnp.where(largest > 0.0, 1.0 / jnp.where(largest > 0.0, largest, 1.0), 0.0)
    right = n[0][2] + 2.0 * n[1][2] + n[2][2]
    left = n[0][0] + 2.0 * n[1][0] + n[2][0]
    lower = n[2][0] + 2.0 * n[2][1] + n[2][2]
    upper = n[0][0] + 2.0 * n[0][1] + n[0][2]
    gradient_x, gradient_y = (right - left) * scale, (lower - upper) * scale
    return vector.root(gradient_x * gradient_x + gradient_y * gradient_y) * 0.125


def normal_edge(normal: Float[Array, "h w 3"]) -> Float[Array, "h w"]:
    """Returns the largest angle between a pixel's normal and its 3×3's, over π.

    With d = |a − b| the distance of two unit normals the angle is 2 asin(d/2), exact
    for small angles where acos(a · b) is not. The sky has no normal and no angle.
    """
    planes = tuple(
        window.neighbours(window.border(c))
        for c in (normal[..., 0], normal[..., 1], normal[..., 2])
    )
    own = tuple(plane[1][1] for plane in planes)
    own_length = _squared(own)
    largest = jnp.zeros(normal.shape[:2], jnp.float32)
    for r in range(3):
        for c in range(3):
            other = tuple(plane[r][c] for plane in planes)
            squared = _squared(tuple(p - q for p, q in zip(own, other, strict=True)))
            # Unit or zero: half lies between.
            both = (own_length > 0.5) & (_squared(other) > 0.5)
            largest = jnp.where(both, jnp.maximum(largest, squared), largest)
    half = jnp.minimum(0.5 * jnp.sqrt(largest), 1.0)
    return jnp.arcsin(half) * (2.0 / jnp.pi)


def _squared(
    parts: tuple[Float[Array, "h w"], ...],
) -> Float[Array, "h w"]:
    """Returns x² + y² + z²."""
    x, y, z = parts
    return x * x + y * y + z * z


def id_edge(ids: Int[Array, "h w"]) -> Float[Array, "h w"]:
    """Returns 1 where the ids in the 3×3 are not all the same, else 0; sky is −1."""
    bordered = window.border(ids)
    low = window.reduce3x3(bordered, jnp.minimum)
    high = window.reduce3x3(bordered, jnp.maximum)
    return (low != high).astype(jnp.float32)


def layers(
    motion: Float[Array, "h w 2"],
    second_motion: Float[Array, "h w 2"],
    second_share: Float[Array, "h w"],
) -> Float[Array, "h w"]:
    """Returns s · d / (1 + d), in [0, 1]: how much of a pixel moves otherwise.

    TAA reads one history position for all that a pixel shows. Where a second surface is
    seen before or behind the first, with weight s in the composite, its history lies
    d = |m − m₂| px (divided by one pixel) beside that position.
    """
    x, y = (motion[..., k] - second_motion[..., k] for k in (0, 1))
    apart = vector.root(x * x + y * y)
    return second_share * (apart / (1.0 + apart))


def spread(
    color: Float[Array, "h w 3"],
    reprojected: Float[Array, "h w 3"],
    floor: Float[Array, ""],
) -> Float[Array, "h w"]:
    """Returns |σ(L) − σ(L′)| / (√8 · max(m(L), m(L′))), σ and m over the 3×3.

    Detail finer than pixels spreads the samples of this frame and averages out in the
    history, while both means agree. L is tone-mapped luma; of nine values that are not
    negative, σ is at most √8 m. 0 where both means are below the floor.
    """
    (mean_now, now), (mean_then, then) = (
        _mean_and_deviation(_tonemapped_luma(image)) for image in (color, reprojected)
    )
    larger = jnp.maximum(mean_now, mean_then)
    seen = (larger >= floor) & (larger > 0.0)
    change = jnp.abs(now - then) / (jnp.where(seen, larger, 1.0) * 8.0**0.5)
    return jnp.where(seen, change, 0.0)


def _mean_and_deviation(
    plane: Float[Array, "h w"],
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """Returns mean and standard deviation of the 3×3."""
    mean, variance = _mean_and_variance(plane)
    return mean, vector.root(variance)


def _mean_and_variance(
    plane: Float[Array, "h w"],
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    bordered = window.border(plane)
    mean = window.mean3x3(bordered)
    # Differences from the mean, not E[x²] − m²: a flat area's spread is exactly 0 or
    # rounding of its last bit.
    total = jnp.zeros_like(plane)
    for row in window.neighbours(bordered):
        for other in row:
            total = total + (other - mean) ** 2
    return mean, total * (1.0 / 9.0)


def response(
    blended: Float[Array, "h w 3"],
    reprojected: Float[Array, "h w 3"],
    contrast: Float[Array, ""],
) -> Float[Array, "h w"]:
    """Returns Δ · c / √(σ² + c²), in [0, 1]: TAA's distance from the history it read.

    Δ is what rectification and the new sample did together, in the colours that are
    shown: √(mean over the channels of the squared sRGB difference). σ is the 3×3's
    standard deviation of the history's sRGB luma: where the picture is busy, the same
    error is seen less, by SSIM too, whose denominator is σ² + σ² + C₂.

    Args:
        blended: TAA's result, linear.
        reprojected: the history that it read, linear.
        contrast: c > 0, the σ at which Δ counts for 1/√2 of what it does on a flat
            area.
    """
    now, then = (
        vector.materialize(colors.display_vec(vector.unstack(image)))
        for image in (blended, reprojected)
    )
    x, y, z = now.x - then.x, now.y - then.y, now.z - then.z
    mean = (x * x + y * y + z * z) * (1.0 / 3.0)
    _, variance = _mean_and_variance(colors.luma_vec(then))
    return vector.root(mean) * jax.lax.rsqrt(variance / (contrast * contrast) + 1.0)
