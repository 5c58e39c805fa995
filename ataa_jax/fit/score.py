"""The final number: hard mask, closed loop, at the budget, scored by scikit-image."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ataa_jax import hostcall, metrics, pipeline
from ataa_jax.errors import InputError
from ataa_jax.fit import replay, solve, space
from ataa_jax.fit.replay import Take


@dataclass(frozen=True)
class Result:
    """One contender on one sequence."""

    ssim: float
    rays: float  # a pixel
    threshold: float


def check_budget(budget: float, samples: int = 8) -> None:
    """Refuses budgets that no mask can spend.

    Raises:
        InputError: not above 0, or above one traced pixel's rays.
    """
    if not 0.0 < budget <= samples:
        raise InputError(
            f"a fit needs a budget above 0 and at most {samples} rays a pixel, the "
            f"rays of tracing every pixel, not {budget:g}"
        )


@partial(jax.jit, static_argnames="capped")
def _played(
    take: Take, params: pipeline.Params, *, capped: bool = False
) -> replay.Played:
    config = take.config
    budget_of = config if capped else None
    return replay.play(
        take.frames,
        params,
        config=config,
        choose=replay.by_criteria(config.segmentation, budget_of),
    )


@jax.jit
def _solved(
    take: Take, params: pipeline.Params, budget: Float[Array, ""]
) -> solve.Solved:
    return solve.threshold((take,), params, budget)


def at_budget(take: Take, params: pipeline.Params, budget: float) -> Result:
    """Solves the threshold for the budget, and scores what comes of it."""
    solved = _solved(take, params, jnp.float32(budget))
    return as_is(take, space.with_threshold(
        params, solved.threshold, take.config.segmentation
    ), float(solved.threshold))  # fmt: skip


def as_is(
    take: Take,
    params: pipeline.Params,
    threshold: float | None = None,
    *,
    capped: bool = False,
) -> Result:
    """Scores parameters untouched, with the rays that they ask for.

    Args:
        take: the sequence.
        params: numbers.
        threshold: told in the result; None: their own.
        capped: each frame keeps the budget of `params`, as `pipeline.frame` does.
    """
    played = _played(take, params, capped=capped)
    if threshold is None:
        threshold = float(params.segmentation.threshold)
    return Result(
        ssim=_mean_ssim(played.image[take.lead_in :], _truth(take)),
        rays=rays(take, played),
        threshold=threshold,
    )


def chosen(take: Take, params: pipeline.Params, choose: replay.Chooser, extra: object
) -> Result:  # fmt: skip
    """Scores another chooser of pixels."""
    played = replay.play(take.frames, params, extra, config=take.config, choose=choose)
    return Result(
        ssim=_mean_ssim(played.image[take.lead_in :], _truth(take)),
        rays=rays(take, played),
        threshold=float("nan"),
    )


def _truth(take: Take) -> Float[Array, "f h w 3"]:
    return take.frames.truth[take.lead_in :]


def rays(take: Take, played: replay.Played) -> float:
    """Returns the mean sparse primary rays a pixel over the scored frames."""
    pixels = take.config.raster.size[0] * take.config.raster.size[1]
    traced = np.asarray(played.traced_pixels)[take.lead_in :]
    return float(traced.mean()) * take.samples / pixels


def _mean_ssim(images: Array, truths: Array) -> float:
    return float(np.mean(ssim(np.asarray(images), np.asarray(truths))[0]))


@hostcall.target
def ssim(images: np.ndarray, truths: np.ndarray) -> tuple[np.ndarray]:
    """Returns each image's SSIM, float32; NumPy only, for `hostcall`."""
    pairs = zip(images, truths, strict=True)
    return (np.array([metrics.ssim(a, b) for a, b in pairs], np.float32),)


def traced_at_budget(
    take: Take, params: pipeline.Params, budget: Float[Array, ""]
) -> Float[Array, ""]:
    """Returns `at_budget`'s SSIM, traceable: scikit-image is a NumPy callback."""
    solved = _solved(take, params, budget)
    at = space.with_threshold(params, solved.threshold, take.config.segmentation)
    images = _played(take, at).image[take.lead_in :]
    shape = jax.ShapeDtypeStruct((images.shape[0],), jnp.float32)
    (each,) = hostcall.call(ssim, (shape,), images, _truth(take))
    return jnp.mean(each)


def objective(
    x: Float[Array, " n"],
    args: tuple[tuple[Take, ...], pipeline.Params, Float[Array, ""]],
    *,
    quantities: tuple[space.Quantity, ...],
) -> Float[Array, ""]:
    """Returns 1 − the mean SSIM over sequences, each at the budget by itself."""
    takes, params, budget = args
    at = space.place(params, quantities, space.free(x))
    scores = [traced_at_budget(take, at, budget) for take in takes]
    return 1.0 - jnp.mean(jnp.stack(scores))


def compiled(quantities: tuple[space.Quantity, ...]) -> partial:
    """Returns the objective for one space."""
    return partial(objective, quantities=quantities)
