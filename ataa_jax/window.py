"""Reads around a pixel of an image: 3×3 neighbourhoods, and the reprojected position.

Border rule, everywhere: clamp to edge, the nearest pixel of the image stands for one
outside. Images are single planes, (h, w): on the CPU a plane is bordered once and then
read through nine slices, which one vectorized loop fuses; shifting a plane for each
neighbour, or an axis of three channels, takes two to ten times as long.

Axis letters: ``hb wb`` are the rows and columns of a bordered plane, h + 2 and w + 2.
"""

from collections.abc import Callable
from functools import reduce

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from ataa_jax.vector import materialize

Reduce = Callable[[Array, Array], Array]


def border(plane: Shaped[Array, "h w"]) -> Shaped[Array, "h+2 w+2"]:
    """Returns the plane with one more row and column on each side, clamped to edge."""
    plane = jnp.concatenate([plane[:1], plane, plane[-1:]], axis=0)
    plane = jnp.concatenate([plane[:, :1], plane, plane[:, -1:]], axis=1)
    # Materialized here: fused into its nine readers, the border would become branches
    # in their inner loops.
    return materialize(plane)


def neighbours(
    bordered: Shaped[Array, "hb wb"],
) -> tuple[tuple[Shaped[Array, "h w"], ...], ...]:
    """Returns the nine shifted views, ``[row][column]``, the pixel's own at [1][1]."""
    height, width = bordered.shape[0] - 2, bordered.shape[1] - 2
    return tuple(
        tuple(bordered[r : r + height, c : c + width] for c in range(3))
        for r in range(3)
    )


def reduce3x3(bordered: Shaped[Array, "hb wb"], combine: Reduce) -> Array:
    """Folds the nine neighbours by an associative and commutative function."""
    rows = [reduce(combine, row) for row in neighbours(bordered)]
    return reduce(combine, rows)


def mean3x3(bordered: Float[Array, "hb wb"]) -> Float[Array, "h w"]:
    """Returns the mean of the nine neighbours."""
    return reduce3x3(bordered, jnp.add) * (1.0 / 9.0)


def history_position(
    motion_x: Float[Array, "h w"], motion_y: Float[Array, "h w"]
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """Returns where each pixel was: pixel centre + motion.

    Args:
        motion_x: previous − current position, px, to the right.
        motion_y: likewise, downward.

    Returns:
        (row, column) in index units: an integer is a pixel centre, so a motion of
        zero, or of whole pixels, lands exactly on a texel.
    """
    height, width = motion_x.shape
    row = jnp.arange(height, dtype=jnp.float32)[:, None] + motion_y
    column = jnp.arange(width, dtype=jnp.float32)[None, :] + motion_x
    return row, column


def inside(row: Float[Array, "h w"], column: Float[Array, "h w"]) -> Bool[Array, "h w"]:
    """Returns whether a position, in index units, lies in the view; NaN does not."""
    height, width = row.shape
    in_rows = (row >= -0.5) & (row <= height - 0.5)
    return in_rows & (column >= -0.5) & (column <= width - 0.5)


def nearest_index(
    row: Float[Array, "*n"],
    column: Float[Array, "*n"],
    size: tuple[int, int] | None = None,
) -> Int[Array, "*n"]:
    """Returns the flat index of the texel that a position falls in, clamped to edge.

    A position on the border between two texels belongs to the right or lower one. NaN
    gives index 0.

    Args:
        row: in index units.
        column: likewise.
        size: image (height, width); None: there is a position for every pixel of it.
    """
    height, width = size or row.shape
    r, c = floor_index(row + 0.5, height), floor_index(column + 0.5, width)
    return r * width + c


def floor_index(position: Float[Array, "*n"], size: int) -> Int[Array, "*n"]:
    """Returns ⌊position⌋ clamped to [0, size − 1]; NaN gives 0."""
    # Clamped before the conversion: an out-of-range float has no integer.
    floor = jnp.clip(jnp.floor(position), 0.0, float(size - 1))
    return jnp.where(floor >= 0.0, floor, 0.0).astype(jnp.int32)


def read(plane: Shaped[Array, "h w"], index: Int[Array, "*n"]) -> Shaped[Array, "*n"]:
    """Returns the plane's values at flat indices, which must lie in the image."""
    return plane.reshape(-1).at[index].get(mode="promise_in_bounds")
