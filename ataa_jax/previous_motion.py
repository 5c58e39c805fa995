"""How much a pixel's motion differs from what moved in its place a frame ago.

What an object in motion uncovers is found thereby: the reprojected pixel of the still
background showed the object, whose motion differs (paper, section 3). Symbols as in
`segmentation`: m is a pixel's motion vector, px, m′ the previous frame's.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import compact, vector, window

# our choice: pixels at a time that look around for a similar motion; in a walk they are
# under 1 % of the image.
_CHUNK = 4096


class MotionChange(NamedTuple):
    """A pixel's motion beside one of the previous frame's."""

    difference: Float[Array, "*n"]  # |m − m′|², px²; infinite where m′ is NaN
    length: Float[Array, "*n"]  # |m′|², px²


def at_pixel(
    motion: Float[Array, "h w 2"],
    then: Float[Array, "h w 2"],
    row: Float[Array, "h w"],
    column: Float[Array, "h w"],
) -> MotionChange:
    """Compares with the motion at the reprojected pixel.

    Args:
        motion: m, px, (right, down).
        then: last frame's motion, likewise.
        row: where the pixel was, in index units.
        column: likewise.
    """
    then_xy = then[..., 0], then[..., 1]
    return _most_similar(
        then_xy, motion[..., 0], motion[..., 1], row, column, steps=(0.0,)
    )


def look_around(
    found: MotionChange,
    where: Bool[Array, "h w"],
    motion: Float[Array, "h w 2"],
    then: Float[Array, "h w 2"],
    row: Float[Array, "h w"],
    column: Float[Array, "h w"],
) -> MotionChange:
    """Compares some pixels with the most similar motion of the 3×3 instead.

    Args:
        found: `at_pixel`'s, which stays elsewhere.
        where: the pixels that look around; the time goes by their number.
        motion: as `at_pixel`'s, as are all that follow.
        then: likewise.
        row: likewise.
        column: likewise.
    """
    then_xy = then[..., 0], then[..., 1]
    images = motion[..., 0], motion[..., 1], row, column
    fields = tuple(image.reshape(-1) for image in images)

    def chunk(
        index: Int[Array, " c"], used: Bool[Array, " c"], found: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        taken = jnp.minimum(index, where.size - 1)  # the fill reads the last pixel
        own = (field.at[taken].get(mode="promise_in_bounds") for field in fields)
        near = _most_similar(then_xy, *own, steps=(-1.0, 0.0, 1.0))
        return (
            found[0].at[index].set(near.difference, mode="drop"),
            found[1].at[index].set(near.length, mode="drop"),
        )

    flat = vector.materialize((found.difference.reshape(-1), found.length.reshape(-1)))
    flat = compact.for_each_chunk(where, _CHUNK, chunk, flat)
    return MotionChange(*(plane.reshape(where.shape) for plane in flat))


def _most_similar(
    then: tuple[Float[Array, "h w"], Float[Array, "h w"]],
    x: Float[Array, "*n"],
    y: Float[Array, "*n"],
    row: Float[Array, "*n"],
    column: Float[Array, "*n"],
    *,
    steps: tuple[float, ...],
) -> MotionChange:
    """Returns the comparison with the neighbour that differs least.

    Args:
        then: last frame's motion, px.
        x: m, px, to the right.
        y: likewise, downward.
        row: where the pixel was, in index units.
        column: likewise.
        steps: of rows and of columns, from there to the neighbours.
    """
    size = (then[0].shape[0], then[0].shape[1])

    def in_row(step: Int[Array, ""] | int, best: MotionChange) -> MotionChange:
        difference, length = best
        down = jnp.asarray(steps, jnp.float32)[step]
        for right in steps:
            index = window.nearest_index(row + down, column + right, size)
            px, py = (window.read(plane, index) for plane in then)
            here = (x - px) ** 2 + (y - py) ** 2
            closer = here < difference
            difference = jnp.where(closer, here, difference)
            length = jnp.where(closer, px * px + py * py, length)
        return MotionChange(difference, length)

    none = jnp.full(x.shape, jnp.inf, jnp.float32), jnp.zeros(x.shape, jnp.float32)
    return jax.lax.fori_loop(0, len(steps), in_row, MotionChange(*none))
