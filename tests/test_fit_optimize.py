"""optimistix's Nelder–Mead, stepped by hand: its bottom, its counts, its resuming."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax.fit import optimize
from ataa_jax.fit.checkpoint import Checkpoints


@pytest.mark.parametrize("centre", [[0.3, -0.2], [0.3, -0.2, 0.6]])
def test_nelder_mead_finds_the_bottom_of_a_bowl_and_counts_its_evaluations(centre):
    calls = []

    def bowl(x, centre):
        jax.debug.callback(lambda: calls.append(1))
        return jnp.sum((x - centre) ** 2)

    centre = jnp.asarray(centre)
    found = optimize.nelder_mead(
        bowl, jnp.zeros_like(centre), centre, steps=150, tolerance=1e-9
    )
    jax.effects_barrier()
    np.testing.assert_allclose(found.x, centre, atol=1e-3)
    assert found.value == pytest.approx(float(jnp.sum((found.x - centre) ** 2)))
    assert found.evaluations == len(calls)


def test_a_search_that_was_killed_ends_where_an_undisturbed_one_does(tmp_path):
    def bowl(x, centre):
        return jnp.sum((x - centre) ** 2)

    centre = jnp.asarray([0.3, -0.2])
    whole = optimize.nelder_mead(bowl, jnp.zeros(2), centre, steps=12)
    kept = Checkpoints(folder=tmp_path, key="bowl")

    class KilledError(Exception):
        pass

    def kill(text, done, total):
        if done == 5:
            raise KilledError

    with pytest.raises(KilledError):
        optimize.nelder_mead(
            bowl, jnp.zeros(2), centre, steps=12, checkpoints=kept, progress=kill
        )
    seen = []
    again = optimize.nelder_mead(
        bowl, jnp.zeros(2), centre, steps=12, checkpoints=kept,
        progress=lambda text, done, total: seen.append(done),
    )  # fmt: skip
    assert seen[0] == 6, "a finished step was done again"
    repeated = optimize.nelder_mead(
        bowl, jnp.zeros(2), centre, steps=12, checkpoints=kept
    )
    for each in (again, repeated):
        assert np.array_equal(whole.x, each.x)
        assert whole.evaluations == each.evaluations


def test_a_search_that_has_stopped_does_not_go_on_when_it_is_asked_again(tmp_path):
    def bowl(x, centre):
        return jnp.sum((x - centre) ** 2)

    kept = Checkpoints(folder=tmp_path, key="bowl")
    first, again = (
        optimize.nelder_mead(
            bowl, jnp.zeros(2), jnp.ones(2), steps=90, tolerance=1e-3, checkpoints=kept
        )
        for _ in range(2)
    )
    assert first.steps == again.steps < 90
    assert first.evaluations == again.evaluations
