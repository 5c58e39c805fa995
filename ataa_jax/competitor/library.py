"""Finds Mitsuba 3 and the LLVM library that its vectorized CPU variant compiles with.

Dr.Jit, which Mitsuba is built on, loads LLVM at run time and looks for it by names of
its own. The newest library found here is named to it instead, unless the user has
named one in `DRJIT_LIBLLVM_PATH`.
"""

import importlib
import os
import re
import sys
from collections.abc import Iterable
from glob import glob
from pathlib import Path
from types import ModuleType

from ataa_jax.errors import InputError

VARIANT = "llvm_ad_rgb"
_VARIABLE = "DRJIT_LIBLLVM_PATH"

# LLVM 14 and 15 crash where the processor has AVX-512-FP16 (measured on one such).
_OLDEST = 16

_FOLDERS = (
    *("/usr/lib/*-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/local/lib"),
    *("/usr/lib/llvm-*/lib", "/usr/lib64/llvm*/lib", "/opt/homebrew/opt/llvm*/lib"),
)
# libLLVM.so.19.1, libLLVM-17.so.1, libLLVM-16.0.6.so, libLLVM.dylib
_NAME = re.compile(r"libLLVM(?:-(\d+)[\d.]*)?\.(?:so|dylib)(?:\.(\d+)[\d.]*)?$")

_ADVICE = (
    "install it with `pip install 'ataa-jax[mitsuba]'`, and LLVM with Debian's package "
    f"libllvm19, or name the library's file in {_VARIABLE}"
)


def load() -> ModuleType:
    """Imports Mitsuba and sets its variant.

    Returns:
        The module `mitsuba`, with `llvm_ad_rgb` as its variant in this thread.

    Raises:
        InputError: Mitsuba or LLVM is missing.
    """
    named = os.environ.get(_VARIABLE)
    if named and not Path(named).is_file():
        raise InputError(f"{_VARIABLE} names '{named}', which is no file; {_ADVICE}")
    found = None if named else newest(_candidates())
    if found is not None:
        os.environ[_VARIABLE] = found
    elif not named and sys.platform == "linux":
        raise InputError(
            f"no LLVM library from version {_OLDEST} on was found; {_ADVICE}"
        )
    try:
        mitsuba = importlib.import_module("mitsuba")
        drjit = importlib.import_module("drjit")
    except ImportError as error:
        raise InputError(f"Mitsuba 3 cannot be loaded ({error}); {_ADVICE}") from error
    if VARIANT not in mitsuba.variants() or not drjit.has_backend(
        drjit.JitBackend.LLVM
    ):
        raise InputError(f"Mitsuba cannot use the LLVM library it found; {_ADVICE}")
    mitsuba.set_variant(VARIANT)
    return mitsuba


def newest(files: Iterable[str]) -> str | None:
    """Returns the LLVM library with the highest version, if any is new enough.

    Args:
        files: paths; names that tell no version are passed over.
    """
    versions = {file: _version(file) for file in files}
    usable = [file for file, version in versions.items() if version >= _OLDEST]
    return max(usable, key=lambda file: (versions[file], file), default=None)


def _version(file: str) -> int:
    """Returns the major version that a file name tells, or 0."""
    match = _NAME.search(Path(file).name)
    if match is None:
        return 0
    before, after = match.groups()
    return int(before or after or 0)


def _candidates() -> list[str]:
    return [file for folder in _FOLDERS for file in glob(f"{folder}/libLLVM*")]
