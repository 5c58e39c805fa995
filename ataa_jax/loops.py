"""Loops that numba compiles, for what XLA has no operation for, or a slow one.

What was compiled is kept where numba finds a folder to write: beside the sources, or
the user's cache. Where it finds none (an installation that is read-only), every process
compiles anew.

The test suite's import hook would wrap these functions before numba sees them:
`typing.no_type_check`, the inner decorator, keeps it away.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core.ccallback import CFunc

F = TypeVar("F", bound=Callable[..., Any])

# Divisions by 0 give what IEEE 754 says.
_OPTIONS = {"error_model": "numpy"}


def compiled(function: F) -> F:
    """Compiles a function when it is called first; it runs without the interpreter."""
    return _kept(lambda keep: numba.njit(**_OPTIONS, nogil=True, cache=keep)(function))


def called_back(signature: Any, function: Callable[..., None]) -> CFunc:
    """Compiles a function at once, for C code to call by its address."""
    return _kept(lambda keep: numba.cfunc(signature, **_OPTIONS, cache=keep)(function))


def _kept(make: Callable[[bool], Any]) -> Any:
    try:
        return make(True)
    except RuntimeError:  # numba's, where it finds no folder
        return make(False)
