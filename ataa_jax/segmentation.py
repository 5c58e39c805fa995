"""Segmentation: where TAA will fail, and why (paper, section 3).

In the paper's order, each test overriding those after it:

1. motion vectors tell what was occluded or outside the view: FXAA;
2. the classification history keeps a pixel whose criteria fired lately traced for the
   next few frames, unless its motion vector changed significantly: ATAA;
3. the temporal change of luminance in a small neighbourhood, and
4. the magnitude of a 3×3 Sobel filter on depth, weighted equally, against a threshold:
   ATAA where they pass it, else TAA.

Symbols: L is the luma of the tone-mapped colour and m its 3×3 mean; z is linear depth.

    luminance = |m(L) − m(L_history)| / max(m(L), m(L_history))
    depth     = |Sobel(1/z)| / (8 · largest 1/z of the 3×3)

Both lie in [0, 1] and do not change with the scene's scale: 8 is the largest response
of the kernel to values in [0, 1] along one axis, so a step between a surface and the
sky gives 1 at a straight edge.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from ataa_jax import color as colors
from ataa_jax import _w as window
from ataa_jax.types import (
    METHOD_ATAA,
    METHOD_FXAA,
    METHOD_TAA,
    WHY_DEPTH,
    WHY_DISOCCLUDED,
    WHY_HELD,
    WHY_LUMINANCE,
    WHY_OFF_SCREEN,
    WHY_OVER_BUDGET,
    WHY_RESET,
    GBuffer,
    History,
    Segmentation,
    State,
)
from ataa_jax.vector import materialize

MAX_HOLD = 0xFFFF  # the classification history has sixteen bits


@dataclass(frozen=True)
class Config:
    """Choices that change the program; each criterion can be switched off."""

    use_disocclusion: bool = True  # off: only what was off-screen gets FXAA
    use_history: bool = True
    use_luminance: bool = True
    use_depth: bool = True
    # "Depth and temporal luminance are weighted equally": their weighted mean against
    # one threshold, or either one against it.
    reading: Literal["sum", "either"] = "sum"
    # `pixel`: the previous motion at the reprojected pixel, as the paper says.
    # `neighbourhood`: the closest of the 3×3 around it, and only where the previous
    # surface was nearer than this one. our choice: a wire that jitter hits in one frame
    # and misses in the next is no disocclusion, yet its motion differs from the sky's.
    disocclusion: Literal["pixel", "neighbourhood"] = "neighbourhood"


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    luminance_weight: Float[Array, ""]
    depth_weight: Float[Array, ""]
    threshold: Float[Array, ""]
    luminance_floor: Float[Array, ""]  # tone-mapped luma below which nothing changes
    disocclusion_px: Float[Array, ""]  # motion difference that means another surface
    disocclusion_ratio: Float[Array, ""]  # the same, as a share of the motion
    nearer_ratio: Float[Array, ""]  # previous depth below this share of ours: in front
    reset_px: Float[Array, ""]  # motion difference that resets the history
    hold: Int[Array, ""]  # frames for which a pixel stays traced after it fired


def default_params() -> Params:
    """Returns the defaults."""
    return Params(
        luminance_weight=_number(1.0),  # paper, section 3: equal weights
        depth_weight=_number(1.0),
        # our choice: experiments/shares.py, under 0.5 rays a pixel at 8x.
        threshold=_number(0.12),
        # our choice: two 8-bit sRGB steps above black, below what a display shows.
        luminance_floor=_number(0.001),
        # our choice: a pixel and a tenth of the motion. Jitter moves the sample by up
        # to a pixel along a slanted surface, and perspective changes the motion of one
        # surface by a few per cent a frame.
        disocclusion_px=_number(1.0),
        disocclusion_ratio=_number(0.1),
        # our choice: an occluder within 5 % of the depth leaves little parallax.
        nearer_ratio=_number(0.95),
        # our choice: twice the disocclusion's, so that held pixels survive jitter.
        reset_px=_number(2.0),
        # our choice: "the next few frames" (paper, section 3).
        hold=jnp.asarray(4, jnp.int32),
    )


def _number(value: float) -> Float[Array, ""]:
    return jnp.asarray(value, jnp.float32)


def pack_mask(
    method: UInt[Array, "*n"], history: UInt[Array, "*n"]
) -> UInt[Array, "*n"]:
    """Packs method (low 16 bits) and classification history (high 16), uint32."""
    low = method.astype(jnp.uint32) & jnp.uint32(0xFFFF)
    return low | (history.astype(jnp.uint32) << jnp.uint32(16))


def unpack_mask(
    mask: UInt[Array, "*n"],
) -> tuple[UInt[Array, "*n"], UInt[Array, "*n"]]:
    """Returns method and classification history, uint32 each."""
    return mask & jnp.uint32(0xFFFF), mask >> jnp.uint32(16)


@partial(jax.jit, static_argnames=("config",))
def segment(
    state: State,
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    reprojected: Float[Array, "h w 3"],
    params: Params,
    max_pixels: Int[Array, ""],
    *,
    config: Config,
) -> tuple[Segmentation, Int[Array, ""]]:
    """Classifies every pixel, and holds the mask to the ray budget.

    Args:
        state: what the last frame left.
        color: this frame's raster colour, linear.
        gbuffer: its depth and motion vectors.
        reprojected: the history as TAA read it, before rectification, linear.
        params: numbers.
        max_pixels: pixels that may be traced; the highest scores win.
        config: choices.

    Returns:
        The segmentation, and how many pixels asked for rays beyond the budget: those
        keep TAA's colour and their classification history.
    """
    found = classify(state, color, gbuffer, reprojected, params, config=config)
    return apply_budget(found, max_pixels)


def classify(
    state: State,
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    reprojected: Float[Array, "h w 3"],
    params: Params,
    *,
    config: Config,
) -> Segmentation:
    """Classifies every pixel without a budget; see `segment`."""
    shape = gbuffer.depth.shape
    never = jnp.zeros(shape, bool)
    index = _reprojected_index(gbuffer)
    off_screen = ~gbuffer.motion_valid | ~state.history.valid
    change = _motion_change(gbuffer, state.history, index)
    disoccluded = never
    if config.use_disocclusion:
        disoccluded = _disoccluded(gbuffer, state.history, params, config)
    new = off_screen | disoccluded

    remaining = jnp.zeros(shape, jnp.int32)
    reset = never
    if config.use_history:
        _, stored = unpack_mask(_read(state.classification.mask, index))
        reset = (change > params.reset_px) & ~new
        remaining = jnp.where(new | reset, 0, stored.astype(jnp.int32))
    held = remaining > 0

    luminance = _luminance_term(color, reprojected, params.luminance_floor)
    luminance = jnp.where(new, 0.0, luminance)
    depth = _depth_term(gbuffer.depth)
    score, fires = _criteria(luminance, depth, params, config)
    fires = fires & ~new
    traced = held | fires
    hold = jnp.clip(params.hold, 0, MAX_HOLD)
    # Only a firing criterion sets the counter, so holding never feeds itself.
    history = jnp.where(fires, hold, jnp.maximum(remaining - 1, 0))
    history = jnp.where(new, 0, history) if config.use_history else remaining
    method = jnp.where(new, METHOD_FXAA, jnp.where(traced, METHOD_ATAA, METHOD_TAA))
    by_luminance, by_depth = _reasons(luminance, depth, fires, params, config)
    why = (
        _bit(off_screen, WHY_OFF_SCREEN)
        | _bit(disoccluded & ~off_screen, WHY_DISOCCLUDED)
        | _bit(held & ~new, WHY_HELD)
        | _bit(by_luminance & ~new, WHY_LUMINANCE)
        | _bit(by_depth & ~new, WHY_DEPTH)
        | _bit(reset, WHY_RESET)
    )
    return Segmentation(
        mask=pack_mask(method.astype(jnp.uint32), history.astype(jnp.uint32)),
        why=why,
        score=score,
        luminance=luminance,
        depth=depth,
    )


def apply_budget(
    found: Segmentation, max_pixels: Int[Array, ""]
) -> tuple[Segmentation, Int[Array, ""]]:
    """Leaves rays to at most `max_pixels` pixels: the highest scores win.

    Ties go to the lowest pixel index, so the choice is deterministic. The cut-off score
    is found by bisection on the bit pattern of the scores (non-negative floats order as
    their bits do): 31 counts in place of a sort.

    Args:
        found: the mask without a budget.
        max_pixels: pixels that may be traced.

    Returns:
        The mask within the budget, and the number of pixels that lost their rays.
    """
    method, history = unpack_mask(found.mask)
    traced = method == METHOD_ATAA
    asked = jnp.sum(traced, dtype=jnp.int32)

    def cut() -> Bool[Array, "h w"]:
        bits = jax.lax.bitcast_convert_type(found.score, jnp.int32)
        bits = jnp.where(traced, jnp.maximum(bits, 0), -1)

        def narrow(_: Int[Array, ""], bounds: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = bounds  # count(bits > high) ≤ max_pixels < count(bits > low)
            middle = low + (high - low) // 2
            above = jnp.sum(bits > middle, dtype=jnp.int32)
            fits = above <= max_pixels
            return jnp.where(fits, low, middle), jnp.where(fits, middle, high)

        start = jnp.asarray(-1, jnp.int32), jnp.asarray(0x7F800000, jnp.int32)
        _, level = jax.lax.fori_loop(0, 31, narrow, start)
        sure = bits > level
        tied = bits == level
        room = max_pixels - jnp.sum(sure, dtype=jnp.int32)
        order = jnp.cumsum(tied.reshape(-1).astype(jnp.int32)).reshape(tied.shape)
        return sure | (tied & (order <= room))

    kept = jax.lax.cond(asked > max_pixels, cut, lambda: traced)
    lost = traced & ~kept
    method = jnp.where(lost, jnp.uint32(METHOD_TAA), method)
    limited = eqx.tree_at(
        lambda s: (s.mask, s.why),
        found,
        (pack_mask(method, history), found.why | _bit(lost, WHY_OVER_BUDGET)),
    )
    return limited, jnp.sum(lost, dtype=jnp.int32)


def _bit(where: Bool[Array, "h w"], bit: int) -> UInt[Array, "h w"]:
    return jnp.where(where, jnp.uint8(bit), jnp.uint8(0))


def _reprojected_index(gbuffer: GBuffer) -> Int[Array, "h w"]:
    """Returns the flat index of the nearest pixel to where the point was before.

    Border rule: clamp to edge (what was off-screen is FXAA and never reads it).
    """
    height, width = gbuffer.depth.shape
    row = jnp.arange(height, dtype=jnp.float32)[:, None]
    column = jnp.arange(width, dtype=jnp.float32)[None, :]
    row = jnp.clip(jnp.round(row + gbuffer.motion[..., 1]), 0, height - 1)
    column = jnp.clip(jnp.round(column + gbuffer.motion[..., 0]), 0, width - 1)
    return row.astype(jnp.int32) * width + column.astype(jnp.int32)


def _read(image: Array, index: Int[Array, "h w"]) -> Array:
    return image.reshape(-1).at[index].get(mode="promise_in_bounds")


def _motion_change(
    gbuffer: GBuffer, history: History, index: Int[Array, "h w"]
) -> Float[Array, "h w"]:
    """Returns |motion − previous motion at the reprojected pixel|, px."""
    x = gbuffer.motion[..., 0] - _read(history.motion[..., 0], index)
    y = gbuffer.motion[..., 1] - _read(history.motion[..., 1], index)
    return jnp.sqrt(x * x + y * y)


def _disoccluded(
    gbuffer: GBuffer, history: History, params: Params, config: Config
) -> Bool[Array, "h w"]:
    """Returns where the previous frame showed another surface at this point's place."""
    height, width = gbuffer.depth.shape
    index = _reprojected_index(gbuffer)
    x, y = gbuffer.motion[..., 0], gbuffer.motion[..., 1]
    speed = jnp.sqrt(x * x + y * y)
    tolerance = params.disocclusion_px + params.disocclusion_ratio * speed
    if config.disocclusion == "pixel":
        return _motion_change(gbuffer, history, index) > tolerance
    row, column = index // width, index % width
    past_x, past_y = history.motion[..., 0], history.motion[..., 1]
    smallest = jnp.full((height, width), jnp.inf, jnp.float32)
    for down in (-1, 0, 1):
        r = jnp.clip(row + down, 0, height - 1) * width
        for right in (-1, 0, 1):
            at = r + jnp.clip(column + right, 0, width - 1)
            dx, dy = x - _read(past_x, at), y - _read(past_y, at)
            smallest = materialize(jnp.minimum(smallest, dx * dx + dy * dy))
    in_front = _read(history.depth, index) < params.nearer_ratio * gbuffer.depth
    return (smallest > tolerance * tolerance) & in_front


