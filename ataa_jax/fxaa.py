"""FXAA stage: FXAA 3.11 quality on the display-referred image (paper, section 3).

"FXAA" is Lottes's filter (2009; version 3.11 of 2011, quality path): on the luma of
a tone-mapped, sRGB-encoded image it finds the direction of an edge, walks along it both
ways to its ends, and moves the sample across the edge by up to half a pixel. It runs at
the pixels that the mask gives it; the rest pass unchanged.

Symbols: M is the pixel's luma, N, S, W, E and the corners its neighbours'. The *pair*
is the pixel and the neighbour across the edge. Positions are in index units, integers
are pixel centres. Border rule of every read: clamp to edge.
"""

import itertools
from dataclasses import dataclass
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import color as colors
from ataa_jax import compact, exported, window

# Lengths of the search's steps, px (FXAA 3.11, FXAA_QUALITY__P0 and following).
STEPS: dict[int, tuple[float, ...]] = {
    12: (1.0, 1.5, 2.0, 4.0, 12.0),
    29: (1.0, 1.5, *[2.0] * 8, 4.0, 8.0),
    39: (*[1.0] * 5, 1.5, *[2.0] * 4, 4.0, 8.0),
}

# Two comparisons tie by algebra on common images: both directions' second differences
# at a pixel that stands out alone, and a tap half on, half off the end of a clean edge.
# our choice: a margin far under one 8-bit step, so that rounding never decides them.
_TIE = 1e-5


@dataclass(frozen=True)
class Config:
    """Choices that change the program."""

    preset: Literal[12, 29, 39] = 39  # our choice: the paper names none; the best
    # Pixels a pass of the sparse loop. our choice: half of the last pass is empty on
    # average, so few pixels cost less than with 8,192 or 16,384, and the full screen no
    # more; with 1,024 it costs half as much again.
    chunk: int = 4096


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    subpix: Float[Array, ""]  # 0: leave single-pixel features alone; 1: soften most
    edge_threshold: Float[Array, ""]  # contrast, relative to the brightest of the cross
    edge_threshold_min: Float[Array, ""]  # and absolute, for dark areas


def default_params(
    subpix: float = 0.75,  # FXAA 3.11's defaults, all three
    edge_threshold: float = 0.166,
    edge_threshold_min: float = 0.0833,
) -> Params:
    """Returns FXAA 3.11's default parameters."""
    return Params(
        subpix=jnp.asarray(subpix, jnp.float32),
        edge_threshold=jnp.asarray(edge_threshold, jnp.float32),
        edge_threshold_min=jnp.asarray(edge_threshold_min, jnp.float32),
    )


@exported.jit("config")
def fxaa(
    image: Float[Array, "h w 3"], params: Params, *, config: Config
) -> Float[Array, "h w 3"]:
    """Filters every pixel.

    Args:
        image: sRGB in [0, 1].
        params: thresholds.
        config: search steps and chunk size.

    Returns:
        sRGB in [0, 1].
    """
    everywhere = jnp.ones(image.shape[:2], jnp.bool_)
    return fxaa_sparse(image, everywhere, params, config=config)


@exported.jit("config")
def fxaa_sparse(
    image: Float[Array, "h w 3"],
    needed: Bool[Array, "h w"],
    params: Params,
    *,
    config: Config,
) -> Float[Array, "h w 3"]:
    """Filters the pixels asked for; the others pass unchanged, bit by bit.

    The cost falls with the pixels asked for that show an edge; no count of them
    compiles anew.

    Args:
        image: sRGB in [0, 1]. Neighbours are read from it, filtered or not.
        needed: the pixels to filter.
        params: thresholds.
        config: search steps and chunk size.

    Returns:
        sRGB in [0, 1].
    """
    luma = colors.luma(image)
    _, is_edge = _contrast(window.neighbours(window.border(luma)), params)
    height, width = needed.shape
    pixels = height * width

    def filter_chunk(
        index: Int[Array, " c"], used: Bool[Array, " c"], output: Float[Array, "n 3"]
    ) -> Float[Array, "n 3"]:
        inside = jnp.minimum(index, pixels - 1)  # the fill reads the last pixel
        filtered = fxaa_at(
            image, luma, inside // width, inside % width, params, config=config
        )
        return output.at[index].set(filtered, mode="drop")

    output = compact.for_each_chunk(
        needed & is_edge, config.chunk, filter_chunk, image.reshape(-1, 3)
    )
    return output.reshape(height, width, 3)


