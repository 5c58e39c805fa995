"""What is fitted: named numbers of the parameters, each a coordinate in [0, 1].

Only ratios of the weights matter, for the score is their weighted mean: the first
term's weight stays 1. The threshold is no coordinate at all: it is solved for the ray
budget (`solve`). Positive quantities are laid out in their logarithm; the hold is a
whole number, rounded, so a search without gradients walks over steps of it.

Under the reading "either", term i fires where it passes threshold / wᵢ: the same
weights, the same single threshold.
"""

import dataclasses
import math
from collections.abc import Iterable
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ataa_jax import pipeline, segmentation
from ataa_jax.errors import InputError

_SUFFIX = "_weight"
PAPER_TERMS = ("luminance", "depth")


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One number to fit, and where to look for it; bounds are fixed beforehand."""

    name: str  # dotted path in `pipeline.Params`
    low: float
    high: float
    kind: Literal["log", "whole"] = "log"

    def value(self, u: Float[Array, ""]) -> Float[Array, ""]:
        """Returns the number at coordinate u."""
        if self.kind == "whole":
            return jnp.round(self.low + (self.high - self.low) * u)
        ratio = jnp.log(self.high / self.low)
        return self.low * jnp.exp(ratio * u)


def known_terms() -> tuple[str, ...]:
    """Returns the names of the segmentation's weighted terms, luminance first."""
    names = [field.name for field in dataclasses.fields(segmentation.Params)]
    return tuple(n.removesuffix(_SUFFIX) for n in names if n.endswith(_SUFFIX))


def switched(
    config: segmentation.Config, terms: tuple[str, ...]
) -> segmentation.Config:
    """Returns the configuration with just these terms on.

    Raises:
        InputError: none, or an unknown one.
    """
    known = known_terms()
    for term in terms:
        if term not in known:
            raise InputError(f"unknown term '{term}'; known are {', '.join(known)}")
    if not terms:
        raise InputError(f"a fit needs at least one term of {', '.join(known)}")
    switches = {f"use_{term}": term in terms for term in known}
    return dataclasses.replace(config, **switches)


def weight(term: str) -> Quantity:
    """Returns the weight of a term over luminance's."""
    # our choice: beyond 64 to 1 the lesser term moves no pixel's rank by 2 %.
    return Quantity(f"segmentation.{term}{_SUFFIX}", 1.0 / 64.0, 64.0)


# our choice: from a quarter of a pixel, the size of jitter, to the motion of rapid
# paths at 160 pixels' width; nine whole numbers of frames.
RESET = Quantity("segmentation.reset_px", 0.25, 16.0)
HOLD = Quantity("segmentation.hold", 0.0, 8.0, "whole")
# our choice: from under one step of 8 bits' noise to where nothing is busy.
CONTRAST = Quantity("segmentation.response_contrast", 0.01, 1.0)
# TAA's own, a separate choice: the frames that a history counts as at most, which is
# its blend, the width of its variance clip where it has one, and what a traced colour
# counts as.
BLEND = Quantity("taa.count_limit", 1.0, 16.0)
CLIP = Quantity("taa.variance_gamma", 0.5, 4.0)
TRACED = Quantity("resolve.traced_count", 1.0, 16.0)

KNOWN = (RESET, HOLD, CONTRAST, BLEND, CLIP, TRACED)


def weights(terms: tuple[str, ...]) -> tuple[Quantity, ...]:
    """Returns the weights to fit: all but the first term's, which stays 1."""
    return tuple(weight(term) for term in terms[1:])


def named(names: Iterable[str]) -> tuple[Quantity, ...]:
    """Returns quantities by their dotted names, weights left out.

    Raises:
        InputError: an unknown name.
    """
    known = {quantity.name: quantity for quantity in KNOWN}
    chosen = tuple(names)
    for name in chosen:
        if name not in known:
            raise InputError(f"'{name}' cannot be fitted; known are {', '.join(known)}")
    return tuple(known[name] for name in chosen)


def place(
    params: pipeline.Params, space: tuple[Quantity, ...], u: Float[Array, " n"]
) -> pipeline.Params:
    """Returns the parameters at a point of the unit box."""
    for index, quantity in enumerate(space):
        stage, field = quantity.name.split(".")
        old = getattr(getattr(params, stage), field)
        params = eqx.tree_at(
            lambda p, stage=stage, field=field: getattr(getattr(p, stage), field),
            params,
            quantity.value(u[index]).astype(old.dtype),
        )
    return params


def with_threshold(
    params: pipeline.Params, threshold: Float[Array, ""], config: segmentation.Config
) -> pipeline.Params:
    """Returns the parameters at a threshold of the score, in either reading."""
    own = params.segmentation
    if config.reading == "sum":
        return eqx.tree_at(lambda p: p.segmentation.threshold, params, threshold)
    tiny = 1e-9  # a weight of 0 never fires
    for term in known_terms():
        # Edges between ids are 0 or 1: they have no threshold of their own.
        if hasattr(own, f"{term}_threshold"):
            limit = threshold / jnp.maximum(getattr(own, f"{term}{_SUFFIX}"), tiny)
            params = eqx.tree_at(
                lambda p, term=term: getattr(p.segmentation, f"{term}_threshold"),
                params,
                limit,
            )
    return params


def coordinates(
    params: pipeline.Params, space: tuple[Quantity, ...]
) -> Float[Array, " n"]:
    """Returns the point of the unit box where parameters lie, limited to it."""
    found = []
    for quantity in space:
        stage, field = quantity.name.split(".")
        value = float(getattr(getattr(params, stage), field))
        low, high = quantity.low, quantity.high
        if quantity.kind == "log":
            value, low, high = (math.log(max(v, 1e-30)) for v in (value, low, high))
        found.append(min(max((value - low) / (high - low), 0.0), 1.0))
    return jnp.asarray(found, jnp.float32)


def free(x: Float[Array, " n"]) -> Float[Array, " n"]:
    """Maps the line to [0, 1] for searches that know no bounds: a reflection.

    Piecewise linear, 0 at 0 and 1 at 1; it keeps distances, and no point is lost in
    the flat tail of a sigmoid.
    """
    folded = jnp.mod(x, 2.0)
    return jnp.where(folded > 1.0, 2.0 - folded, folded)
