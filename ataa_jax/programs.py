"""The cache folder: what it holds, how it is emptied, and compiled programs in it.

Compiling takes most of a first command's time; a program that is kept serves the next
process that runs the same code on arrays of the same shapes, with the same effects
(see `hostcall` for why it can be kept). Imports neither JAX nor NumPy, so that it can
come before them.
"""

import hashlib
import os
import platform
import shutil
import stat
import sys
import time
from contextlib import suppress
from pathlib import Path

import platformdirs

# What the package keeps, each in a folder of its own.
KINDS = {
    "programs": "compiled programs",
    "reference": "supersampled references",
    "pyramids": "mip levels of textures",
    "exposure": "brightness of views",
    "record": "recorded sequences, for fits",
    "fit": "steps of fits",
}

# our choice: of some 0.5 MB each, some thousand programs; the oldest go first.
LIMIT_BYTES = 512 << 20


def folder() -> Path:
    """Returns the cache: `ATAA_CACHE`, or the user's cache folder."""
    return Path(os.environ.get("ATAA_CACHE") or platformdirs.user_cache_dir("ataa_jax"))


def contents() -> dict[str, tuple[int, int]]:
    """Returns the number of files and bytes of each of `KINDS`."""
    found = {}
    for kind in KINDS:
        sizes = [state.st_size for _, state in _files(folder() / kind, "**/*")]
        found[kind] = (len(sizes), sum(sizes))
    return found


def clear() -> None:
    """Removes what the package keeps, and nothing else that may lie in the folder."""
    for kind in KINDS:
        shutil.rmtree(folder() / kind, ignore_errors=True)


_BEGAN, _DAY_S = time.time(), 24 * 3600.0  # our choice: a day, for what runs for weeks

_kept = False


def kept() -> bool:
    """Returns whether programs are kept: whether `keep` was called in time."""
    return _kept


def keep() -> None:
    """Has JAX keep programs for the next process; best called before it is imported.

    What the environment, or who imported JAX, says about its cache already, stays. A
    folder that cannot be written costs a warning and the time of compiling.
    """
    place = folder() / "programs" / _processor()
    imported = sys.modules.get("jax")
    if imported is not None and imported.config.jax_compilation_cache_dir is not None:
        return
    global _kept
    _kept = True
    for name, value in (
        ("jax_compilation_cache_dir", str(place)),
        # our choice: all of them; the forty smallest of a command cost a second.
        ("jax_persistent_cache_min_compile_time_secs", 0.0),
    ):
        if name.upper() not in os.environ:
            os.environ[name.upper()] = str(value)
            if imported is not None:
                imported.config.update(name, value)
    prune(place, LIMIT_BYTES)


def _processor() -> str:
    """Names the instruction set: a program compiled for another could crash."""
    flags = platform.processor() + processor_flags()
    digest = hashlib.blake2b(flags.encode(), digest_size=6).hexdigest()
    return f"{platform.machine()}-{digest}"


def processor_flags() -> str:
    """Returns the line of the system's that lists the processor's abilities, or ""."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        return ""
    return next((x for x in lines if x.startswith(("flags", "Features"))), "")


# XLA and Embree choose vector instructions by these; others change no result.
_VECTORS = ("avx", "fma", "sse", "amx", "asimd", "sve", "f16c")


def vectors() -> str:
    """Names the vector instructions, which decide the last bits of a result."""
    listed = processor_flags().split() or [platform.processor()]
    flags = {flag for flag in listed if flag.startswith(_VECTORS)} or set(listed)
    return " ".join([platform.machine(), *sorted(flags)])


def prune(place: Path, limit_bytes: int) -> None:
    """Removes the oldest files of a folder until the rest keeps to a limit.

    What was written since this process began, in the last day at most, stays: it may be
    about to read that, and were it the oldest each time, would find nothing of it.
    """
    found = _files(place, "*")
    total = sum(state.st_size for _, state in found)
    spared = max(_BEGAN, time.time() - _DAY_S)
    for file, state in sorted(found, key=lambda each: each[1].st_mtime):
        if total <= limit_bytes or state.st_mtime >= spared:
            return
        total -= state.st_size
        with suppress(OSError):  # another's file, or another process removed it
            file.unlink()


def _files(place: Path, pattern: str) -> list[tuple[Path, os.stat_result]]:
    """Returns the files of a folder, without those that another process removes."""
    found = []
    for file in place.glob(pattern):
        with suppress(OSError):
            state = file.stat()
            if stat.S_ISREG(state.st_mode):
                found.append((file, state))
    return found
