"""The threshold at which a sequence meets its ray budget, in closed loop.

Rays fall as the threshold rises; over the square root of the threshold their logarithm
is near a line from 4 rays a pixel to a hundredth of one. False position on it, with
Illinois' halving, keeps the bracket and needs about five replays.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import pipeline
from ataa_jax.fit import replay, space
from ataa_jax.fit.replay import Take

# our choice: a fifth of the 5 % within which budgets count as equal.
TOLERANCE = 0.01
REPLAYS = 16
# Scores lie in [0, 1]; beneath the lowest, no score is told from 0.
LOWEST, HIGHEST = 1e-5, 1.0
_SMALLEST = 1e-6  # rays a pixel that stand for none, whose logarithm is finite


class Solved(NamedTuple):
    """What was found, and at what cost."""

    threshold: Float[Array, ""]
    rays: Float[Array, ""]  # a pixel, mean over the scored frames
    replays: Int[Array, ""]


class _Search(NamedTuple):
    low: Float[Array, ""]  # root of a threshold with too many rays
    high: Float[Array, ""]  # with too few
    low_miss: Float[Array, ""]  # log rays − log budget there, at least 0
    high_miss: Float[Array, ""]  # at most 0
    best: Solved
    last_low: Bool[Array, ""]


def rays(take: Take, params: pipeline.Params) -> Float[Array, ""]:
    """Returns the mean sparse primary rays a pixel over the scored frames."""
    played = replay.play(
        take.frames,
        params,
        config=take.config,
        choose=replay.by_criteria(take.config.segmentation),
        shown=False,
    )
    pixels = take.config.raster.size[0] * take.config.raster.size[1]
    counts = played.traced_pixels[take.lead_in :].astype(jnp.float32)
    return jnp.mean(counts) * (take.samples / pixels)


@jax.jit
def threshold(
    takes: tuple[Take, ...], params: pipeline.Params, budget: Float[Array, ""]
) -> Solved:
    """Solves for the one threshold at which sequences spend a budget in their mean.

    Args:
        takes: the recorded sequences.
        params: numbers; their own threshold is not read.
        budget: rays a pixel, above 0.

    Returns:
        The threshold nearest to the budget of those tried. Where even the lowest asks
        for less than the budget, the lowest.
    """
    goal = jnp.log(budget)

    def miss(root: Array) -> tuple[Array, Array]:
        spent = jnp.float32(0.0)
        for take in takes:
            choices = take.config.segmentation
            at = space.with_threshold(params, root * root, choices)
            spent += rays(take, at) / len(takes)
        return jnp.log(jnp.maximum(spent, _SMALLEST)) - goal, spent

    def unfinished(search: _Search) -> Array:
        off = jnp.abs(search.best.rays / budget - 1.0) > TOLERANCE
        open_ = search.high - search.low > 1e-5
        return off & open_ & (search.best.replays < REPLAYS)

    def narrow(search: _Search) -> _Search:
        span = search.low_miss - search.high_miss
        share = search.low_miss / jnp.maximum(span, 1e-6)
        # Off the ends, or a far outlier's step would crawl.
        share = jnp.clip(share, 0.02, 0.98)
        middle = search.low + (search.high - search.low) * share
        found, spent = miss(middle)
        above = found > 0.0
        # Illinois: an end that stays twice counts half.
        halve_high = above & search.last_low
        halve_low = ~above & ~search.last_low
        closer = jnp.abs(spent - budget) < jnp.abs(search.best.rays - budget)
        best = search.best
        return _Search(
            low=jnp.where(above, middle, search.low),
            high=jnp.where(above, search.high, middle),
            low_miss=jnp.where(
                above, found, search.low_miss * jnp.where(halve_low, 0.5, 1.0)
            ),
            high_miss=jnp.where(
                above, search.high_miss * jnp.where(halve_high, 0.5, 1.0), found
            ),
            best=Solved(
                threshold=jnp.where(closer, middle * middle, best.threshold),
                rays=jnp.where(closer, spent, best.rays),
                replays=best.replays + 1,
            ),
            last_low=above,
        )

    # The lowest threshold decides whether the budget can be spent at all.
    lowest, highest = jnp.sqrt(jnp.float32(LOWEST)), jnp.sqrt(jnp.float32(HIGHEST))
    found, spent = miss(lowest)
    start = _Search(
        low=lowest,
        high=jnp.where(found > 0.0, highest, lowest),
        low_miss=found,
        # No score passes 1, so no rays there.
        high_miss=jnp.log(jnp.float32(_SMALLEST)) - goal,
        best=Solved(
            threshold=jnp.float32(LOWEST), rays=spent, replays=jnp.asarray(1, jnp.int32)
        ),
        last_low=jnp.asarray(False),
    )
    return jax.lax.while_loop(unfinished, narrow, start).best
