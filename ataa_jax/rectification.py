"""Rectification of a history: the box of colours that the current frame allows.

The public variants of a TAA's neighbourhood clamp (Karis 2014, Salvi 2016; survey:
Yang, Liu and Salvi 2020): what the box is of, and how a colour is brought into it. The
colour space in which it is axis-aligned is the caller's.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ataa_jax import vector, window
from ataa_jax.vector import Vec3

# plus: the pixel and its four edge neighbours; rounded: mean of both boxes.
Neighbourhood = Literal["box", "plus", "rounded"]


class Box(eqx.Module):
    """A box of colours per pixel."""

    low: Vec3
    centre: Vec3
    high: Vec3


def box(
    bordered: Vec3, neighbourhood: Neighbourhood, gamma: Float[Array, ""] | None
) -> Box:
    """Returns the box of each pixel's 3×3 neighbourhood.

    Args:
        bordered: the current samples with a border of one pixel, (h + 2, w + 2).
        neighbourhood: which of the nine count.
        gamma: None: the box spans them; else it is their mean ± γ standard deviations
            (Salvi 2016).
    """
    planes = (bordered.x, bordered.y, bordered.z)
    extents = [_extent(plane, neighbourhood, gamma) for plane in planes]
    low, centre, high = (Vec3(*(each[k] for each in extents)) for k in range(3))
    return Box(low=low, centre=centre, high=high)


def clamp(value: Vec3, box: Box) -> Vec3:
    """Brings each component into the box by itself."""
    return jax.tree.map(jnp.clip, value, box.low, box.high)


def clip(value: Vec3, box: Box) -> Vec3:
    """Pulls the value along the line to the box's centre until it is in the box.

    With d = value − centre and e the box's half-size, the line leaves the box at
    centre + d / max(|dᵢ| / eᵢ); inside the box that maximum is below 1.
    """
    d = value - box.centre

    def overshoot(d: Array, low: Array, high: Array) -> Array:
        # A flat box has e = 0; a difference below the floor is rounding, not colour.
        return jnp.abs(d) / jnp.maximum(0.5 * (high - low), 1e-6)

    ratios = jax.tree.map(overshoot, d, box.low, box.high)
    return box.centre + d * (1.0 / jnp.maximum(vector.largest(ratios), 1.0))


def _extent(
    bordered: Float[Array, "hb wb"],
    neighbourhood: Neighbourhood,
    gamma: Float[Array, ""] | None,
) -> tuple[Float[Array, "h w"], Float[Array, "h w"], Float[Array, "h w"]]:
    """Returns (low, centre, high) of one component."""
    if neighbourhood == "rounded":
        box = _extent(bordered, "box", gamma)
        plus = _extent(bordered, "plus", gamma)
        return (
            0.5 * (box[0] + plus[0]),
            0.5 * (box[1] + plus[1]),
            0.5 * (box[2] + plus[2]),
        )
    nine = window.neighbours(bordered)
    own = nine[1][1]
    if neighbourhood == "plus":
        others = [nine[0][1], nine[1][0], nine[1][2], nine[2][1]]
    else:
        others = [nine[r][c] for r in range(3) for c in range(3) if (r, c) != (1, 1)]
    if gamma is None:
        low, high = own, own
        for other in others:
            low, high = jnp.minimum(low, other), jnp.maximum(high, other)
        return low, 0.5 * (low + high), high
    # Moments of the differences from the pixel's own value, not of the values: in
    # E[x²] − E[x]² a bright flat area would lose its variance to rounding.
    first, second = jnp.zeros_like(own), jnp.zeros_like(own)
    for other in others:
        difference = other - own
        first, second = first + difference, second + difference * difference
    count = float(len(others) + 1)
    shift = first / count
    sigma = vector.root(second / count - shift * shift)
    mean, reach = own + shift, gamma * sigma
    return mean - reach, mean, mean + reach
