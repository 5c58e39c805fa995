"""Compaction: the indices of the pixels that a mask asks for, in row-major order.

Sparse stages (ray tracing, FXAA) work on fixed-shape chunks of this list.
"""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

_BITS = 32
BLOCK = 4  # pixels a side; a packet of rays is a block, or a half or quarter of one

T = TypeVar("T")
U = TypeVar("U")
V = TypeVar("V")


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


def map_chunks(
    needed: Bool[Array, " n"],
    chunk: int,
    work: Callable[[T, Bool[Array, " c"]], tuple[U, V]],
    rows: T,
    tile: tuple[int, int] | None = None,
) -> tuple[U, V]:
    """Maps a function over the elements asked for, packed together.

    Args:
        needed: the elements asked for.
        chunk: about as many elements at a time.
        work: takes a chunk's rows and which of them are used; returns rows, and what
            is to be summed over all chunks, 0 for rows that are not used.
        rows: any pytree of n rows; a scalar goes with every one of them.
        tile: image (height, width) where the elements are its pixels in row-major
            order: pixels of 4×4 blocks then stay together, as rays like it.

    Returns:
        (rows, 0 where they were not asked for; sums).
    """
    n = needed.shape[0]
    # As equal as they can be, and a multiple of every vector's width.
    chunk = -(-n // (-(-n // chunk) * _BITS)) * _BITS
    blocked, unblocked = _blocks(tile)

    def place(
        index: Int[Array, " c"], used: Bool[Array, " c"], carry: tuple[U, V]
    ) -> tuple[U, V]:
        whole, sums = carry
        index = jnp.where(index < n, unblocked(index), n)
        taken = jnp.minimum(index, n - 1)
        found, own = work(jax.tree.map(lambda x: _rows(x, taken), rows), used)
        whole = jax.tree.map(lambda x, y: x.at[index].set(y, mode="drop"), whole, found)
        return whole, jax.tree.map(jnp.add, sums, own)

    shapes = jax.eval_shape(work, rows, needed)
    start = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    return for_each_chunk(blocked(needed), chunk, place, start)


def _blocks(
    tile: tuple[int, int] | None,
) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
    """Returns how pixels are put in the order of blocks, and where each then is from.

    An image that is not made of whole blocks keeps its order.
    """
    if tile is None or tile[0] % BLOCK or tile[1] % BLOCK:
        return lambda x: x, lambda i: i
    across = tile[1] // BLOCK

    def blocked(values: Array) -> Array:
        cut = values.reshape(-1, BLOCK, across, BLOCK)
        return cut.transpose(0, 2, 1, 3).reshape(-1)

    def unblocked(index: Array) -> Array:
        block, within = index // BLOCK**2, index % BLOCK**2
        row = block // across * BLOCK + within // BLOCK
        return row * tile[1] + block % across * BLOCK + within % BLOCK

    return blocked, unblocked


def _rows(array: Array, index: Int[Array, " c"]) -> Array:
    return array.at[index].get(mode="promise_in_bounds") if array.ndim else array


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
