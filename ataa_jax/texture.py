"""Texture lookup in the packed mip pyramids of `types.Textures`.

A texel (i, j) of a level w×h covers u in [i/w, (i+1)/w]; its centre is at +0.5. Each
lookup is bilinear within a level and, where a level of detail is given, linear between
the two nearest levels (trilinear; OpenGL 4.6 specification, 8.14). sRGB texels are
decoded before they are filtered.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt

from ataa_jax.types import WRAP_MIRROR, WRAP_REPEAT, Textures


def _decode_table() -> np.ndarray:
    """Linear values of the 256 sRGB codes (IEC 61966-2-1), then of 256 linear codes."""
    code = np.arange(256) / 255.0
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    return np.concatenate([linear, code]).astype(np.float32)


_DECODE = _decode_table()


def sample(
    textures: Textures,
    texture: Int[Array, " n"],
    uv: Float[Array, "n 2"],
    uv_dx: Float[Array, "n 2"] | None,
    uv_dy: Float[Array, "n 2"] | None,
    mip_bias: Float[Array, ""] | float = 0.0,
    *,
    alpha: bool = False,
) -> Float[Array, "n c"]:
    """Samples one texture per element.

    Args:
        textures: the pyramids.
        texture: texture id, or NO_TEXTURE, which reads as white.
        uv: texture coordinates, any finite value.
        uv_dx: change of uv by one pixel to the right; None: mip level 0 everywhere,
            the paper's infinite derivatives.
        uv_dy: the same, one pixel down.
        mip_bias: added to the level of detail.
        alpha: return four channels, with alpha, instead of three.

    Returns:
        Linear colour (n, 3), or (n, 4) with alpha.
    """
    present = texture >= 0
    safe = jnp.where(present, texture, 0)
    uv = _wrap(textures, safe, uv)
    if uv_dx is None or uv_dy is None:
        color = _bilinear(textures, safe, jnp.zeros_like(safe), uv, alpha)
    else:
        level = level_of_detail(textures, safe, uv_dx, uv_dy, mip_bias)
        low = jnp.floor(level)
        fraction = (level - low)[:, None]
        low = low.astype(jnp.int32)
        # A scan over the two levels would compile one body; unrolled it fuses better.
        near = _bilinear(textures, safe, low, uv, alpha)
        high = jnp.minimum(low + 1, textures.level_offset.shape[1] - 1)
        far = _bilinear(textures, safe, high, uv, alpha)
        color = near + (far - near) * fraction
    return jnp.where(present[:, None], color, 1.0)


def level_of_detail(
    textures: Textures,
    texture: Int[Array, " n"],
    uv_dx: Float[Array, "n 2"],
    uv_dy: Float[Array, "n 2"],
    mip_bias: Float[Array, ""] | float,
) -> Float[Array, " n"]:
    """Returns log2 of the longer pixel footprint in texels, plus bias, clamped.

    OpenGL 4.6 specification, equation 8.7 with the exact (Euclidean) scale factor.
    """
    extent = jnp.stack(
        [textures.level_width[texture, 0], textures.level_height[texture, 0]], axis=-1
    ).astype(jnp.float32)
    squared = jnp.maximum(
        jnp.sum((uv_dx * extent) ** 2, axis=-1), jnp.sum((uv_dy * extent) ** 2, axis=-1)
    )
    # 2^±60 keeps log2 finite for degenerate derivatives; the clamp below decides.
    level = 0.5 * jnp.log2(jnp.clip(squared, 2.0**-60, 2.0**60)) + mip_bias
    last = (textures.level_count[texture] - 1).astype(jnp.float32)
    return jnp.clip(level, 0.0, last)


def _wrap(
    textures: Textures, texture: Int[Array, " n"], uv: Float[Array, "n 2"]
) -> Float[Array, "n 2"]:
    """Brings uv into [0, 1] by each axis's wrap mode."""
    mode = jnp.stack([textures.wrap_u[texture], textures.wrap_v[texture]], axis=-1)
    repeat = uv - jnp.floor(uv)
    mirror = 1.0 - jnp.abs(1.0 - 2.0 * (uv * 0.5 - jnp.floor(uv * 0.5)))
    clamp = jnp.clip(uv, 0.0, 1.0)
    return jnp.where(
        mode == WRAP_REPEAT, repeat, jnp.where(mode == WRAP_MIRROR, mirror, clamp)
    )


def _bilinear(
    textures: Textures,
    texture: Int[Array, " n"],
    level: Int[Array, " n"],
    uv: Float[Array, "n 2"],
    alpha: bool,
) -> Float[Array, "n c"]:
    """Filters four texels of one level; `uv` is already wrapped into [0, 1].

    Border rule: at the edge the neighbour wraps round under REPEAT and is clamped
    under CLAMP and MIRROR (a mirrored neighbour of the edge is the edge itself).
    """
    width = textures.level_width[texture, level]
    height = textures.level_height[texture, level]
    x0, x1, fx = _neighbours(uv[:, 0], width, textures.wrap_u[texture] == WRAP_REPEAT)
    y0, y1, fy = _neighbours(uv[:, 1], height, textures.wrap_v[texture] == WRAP_REPEAT)
    base = textures.level_offset[texture, level]
    table = jnp.asarray(_DECODE)
    offset = jnp.where(textures.srgb[texture], 0, 256).astype(jnp.uint32)
    row0, row1 = base + y0 * width, base + y1 * width

    def fetch(index: Int[Array, " n"]) -> list[Float[Array, " n"]]:
        return _decode(textures.texels[index], table, offset, alpha)

    corners = zip(
        fetch(row0 + x0), fetch(row0 + x1), fetch(row1 + x0), fetch(row1 + x1),
        strict=True,
    )  # fmt: skip
    channels = []
    for c00, c01, c10, c11 in corners:
        top = c00 + (c01 - c00) * fx
        bottom = c10 + (c11 - c10) * fx
        channels.append(top + (bottom - top) * fy)
    return jnp.stack(channels, axis=-1)


def _neighbours(
    u: Float[Array, " n"], extent: Int[Array, " n"], repeat: Array
) -> tuple[Int[Array, " n"], Int[Array, " n"], Float[Array, " n"]]:
    """Returns the two texel indices around u in [0, 1], and the second's weight."""
    x = u * extent.astype(jnp.float32) - 0.5
    floor = jnp.floor(x)
    fraction = x - floor
    low = floor.astype(jnp.int32)
    high = low + 1
    last = extent - 1
    # u = 1 gives low = extent − 1 at most; a single wrap either side is enough.
    low = jnp.where(low < 0, jnp.where(repeat, last, 0), jnp.minimum(low, last))
    high = jnp.where(high > last, jnp.where(repeat, 0, last), high)
    return low, high, fraction


def _decode(
    texel: UInt[Array, " n"], table: Array, offset: UInt[Array, " n"], alpha: bool
) -> list[Float[Array, " n"]]:
    """Unpacks 8-bit channels; RGB through the sRGB or the linear half of the table."""
    mask = jnp.uint32(0xFF)
    channels = [
        table[((texel >> jnp.uint32(shift)) & mask) + offset] for shift in (0, 8, 16)
    ]
    if alpha:
        channels.append(
            (texel >> jnp.uint32(24)).astype(jnp.float32) * jnp.float32(1.0 / 255.0)
        )
    return channels


sample_jit = jax.jit(sample, static_argnames=("alpha",))
