"""References and records by several processes: the same bytes, whoever dies."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import psutil
import pytest

from ataa_jax import cache, cli, jobs, paths, reference, world
from ataa_jax.cli import fit_sources
from ataa_jax.errors import InputError
from ataa_jax.fit import recording
from ataa_jax.jobs import cluster, tasks
from tests.gltf_writer import ball
from tests.test_interruptions import COMMAND_LINE, result

WIDTH, HEIGHT, FRAMES, SAMPLES = 32, 18, 6, 2
SMALL = ("--size", f"{WIDTH}x{HEIGHT}", "--frames", str(FRAMES))
COMPARE = (*SMALL, "--lead-in", "0", "--method", "none")
TRUTH = ("--reference-samples", str(SAMPLES))
DEATHS = "ATAA_TEST_DEATHS"  # names a folder that counts them
ALL_THE_TIME = 99


def die(often: int) -> None:
    """Kills this process, unless that has been done often enough."""
    folder = Path(os.environ[DEATHS])
    met = len(list(folder.iterdir()))
    if met < often:
        (folder / str(met)).touch()
        os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class Deadly(jobs.References):
    """References whose fourth frame kills the first who renders it."""

    often: int = 1

    def render(self, shot, frame):
        if frame == 3:
            die(self.often)
        super().render(shot, frame)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    """A folder with a small scene."""
    folder = tmp_path_factory.mktemp("jobs")
    ball(folder / "ball.glb")
    return folder


@pytest.fixture(scope="module")
def serial(place) -> dict[str, bytes]:
    """What one process writes: its output and the references in its cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATAA_CACHE", str(place / "cache-serial"))
        return compared(place, "serial")


@pytest.fixture
def folder(place, tmp_path, monkeypatch) -> Path:
    """An empty cache, and where deaths are counted."""
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path / "cache"))
    (tmp_path / "deaths").mkdir()
    monkeypatch.setenv(DEATHS, str(tmp_path / "deaths"))
    return tmp_path


@pytest.fixture(scope="module")
def shot(place) -> world.Sequence:
    loaded = world.load(place / "ball.glb", size=(HEIGHT, WIDTH))
    return world.sequence(loaded, paths.load("walk"), (HEIGHT, WIDTH))


@pytest.fixture
def dask(folder):
    """Two Dask workers with a cache of their own."""
    import distributed

    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        dashboard_address=None,
        env={"ATAA_CACHE": str(folder / "far")},
    ) as found:
        yield found


def compared(place: Path, out: str, *more: str) -> dict[str, bytes]:
    scene = str(place / "ball.glb")
    words = ["compare", scene, *COMPARE, *TRUTH, "--out", str(place / out), *more]
    assert cli.main(words) == 0
    kept = result(cache.folder() / "reference")
    assert len(kept) == FRAMES
    return result(place / out) | kept


def deaths(folder: Path) -> int:
    return len(list((folder / "deaths").iterdir()))


def one_line(capsys) -> str:
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    return lines[0]


def references(place: Path, shot: world.Sequence, what: jobs.References) -> jobs.Task:
    return jobs.task(str(place / "ball.glb"), shot, what, range(FRAMES))


# ---- the same bytes


def test_a_process_that_is_killed_is_replaced_and_the_bytes_are_those_of_one_process(
    place, folder, serial, monkeypatch
):
    monkeypatch.setattr(jobs, "References", Deadly)
    assert compared(place, "local", "--jobs", "2") == serial
    assert deaths(folder) == 1


def test_dask_workers_one_of_them_killed_make_the_bytes_of_one_process(
    place, folder, serial, dask, monkeypatch
):
    monkeypatch.setattr(jobs, "References", Deadly)
    assert compared(place, "dask", "--scheduler", dask.scheduler_address) == serial
    sent = result(folder / "far" / "reference")
    assert len(sent) == FRAMES
    assert sent.items() <= serial.items()
    assert deaths(folder) == 1


def test_a_recording_finds_all_that_its_workers_rendered(place, folder, monkeypatch):
    planned = fit_sources.plan(
        (f"{place / 'ball.glb'}@pan",),
        fit_sources.Asked((HEIGHT, WIDTH), None, 2, 1, SAMPLES),
    )
    told = []
    with jobs.workers(2) as crew:
        monkeypatch.setattr(recording, "_render", None)  # here nothing is rendered
        ((made, _),) = fit_sources.record(planned, lambda *at: told.append(at), crew)
    assert made.truth.shape == (2, HEIGHT, WIDTH, 3)
    assert [done for _, done, _ in told] == [0, 1, 2, 3]


def test_references_are_written_as_compare_shows_them(place, folder, serial):
    out = folder / "references"
    scene = str(place / "ball.glb")
    words = ["reference", scene, *SMALL, "--samples", str(SAMPLES), "--exr"]
    assert cli.main([*words, "--out", str(out)]) == 0
    for index in range(FRAMES):
        name = f"{index:04d}"
        assert (out / f"frames/{name}.png").read_bytes() == serial[
            f"frames/reference/{name}.png"
        ]
        assert (out / f"exr/{name}.exr").is_file()


def test_what_the_cache_has_is_not_rendered_again(place, folder, shot):
    for frame in range(FRAMES):
        reference.reference(shot, frame, SAMPLES)
    told = []
    with jobs.workers(2) as crew:
        wanted = references(place, shot, Deadly(SAMPLES, often=ALL_THE_TIME))
        jobs.fill(crew, wanted, lambda *at: told.append(at))
    assert told == [(FRAMES, FRAMES)]


