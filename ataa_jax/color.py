"""Colour: luma, the tone map and its inverse, sRGB, YCoCg, and the averaging space.

Linear, scene-referred radiance x becomes display-referred by

    exposure → tone map t = x / (1 + max(r, g, b)) → sRGB

and averages over samples (rays, history, supersampling) are taken of t by default:
`to_average` leads there, `from_average` back.

Functions named ``*_vec`` take a `vector.Vec3`, one array a component, the form that
the stages compute in; their namesakes take images with a trailing axis of three.
"""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ataa_jax import exported, vector
from ataa_jax.vector import Vec3

# The space in which samples are averaged: tone-mapped, or linear radiance.
Average = Literal["tonemap", "linear"]

LUMA_WEIGHTS = (0.2126, 0.7152, 0.0722)  # ITU-R BT.709, for linear RGB

# our choice: the largest half float; half-float HDR buffers of engines hold no more,
# and its tone-mapped value still differs from 1 in float32.
MAX_RADIANCE = 65504.0
_MIN_HEADROOM = 1.0 / (1.0 + MAX_RADIANCE)

_SRGB_LINEAR_END = 0.0031308  # IEC 61966-2-1
_SRGB_ENCODED_END = 0.04045


def luma_vec(color: Vec3) -> Float[Array, "..."]:
    """Returns the Rec. 709 luma of linear or tone-mapped RGB, in the input's unit."""
    red, green, blue = LUMA_WEIGHTS
    return red * color.x + green * color.y + blue * color.z


def luma(color: Float[Array, "*n 3"]) -> Float[Array, "*n"]:
    """Returns the Rec. 709 luma of linear or tone-mapped RGB, in the input's unit."""
    return luma_vec(vector.unstack(color))


def sanitize_vec(color: Vec3) -> Vec3:
    """Returns a finite colour in [0, MAX_RADIANCE]: NaN and negatives become 0."""
    return Vec3(*(_sanitize(c) for c in (color.x, color.y, color.z)))


def sanitize(color: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Returns finite values in [0, MAX_RADIANCE]: NaN and negatives become 0."""
    return _sanitize(color)


def _sanitize(value: Float[Array, "..."]) -> Float[Array, "..."]:
    # A comparison with NaN is false, so NaN takes the 0 that negatives take.
    return jnp.where(value > 0.0, jnp.minimum(value, MAX_RADIANCE), 0.0)


def tonemap_vec(color: Vec3) -> Vec3:
    """Returns x / (1 + max(r, g, b)); see `tonemap`."""
    return color * (1.0 / (1.0 + _peak(color)))


def tonemap(color: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Returns x / (1 + max(r, g, b)).

    Args:
        color: linear radiance. A negative component is scaled like the others, the
            maximum is floored at 0; inf gives NaN (`sanitize` first).

    Returns:
        Values below 1, hue kept.
    """
    return vector.stack(tonemap_vec(vector.unstack(color)))


def inverse_tonemap_vec(color: Vec3) -> Vec3:
    """Returns t / (1 − max(r, g, b)); see `inverse_tonemap`."""
    return color * (1.0 / jnp.maximum(1.0 - _peak(color), _MIN_HEADROOM))


def inverse_tonemap(color: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Returns t / (1 − max(r, g, b)), the inverse of `tonemap`.

    Args:
        color: tone-mapped; where the largest component is at or above
            MAX_RADIANCE / (1 + MAX_RADIANCE) the denominator stops falling, so 1 and
            more stay finite.

    Returns:
        Linear radiance. In float32 the relative error of a round trip is about
        6e-8 · (1 + max(r, g, b)).
    """
    return vector.stack(inverse_tonemap_vec(vector.unstack(color)))


def _peak(color: Vec3) -> Float[Array, "..."]:
    """Returns max(r, g, b, 0)."""
    return jnp.maximum(jnp.maximum(color.x, color.y), jnp.maximum(color.z, 0.0))


def to_average(color: Float[Array, "*n 3"], average: Average) -> Float[Array, "*n 3"]:
    """Takes linear radiance to the averaging space; NaN, inf and negatives end here.

    Args:
        color: linear radiance, sanitized on the way.
        average: which space.
    """
    return vector.stack(to_average_vec(vector.unstack(color), average))


def to_average_vec(color: Vec3, average: Average) -> Vec3:
    """See `to_average`."""
    clean = sanitize_vec(color)
    return tonemap_vec(clean) if average == "tonemap" else clean


def from_average(color: Float[Array, "*n 3"], average: Average) -> Float[Array, "*n 3"]:
    """Takes a value of the averaging space back to linear radiance."""
    return vector.stack(from_average_vec(vector.unstack(color), average))


def from_average_vec(color: Vec3, average: Average) -> Vec3:
    """See `from_average`."""
    return inverse_tonemap_vec(color) if average == "tonemap" else color


def ycocg_vec(color: Vec3) -> Vec3:
    """Returns (Y, Co, Cg); see `ycocg`."""
    outer = 0.25 * (color.x + color.z)
    half_green = 0.5 * color.y
    return Vec3(half_green + outer, 0.5 * (color.x - color.z), half_green - outer)


def ycocg(color: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Returns (Y, Co, Cg) of RGB (Malvar and Sullivan 2003), lossless up to rounding.

    Y = r/4 + g/2 + b/4, Co = (r − b)/2, Cg = −r/4 + g/2 − b/4.
    """
    return vector.stack(ycocg_vec(vector.unstack(color)))


def rgb_vec(color: Vec3) -> Vec3:
    """Returns RGB of (Y, Co, Cg)."""
    rest = color.x - color.z
    return Vec3(rest + color.y, color.x + color.z, rest - color.y)


def rgb(color: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Returns RGB of (Y, Co, Cg)."""
    return vector.stack(rgb_vec(vector.unstack(color)))


def srgb_encode(linear: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Encodes display-linear values by IEC 61966-2-1; below 0 gives 0, above 1 1."""
    linear = jnp.clip(linear, 0.0, 1.0)
    # The power's argument stays clear of 0, where its slope is infinite. XLA computes a
    # power value by value on the CPU; these two are vectors, and as near (1.2e-7).
    power = jnp.exp(jnp.log(jnp.maximum(linear, _SRGB_LINEAR_END)) * (1.0 / 2.4))
    powered = 1.055 * power - 0.055
    return jnp.where(linear <= _SRGB_LINEAR_END, 12.92 * linear, powered)


def srgb_decode(encoded: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Decodes sRGB values in [0, 1] to display-linear ones."""
    encoded = jnp.clip(encoded, 0.0, 1.0)
    base = (jnp.maximum(encoded, _SRGB_ENCODED_END) + 0.055) / 1.055
    return jnp.where(encoded <= _SRGB_ENCODED_END, encoded / 12.92, base**2.4)


@exported.jit()
def display(
    linear: Float[Array, "*n 3"], exposure: float | Float[Array, ""] = 1.0
) -> Float[Array, "*n 3"]:
    """Returns the display-referred image: exposure, tone map, sRGB.

    Args:
        linear: radiance; NaN and negatives show black, inf white.
        exposure: multiplier of radiance, fixed for a sequence.

    Returns:
        sRGB in [0, 1].
    """
    return vector.stack(display_vec(vector.unstack(linear) * exposure))


def display_vec(exposed: Vec3) -> Vec3:
    """Returns tone map and sRGB of exposed radiance; see `display`."""
    return jax.tree.map(srgb_encode, tonemap_vec(sanitize_vec(exposed)))
