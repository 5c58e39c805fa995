"""FXAA 3.11 quality (Lottes), at the pixels that ask for it (paper, section 3).

The paper runs FXAA on the tone-mapped image at disoccluded pixels only, so that its
cost falls with their number. `fxaa_at` evaluates a batch of pixels; `fxaa` (full
screen, the baseline) and `fxaa_sparse` (masked, in chunks) both call it.

Symbols: M is the pixel, N S E W and the corners its neighbours' lumas; *range* is the
largest minus the smallest of the cross. An edge runs along the axis across which the
second differences are smaller; both its ends are searched for in growing steps, half a
pixel off the pixel's centre toward the steeper side.
"""

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import color as colors
from ataa_jax import compact, vector
from ataa_jax.vector import Vec3

# Search steps in pixels (FXAA 3.11, FXAA_QUALITY__P0 …), by preset.
STEPS: dict[int, tuple[float, ...]] = {
    12: (1.0, 1.5, 2.0, 4.0, 12.0),
    29: (1.0, 1.5, *(2.0,) * 8, 4.0, 8.0),
    39: (*(1.0,) * 5, 1.5, *(2.0,) * 4, 4.0, 8.0),
}


@dataclass(frozen=True)
class Config:
    """Choices that change the program."""

    preset: int = 39  # 12: medium dither (UE4's default class), 39: extreme quality
    # our choice: the unused tail of the last chunk stays under 2 % of a 640×360 frame.
    chunk: int = 4096


class Params(eqx.Module):
    """Lottes's tuning knobs."""

    subpixel: Float[Array, ""]
    edge_threshold: Float[Array, ""]
    edge_threshold_min: Float[Array, ""]


def default_params() -> Params:
    """Returns FXAA 3.11's "high quality" values."""
    return Params(
        subpixel=jnp.asarray(0.75, jnp.float32),
        edge_threshold=jnp.asarray(0.125, jnp.float32),
        edge_threshold_min=jnp.asarray(0.0625, jnp.float32),
    )


@partial(jax.jit, static_argnames=("config",))
def fxaa(
    image: Float[Array, "h w 3"], params: Params, *, config: Config
) -> Float[Array, "h w 3"]:
    """Filters the whole image.

    Args:
        image: display-referred sRGB in [0, 1].
        params: Lottes's knobs.
        config: the preset.

    Returns:
        The filtered image, sRGB.
    """
    height, width, _ = image.shape
    index = jnp.arange(height * width, dtype=jnp.int32)
    channels = vector.unstack(image.reshape(-1, 3))
    found = fxaa_at(
        channels,
        vector.materialize(colors.luma(image).reshape(-1)),
        index // width,
        index % width,
        (height, width),
        params,
        config=config,
    )
    return vector.stack(found).reshape(image.shape)


@partial(jax.jit, static_argnames=("config",))
def fxaa_sparse(
    image: Float[Array, "h w 3"],
    needed: Bool[Array, "h w"],
    params: Params,
    *,
    config: Config,
) -> Float[Array, "h w 3"]:
    """Filters the pixels of a mask; the rest pass unchanged and cost nothing.

    Args:
        image: display-referred sRGB in [0, 1].
        needed: the pixels to filter.
        params: Lottes's knobs.
        config: preset and capacity of a chunk.

    Returns:
        The image with those pixels filtered, from the unfiltered image throughout.
    """
    height, width, _ = image.shape
    pixels = height * width
    chunk = min(config.chunk, pixels)
    indices, count = compact.compact(needed)
    padding = -pixels % chunk
    indices = jnp.concatenate([indices, jnp.full((padding,), pixels, jnp.int32)])
    flat = image.reshape(-1, 3)
    channels = vector.materialize(vector.unstack(flat))
    luma = vector.materialize(colors.luma(flat))

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        done, out = carry
        index = jax.lax.dynamic_slice(indices, (done,), (chunk,))
        inside = jnp.minimum(index, pixels - 1)
        found = fxaa_at(
            channels,
            luma,
            inside // width,
            inside % width,
            (height, width),
            params,
            config=config,
        )
        return done + chunk, out.at[index].set(vector.stack(found), mode="drop")

    start = jnp.zeros((), jnp.int32), flat
    _, out = jax.lax.while_loop(lambda carry: carry[0] < count, body, start)
    return out.reshape(image.shape)