@pytest.mark.parametrize("frames", [0, 1, 5, 12, 97])
@pytest.mark.parametrize("count", [1, 3, 40])
def test_chunks_are_all_frames_in_order(place, folder, shot, frames, count):
    whole = jobs.task("builtin", shot, jobs.References(SAMPLES), range(frames))
    parts = jobs._chunks(whole, count)
    assert sum((part.frames for part in parts), ()) == whole.frames
    assert sum((part.names for part in parts), ()) == whole.names
    assert len(parts) >= min(frames, count)


# ---- what goes wrong


def test_frames_that_kill_every_process_end_in_a_sentence(place, folder, shot):
    wanted = references(place, shot, Deadly(SAMPLES, often=ALL_THE_TIME))
    with (
        pytest.raises(InputError, match=r"3 processes died over frame 3 .* signal 9"),
        jobs.workers(2) as crew,
    ):
        jobs.fill(crew, wanted)
    assert deaths(folder) == 3
    assert cache.folder().joinpath(wanted.names[0]).is_file()  # what was done stays


def test_ctrl_c_ends_all_processes_in_a_word(place, folder):
    words = ("reference", str(place / "ball.glb"), *SMALL[:2], "--samples", "64")
    process = subprocess.Popen(
        [sys.executable, "-c", COMMAND_LINE, *words, "--frames", "5000", "--jobs", "2"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    done = folder / "cache" / "reference"
    while process.poll() is None and not list(done.glob("*.npz")):
        time.sleep(0.05)
    children = psutil.Process(process.pid).children(recursive=True)
    assert len(children) >= 2
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, told = process.communicate(timeout=30.0)
    assert process.returncode == 130
    assert told.decode().splitlines() == ["interrupted"]
    assert psutil.wait_procs(children, timeout=5.0)[1] == []
    assert list(done.glob("*.npz"))
    assert not list(done.glob("*.part"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--jobs", "0"), "--jobs must be at least 1, not 0"),
        (("--jobs", "-2"), "--jobs must be at least 1, not -2"),
        (("--jobs", "2", "--scheduler", "tcp://x:1"), "leave out --jobs or"),
        (("--scheduler", "tcp://127.0.0.1:9"), "no Dask scheduler answers at"),
        (("--scheduler", "nowhere at all"), "no Dask scheduler answers at"),
    ],
)
@pytest.mark.parametrize("command", ["compare", "fit", "reference"])
def test_workers_that_cannot_be_had_are_refused_in_a_sentence(
    place, folder, words, told, command, monkeypatch, capsys
):
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    given = (command, str(place / "ball.glb"), *SMALL, *words)
    assert cli.main(list(given)) == 2
    assert told in one_line(capsys)


def test_dask_that_is_not_installed_is_told_with_the_remedy(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="pip install"), jobs.workers(1, "tcp://x:1"):
        pass


def test_a_scheduler_without_workers_is_told(folder, monkeypatch):
    import distributed

    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, dashboard_address=None
        ) as empty,
        pytest.raises(InputError, match="has no workers"),
        jobs.workers(1, empty.scheduler_address),
    ):
        pass


@pytest.mark.parametrize(
    ("field", "told"),
    [("code", "another version of ataa_jax"), ("processor", "is of another kind")],
)
def test_a_worker_that_would_compute_other_bits_refuses(
    place, folder, shot, field, told
):
    wanted = references(place, shot, jobs.References(SAMPLES))
    other = replace(wanted, view=replace(wanted.view, **{field: "another"}))
    with pytest.raises(InputError, match=told):
        tasks.perform(other)
    assert not result(cache.folder() / "reference")


def test_a_worker_whose_scene_is_another_refuses(place, folder, shot):
    ball(place / "other.glb", color=(10, 200, 10, 255))
    wanted = references(place, shot, jobs.References(SAMPLES))
    view = replace(wanted.view, scene=str(place / "other.glb"))
    with pytest.raises(InputError, match="holds another scene"):
        tasks.perform(replace(wanted, view=view))
    # The same surfaces, but seen from elsewhere.
    view = replace(wanted.view, path=paths.load("pan"))
    with pytest.raises(InputError, match="moves otherwise"):
        tasks.perform(replace(wanted, view=view, names=wanted.names[::-1]))
    assert not result(cache.folder() / "reference")


@pytest.mark.parametrize("name", ["../evil.npz", "/tmp/evil.npz", "reference/b.npz"])
def test_files_that_were_not_asked_for_are_not_written(place, folder, shot, name):
    wanted = references(place, shot, jobs.References(SAMPLES)).part(slice(1))
    for files in ({wanted.names[0]: b"x", name: b"y"}, {name: b"y"}):
        with pytest.raises(InputError, match="other files than were asked for"):
            tasks.receive(wanted, files)
    assert not list(cache.folder().parent.rglob("evil.npz"))
    assert not result(cache.folder() / "reference")


def test_a_worker_that_cannot_write_its_cache_says_so(place, folder, shot, monkeypatch):
    wanted = references(place, shot, jobs.References(SAMPLES)).part(slice(1))
    monkeypatch.setattr(cache, "write", lambda *_: None)  # as on a full disk
    with pytest.raises(OSError, match="nothing can be written"):
        tasks.perform(wanted)