def fxaa_at(
    image: Float[Array, "h w 3"],
    luma: Float[Array, "h w"],
    row: Int[Array, " n"],
    column: Int[Array, " n"],
    params: Params,
    *,
    config: Config,
) -> Float[Array, "n 3"]:
    """Returns the filtered colour of a batch of pixels.

    Args:
        image: sRGB in [0, 1].
        luma: its luma.
        row: pixels inside the image.
        column: likewise.
        params: thresholds.
        config: search steps.

    Returns:
        sRGB; the pixel's own colour where its cross has too little contrast.
    """
    cross = tuple(
        tuple(_texel(luma, row + r, column + c) for c in (-1, 0, 1)) for r in (-1, 0, 1)
    )
    span, is_edge = _contrast(cross, params)
    horizontal = _is_horizontal(cross)
    subpixel = _subpixel_shift(cross, span) * params.subpix
    ((_, n, _), (w, m, e), (_, s, _)) = cross
    first, second = jnp.where(horizontal, n, w), jnp.where(horizontal, s, e)
    gradient_first, gradient_second = jnp.abs(first - m), jnp.abs(second - m)
    toward_first = gradient_first >= gradient_second
    sign = jnp.where(toward_first, -1.0, 1.0)
    pair_luma = 0.5 * (jnp.where(toward_first, first, second) + m)
    gradient = jnp.maximum(gradient_first, gradient_second)
    shift = _edge_shift(
        luma,
        row,
        column,
        horizontal,
        sign,
        pair_luma,
        0.25 * gradient - _TIE,
        m,
        config,
    )
    offset = jnp.maximum(shift, subpixel) * sign
    at_row = row.astype(jnp.float32) + jnp.where(horizontal, offset, 0.0)
    at_column = column.astype(jnp.float32) + jnp.where(horizontal, 0.0, offset)
    moved = _bilinear(image, at_row, at_column)
    own = image[row, column]
    return jnp.where(is_edge[:, None], moved, own)


def _contrast(
    nine: tuple[tuple[Array, ...], ...], params: Params
) -> tuple[Float[Array, "*n"], Bool[Array, "*n"]]:
    """Returns (luma range of the cross M, N, S, W, E, whether it is an edge)."""
    ((_, n, _), (w, m, e), (_, s, _)) = nine
    high = jnp.maximum(m, jnp.maximum(jnp.maximum(n, s), jnp.maximum(w, e)))
    low = jnp.minimum(m, jnp.minimum(jnp.minimum(n, s), jnp.minimum(w, e)))
    span = high - low
    limit = jnp.maximum(params.edge_threshold_min, high * params.edge_threshold)
    # Also not where all is equal: thresholds of 0 must not divide by a range of 0.
    return span, (span >= limit) & (span > 0.0)


def _is_horizontal(nine: tuple[tuple[Array, ...], ...]) -> Bool[Array, " n"]:
    """Compares second differences across rows and across columns, middle ones twice."""
    ((nw, n, ne), (w, m, e), (sw, s, se)) = nine

    def bend(a: Array, b: Array, c: Array) -> Array:
        return jnp.abs(a - 2.0 * b + c)

    across_rows = bend(nw, w, sw) + 2.0 * bend(n, m, s) + bend(ne, e, se)
    across_columns = bend(nw, n, ne) + 2.0 * bend(w, m, e) + bend(sw, s, se)
    return across_rows >= across_columns - _TIE


def _subpixel_shift(
    nine: tuple[tuple[Array, ...], ...], span: Float[Array, " n"]
) -> Float[Array, " n"]:
    """Returns (s²(3 − 2s))², s = sat(|mean of the neighbours − M| / range).

    The mean is (2·cross + corners)/12: how much the pixel stands out alone.
    """
    ((nw, n, ne), (w, m, e), (sw, s, se)) = nine
    mean = (2.0 * (n + s + w + e) + nw + ne + sw + se) * (1.0 / 12.0)
    lone = jnp.clip(jnp.abs(mean - m) / jnp.where(span > 0.0, span, 1.0), 0.0, 1.0)
    smooth = lone * lone * (3.0 - 2.0 * lone)
    return smooth * smooth


class _Walk(eqx.Module):
    """Both searches for the ends of an edge, backward and forward."""

    end: Float[Array, "2 n"]  # luma at the last tap, less the pair's mean
    reached: Float[Array, "2 n"]  # px
    done: Bool[Array, "2 n"]


