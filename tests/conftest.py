"""Settings that every test runs under; they must stand before JAX is imported."""

import os

os.environ["JAX_PLATFORMS"] = "cpu"

import hypothesis
import jax
import pytest

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

hypothesis.settings.register_profile("ataa", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ataa")


@pytest.fixture(params=("packet", "run"))
def backend(request: pytest.FixtureRequest) -> str:
    """Embree's entry points: packets of rays, or embreex's own `run`."""
    return request.param
