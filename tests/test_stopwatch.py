"""Two clocks: what a person waits, and what the process works."""

import time

from ataa_jax.stopwatch import Stopwatch


def test_a_pause_passes_by_the_clock_and_is_no_work():
    watch = Stopwatch()
    time.sleep(0.2)
    lap = watch.lap()
    assert lap.clock_ms >= 200.0
    assert lap.processor_ms < 100.0  # of a process that rests


def test_work_passes_by_both_clocks_and_starting_again_forgets_it():
    watch = Stopwatch()
    end = time.process_time() + 0.05
    while time.process_time() < end:
        pass
    lap = watch.lap()
    assert lap.processor_ms >= 50.0
    assert lap.clock_ms > 0.0
    watch.start()
    assert watch.lap().processor_ms < 50.0
