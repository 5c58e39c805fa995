"""Optimistix's optimizers, stepped by hand: with progress, and resumable.

Every function evaluation is counted; each start, gradient and column of a Jacobian
counts as one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ataa_jax.fit.checkpoint import NOWHERE, Checkpoints

Objective = Callable[[Float[Array, " n"], Any], Float[Array, ""]]
Progress = Callable[[str, int, int], None]


def _silent(text: str, done: int, total: int) -> None:
    del text, done, total


@dataclass(frozen=True)
class Found:
    """The best point of a search."""

    x: np.ndarray  # as the objective takes it
    value: float
    evaluations: int
    steps: int


def nelder_mead(
    objective: Objective,
    start: Float[Array, " n"],
    args: Any,
    *,
    steps: int,
    reach: float = 0.25,
    tolerance: float = 1e-5,
    checkpoints: Checkpoints = NOWHERE,
    progress: Progress = _silent,
) -> Found:
    """Minimises without gradients by `optimistix.NelderMead`.

    Args:
        objective: (x, args) → value; traced, so callbacks inside must allow it.
        start: first vertex; the others lie `reach` along each axis.
        args: operands of the objective.
        steps: at most; the first evaluates the simplex, each later one two points, or
            n + 1 more where the simplex shrinks.
        reach: size of the first simplex.
        tolerance: the values' spread over the simplex at which it stops.
        checkpoints: where the state is kept after every step.
        progress: told after every step.
    """
    solver = optx.NelderMead(rtol=0.0, atol=tolerance)
    # One point at a time: a batch of closed loops costs what they cost in turn.
    one = jax.custom_batching.sequential_vmap(objective)

    def fn(x: Array, args: Any) -> tuple[Array, None]:
        return one(x, args), None

    struct = jax.eval_shape(objective, start, args)
    state = solver.init(fn, start, args, {}, struct, None, frozenset())
    # optimistix 0.1.0 counts through its first simplex in the wrong order: it is flat,
    # two of its vertices are the start. One given as an option it refuses.
    size = start.shape[0]
    simplex = start[None] + reach * jnp.eye(size + 1, size, -1, dtype=start.dtype)
    state = eqx.tree_at(lambda s: s.simplex, state, simplex)
    dynamic, static = eqx.partition(state, eqx.is_array)

    @jax.jit
    def step(x: Array, dynamic: Any, args: Any) -> tuple[Array, Any]:
        state = eqx.combine(dynamic, static)
        x, state, _ = solver.step(fn, x, args, {}, state, frozenset())
        return x, eqx.filter(_corrected(state), eqx.is_array)

    x = start
    saved = checkpoints.load("nelder-mead", (x, dynamic))
    if saved is not None:
        x, dynamic = jax.tree.map(jnp.asarray, saved)
    state = eqx.combine(dynamic, static)
    while (done := int(state.step)) < steps and not (done and _met(state, tolerance)):
        x, dynamic = step(x, dynamic, args)
        checkpoints.save("nelder-mead", (x, dynamic))
        state = eqx.combine(dynamic, static)
        progress(f"Nelder–Mead, {float(state.best[0]):.5f}", int(state.step), steps)
    shrinks = int(state.stats.n_shrink)
    vertices = start.shape[0] + 1
    return Found(
        x=np.asarray(state.best[1]),
        value=float(state.best[0]),
        evaluations=vertices * (1 + shrinks) + 2 * max(done - 1, 0),
        steps=done,
    )


def _met(state: Any, tolerance: float) -> bool:
    """Returns whether the simplex's values agree within a tolerance."""
    return float(jnp.max(jnp.abs(state.f_simplex - state.best[0]))) <= tolerance


def _corrected(state: Any) -> Any:
    """Returns the state with its best and worst vertex read from the new simplex.

    optimistix 0.1.0 reads them from the simplex before the step: a new best vertex
    would be reported as the worst one that it replaced.
    """
    best, worst = jnp.argmin(state.f_simplex), jnp.argmax(state.f_simplex)
    return eqx.tree_at(
        lambda s: (s.best[1], s.worst[1]),
        state,
        (state.simplex[best], state.simplex[worst]),
    )
