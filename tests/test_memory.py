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
def test_the_allocator_suits_the_size_of_the_images():
    """Of a piece over 32 MB, and of planes once a larger buffer was freed."""
    words = """
import sys
import numpy as np, psutil
from ataa_jax import memory
def resident(): return psutil.Process().memory_info().rss >> 20
for size in sys.argv[1:]: memory.suit(tuple(map(int, size.split("x"))))
piece = np.ones(60 << 20, np.uint8)
before = resident()
del piece
told = [before - resident()]
taught = np.ones(30 << 20, np.uint8)
del taught
planes = [np.ones(6 << 20, np.uint8) for _ in range(20)]
held = np.ones(1 << 20, np.uint8)
before = resident()
planes.clear()
print(*told, before - resident())
"""

    def returned(*sizes: str) -> tuple[int, int]:
        child = subprocess.run(
            [sys.executable, "-c", words, *sizes],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        piece, planes = map(int, child.stdout.split())
        return piece, planes

    for sizes in (["1080x1920"], ["720x1280", "1080x1920"]):
        piece, planes = returned(*sizes)
        assert piece > 55  # of 60 MB
        assert planes > 110  # of 120 MB
    piece, planes = returned("360x640")
    assert piece > 55
    assert planes < 60
    assert max(returned("720x1280")) < 5
