"""The cache folder and the programs in it."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ataa_jax import cache, programs
from ataa_jax.cli import main


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path))
    return tmp_path


def fill(place: Path) -> None:
    for kind in programs.KINDS:
        (place / kind).mkdir()
        (place / kind / "a.npz").write_bytes(bytes(1 << 20))
    (place / "mine.txt").write_text("not the package's")


def test_show_tells_what_is_kept(place, capsys):
    fill(place)
    assert main(["cache", "show"]) == 0
    told = capsys.readouterr().out
    assert str(place) in told.replace("\n", "")
    assert told.count("1.0 MB") == len(programs.KINDS)


def test_clear_removes_what_the_package_kept_and_nothing_else(place):
    fill(place)
    assert main(["cache", "clear"]) == 0
    assert [f.name for f in place.iterdir()] == ["mine.txt"]
    assert main(["cache", "clear"]) == 0  # an empty one, too


def test_the_oldest_files_go_until_the_rest_keeps_to_the_limit(place):
    for age, name in enumerate("dcba"):
        (place / name).write_bytes(bytes(100))
        os.utime(place / name, (1000 - age, 1000 - age))
    programs.prune(place, 250)
    assert sorted(f.name for f in place.iterdir()) == ["c", "d"]
    programs.prune(place / "missing", 0)


def test_what_this_process_wrote_stays_whatever_the_limit(place, monkeypatch):
    """A sequence that is larger than the limit would else find none of its frames."""
    for age, name in enumerate("dcba"):
        (place / name).write_bytes(bytes(100))
        os.utime(place / name, (1000 - age, 1000 - age))
    (place / "now").write_bytes(bytes(100))
    programs.prune(place, 0)
    assert [f.name for f in place.iterdir()] == ["now"]
    later = time.time() + 25 * 3600  # of a process that runs for weeks
    monkeypatch.setattr(time, "time", lambda: later)
    programs.prune(place, 0)
    assert list(place.iterdir()) == []


def test_parts_that_a_killed_process_left_count_and_go(place):
    part = place / "fit" / "tmp1.part"
    part.parent.mkdir()
    part.write_bytes(bytes(1000))
    os.utime(part, (1000, 1000))
    cache.write(place / "fit" / "a.npz", np.zeros(3), limit_bytes=600)
    assert [f.name for f in part.parent.iterdir()] == ["a.npz"]


def test_files_that_cannot_be_removed_stay_and_nothing_is_raised(place, monkeypatch):
    """Of another user, or of an image that is read-only."""
    (place / "a").write_bytes(bytes(100))
    os.utime(place / "a", (1000, 1000))

    def refuse(self, missing_ok=False):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "unlink", refuse)
    programs.prune(place, 50)
    assert (place / "a").is_file()


SCRIPT = """
from ataa_jax import programs
{before}
programs.keep()
import jax
print(jax.config.jax_compilation_cache_dir)
"""


@pytest.mark.parametrize("own", [None, "/somewhere/else"])
@pytest.mark.parametrize("before", ["", "import jax"])
def test_jax_keeps_programs_there_unless_told_otherwise(place, own, before):
    environment = {k: v for k, v in os.environ.items() if "JAX_COMPILATION" not in k}
    if own is not None:
        environment["JAX_COMPILATION_CACHE_DIR"] = own
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(before=before)],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    found = run.stdout.strip()
    assert found == own if own else found.startswith(str(place / "programs"))
