"""Texture lookup in the packed mip pyramids of `types.Textures`.

A texel (i, j) of a level w×h covers u in [i/w, (i+1)/w]; its centre is at +0.5. Each
lookup is bilinear within a level and, where derivatives are given, linear between the
two nearest levels (trilinear; OpenGL 4.6 specification, 8.14). sRGB texels are decoded
before they are filtered.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from ataa_jax import vector
from ataa_jax.surface import Uv
from ataa_jax.types import WRAP_MIRROR, WRAP_REPEAT, Textures
from ataa_jax.vector import Vec3

# ((x + 0.055) / 1.055)^2.4 on [0.04, 1], interpolated at Chebyshev nodes: within 3e-6,
# a hundredth of the smallest step between two codes. A table of the 256 codes would be
# exact, but its gathers do not vectorize and took most of the lookup's time.
_SRGB_POLYNOMIAL = (
    *(0.0008802178781, 0.03431976959, 0.4979813099, 0.7863962650),
    *(-0.6175867319, 0.4830197990, -0.2358321398, 0.05082232133),
)


def sample(
    textures: Textures,
    texture: Int[Array, " n"],
    uv: Uv,
    uv_dx: Uv | None,
    uv_dy: Uv | None,
    mip_bias: Float[Array, ""] | float = 0.0,
    *,
    srgb: bool,
) -> Vec3:
    """Samples one texture per element.

    Args:
        textures: the pyramids.
        texture: texture id, or NO_TEXTURE, which reads as white.
        uv: texture coordinates, any finite value.
        uv_dx: change of uv by one pixel to the right; None: mip level 0 everywhere,
            the paper's infinite derivatives.
        uv_dy: the same, one pixel down.
        mip_bias: added to the level of detail.
        srgb: texels are sRGB-encoded (glTF: base colour and emissive textures are,
            the others are not).

    Returns:
        Linear colour, or codes / 255 where not sRGB.
    """
    channels = _sample(textures, texture, uv, uv_dx, uv_dy, mip_bias, (0, 8, 16), srgb)
    return vector.select(texture >= 0, Vec3(*channels), 1.0)


def sample_alpha(
    textures: Textures,
    texture: Int[Array, " n"],
    uv: Uv,
    uv_dx: Uv | None,
    uv_dy: Uv | None,
    mip_bias: Float[Array, ""] | float = 0.0,
) -> Float[Array, " n"]:
    """Samples the alpha channel, in [0, 1]; see `sample`. NO_TEXTURE reads as 1."""
    (alpha,) = _sample(textures, texture, uv, uv_dx, uv_dy, mip_bias, (24,), False)
    return jnp.where(texture >= 0, alpha, 1.0)


def _sample(
    textures: Textures,
    texture: Int[Array, " n"],
    uv: Uv,
    uv_dx: Uv | None,
    uv_dy: Uv | None,
    mip_bias: Float[Array, ""] | float,
    shifts: tuple[int, ...],
    srgb: bool,
) -> Float[Array, "c n"]:
    """Samples the channels that start at some bits of a texel."""
    safe = jnp.where(texture >= 0, texture, 0)
    modes = jnp.stack([textures.wrap_u, textures.wrap_v], axis=1)
    wrap_u, wrap_v = vector.take(modes, safe)
    wrapped = vector.materialize(Uv(_wrap(uv.u, wrap_u), _wrap(uv.v, wrap_v)))
    repeat = wrap_u == WRAP_REPEAT, wrap_v == WRAP_REPEAT
    if uv_dx is None or uv_dy is None:
        level = jnp.zeros_like(safe)[None]
        return _bilinear(textures, safe, level, wrapped, repeat, shifts, srgb)[:, 0]
    detail = level_of_detail(textures, safe, uv_dx, uv_dy, mip_bias)
    low = jnp.floor(detail)
    low, fraction = vector.materialize((low.astype(jnp.int32), detail - low))
    above = jnp.arange(2, dtype=jnp.int32)[:, None]
    level = jnp.minimum(low[None] + above, textures.level_offset.shape[1] - 1)
    values = _bilinear(textures, safe, level, wrapped, repeat, shifts, srgb)
    near, far = values[:, 0], values[:, 1]
    return near + (far - near) * fraction[None]


def level_of_detail(
    textures: Textures,
    texture: Int[Array, " n"],
    uv_dx: Uv,
    uv_dy: Uv,
    mip_bias: Float[Array, ""] | float,
) -> Float[Array, " n"]:
    """Returns log2 of the longer pixel footprint in texels, plus bias, clamped.

    OpenGL 4.6 specification, equation 8.7 with the exact (Euclidean) scale factor.
    """
    columns = textures.level_width[:, 0], textures.level_height[:, 0]
    extents = jnp.stack([*columns, textures.level_count], axis=1)
    width, height, count = vector.take(extents, texture)
    width, height = width.astype(jnp.float32), height.astype(jnp.float32)
    squared = jnp.maximum(
        (uv_dx.u * width) ** 2 + (uv_dx.v * height) ** 2,
        (uv_dy.u * width) ** 2 + (uv_dy.v * height) ** 2,
    )
    # The level indexes a table: a comparison with NaN is false, so NaN reads level 0.
    squared = jnp.where(squared > 0.0, squared, 0.0)
    # 2^±60 keeps log2 finite for degenerate derivatives; the clamp below decides.
    level = 0.5 * jnp.log2(jnp.clip(squared, 2.0**-60, 2.0**60)) + mip_bias
    last = (count - 1).astype(jnp.float32)
    return jnp.clip(level, 0.0, last)


def _wrap(u: Float[Array, " n"], mode: Int[Array, " n"]) -> Float[Array, " n"]:
    """Brings a coordinate into [0, 1] by its wrap mode; NaN reads as 0."""
    u = jnp.where(jnp.isfinite(u), u, 0.0)
    repeat = u - jnp.floor(u)
    mirror = 1.0 - jnp.abs(1.0 - 2.0 * (u * 0.5 - jnp.floor(u * 0.5)))
    clamp = jnp.clip(u, 0.0, 1.0)
    return jnp.where(
        mode == WRAP_REPEAT, repeat, jnp.where(mode == WRAP_MIRROR, mirror, clamp)
    )


def _bilinear(
    textures: Textures,
    texture: Int[Array, " n"],
    level: Int[Array, "l n"],
    uv: Uv,
    repeat: tuple[Bool[Array, " n"], Bool[Array, " n"]],
    shifts: tuple[int, ...],
    srgb: bool,
) -> Float[Array, "c l n"]:
    """Filters four texels of each level; `uv` is already wrapped into [0, 1].

    Border rule: at the edge the neighbour wraps round under REPEAT and is clamped
    under CLAMP and MIRROR (a mirrored neighbour of the edge is the edge itself).
    """
    entry = (texture * textures.level_offset.shape[1])[None] + level
    columns = textures.level_width, textures.level_height, textures.level_offset
    table = jnp.stack([column.reshape(-1) for column in columns], axis=1)
    width, height, base = (
        column.reshape(level.shape) for column in vector.take(table, entry.reshape(-1))
    )
    x, fx = vector.materialize(_neighbours(uv.u, width, repeat[0]))
    y, fy = vector.materialize(_neighbours(uv.v, height, repeat[1]))
    fx, fy = fx[None], fy[None]
    index = (base[None] + y * width[None])[:, None] + x[None]
    texels = vector.materialize(textures.texels.at[index].get(mode="promise_in_bounds"))

    shift = jnp.asarray(shifts, jnp.uint32)[:, None, None]
    (c00, c01), (c10, c11) = (
        [_decode(texels[row, column][None] >> shift, srgb) for column in (0, 1)]
        for row in (0, 1)
    )
    top = c00 + (c01 - c00) * fx
    bottom = c10 + (c11 - c10) * fx
    return vector.materialize(top + (bottom - top) * fy)


def _decode(texel: UInt[Array, "c l n"], srgb: bool) -> Float[Array, "c l n"]:
    """Takes the lowest 8 bits, to [0, 1], linear."""
    code = texel & jnp.uint32(0xFF)
    # By way of int32: the CPU has no vector conversion from unsigned.
    x = code.astype(jnp.int32).astype(jnp.float32) * jnp.float32(1.0 / 255.0)
    if not srgb:
        return x
    power = jnp.full_like(x, _SRGB_POLYNOMIAL[-1])
    for coefficient in _SRGB_POLYNOMIAL[-2::-1]:
        power = power * x + coefficient
    return jnp.where(x <= 0.04045, x * (1.0 / 12.92), power)


def _neighbours(
    u: Float[Array, " n"], extent: Int[Array, "l n"], repeat: Bool[Array, " n"]
) -> tuple[Int[Array, "2 l n"], Float[Array, "l n"]]:
    """Returns the two texel indices around u in [0, 1], and the second's weight."""
    x = u[None] * extent.astype(jnp.float32) - 0.5
    floor = jnp.floor(x)
    low, last = floor.astype(jnp.int32), extent - 1
    # From −1 to the extent: a single wrap either side is enough.
    before, after = jnp.where(repeat, last, 0), jnp.where(repeat, 0, last)
    beside = [
        jnp.where(index < 0, before, jnp.where(index > last, after, index))
        for index in (low, low + 1)
    ]
    return jnp.stack(beside), x - floor
