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
) -> list[Float[Array, " n"]]:
    """Samples the channels that start at some bits of a texel."""
    safe = jnp.where(texture >= 0, texture, 0)
    repeat_u = textures.wrap_u[safe] == WRAP_REPEAT
    repeat_v = textures.wrap_v[safe] == WRAP_REPEAT
    wrapped = vector.materialize(
        Uv(
            _wrap(uv.u, textures.wrap_u[safe]),
            _wrap(uv.v, textures.wrap_v[safe]),
        )
    )

    def level(index: Int[Array, " n"]) -> list[Float[Array, " n"]]:
        return _bilinear(
            textures, safe, index, wrapped, (repeat_u, repeat_v), shifts, srgb
        )

    if uv_dx is None or uv_dy is None:
        return level(jnp.zeros_like(safe))
    detail = level_of_detail(textures, safe, uv_dx, uv_dy, mip_bias)
    low = jnp.floor(detail)
    fraction = detail - low
    low, fraction = vector.materialize((low.astype(jnp.int32), fraction))
    near = level(low)
    far = level(jnp.minimum(low + 1, textures.level_offset.shape[1] - 1))
    return [n + (f - n) * fraction for n, f in zip(near, far, strict=True)]


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
    width = textures.level_width[texture, 0].astype(jnp.float32)
    height = textures.level_height[texture, 0].astype(jnp.float32)
    squared = jnp.maximum(
        (uv_dx.u * width) ** 2 + (uv_dx.v * height) ** 2,
        (uv_dy.u * width) ** 2 + (uv_dy.v * height) ** 2,
    )
    # The level indexes a table: a comparison with NaN is false, so NaN reads level 0.
    squared = jnp.where(squared > 0.0, squared, 0.0)
    # 2^±60 keeps log2 finite for degenerate derivatives; the clamp below decides.
    level = 0.5 * jnp.log2(jnp.clip(squared, 2.0**-60, 2.0**60)) + mip_bias
    last = (textures.level_count[texture] - 1).astype(jnp.float32)
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
    level: Int[Array, " n"],
    uv: Uv,
    repeat: tuple[Bool[Array, " n"], Bool[Array, " n"]],
    shifts: tuple[int, ...],
    srgb: bool,
) -> list[Float[Array, " n"]]:
    """Filters four texels of one level; `uv` is already wrapped into [0, 1].

    Border rule: at the edge the neighbour wraps round under REPEAT and is clamped
    under CLAMP and MIRROR (a mirrored neighbour of the edge is the edge itself).
    """
    entry = texture * textures.level_offset.shape[1] + level
    width, height, base = (
        table.reshape(-1).at[entry].get(mode="promise_in_bounds")
        for table in (
            textures.level_width,
            textures.level_height,
            textures.level_offset,
        )
    )
    x0, x1, fx = _neighbours(uv.u, width, repeat[0])
    y0, y1, fy = _neighbours(uv.v, height, repeat[1])
    row0, row1 = base + y0 * width, base + y1 * width
    indices = (row0 + x0, row0 + x1, row1 + x0, row1 + x1)
    texels = vector.materialize(
        [textures.texels.at[i].get(mode="promise_in_bounds") for i in indices]
    )
    fx, fy = vector.materialize((fx, fy))

    def channel(shift: int) -> Float[Array, " n"]:
        c00, c01, c10, c11 = (_decode(texel, shift, srgb) for texel in texels)
        top = c00 + (c01 - c00) * fx
        bottom = c10 + (c11 - c10) * fx
        return top + (bottom - top) * fy

    return vector.materialize([channel(shift) for shift in shifts])


def _decode(texel: UInt[Array, " n"], shift: int, srgb: bool) -> Float[Array, " n"]:
    """Unpacks one 8-bit channel, to [0, 1], linear."""
    code = (texel >> jnp.uint32(shift)) & jnp.uint32(0xFF)
    # By way of int32: the CPU has no vector conversion from unsigned.
    x = code.astype(jnp.int32).astype(jnp.float32) * jnp.float32(1.0 / 255.0)
    if not srgb:
        return x
    power = jnp.full_like(x, _SRGB_POLYNOMIAL[-1])
    for coefficient in _SRGB_POLYNOMIAL[-2::-1]:
        power = power * x + coefficient
    return jnp.where(x <= 0.04045, x * (1.0 / 12.92), power)


def _neighbours(
    u: Float[Array, " n"], extent: Int[Array, " n"], repeat: Bool[Array, " n"]
) -> tuple[Int[Array, " n"], Int[Array, " n"], Float[Array, " n"]]:
    """Returns the two texel indices around u in [0, 1], and the second's weight."""
    x = u * extent.astype(jnp.float32) - 0.5
    floor = jnp.floor(x)
    last = extent - 1
    # u = 1 gives low = extent − 1 at most; a single wrap either side is enough.
    low = floor.astype(jnp.int32)
    high = low + 1
    low = jnp.where(low < 0, jnp.where(repeat, last, 0), jnp.minimum(low, last))
    high = jnp.where(high > last, jnp.where(repeat, 0, last), high)
    return low, high, x - floor
