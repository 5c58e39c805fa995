"""The relaxed fit: Levenberg–Marquardt or BFGS on the soft mask, priced to a budget.

The outer loop is: replay the hard mask at the budget, gather its pixels, fit, replay
again, until the weights stop changing. Within it the price a ray is moved until the
soft mask spends the budget: at the optimum the dearest pixel traced is worth its rays.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from ataa_jax import pipeline
from ataa_jax.fit import relaxed, score, space
from ataa_jax.fit.checkpoint import NOWHERE, Checkpoints
from ataa_jax.fit.relaxed import Pixels, Soft
from ataa_jax.fit.replay import Take

Solver = Literal["lm", "bfgs"]
ROUNDS = 3
PRICES = 6  # moves of the price a round
_STEPS = 25
_FIRST_PRICE = 1e-2
_STILL = 0.05  # our choice: weights that moved by less than 5 % have stopped changing


@dataclass(frozen=True)
class SoftFit:
    """Weights that a relaxed fit found."""

    params: pipeline.Params
    hard_ssim: float  # closed loop, hard mask, mean over the sequences
    price: float
    evaluations: int  # of the relaxed loss: values, gradients, columns
    hard_evaluations: int  # of the closed loop
    rounds: int


def fit(
    takes: tuple[Take, ...],
    params: pipeline.Params,
    terms: tuple[str, ...],
    budget: float,
    *,
    solver: Solver = "lm",
    starts: int = 1,
    seed: int = 0,
    rounds: int = ROUNDS,
    checkpoints: Checkpoints = NOWHERE,
    progress: Callable[[str, int, int], None] = lambda text, done, total: None,
) -> SoftFit:
    """Fits the weights of terms; hold and reset stay as given.

    Args:
        takes: sequences, the terms switched on.
        params: where to start.
        terms: names; the first's weight stays 1.
        budget: rays a pixel.
        solver: lm on residuals, bfgs on the loss.
        starts: the first lies at `params`, the others are drawn from the bounds.
        seed: of the pixels sampled and of the starts.
        rounds: of replaying, at most.
        checkpoints: keep the state after every round.
        progress: told after every round.

    Returns:
        The best of all rounds by the hard score, the start's own included.
    """
    quantities = space.weights(terms)
    current = jnp.log(_values(params, quantities))
    # what is kept: weights now, best weights, its score, price, evaluations, round, and
    # how far the weights moved in it
    state = (current, current, *(jnp.zeros((), jnp.float32),) * 4, jnp.float32(jnp.inf))
    saved = checkpoints.load(f"soft-{solver}", state)
    if saved is not None:
        state = jax.tree.map(jnp.asarray, saved)
    current, best, best_ssim, price, evaluations, done, moved = state
    price = jnp.where(done > 0, price, _FIRST_PRICE)
    while int(done) < rounds and moved >= _STILL:
        at = with_weights(params, quantities, jnp.exp(current))
        results = [score.at_budget(take, at, budget) for take in takes]
        ssim = float(np.mean([each.ssim for each in results]))
        if ssim > float(best_ssim):
            best, best_ssim = current, jnp.float32(ssim)
        own = [
            space.with_threshold(
                at, jnp.float32(each.threshold), take.config.segmentation
            )
            for each, take in zip(results, takes, strict=True)
        ]
        pixels = relaxed.gather(takes, own, terms, seed=seed)
        middle = float(np.mean(np.log([each.threshold for each in results])))
        start = jnp.concatenate([current, jnp.full((1,), middle, jnp.float32)])
        points = _starts(start, quantities, starts if int(done) == 0 else 1, seed)
        y, priced, spent = _priced(
            points, pixels, budget, float(price), takes, solver, quantities
        )
        price = jnp.float32(priced)  # as it is kept: who goes on must go on alike
        moved = jnp.max(jnp.abs(y[:-1] - current), initial=0.0)
        current = y[:-1]
        evaluations = evaluations + spent
        done = done + 1
        checkpoints.save(
            f"soft-{solver}",
            (current, best, best_ssim, price, evaluations, done, moved),
        )
        progress(f"relaxed fit ({solver}), {ssim:.5f}", int(done), rounds)
    at = with_weights(params, quantities, jnp.exp(current))
    last = float(np.mean([score.at_budget(take, at, budget).ssim for take in takes]))
    if last >= float(best_ssim):
        best, best_ssim = current, jnp.float32(last)
    return SoftFit(
        params=with_weights(params, quantities, jnp.exp(best)),
        hard_ssim=float(best_ssim),
        price=float(price),
        evaluations=int(evaluations),
        hard_evaluations=int(done) + 1,
        rounds=int(done),
    )


def _values(
    params: pipeline.Params, quantities: tuple[space.Quantity, ...]
) -> Float[Array, " k"]:
    found = [
        getattr(params.segmentation, q.name.removeprefix("segmentation."))
        for q in quantities
    ]
    return jnp.stack(found) if found else jnp.zeros((0,), jnp.float32)


def with_weights(
    params: pipeline.Params,
    quantities: tuple[space.Quantity, ...],
    values: Float[Array, " k"],
) -> pipeline.Params:
    """Returns the parameters under other weights, limited to their bounds."""
    for quantity, value in zip(quantities, values, strict=True):
        field = quantity.name.removeprefix("segmentation.")
        limited = jnp.clip(value, quantity.low, quantity.high)
        params = eqx.tree_at(
            lambda p, field=field: getattr(p.segmentation, field), params, limited
        )
    return params


def _starts(
    start: Float[Array, " k"],
    quantities: tuple[space.Quantity, ...],
    count: int,
    seed: int,
) -> Float[Array, "s k"]:
    low = np.log([q.low for q in quantities])
    high = np.log([q.high for q in quantities])
    rng = np.random.default_rng(seed)
    drawn = rng.uniform(low, high, (count - 1, len(quantities)))
    others = np.concatenate([drawn, np.full((count - 1, 1), start[-1])], axis=1)
    return jnp.concatenate([start[None], jnp.asarray(others, jnp.float32)])


def _priced(
    points: Float[Array, "s k"],
    pixels: Pixels,
    budget: float,
    price: float,
    takes: tuple[Take, ...],
    solver: Solver,
    quantities: tuple[space.Quantity, ...],
) -> tuple[Float[Array, " k"], float, int]:
    """Moves the price until the soft mask spends the budget; anneals on the way.

    Returns:
        (the best start's point, price, evaluations).
    """
    samples = jnp.float32(takes[0].samples)
    spent, best, limits = 0, points[0], limits_of(quantities)
    schedule = [
        *relaxed.TEMPERATURES,
        *(relaxed.TEMPERATURES[-1],) * (PRICES - len(relaxed.TEMPERATURES)),
    ]
    for temperature in schedule:
        soft = Soft(
            temperature=jnp.float32(temperature),
            price=jnp.float32(price),
            samples=samples,
        )
        points, losses, steps = minimise(points, (pixels, soft), limits, solver=solver)
        each = points.shape[1] + 1 if solver == "lm" else 2
        spent += each * int(jnp.sum(steps))
        losses = jnp.where(jnp.isfinite(losses), losses, jnp.inf)
        best = points[jnp.argmin(losses)]
        points = best[None]  # the others have done their part
        # Rays fall about as the price's power of −1; damped, for the mask is soft.
        ratio = float(relaxed.rays(best, pixels, soft)) / budget
        price *= float(np.clip(ratio, 0.2, 5.0)) ** 0.8
    return best, price, spent


def at_price(
    start: Float[Array, " k"],
    pixels: Pixels,
    price: float,
    samples: int,
    quantities: tuple[space.Quantity, ...],
    *,
    solver: Solver = "lm",
) -> Float[Array, " k"]:
    """Returns the point that is best at a price a ray, whatever rays it spends."""
    points = start[None]
    for temperature in relaxed.TEMPERATURES:
        soft = Soft(
            temperature=jnp.float32(temperature),
            price=jnp.float32(price),
            samples=jnp.float32(samples),
        )
        points, _, _ = minimise(
            points, (pixels, soft), limits_of(quantities), solver=solver
        )
    return points[0]


def limits_of(quantities: tuple[space.Quantity, ...]) -> Float[Array, "2 k"]:
    """Returns the bounds of the logarithms; the threshold's are none that matter."""
    bounds = [(q.low, q.high) for q in quantities]
    rows = [*bounds, (np.exp(-30.0), np.exp(30.0))]
    return jnp.asarray(np.log(rows).T, jnp.float32)


@eqx.filter_jit
def minimise(
    points: Float[Array, "s k"],
    args: tuple[Pixels, Soft],
    limits: Float[Array, "2 k"],
    *,
    solver: Solver,
) -> tuple[Float[Array, "s k"], Float[Array, " s"], Int[Array, " s"]]:
    """Runs optimistix from several starts at once, within bounds.

    Where the first term, whose weight stays 1, tells nothing, the others' weights would
    grow without end, and limiting them afterwards would lose what they are to each
    other. A point is y = m + r tanh(v), m and r the middle and half the range of the
    bounds; the solvers walk in r v, whose steps are y's near the middle.

    Returns:
        (points, their losses, their steps).
    """
    middle, reach = 0.5 * (limits[0] + limits[1]), 0.5 * (limits[1] - limits[0])

    def bounded(v: Float[Array, " k"]) -> Float[Array, " k"]:
        return middle + reach * jnp.tanh(v / reach)

    def residuals(v: Float[Array, " k"], args: Any) -> tuple[Array, Array]:
        return relaxed.residuals(bounded(v), args)

    def loss(v: Float[Array, " k"], args: Any) -> Array:
        return relaxed.loss(bounded(v), args)

    def one(y: Float[Array, " k"]) -> tuple[Array, Array, Array]:
        # Not from the very bound, where nothing has a slope.
        y = reach * jnp.arctanh(jnp.clip((y - middle) / reach, -0.99, 0.99))
        if solver == "lm":
            found = optx.least_squares(
                residuals,
                optx.LevenbergMarquardt(rtol=1e-3, atol=1e-4),
                y,
                args,
                max_steps=_STEPS,
                throw=False,
            )
        else:
            found = optx.minimise(
                loss,
                optx.BFGS(rtol=1e-3, atol=1e-5),
                y,
                args,
                max_steps=_STEPS,
                throw=False,
            )
        value = bounded(found.value)
        return value, relaxed.loss(value, args), found.stats["num_steps"]

    return jax.vmap(one)(points)
