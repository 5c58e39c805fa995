"""A killed command goes on where it was killed, and ends in the same bytes."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ataa_jax import cache, files
from ataa_jax.errors import InputError
from ataa_jax.journal import Journal
from tests.gltf_writer import ball

# Who tests in the background may have Ctrl-C ignored, for all that is started there.
COMMAND_LINE = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from ataa_jax import cli
sys.exit(cli.main())
"""
SMALL = ("--size", "48x32", "--frames", "4", "--lead-in", "2")
TRUTH = ("--reference-samples", "4")
COMMANDS = {
    "run": ("run", "{scene}", *SMALL, "--out", "{out}"),
    "compare": (
        *("compare", "{scene}", *SMALL, *TRUTH, "--out", "{out}"),
        *("--method", "none,taa,ataa8,ssaa2"),
    ),
    "fit": (
        *("fit", "{scene}", *SMALL, *TRUTH, "--steps", "3"),
        *("--output", "{out}/params.toml"),
    ),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a small scene, and a cache that holds its compiled programs."""
    folder = tmp_path_factory.mktemp("interruptions")
    ball(folder / "ball.glb")
    return folder


def start(place: Path, name: str, out: str, *more: str) -> subprocess.Popen:
    names = {"scene": place / "ball.glb", "out": place / out}
    words = [word.format(**names) for word in COMMANDS[name]]
    if name == "fit":  # it keeps its state beside the recordings, in the cache
        (place / out).mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND_LINE, *words, *more],
        env={**os.environ, "ATAA_CACHE": str(place / "cache")},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
    )


def result(folder: Path) -> dict[str, bytes]:
    """Returns every file but the one that tells times."""
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file() and file.name != "timings.csv"
    }


def forget(place: Path) -> None:
    """Removes all that an earlier command left to go on from, but compiled programs."""
    for kept in ("exposure", "fit", "record", "reference"):
        shutil.rmtree(place / "cache" / kept, ignore_errors=True)


def undisturbed(place: Path, name: str) -> tuple[dict[str, bytes], float]:
    """Returns what a command writes, and how long it takes with all compiled."""
    seconds = 0.0
    for out in (f"{name}-first", f"{name}-calm"):
        forget(place)
        begin = time.monotonic()
        process = start(place, name, out)
        _, told = process.communicate()
        assert process.returncode == 0, told
        seconds = time.monotonic() - begin
    return result(place / f"{name}-calm"), seconds


def finished(place: Path, out: Path) -> dict[Path, int]:
    """Returns what no restart may do again: files of finished work, and their times.

    Whole files in the cache, and those of the steps that the journal names, by where
    they lie under `out` in the end.
    """
    kept = ("exposure", "record", "reference")
    found = {f: f for kind in kept for f in (place / "cache" / kind).rglob("*.npz")}
    growing = out / ".ataa-partial"
    journal = growing / files.JOURNAL / "entry.json"
    step = json.loads(journal.read_text())["step"] if journal.is_file() else None
    for file in growing.glob("*/*.*"):
        number = file.stem.removeprefix("step-")
        if step is not None and number.lstrip("-").isdigit() and int(number) <= step:
            found[out / file.relative_to(growing)] = file
    if not growing.is_dir():
        found |= {file: file for file in out.glob("*/*.*")}
    return {name: file.stat().st_mtime_ns for name, file in found.items()}


def killed(place: Path, name: str, kills: int, seed: int) -> int:
    """Kills a command at random moments; returns how often it was still alive."""
    expected, seconds = undisturbed(place, name)
    forget(place)
    draw = random.Random(seed)
    out = place / f"{name}-killed"
    met, before = 0, {}
    for _ in range(4 * kills):  # some end before they are killed
        if met == kills:
            break
        process = start(place, name, f"{name}-killed")
        time.sleep(draw.uniform(0.2, 1.0) * seconds)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        # All is done once the growing folder is gone, though the process may not be.
        ended = out.is_dir() and not (out / ".ataa-partial").is_dir()
        ended = ended or process.returncode == 0
        met += not ended
        before = untouched(before, finished(place, out))
        if ended:  # it was faster: the next one begins anew
            assert result(place / f"{name}-killed") == expected
            forget(place)
            before = {}
    process = start(place, name, f"{name}-killed")
    _, told = process.communicate()
    assert process.returncode == 0, told
    untouched(before, finished(place, out))
    assert result(place / f"{name}-killed") == expected
    return met


def untouched(before: dict[Path, int], after: dict[Path, int]) -> dict[Path, int]:
    """Holds that what was finished was not done again; returns what now is."""
    again = [file for file, at in before.items() if after.get(file, at) != at]
    assert not again
    return after


def test_a_command_that_is_killed_thrice_ends_in_the_same_bytes(place):
    assert killed(place, "compare", 3, seed=0) == 3


@pytest.mark.hard
@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_is_killed_often_ends_in_the_same_bytes(
    place, name, record_property
):
    kills = killed(place, name, 25, seed=1)
    record_property("commands killed", kills)
    assert kills == 25


def test_ctrl_c_ends_in_a_word_and_leaves_nothing(place):
    process = start(place, "run", "stopped", "--frames", "2000")
    while process.poll() is None and not list(place.glob("stopped/**/latest-*.npz")):
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=120.0)
    assert process.returncode == 130
    assert told.decode().splitlines()[-1] == "interrupted"
    assert not (place / "stopped").exists()


# ---- the journal


def test_a_step_without_its_entry_was_not_done(tmp_path):
    journal = Journal(tmp_path, "key")
    journal.commit(0, {"x": np.arange(3)}, ["a"])
    # Killed while step 1 was being noted: its arrays are there, its entry is not.
    (tmp_path / files.JOURNAL / "latest-1.npz").write_bytes(b"half")
    again = Journal(tmp_path, "key")
    assert (again.step, again.facts) == (0, ["a"])
    np.testing.assert_array_equal(
        again.latest({"x": np.zeros(3, np.int64)})["x"], np.arange(3)
    )


def test_another_job_finds_nothing_of_the_first(tmp_path):
    Journal(tmp_path, "key").commit(4, np.zeros(2), None)
    (tmp_path / "frame.png").write_bytes(b"x")
    assert Journal(tmp_path, "other").step is None
    assert not (tmp_path / "frame.png").exists()


def test_damaged_arrays_are_not_believed(tmp_path):
    journal = Journal(tmp_path, "key")
    journal.commit(2, np.zeros(2), None, {"image": np.ones(3)})
    np.testing.assert_array_equal(journal.kept(2)["image"], np.ones(3))
    for file in (tmp_path / files.JOURNAL).glob("*.npz"):
        file.write_bytes(file.read_bytes()[:-9])
    with pytest.raises(KeyError):
        journal.latest(np.zeros(2))
    with pytest.raises(KeyError):
        journal.kept(2)


def test_what_a_full_disk_did_not_take_is_not_made_up_of_an_older_step(
    tmp_path, monkeypatch
):
    journal = Journal(tmp_path, "key")
    for step in range(2):
        journal.commit(step, np.full(2, step), None)
    monkeypatch.setattr(cache, "write", lambda *_: None)  # as it does then
    journal.commit(2, np.full(2, 2), None)
    with pytest.raises(KeyError):
        journal.latest(np.zeros(2, np.int64))


def test_two_processes_do_not_write_into_one_folder(tmp_path):
    with (
        files.output_folder(tmp_path / "out"),
        pytest.raises(InputError, match="another process"),
        files.output_folder(tmp_path / "out"),
    ):
        pass


def test_a_folder_killed_while_it_was_published_is_known_again(tmp_path, monkeypatch):
    out = tmp_path / "out"
    moved = []
    replace = Path.replace

    def stop_at_the_second(self, target):
        if Path(target).suffix == ".txt" and Path(target).name != files.MANIFEST:
            moved.append(target)
            if len(moved) == 2:
                raise KeyboardInterrupt
        return replace(self, target)

    def write(names):
        with files.output_folder(out) as folder:
            for name in names:
                (folder / name).write_text("x")

    monkeypatch.setattr(Path, "replace", stop_at_the_second)
    with pytest.raises(KeyboardInterrupt):
        write(["a.txt", "b.txt"])
    monkeypatch.undo()
    assert (out / "a.txt").exists()
    write(["c.txt"])
    assert sorted(file.name for file in out.iterdir()) == [files.MANIFEST, "c.txt"]
