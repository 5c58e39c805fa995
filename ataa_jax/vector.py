"""Three-vectors as component-first arrays, ``(3, n)``: every operation vectorizes.

XLA's CPU backend turns a sum over a trailing axis of length 3 into a scalar loop; with
components first each operation below is elementwise over n and fuses.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def dot(a: Float[Array, "3 n"], b: Float[Array, "3 n"]) -> Float[Array, " n"]:
    """Returns the inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Float[Array, "3 n"], b: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
    """Returns the right-handed cross product."""
    return jnp.stack(
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    )


def normalize(a: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
    """Returns a unit vector, or zero where the input is zero or not finite.

    The input is first scaled by its largest component's power of two, so that squares
    neither overflow nor underflow and a scaling of the scene by 2^k changes no bit.
    """
    largest = jnp.max(jnp.abs(a), axis=0)
    usable = (largest > 0.0) & jnp.isfinite(largest)
    scaled = jnp.where(usable[None], a, 1.0) * _reciprocal_power(largest, usable)[None]
    return jnp.where(usable[None], scaled * jax.lax.rsqrt(dot(scaled, scaled)), 0.0)


def _reciprocal_power(x: Float[Array, " n"], usable: Array) -> Float[Array, " n"]:
    """Returns 2^−floor(log2 x) from the exponent bits, 1 where not usable."""
    # x = m·2^e with biased exponent b = e + 127: 2^−e has biased exponent 254 − b.
    bits = jax.lax.bitcast_convert_type(jnp.where(usable, x, 1.0), jnp.int32)
    biased = jnp.clip(254 - (bits >> 23), 1, 254)
    return jax.lax.bitcast_convert_type(biased << 23, jnp.float32)


def transform(
    target_from_source: Float[Array, "3 4 n"],
    point: Float[Array, "3 n"],
) -> Float[Array, "3 n"]:
    """Applies one affine matrix per element to points."""
    return rotate(target_from_source, point) + target_from_source[:, 3]


def rotate(
    target_from_source: Float[Array, "3 4 n"], vector: Float[Array, "3 n"]
) -> Float[Array, "3 n"]:
    """Applies one matrix's linear part per element to directions."""
    m = target_from_source
    return m[:, 0] * vector[0] + m[:, 1] * vector[1] + m[:, 2] * vector[2]
