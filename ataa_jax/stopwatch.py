"""Time by the clock, and the processor time of all threads beside it.

The clock is what a person waits; but on a machine that does other work too, it counts
that as well. Processor time counts this process alone.
"""

import time
from typing import NamedTuple


class Lap(NamedTuple):
    """What passed, in milliseconds."""

    clock_ms: float
    processor_ms: float


class Stopwatch:
    """Runs from when it is made, or started again."""

    def __init__(self) -> None:
        self.start()

    def start(self) -> None:
        """Starts again from now."""
        self._clock, self._processor = time.perf_counter(), time.process_time()

    def lap(self) -> Lap:
        """Returns what passed since the start; asynchronous work must be waited for."""
        clock, processor = time.perf_counter(), time.process_time()
        return Lap(1e3 * (clock - self._clock), 1e3 * (processor - self._processor))
