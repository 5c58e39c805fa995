"""What a process says of its memory, and gives back."""

import ctypes
import subprocess
import sys

import numpy as np
import pytest

from ataa_jax import memory


def test_the_peak_memory_is_the_process_s_own():
    # A process that a larger one starts: the system's figure begins at the larger's.
    ballast = np.ones(3 * 2**28 // 8)
    words = "from ataa_jax import memory; print(memory.peak())"
    child = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True
    )
    assert 2**20 < int(child.stdout) < ballast.nbytes <= memory.peak()


@pytest.mark.skipif(
    not hasattr(ctypes.CDLL(None), "malloc_trim"), reason="another libc than glibc"
)
def test_freed_pieces_go_back_to_the_system():
    # Small pieces with a held one above: freeing alone cannot lower the heap's end.
    words = """
from ataa_jax import memory
import psutil
def resident(): return psutil.Process().memory_info().rss >> 20
pieces = [bytes(40_000) for _ in range(10_000)]
held = bytes(40_000)
pieces.clear()
before = resident()
memory.release()
print(before - resident())
"""
    child = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True
    )
    assert int(child.stdout) > 200  # MB, of 400


@pytest.mark.skipif(
    not hasattr(ctypes.CDLL(None), "mallopt"), reason="another libc than glibc"
)
def test_planes_of_large_images_go_back_to_the_system():
    # Once a larger buffer was freed, glibc would keep this one, with one above it held.
    words = """
import sys
import numpy as np, psutil
from ataa_jax import memory
def resident(): return psutil.Process().memory_info().rss >> 20
if sys.argv[1] == "large": memory.return_planes((1080, 1920))
if sys.argv[1] == "small": memory.return_planes((360, 640))
taught = np.ones(30 << 20, np.uint8)
del taught
planes = [np.ones(6 << 20, np.uint8) for _ in range(20)]
held = np.ones(1 << 20, np.uint8)
before = resident()
planes.clear()
print(before - resident())
"""

    def returned(size: str) -> int:
        child = subprocess.run(
            [sys.executable, "-c", words, size],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        return int(child.stdout)

    assert returned("large") > 110  # of 120 MB
    assert returned("small") < 60
