"""Loops that numba compiles, for what XLA has no operation for, or a slow one.

What was compiled is kept where numba finds a folder to write: beside the sources, or
the user's cache. Where it finds none (an installation that is read-only), every process
compiles anew.

The test suite's import hook would wrap these functions before numba sees them:
`typing.no_type_check`, the inner decorator, keeps it away.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.ccallback import CFunc

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


def compiled(function: F) -> F:
    """Compiles a function when it is called first; it runs without the interpreter.

    A division by 0 gives what IEEE 754 says.
    """

    def make(keep: bool) -> F:
        made = numba.njit(cache=keep, nogil=True, error_model="numpy")(function)
        return cast("F", made)

    return _kept(make)


def called_back(signature: Any, function: Callable[..., None]) -> CFunc:
    """Compiles a function at once, for C code to call by its address."""

    def make(keep: bool) -> CFunc:
        return numba.cfunc(signature, cache=keep, error_model="numpy")(function)

    return _kept(make)


def _kept(make: Callable[[bool], T]) -> T:
    try:
        return make(True)
    except RuntimeError:  # numba's, where it finds no folder
        return make(False)