def _luminance_term(
    color: Float[Array, "h w 3"],
    reprojected: Float[Array, "h w 3"],
    floor: Float[Array, ""],
) -> Float[Array, "h w"]:
    """Returns the relative temporal change of the 3×3 mean luma, in [0, 1]."""
    now = window.mean(colors.luma(colors.tonemap(color)))
    then = window.mean(colors.luma(colors.tonemap(reprojected)))
    largest = jnp.maximum(now, then)
    dark = largest < floor
    # Two equal means computed by two fused programs may differ in the last bits.
    change = jnp.abs(now - then) / jnp.where(dark, 1.0, largest)
    return jnp.clip(jnp.where(dark, 0.0, change), 0.0, 1.0)


def _depth_term(depth: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Returns the relative Sobel magnitude of 1/z, in [0, 1]; 0 where all is sky."""
    usable = depth > 0.0
    inverse = jnp.where(usable, 1.0 / jnp.where(usable, depth, 1.0), 0.0)
    largest = window.maximum(inverse)
    present = largest > 0.0
    ratio = window.sobel(inverse) / (8.0 * jnp.where(present, largest, 1.0))
    return jnp.clip(jnp.where(present, ratio, 0.0), 0.0, 1.0)


def _criteria(
    luminance: Float[Array, "h w"],
    depth: Float[Array, "h w"],
    params: Params,
    config: Config,
) -> tuple[Float[Array, "h w"], Bool[Array, "h w"]]:
    """Returns the score by which rays are given, and whether it passes."""
    wl = params.luminance_weight if config.use_luminance else jnp.zeros_like(depth)
    wd = params.depth_weight if config.use_depth else jnp.zeros_like(depth)
    if config.reading == "either":
        score = jnp.maximum(jnp.sign(wl) * luminance, jnp.sign(wd) * depth)
    else:
        total = wl + wd
        score = (wl * luminance + wd * depth) / jnp.where(total > 0.0, total, 1.0)
    return score, (score > params.threshold) & (wl + wd > 0.0)


def _reasons(
    luminance: Float[Array, "h w"],
    depth: Float[Array, "h w"],
    fires: Bool[Array, "h w"],
    params: Params,
    config: Config,
) -> tuple[Bool[Array, "h w"], Bool[Array, "h w"]]:
    """Returns where each criterion passes alone, or gave the greater part of the sum."""
    nothing = jnp.zeros_like(depth)
    score_l, by_luminance = _criteria(luminance, nothing, params, config)
    score_d, by_depth = _criteria(nothing, depth, params, config)
    return by_luminance | (fires & (score_l >= score_d)), by_depth | (
        fires & (score_d > score_l)
    )
