"""Settings that every test runs under; they must stand before JAX is imported."""

import gc
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


@pytest.fixture(autouse=True, scope="module")
def _compiled_programs_go_with_their_module():
    """Frees what a module compiled.

    Every scene has a tracer of its own, for which all stages compile anew; a process
    that keeps thousands of programs runs out of memory mappings and dies compiling.
    """
    yield
    jax.clear_caches()
    gc.collect()