def fxaa_at(
    image: Vec3,
    luma: Float[Array, " p"],
    row: Int[Array, " n"],
    column: Int[Array, " n"],
    size: tuple[int, int],
    params: Params,
    *,
    config: Config,
) -> Vec3:
    """Filters single pixels of an image.

    Args:
        image: all pixels' channels, row-major, sRGB.
        luma: all pixels' perceptual luma.
        row: the pixels to filter.
        column: their columns.
        size: the image's (height, width).
        params: Lottes's knobs.
        config: the preset.

    Returns:
        The filtered colours. Border rule: reads clamp to edge.
    """
    height, width = size

    def at(down: int, right: int) -> Float[Array, " n"]:
        r = jnp.clip(row + down, 0, height - 1)
        c = jnp.clip(column + right, 0, width - 1)
        return luma.at[r * width + c].get(mode="promise_in_bounds")

    m = at(0, 0)
    n, s, e, w = at(-1, 0), at(1, 0), at(0, 1), at(0, -1)
    nw, ne, sw, se = at(-1, -1), at(-1, 1), at(1, -1), at(1, 1)
    m, n, s, e, w, nw, ne, sw, se = vector.materialize((m, n, s, e, w, nw, ne, sw, se))
    highest = jnp.maximum(jnp.maximum(jnp.maximum(n, s), jnp.maximum(e, w)), m)
    lowest = jnp.minimum(jnp.minimum(jnp.minimum(n, s), jnp.minimum(e, w)), m)
    extent = highest - lowest
    limit = jnp.maximum(params.edge_threshold_min, highest * params.edge_threshold)
    flat = extent < limit
    # An edge is horizontal where luma changes most from row to row.
    across_rows = (
        2.0 * jnp.abs(n + s - 2.0 * m)
        + jnp.abs(ne + se - 2.0 * e)
        + jnp.abs(nw + sw - 2.0 * w)
    )
    across_columns = (
        2.0 * jnp.abs(w + e - 2.0 * m)
        + jnp.abs(nw + ne - 2.0 * n)
        + jnp.abs(sw + se - 2.0 * s)
    )
    horizontal = across_rows >= across_columns
    before = jnp.where(horizontal, n, w)
    after = jnp.where(horizontal, s, e)
    gradient_before, gradient_after = jnp.abs(before - m), jnp.abs(after - m)
    toward_before = gradient_before >= gradient_after
    gradient = jnp.maximum(gradient_before, gradient_after)
    side = jnp.where(toward_before, -1.0, 1.0)
    edge_luma = 0.5 * (jnp.where(toward_before, before, after) + m)
    horizontal, side, edge_luma, gradient, extent = vector.materialize(
        (horizontal, side, edge_luma, gradient, extent)
    )

    # Positions in pixel-index units, half a pixel toward the steeper side.
    y = row.astype(jnp.float32) + jnp.where(horizontal, 0.5 * side, 0.0)
    x = column.astype(jnp.float32) + jnp.where(horizontal, 0.0, 0.5 * side)
    step_y = jnp.where(horizontal, 0.0, 1.0)
    step_x = jnp.where(horizontal, 1.0, 0.0)

    def luma_at(distance: Float[Array, " n"]) -> Float[Array, " n"]:
        return _bilinear(luma, y + distance * step_y, x + distance * step_x, size)

    def search(direction: float) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Walks until the luma leaves the edge's mean by a quarter of its gradient."""
        distance = jnp.zeros_like(m)
        end = jnp.zeros_like(m)
        done = jnp.zeros_like(flat)
        for step in STEPS[config.preset]:
            distance = jnp.where(done, distance, distance + step)
            end = jnp.where(done, end, luma_at(direction * distance) - edge_luma)
            done = jnp.abs(end) >= 0.25 * gradient
            distance, end, done = vector.materialize((distance, end, done))
        return distance, end

    negative, end_negative = search(-1.0)
    positive, end_positive = search(1.0)
    nearest = jnp.minimum(negative, positive)
    end = jnp.where(negative < positive, end_negative, end_positive)
    good = (end < 0.0) != (m - edge_luma < 0.0)
    along = 0.5 - nearest / (negative + positive)
    edge_offset = jnp.where(good, along, 0.0)

    cross, corners = n + s + e + w, nw + ne + sw + se
    blur = jnp.abs((2.0 * cross + corners) * (1.0 / 12.0) - m)
    blur = jnp.clip(blur / jnp.where(extent > 0.0, extent, 1.0), 0.0, 1.0)
    smooth = blur * blur * (3.0 - 2.0 * blur)
    subpixel_offset = smooth * smooth * params.subpixel
    offset = jnp.where(flat, 0.0, jnp.maximum(edge_offset, subpixel_offset)) * side
    at_y = row.astype(jnp.float32) + jnp.where(horizontal, offset, 0.0)
    at_x = column.astype(jnp.float32) + jnp.where(horizontal, 0.0, offset)
    at_y, at_x = vector.materialize((at_y, at_x))
    return Vec3(
        *(_bilinear(c, at_y, at_x, size) for c in (image.x, image.y, image.z))
    )


def _bilinear(
    channel: Float[Array, " p"],
    y: Float[Array, " n"],
    x: Float[Array, " n"],
    size: tuple[int, int],
) -> Float[Array, " n"]:
    """Reads between pixel centres, at whole indices exactly; clamps to edge."""
    height, width = size
    y = jnp.clip(y, 0.0, height - 1.0)
    x = jnp.clip(x, 0.0, width - 1.0)
    y0, x0 = jnp.floor(y), jnp.floor(x)
    fy, fx = y - y0, x - x0
    r0, c0 = y0.astype(jnp.int32), x0.astype(jnp.int32)
    r1, c1 = jnp.minimum(r0 + 1, height - 1), jnp.minimum(c0 + 1, width - 1)

    def read(r: Array, c: Array) -> Array:
        return channel.at[r * width + c].get(mode="promise_in_bounds")

    top = read(r0, c0) + (read(r0, c1) - read(r0, c0)) * fx
    low = read(r1, c0) + (read(r1, c1) - read(r1, c0)) * fx
    return top + (low - top) * fy
