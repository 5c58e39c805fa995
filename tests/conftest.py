"""Settings that every test runs under; they must stand before JAX is imported."""

import gc
import os
import shutil
import tempfile

os.environ["JAX_PLATFORMS"] = "cpu"

# What one worker or process compiled, the others load: a folder for this run alone.
os.environ["ATAA_TESTS_PROGRAMS"] = os.environ.get(
    "ATAA_TESTS_PROGRAMS"
) or tempfile.mkdtemp(prefix="ataa-tests-")
os.environ["JAX_COMPILATION_CACHE_DIR"] = os.environ["ATAA_TESTS_PROGRAMS"]
# Nor do tests fill the user's cache, or find anything there.
os.environ["ATAA_CACHE"] = os.environ["ATAA_TESTS_PROGRAMS"] + "/cache"
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"

import hypothesis
import jax
import pytest

jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

hypothesis.settings.register_profile("ataa", deadline=None, derandomize=True)
hypothesis.settings.load_profile("ataa")


# What compiles longest goes first, so that no worker is left alone with it at the end.
SLOWEST = (
    *("test_real_scenes", "test_failures", "test_fit", "test_effects", "test_cli"),
    *("test_readme", "test_pipeline", "test_reference", "test_raytrace"),
    *("test_bad_input", "test_interruptions"),
)


def pytest_unconfigure() -> None:
    """Removes the folder of programs, once its users are gone."""
    if "PYTEST_XDIST_WORKER" not in os.environ:
        shutil.rmtree(os.environ["ATAA_TESTS_PROGRAMS"], ignore_errors=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Orders the files by how long they take."""

    def place(item: pytest.Item) -> int:
        name = item.path.stem
        return SLOWEST.index(name) if name in SLOWEST else len(SLOWEST)

    items.sort(key=place)


@pytest.fixture(params=("packet", "run"))
def backend(request: pytest.FixtureRequest) -> str:
    """Embree's entry points: packets of rays, or embreex's own `run`."""
    return request.param


@pytest.fixture(autouse=True, scope="module")
def _compiled_programs_go_with_their_module():
    """Frees what a module compiled.

    Scenes of other shapes and other effects compile all stages anew; a process
    that keeps thousands of programs runs out of memory mappings and dies compiling.
    """
    yield
    jax.clear_caches()
    gc.collect()
