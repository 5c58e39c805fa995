"""The mask: packing, and the ray budget (paper, section 3).

One uint32 a pixel: the antialiasing method in the low 16 bits, the classification
history in the high 16.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt

from ataa_jax import compact
from ataa_jax.types import METHOD_ATAA, METHOD_TAA, WHY_OVER_BUDGET, Segmentation

HOLD_MAX = 65535  # 16 bits: the counter saturates, it never wraps


def pack_mask(
    method: UInt[Array, "h w"], history: UInt[Array, "h w"]
) -> UInt[Array, "h w"]:
    """Packs a mask: method in the low 16 bits, classification history in the high.

    Args:
        method: METHOD_*, uint32.
        history: frames to hold, uint32; more than 65535 counts as 65535.
    """
    history = jnp.minimum(history, jnp.uint32(HOLD_MAX))
    return method | (history << jnp.uint32(16))


@jax.jit
def unpack_mask(
    mask: UInt[Array, "h w"],
) -> tuple[UInt[Array, "h w"], UInt[Array, "h w"]]:
    """Returns (method, classification history) of a packed mask, both uint32."""
    return mask & jnp.uint32(0xFFFF), mask >> jnp.uint32(16)


def all_taa(size: tuple[int, int]) -> Segmentation:
    """Returns the segmentation of plain TAA: every pixel, and no reason to doubt it."""
    nothing = jnp.zeros(size, jnp.float32)
    return Segmentation(
        mask=pack_mask(
            jnp.full(size, METHOD_TAA, jnp.uint32), jnp.zeros(size, jnp.uint32)
        ),
        why=jnp.zeros(size, jnp.uint16),
        score=nothing,
        luminance=nothing,
        depth=nothing,
    )


def bit(condition: Bool[Array, "h w"], value: int) -> UInt[Array, "h w"]:
    """Returns a WHY_* bit, uint16, where a condition holds."""
    return jnp.where(condition, jnp.uint16(value), jnp.uint16(0))


@jax.jit
def apply_budget(
    segmented: Segmentation, max_pixels: Int[Array, ""]
) -> tuple[Segmentation, Int[Array, ""]]:
    """Leaves rays to the pixels of the highest scores, at most `max_pixels` of them.

    Of equal scores the first in row-major order win. The rest become TAA's, with
    WHY_OVER_BUDGET; they keep their hold counters, and so ask again.

    Args:
        segmented: the mask wanted.
        max_pixels: int32; below 0 counts as 0.

    Returns:
        (segmentation, pixels that lost their rays).
    """
    method, counter = unpack_mask(segmented.mask)
    wants = method == METHOD_ATAA
    wanted = jnp.sum(wants, dtype=jnp.int32)
    allowed = jnp.maximum(max_pixels, 0)
    keeps = jax.lax.cond(
        wanted > allowed,
        _highest,
        lambda wants, score, wanted, allowed: wants,
        wants,
        segmented.score,
        wanted,
        allowed,
    )
    loses = wants & ~keeps
    method = jnp.where(loses, jnp.uint32(METHOD_TAA), method)
    limited = Segmentation(
        mask=pack_mask(method, counter),
        why=segmented.why | bit(loses, WHY_OVER_BUDGET),
        score=segmented.score,
        luminance=segmented.luminance,
        depth=segmented.depth,
    )
    return limited, jnp.maximum(wanted - allowed, 0)


def _highest(
    wants: Bool[Array, "h w"],
    score: Float[Array, "h w"],
    wanted: Int[Array, ""],
    allowed: Int[Array, ""],
) -> Bool[Array, "h w"]:
    """Returns the `allowed` highest scores among candidates, `wanted`, which are more.

    No sort: the bits of floats that are at least 0 order like integers, so the cut,
    the largest key that `allowed` candidates reach, is found bit by bit.
    """
    # A comparison with NaN is false, so NaN counts as 0 and has a place in the order.
    key = jax.lax.bitcast_convert_type(jnp.where(score > 0.0, score, 0.0), jnp.int32)
    key = jnp.where(wants, key, -1)

    def searching(state: tuple[Array, Array, Array]) -> Bool[Array, ""]:
        step, _, reached = state
        # Where as many reach the cut as are allowed, its lower bits change nothing.
        return (step < 31) & (reached != allowed)

    def refine(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        step, cut, reached = state
        higher = cut | jnp.left_shift(jnp.int32(1), 30 - step)
        count = jnp.sum(key >= higher, dtype=jnp.int32)
        enough = count >= allowed
        cut, reached = jnp.where(enough, higher, cut), jnp.where(enough, count, reached)
        return step + 1, cut, reached

    start = jnp.int32(0), jnp.int32(0), wanted
    _, cut, _ = jax.lax.while_loop(searching, refine, start)
    above, tied = key > cut, key == cut
    rank, _ = compact.ranks(tied)
    return above | (tied & (rank < allowed - jnp.sum(above, dtype=jnp.int32)))
