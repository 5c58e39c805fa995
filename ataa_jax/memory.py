"""Memory of the process: the peak it came to, and what its allocator holds back.

glibc's allocator keeps freed pieces for later. XLA's compiler and the readers of scenes
leave hundreds of megabytes of them, beside which a frame then needs its own: at
1920×1080 on Sponza the peak is 0.7 GB lower when they are given back, and another
0.15 GB when buffers as large as a plane of such an image are never kept.
"""

import ctypes
import functools
import gc
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import jax.monitoring

# our choice: shorter ones leave little.
_LONG_COMPILE_S = 1.0
# our choice: from 1920×1080 on planes go back to the system. It costs 3 % of a frame's
# time there; at 640×360, where memory is no matter, it cost the raster stage 15 %.
_LARGE_PIXELS = 1920 * 1080
_SMALL_PIXELS = 640 * 360  # up to here nothing has to be changed
# malloc.h: M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_MMAP_MAX and its default.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _MMAP_MAX = -1, -3, -4
_MMAPS, _NEVER = 65536, 2**31 - 1
_COMPILED = "/jax/core/compile/backend_compile_duration"


def peak() -> int:
    """Returns the process's peak resident memory in bytes, as the system tells it."""
    if sys.platform == "win32":
        import psutil

        return int(psutil.Process().memory_info().peak_wset)
    import resource

    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if sys.platform == "darwin":
        return usage  # bytes
    # Linux starts `ru_maxrss` at the peak of the process that started this one.
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                usage = int(line.split()[1])
    return usage * 1024


def release() -> None:
    """Frees what nobody holds, and gives it back to the system where libc can.

    JAX lets go of the NumPy arrays that it copied from only when Python collects.
    """
    gc.collect()
    _libc("malloc_trim")(0)


@functools.cache
def release_after_compiling() -> None:
    """Has every long compile of this process followed by `release`."""

    def heard(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event == _COMPILED and duration_secs > _LONG_COMPILE_S:
            release()

    jax.monitoring.register_event_duration_secs_listener(heard)


def scarce(size: tuple[int, int]) -> bool:
    """Returns whether images of (height, width) take memory that counts."""
    return size[0] * size[1] >= _LARGE_PIXELS


def suit(size: tuple[int, int]) -> None:
    """Suits the allocator to images of a size; best called before a scene is read.

    What a stage's program needs beside its results lies in one piece. glibc keeps it
    for the next frame up to 32 MB, enough for 640×360; a larger one it takes from the
    system every time, and gives back. For images under 1920×1080 it is told to keep
    all: at 1280×720 that saves 35,000 page faults a frame, 8 % of its time on the ship
    and 16 % on Sponza. For larger ones it is told to give back every plane as soon as
    it is freed. Both hold for the process, until another size is named.

    Args:
        size: image (height, width).
    """
    if scarce(size):
        _libc("mallopt")(_MMAP_MAX, _MMAPS)
        _libc("mallopt")(_MMAP_THRESHOLD, 2 * _LARGE_PIXELS)
    elif size[0] * size[1] > _SMALL_PIXELS:
        _libc("mallopt")(_MMAP_MAX, 0)
        _libc("mallopt")(_TRIM_THRESHOLD, _NEVER)


@functools.cache
def _libc(name: str) -> Callable[..., int]:
    """Returns a function of glibc's, or a stand-in."""
    try:
        return getattr(ctypes.CDLL(None), name)
    except (AttributeError, OSError, TypeError):  # another libc, or none to ask
        return lambda *args: 0
