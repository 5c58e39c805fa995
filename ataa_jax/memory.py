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
_MMAP_THRESHOLD = -3  # malloc.h: M_MMAP_THRESHOLD
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


def return_planes(size: tuple[int, int]) -> None:
    """Has planes of a large image go back to the system as soon as they are freed.

    glibc learns to keep what was freed once, up to 32 MB; told a size, it takes what is
    larger from the system and returns it. That holds for the process from then on, for
    planes of 16 bits and more; best called before a scene is read.

    Args:
        size: image (height, width); of small ones nothing is changed.
    """
    pixels = size[0] * size[1]
    if pixels >= _LARGE_PIXELS:
        _libc("mallopt")(_MMAP_THRESHOLD, 2 * _LARGE_PIXELS)


@functools.cache
def _libc(name: str) -> Callable[..., int]:
    """Returns a function of glibc's, or a stand-in."""
    try:
        return getattr(ctypes.CDLL(None), name)
    except (AttributeError, OSError, TypeError):  # another libc, or none to ask
        return lambda *args: 0
