"""Compaction: the indices of the pixels that a mask asks for, in row-major order.

Sparse stages (ray tracing, FXAA) work on fixed-shape chunks of this list.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

_BITS = 32

T = TypeVar("T")


def for_each_chunk(
    needed: Bool[Array, "..."],
    chunk: int,
    work: Callable[[Int[Array, " c"], Bool[Array, " c"], T], T],
    carry: T,
) -> T:
    """Works on the elements asked for, so many at a time, in a `while_loop`.

    Compiled once whatever their number; the cost follows it.

    Args:
        needed: the elements asked for, n of any shape.
        chunk: elements at a time.
        work: takes flat indices (entries that are only fill hold n, which a scatter
            drops), which of them are used, and the carry; returns the carry.
        carry: any pytree.

    Returns:
        The carry after the last chunk.
    """
    n = needed.size
    chunk = min(chunk, n)
    indices, count = compact(needed)
    # Padding to a whole number of chunks.
    indices = jnp.concatenate([indices, jnp.full((-n % chunk,), n, jnp.int32)])

    def body(state: tuple[Int[Array, ""], T]) -> tuple[Int[Array, ""], T]:
        done, carry = state
        index = jax.lax.dynamic_slice(indices, (done,), (chunk,))
        used = done + jnp.arange(chunk, dtype=jnp.int32) < count
        return done + chunk, work(index, used, carry)

    start = (jnp.zeros((), jnp.int32), carry)
    return jax.lax.while_loop(lambda state: state[0] < count, body, start)[1]


def compact(
    mask: Bool[Array, "..."],
) -> tuple[Int[Array, " n"], Int[Array, ""]]:
    """Lists the pixels where the mask is True.

    Args:
        mask: the pixels asked for, n of any shape.

    Returns:
        (indices, count): flat row-major indices, int32, ascending; entries from
        `count` on hold n, one past the last pixel.
    """
    pixels = mask.size
    rank, count = _ranks(mask.reshape(-1))
    slot = jnp.where(mask.reshape(-1), rank, pixels)  # n: dropped by the scatter
    indices = jnp.full((pixels,), pixels, jnp.int32)
    indices = indices.at[slot].set(jnp.arange(pixels, dtype=jnp.int32), mode="drop")
    return indices, count


def ranks(mask: Bool[Array, "h w"]) -> tuple[Int[Array, "h w"], Int[Array, ""]]:
    """Counts, at each pixel, the True pixels before it in row-major order.

    Returns:
        (ranks, count of all True pixels), int32.
    """
    rank, count = _ranks(mask.reshape(-1))
    return rank.reshape(mask.shape), count


def _ranks(flat: Bool[Array, " n"]) -> tuple[Int[Array, " n"], Int[Array, ""]]:
    """Packs 32 pixels a word, sums over words, counts the lower bits within a word.

    A plain cumulative sum over all pixels takes ten times as long on the CPU.
    """
    n = flat.shape[0]
    bits = jnp.concatenate([flat, jnp.zeros((-n % _BITS,), jnp.bool_)])
    bits = bits.reshape(-1, _BITS)
    one = jnp.left_shift(jnp.uint32(1), jnp.arange(_BITS, dtype=jnp.uint32))[None, :]
    words = jnp.sum(jnp.where(bits, one, jnp.uint32(0)), axis=1, dtype=jnp.uint32)
    sizes = jax.lax.population_count(words).astype(jnp.int32)
    ends = jnp.cumsum(sizes, dtype=jnp.int32)
    starts = ends - sizes
    below = jax.lax.population_count(words[:, None] & (one - jnp.uint32(1)))
    rank = starts[:, None] + below.astype(jnp.int32)
    return rank.reshape(-1)[:n], ends[-1]
