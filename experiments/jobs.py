"""Does who renders the references change a byte, and what does it save?

`ataa compare` of the built-in scene at 320×180, 12 frames, 64 samples a pixel, with an
empty cache each time: by one process; by two more that render the references; the same
with one of them killed on the way; and by a Dask cluster of two workers, with a cache
of their own, of which one is killed on the way. Starting the cluster is not counted.
*references*: seconds until the last of them is in the cache; *same*: every file but
`timings.csv` is byte for byte that of the first row.

Found: all the same, also where a worker was killed. On two processor cores that other
programs used as well, nothing was saved: one process traces on both already, and every
worker compiles and loads anew with an empty cache, one that takes a dead one's place
once more. The seconds are of one run each, and rough. More than two cores were not at
hand.

    python experiments/jobs.py              # writes experiments/results/jobs.csv
"""

import contextlib
import csv
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil

FILE = Path(__file__).parent / "results" / "jobs.csv"
FRAMES = 12
COMMAND = (
    *("compare", "builtin", "--size", "320x180", "--frames", str(FRAMES)),
    *("--method", "none,taa", "--reference-samples", "64"),
)
COLUMNS = ("workers", "killed", "seconds", "references_s", "same")


def measure(
    place: Path, words: tuple[str, ...], victim: Callable[[int], int] | None
) -> tuple[float, float, int, dict[str, bytes]]:
    """Runs the command with an empty cache.

    Args:
        place: a folder of its own.
        words: more arguments.
        victim: returns which process to kill when the first references are there, given
            the command's; None: none.

    Returns:
        Seconds of all; seconds until the last reference; processes killed; the files.
    """
    held = place / "cache" / "reference"
    begin = time.monotonic()
    out = ("--out", str(place / "out"))
    process = subprocess.Popen(
        [sys.executable, "-m", "ataa_jax.cli", *COMMAND, *words, *out],
        env={**os.environ, "ATAA_CACHE": str(place / "cache")},
        stdout=subprocess.DEVNULL,
    )
    killed, last = 0, 0.0
    while process.poll() is None:
        count = len(list(held.glob("*.npz")))
        if count >= 2 and victim is not None and not killed:
            os.kill(victim(process.pid), signal.SIGKILL)
            killed = 1
        if count == FRAMES and not last:
            last = time.monotonic() - begin
        time.sleep(0.05)
    seconds = time.monotonic() - begin
    assert process.returncode == 0
    files = {
        file.relative_to(place / "out").as_posix(): file.read_bytes()
        for file in sorted((place / "out").rglob("*"))
        if file.is_file() and file.name != "timings.csv"
    }
    return seconds, last, killed, files


def child(parent: int) -> int:
    """Returns a process that renders for another: the one with most processor time."""
    children = psutil.Process(parent).children()
    return max(children, key=lambda each: each.cpu_times().user).pid


@contextlib.contextmanager
def cluster(place: Path) -> Iterator[tuple[str, int]]:
    """Yields the address of a cluster of two workers, and a worker's process."""
    import distributed

    started: Any = distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        dashboard_address=":0",
        env={"ATAA_CACHE": str(place / "far")},
    )
    with started:
        client: Any = distributed.Client(started)
        with client:
            workers = client.run(os.getpid)
        yield started.scheduler_address, next(iter(workers.values()))


def main() -> None:
    """Measures and writes the table."""
    rows, expected = [], None
    with tempfile.TemporaryDirectory() as folder:

        def add(name: str, words: tuple[str, ...], victim: Callable | None) -> None:
            nonlocal expected
            place = Path(folder) / str(len(rows))
            seconds, last, killed, files = measure(place, words, victim)
            expected = expected or files
            same = "yes" if files == expected else "no"
            rows.append((name, killed, f"{seconds:.0f}", f"{last:.0f}", same))
            print(*rows[-1], flush=True)

        add("none", (), None)
        add("2 processes", ("--jobs", "2"), None)
        add("2 processes", ("--jobs", "2"), child)
        with cluster(Path(folder)) as (address, pid):
            add("2 of Dask", ("--scheduler", address), lambda _: pid)
    with FILE.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream, lineterminator="\n").writerows([COLUMNS, *rows])
    if any(row[-1] != "yes" for row in rows):
        sys.exit("the bytes differ")


if __name__ == "__main__":
    main()
