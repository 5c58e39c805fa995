"""What a comparison says of its own process."""

import subprocess
import sys

import numpy as np

from ataa_jax import compare


def test_the_peak_memory_is_the_process_s_own():
    # A process that a larger one starts: the system's figure begins at the larger's.
    ballast = np.ones(3 * 2**28 // 8)
    words = "from ataa_jax import compare; print(compare.peak_memory())"
    child = subprocess.run(
        [sys.executable, "-c", words], capture_output=True, text=True, check=True
    )
    assert 2**20 < int(child.stdout) < ballast.nbytes <= compare.peak_memory()
