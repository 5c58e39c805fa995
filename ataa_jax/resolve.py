"""Resolve stage: one colour a pixel, and what the next frame will read (Figure 2).

FXAA's pixels take the raw sample, for FXAA runs later, on the display-referred image,
and its output is never stored; TAA's take the TAA result; ATAA's the traced colour,
which joins the TAA result or, as in the paper, replaces it. The history stores exactly
this composite: traced pixels feed the next frame's TAA (paper, section 5).
"""

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Num

from ataa_jax import color as colors
from ataa_jax import exported, formats
from ataa_jax.types import (
    METHOD_ATAA,
    METHOD_FXAA,
    Classification,
    GBuffer,
    History,
    Segmentation,
)

Traced = Literal["join", "replace"]


@dataclass(frozen=True)
class Config:
    """Choices that change the program."""

    # replace: a traced pixel shows its rays alone (paper, section 3.4). join: each of n
    # rays is one more sample of the pixel, of the weight that a frame's own sample has
    # in the running mean of m frames: rays have n/(n + m) of what is shown. our choice:
    # join; better in `experiments/sparse_jitter.py` on its three scenes, moving and
    # still. In `quality.py` five of six gain, and the milk truck loses 0.0002 of SSIM.
    traced: Traced = "join"
    # Traced colours go into the history (paper, section 5). False: it stores the TAA
    # result and its count at the traced pixels; what is shown stays the composite.
    feedback: bool = True
    # What the history is kept in. our choice: float32, by `experiments/precision.py`.
    history: formats.Format = "float32"


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    traced_count: Float[Array, ""]  # frames that a traced pixel counts as


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


def traced_pixel(
    blended: Blended,
    traced: Float[Array, "h w 3"],
    samples: int | Num[Array, ""] | Num[Array, "h w"],
    *,
    average: colors.Average = "tonemap",
    config: Config,
) -> Float[Array, "h w 3"]:
    """Returns what a pixel shows if it is traced, linear.

    Args:
        blended: the TAA result.
        traced: linear colour of the rays.
        samples: rays a traced pixel, or every pixel's.
        average: the space that means are taken in, the rays' own.
        config: whether they join the TAA result.

    Returns:
        NaN, inf and negative radiance are gone from it, whichever source they are from.
    """
    traced = colors.sanitize(traced)
    if config.traced == "replace":
        return traced
    share = (samples / (samples + blended.count))[..., None]
    old, new = (colors.to_average(c, average) for c in (blended.color, traced))
    return colors.from_average(old + share * (new - old), average)


@exported.jit("average", "config")
def resolve(
    segmented: Segmentation,
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    blended: Blended,
    traced: Float[Array, "h w 3"],
    params: Params,
    *,
    samples: int | Num[Array, ""],
    average: colors.Average = "tonemap",
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
        samples: rays a traced pixel.
        average: see `traced_pixel`.
        config: what traced colours do to the TAA result and to the history.

    Returns:
        Composite and state. NaN, inf and negative radiance end here, whichever
        source they come from.
    """
    method = segmented.mask & jnp.uint32(0xFFFF)
    is_fxaa, is_ataa = method == METHOD_FXAA, method == METHOD_ATAA
    untraced = jnp.where(is_fxaa[..., None], color, blended.color)
    seen = traced_pixel(blended, traced, samples, average=average, config=config)
    composite = colors.sanitize(jnp.where(is_ataa[..., None], seen, untraced))
    stored, count = composite, jnp.where(is_ataa, params.traced_count, blended.count)
    if not config.feedback:
        stored, count = colors.sanitize(untraced), blended.count
    return ResolveOutput(
        composite=composite,
        history=History(
            color=formats.narrow(stored, config.history),
            depth=formats.narrow(gbuffer.depth, config.history),
            motion=formats.narrow(gbuffer.motion, config.history),
            count=formats.narrow(jnp.where(is_fxaa, 1.0, count), config.history),
            valid=jnp.asarray(True),
        ),
        classification=Classification(mask=segmented.mask),
    )
