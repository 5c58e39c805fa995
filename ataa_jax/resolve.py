"""Resolve: per pixel the colour of its method, and what the next frame will read.

The composite takes TAA's colour, the traced colour, or the raw colour where the pixel
is new. It is fed back as the history (paper, section 5: "by feeding our supersampled
results back into the TAA buffer"); FXAA comes after it and is only shown.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt

from ataa_jax import color as colors
from ataa_jax.types import (
    METHOD_ATAA,
    METHOD_FXAA,
    Classification,
    GBuffer,
    History,
    State,
)


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    traced_count: Float[Array, ""]  # frames that a traced pixel counts for


class ResolveOutput(eqx.Module):
    """The composite, and the state of the next frame."""

    composite: Float[Array, "h w 3"]  # linear
    state: State


def default_params() -> Params:
    """Returns the defaults."""
    # our choice: a traced colour is as good as eight jittered frames, the least number
    # of rays at the paper's best setting; only young histories look at the count.
    return Params(traced_count=jnp.asarray(8.0, jnp.float32))


@jax.jit
def resolve(
    mask: UInt[Array, "h w"],
    raw: Float[Array, "h w 3"],
    taa: Float[Array, "h w 3"],
    traced: Float[Array, "h w 3"],
    count: Float[Array, "h w"],
    gbuffer: GBuffer,
    params: Params,
) -> ResolveOutput:
    """Composes the frame by the mask.

    Args:
        mask: packed, method in the low 16 bits.
        raw: raster colour, linear: shown where the pixel is new.
        taa: TAA's colour, linear.
        traced: traced colour, linear; read at ATAA pixels only.
        count: frames in TAA's colour.
        gbuffer: depth and motion go into the history.
        params: numbers.

    Returns:
        The composite, free of NaN and infinities, and the next frame's state: the
        history stores exactly the composite.
    """
    method = mask & jnp.uint32(0xFFFF)
    is_new = (method == METHOD_FXAA)[..., None]
    is_traced = (method == METHOD_ATAA)[..., None]
    composite = jnp.where(is_new, raw, jnp.where(is_traced, traced, taa))
    composite = colors.sanitize(composite)
    count = jnp.where(method == METHOD_FXAA, 1.0, count)
    count = jnp.where(method == METHOD_ATAA, jnp.maximum(count, params.traced_count), count)
    history = History(
        color=composite,
        depth=gbuffer.depth,
        motion=gbuffer.motion,
        count=count,
        valid=jnp.asarray(True),
    )
    return ResolveOutput(
        composite=composite,
        state=State(history=history, classification=Classification(mask=mask)),
    )
