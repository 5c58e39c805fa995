"""Resolve stage: one colour a pixel, and what the next frame will read (Figure 2).

FXAA's pixels take the raw sample, for FXAA runs later, on the display-referred image,
and its output is never stored; TAA's take the TAA result; ATAA's the traced colour.
The history stores exactly this composite: traced pixels feed the next frame's TAA
(paper, section 5).
"""

from dataclasses import dataclass
from functools import partial
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ataa_jax import color as colors
from ataa_jax.types import (
    METHOD_ATAA,
    METHOD_FXAA,
    Classification,
    GBuffer,
    History,
    Segmentation,
)


@dataclass(frozen=True)
class Config:
    """Choices that change the program."""

    # Traced colours go into the history (paper, section 5). False: it stores the TAA
    # result and its count at the traced pixels; what is shown stays the composite.
    feedback: bool = True


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    traced_count: Float[Array, ""]  # frames that a traced colour counts as


def default_params(
    # our choice: of 1, 4, 8 and 16 frames the best mean over three scenes at 0.5 rays a
    # pixel; only "accumulate" blending reads it.
    traced_count: float = 4.0,
) -> Params:
    """Returns the parameters."""
    return Params(traced_count=jnp.asarray(traced_count, jnp.float32))


@runtime_checkable
class Blended(Protocol):
    """What is read of the TAA stage's output."""

    @property
    def color(self) -> Float[Array, "h w 3"]:
        """Linear radiance."""
        ...

    @property
    def count(self) -> Float[Array, "h w"]:
        """Frames accumulated in `color`."""
        ...


class ResolveOutput(eqx.Module):
    """The composite, and the two halves of the next frame's state."""

    composite: Float[Array, "h w 3"]  # linear
    history: History
    classification: Classification


@partial(jax.jit, static_argnames="config")
def resolve(
    segmented: Segmentation,
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    blended: Blended,
    traced: Float[Array, "h w 3"],
    params: Params,
    *,
    config: Config,
) -> ResolveOutput:
    """Composes the frame by the mask.

    Args:
        segmented: the mask, within the ray budget.
        color: linear raw raster colour.
        gbuffer: handed on to the history.
        blended: the TAA result.
        traced: linear colour of the traced pixels; not read elsewhere.
        params: what a traced pixel counts as.
        config: whether traced colours feed the history.

    Returns:
        Composite and state. NaN, inf and negative radiance end here, whichever
        source they come from.
    """
    method = segmented.mask & jnp.uint32(0xFFFF)
    is_fxaa, is_ataa = method == METHOD_FXAA, method == METHOD_ATAA
    untraced = jnp.where(is_fxaa[..., None], color, blended.color)
    composite = colors.sanitize(jnp.where(is_ataa[..., None], traced, untraced))
    stored, count = composite, jnp.where(is_ataa, params.traced_count, blended.count)
    if not config.feedback:
        stored, count = colors.sanitize(untraced), blended.count
    return ResolveOutput(
        composite=composite,
        history=History(
            color=stored,
            depth=gbuffer.depth,
            motion=gbuffer.motion,
            count=jnp.where(is_fxaa, 1.0, count),
            valid=jnp.asarray(True),
        ),
        classification=Classification(mask=segmented.mask),
    )
