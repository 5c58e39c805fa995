"""Compiled loops where there is nowhere to keep them."""

from typing import no_type_check

import numba
import pytest
from numba.core import caching

from ataa_jax import loops


@no_type_check
def twice(x):
    return x + x


@no_type_check
def nothing(at):
    pass


@pytest.fixture
def read_only(monkeypatch):
    """As where neither the sources' folder nor the user's cache can be written."""
    for kind in (caching.CompileResultCacheImpl, caching.CodeLibraryCacheImpl):
        monkeypatch.setattr(kind, "_locator_classes", [])
    with pytest.raises(RuntimeError, match="cannot cache"):
        numba.njit(cache=True)(twice)


@pytest.mark.usefixtures("read_only")
def test_loops_are_compiled_anew():
    assert loops.compiled(twice)(21) == 42


@pytest.mark.usefixtures("read_only")
def test_callbacks_are_compiled_anew():
    signature = numba.types.void(numba.types.int64)
    assert loops.called_back(signature, nothing).address != 0


def test_a_mistake_in_a_loop_is_still_told():
    @no_type_check
    def wrong(x):
        return x.no_such_thing

    with pytest.raises(numba.TypingError):
        loops.compiled(wrong)(1)