def _edge_shift(
    luma: Float[Array, "h w"],
    row: Int[Array, " n"],
    column: Int[Array, " n"],
    horizontal: Bool[Array, " n"],
    sign: Float[Array, " n"],
    pair_luma: Float[Array, " n"],
    limit: Float[Array, " n"],
    m: Float[Array, " n"],
    config: Config,
) -> Float[Array, " n"]:
    """Walks along the edge both ways; returns the shift across it, px, in [0, ½].

    The walk reads half-way between the pair's two rows (or columns). An end is where
    that luma leaves the pair's mean by a quarter of the gradient; at the nearer end,
    if it lies on the other side of the mean than M, the shift is ½ − distance / span.
    """
    steps = STEPS[config.preset]
    # Backward and forward side by side, one batch of (2, n).
    direction = jnp.asarray([[-1], [1]], jnp.int32)
    # The two rows (columns) that every tap averages, as the first and second texel.
    across = jnp.where(sign < 0.0, -1, 0)

    mean, limit = jnp.stack([pair_luma, pair_luma]), jnp.stack([limit, limit])

    def walk(half: float, walked: _Walk, whole: Int[Array, ""]) -> tuple[_Walk, None]:
        tap = _between(luma, row, column, horizontal, across, direction, whole, half)
        end = jnp.where(walked.done, walked.end, tap - mean)
        distance = whole.astype(jnp.float32) + half
        reached = jnp.where(walked.done, walked.reached, distance)
        return _Walk(end, reached, walked.done | (jnp.abs(end) >= limit)), None

    zero = jnp.zeros_like(limit)
    walked = _Walk(end=zero, reached=zero, done=jnp.zeros(limit.shape, jnp.bool_))
    distances = list(itertools.accumulate(steps))
    # A loop for whole distances and one for halves: each step's code is compiled once.
    for half, group in itertools.groupby(distances[:-1], lambda d: d % 1.0):
        whole = jnp.asarray([int(d) for d in group], jnp.int32)
        walked, _ = jax.lax.scan(partial(walk, half), walked, whole)
    # The last step only lengthens the span; nothing is read there.
    end, reached = walked.end, jnp.where(walked.done, walked.reached, distances[-1])

    back, forth = reached[0], reached[1]
    nearest_end = jnp.where(back < forth, end[0], end[1])
    good = (nearest_end < 0.0) != (m < pair_luma)
    shift = 0.5 - jnp.minimum(back, forth) / (back + forth)
    return jnp.where(good, shift, 0.0)


def _between(
    luma: Float[Array, "h w"],
    row: Int[Array, " n"],
    column: Int[Array, " n"],
    horizontal: Bool[Array, " n"],
    across: Int[Array, " n"],
    direction: Int[Array, "2 1"],
    whole: Int[Array, ""],
    half: float,
) -> Float[Array, "2 n"]:
    """Reads luma half-way between two rows (columns), a distance along them each way.

    A bilinear tap whose fractions are known: ½ across, and along 0 or ½ (`half`) more
    than a whole number of texels.
    """
    columns = (0, 1) if half else (0,)
    total = jnp.zeros((2, row.shape[0]), jnp.float32)
    for side in (0, 1):
        for step in columns:
            along, sideways = direction * (whole + step), (across + side)[None, :]
            r = row[None, :] + jnp.where(horizontal[None, :], sideways, along)
            c = column[None, :] + jnp.where(horizontal[None, :], along, sideways)
            total = total + _texel(luma, r, c)
    return total * (0.5 / len(columns))


def _texel(
    plane: Float[Array, "h w"], row: Int[Array, "*n"], column: Int[Array, "*n"]
) -> Float[Array, "*n"]:
    """Returns texels, clamped to edge."""
    height, width = plane.shape
    r, c = jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)
    return window.read(plane, r * width + c)


def _bilinear(
    image: Float[Array, "h w 3"], row: Float[Array, " n"], column: Float[Array, " n"]
) -> Float[Array, "n 3"]:
    """Returns the image at positions in index units, clamped to edge."""
    height, width = image.shape[:2]
    texels = image.reshape(-1, 3)
    f_row = (row - jnp.floor(row))[:, None]
    f_column = (column - jnp.floor(column))[:, None]
    r0, r1 = (window.floor_index(row + k, height) * width for k in (0, 1))
    c0, c1 = (window.floor_index(column + k, width) for k in (0, 1))

    def texel(index: Array) -> Array:
        return texels.at[index].get(mode="promise_in_bounds")

    upper = texel(r0 + c0) * (1.0 - f_column) + texel(r0 + c1) * f_column
    lower = texel(r1 + c0) * (1.0 - f_column) + texel(r1 + c1) * f_column
    return upper * (1.0 - f_row) + lower * f_row
