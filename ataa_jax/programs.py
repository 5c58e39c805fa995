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
        files = [f for f in (folder() / kind).rglob("*") if f.is_file()]
        found[kind] = (len(files), sum(f.stat().st_size for f in files))
    return found


def clear() -> None:
    """Removes what the package keeps, and nothing else that may lie in the folder."""
    for kind in KINDS:
        shutil.rmtree(folder() / kind, ignore_errors=True)


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


def prune(place: Path, limit_bytes: int, pattern: str = "*") -> None:
    """Removes the oldest files of a folder until the rest keeps to a limit."""
    found = []
    for file in place.glob(pattern):
        try:  # another process may remove it too
            state = file.stat()
        except OSError:
            continue
        if not stat.S_ISREG(state.st_mode):
            continue
        found.append((state.st_mtime, state.st_size, file))
    total = sum(size for _, size, _ in found)
    for _, size, file in sorted(found):
        if total <= limit_bytes:
            return
        total -= size
        file.unlink(missing_ok=True)
