"""A disk that takes no more, in the middle of a command: one sentence, nothing left."""

import contextlib
import os
import resource
import subprocess
from pathlib import Path

import numpy as np
import pytest

from ataa_jax import cli, files
from ataa_jax.errors import InputError
from tests.gltf_writer import ball

SMALL = ("--size", "48x32", "--frames", "3", "--lead-in", "2")
COMMANDS = {
    "run": ("run", *SMALL, "--exr"),
    "compare": (
        *("compare", *SMALL, "--reference-samples", "4"),
        *("--method", "none,taa,ataa8"),
    ),
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return ball(tmp_path_factory.mktemp("scene") / "ball.glb")


@contextlib.contextmanager
def disk(folder: Path, kilobytes: int):
    """A file system of its own; only the system's owner may make one."""
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "none", str(folder)],
        capture_output=True,
        check=False,
    )
    if made.returncode:
        pytest.skip("a small disk cannot be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@contextlib.contextmanager
def longest_file(bytes_: int):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def refused(words, capfd) -> str:
    """Runs a command that must end in one sentence; returns it."""
    code = cli.main(list(words))
    lines = capfd.readouterr().err.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    assert code == 2, lines
    assert len(errors) == 1, lines
    return errors[0]


@pytest.mark.parametrize("kilobytes", [4, 12, 32, 100])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_ends_in_a_sentence(name, kilobytes, scene, tmp_path, capfd):
    command, *options = COMMANDS[name]
    with disk(tmp_path / "disk", kilobytes) as small:
        words = (command, str(scene), *options, "--out", str(small / "out"))
        assert "No space left on device" in refused(words, capfd)
        assert list(small.iterdir()) == []


def test_a_disk_that_may_only_be_read_ends_in_a_sentence(scene, tmp_path, capfd):
    with disk(tmp_path / "disk", 100) as folder:
        subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
        words = ("run", str(scene), *SMALL, "--out", str(folder / "out"))
        assert "Read-only file system" in refused(words, capfd)


def test_a_file_in_the_place_of_a_folder_ends_in_a_sentence(scene, tmp_path, capfd):
    (tmp_path / "file").write_text("x")
    output = ("--output", str(tmp_path / "file" / "p.toml"))
    # The fit says so before it has fitted anything.
    told = refused(("fit", str(scene), *output), capfd)
    assert f"{tmp_path / 'file'} is a file" in told
    fitted = str(Path(__file__).parents[1] / "data" / "fitted.toml")
    assert "cannot be written" in refused(("export", fitted, *output), capfd)
    (tmp_path / "a.toml").mkdir()
    told = refused(("fit", str(scene), "--output", str(tmp_path / "a.toml")), capfd)
    assert "it is a folder" in told


def test_what_the_disk_held_before_stays(scene, tmp_path, capfd):
    command, *options = COMMANDS["run"]
    with disk(tmp_path / "disk", 1000) as small:
        words = (command, str(scene), *options, "--out", str(small / "out"))
        assert cli.main(list(words)) == 0
        before = {f: f.read_bytes() for f in small.rglob("*") if f.is_file()}
        left = os.statvfs(small)
        (small / "fill").write_bytes(bytes(left.f_bavail * left.f_frsize - 8192))
        refused(words, capfd)
        (small / "fill").unlink()
        assert before == {f: f.read_bytes() for f in small.rglob("*") if f.is_file()}


def test_a_file_longer_than_allowed_ends_in_a_sentence(tmp_path):
    picture = np.random.default_rng(0).random((64, 64, 3), np.float32)
    for write in (
        lambda: files.write_exr(tmp_path / "a.exr", picture),
        lambda: files.write_bytes(tmp_path / "a.bin", picture.tobytes()),
    ):
        with longest_file(4096), pytest.raises(InputError, match="cannot be written"):
            write()
    assert list(tmp_path.iterdir()) == []
