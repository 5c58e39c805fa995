"""Many frames: nothing grows, nothing hangs, nothing is compiled late."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from scipy import stats

# A callback that waits for the thread it runs on waits for ever.
_PATIENCE = 240.0  # s, of which most is compilation


def held(frames, size, cpus, dispatch, cache, patience=_PATIENCE):
    words = (str(frames), f"{size[1]}x{size[0]}", cpus, dispatch)
    done = subprocess.run(
        [sys.executable, "-m", "tests.long_run", *words],
        cwd=Path(__file__).parents[1],
        env={**os.environ, "ATAA_CACHE": str(cache)},
        capture_output=True,
        text=True,
        timeout=patience,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout)


def check(seen, growth, record=lambda name, value: None):
    first, *later = settled = seen["samples"][len(seen["samples"]) // 4 :]
    _, _, threads, files, arrays = first
    frames, memory = zip(*(sample[:2] for sample in settled), strict=True)
    # What is kept grows with the frames. The median slope between two samples sees that
    # and does not see an allocator that takes one piece more, once.
    grown = stats.theilslopes(memory, frames).slope * frames[-1]
    record("frames", frames[-1] + 1)
    record("growth in MB", round(grown / 2**20, 1))
    record("threads", threads)
    assert len(later) >= 4
    assert grown <= growth
    assert {sample[2] for sample in later} == {threads}
    assert {sample[3] for sample in later} == {files}
    assert {sample[4] for sample in later} == {arrays}
    assert seen["late_programs"] == 0


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("long")


@pytest.mark.parametrize(("cpus", "dispatch"), [("all", "sync"), ("one", "async")])
def test_five_hundred_frames_hold_no_more_than_the_first_of_them(cpus, dispatch, cache):
    # One image of 64×36 kept a frame would be 10 MB by then.
    check(held(500, (36, 64), cpus, dispatch, cache), 4 << 20)


@pytest.mark.hard
@pytest.mark.parametrize("dispatch", ["sync", "async"])
@pytest.mark.parametrize("cpus", ["all", "one"])
def test_two_thousand_frames_hold_no_more_than_the_first_of_them(
    cpus, dispatch, cache, record_property
):
    # One image of 320×180 kept a frame would be 1 GB by then.
    seen = held(2000, (180, 320), cpus, dispatch, cache, 1800.0)
    check(seen, 16 << 20, record_property)
