"""Captures that are damaged or mean harm: one line, exit code 2, bounded memory."""

import itertools
import struct
from pathlib import Path

import numpy as np
import pytest

from ataa_jax import capture, cli
from ataa_jax.capture import exr, fields
from ataa_jax.errors import InputError

SIZE = (18, 32)


def good(folder: Path, frames: int = 2) -> Path:
    """Writes a small capture of noise: nothing in it can be believed, all be read."""
    random = np.random.default_rng(0)
    lines = ["[capture]", f"size = [{SIZE[1]}, {SIZE[0]}]"]
    for k in range(frames):
        planes = {
            name: random.random(SIZE, np.float32)
            for name in ("R", "G", "B", "depth.Z", "motion.X", "motion.Y")
        }
        exr.write(folder / f"{k:04d}.exr", planes)
        lines += ["[[frame]]", f'file = "{k:04d}.exr"', "jitter = [0.25, 0.0]"]
    (folder / "capture.toml").write_text("\n".join(lines))
    return folder


def refused(folder: Path, capsys) -> str:
    """Returns the one line with which every command refuses a capture."""
    line = ""
    for arguments in (["check"], ["run", "--method", "taa", "--out", f"{folder}-out"]):
        assert cli.main([arguments[0], str(folder), *arguments[1:]]) == 2
        captured = capsys.readouterr()
        line = captured.err or captured.out
        if arguments[0] == "run":
            assert captured.err.count("\n") == 1
        assert "Traceback" not in captured.err + captured.out
    assert not Path(f"{folder}-out").exists()
    return line


def attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
    return name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value


def header(
    width: int = 4,
    height: int = 4,
    channels: tuple[bytes, ...] = (b"B", b"G", b"R"),
    flags: int = 2,
    *,
    step: int = 1,
    pixel: int = 2,
    skip: bytes = b"",
) -> bytes:
    listed = b"".join(
        name + b"\0" + struct.pack("<iB3x2i", pixel, 0, step, step) for name in channels
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    parts = {
        b"channels": (b"chlist", listed + b"\0"),
        b"compression": (b"compression", b"\x03"),
        b"dataWindow": (b"box2i", window),
        b"displayWindow": (b"box2i", window),
        b"lineOrder": (b"lineOrder", b"\0"),
        b"pixelAspectRatio": (b"float", struct.pack("<f", 1.0)),
        b"screenWindowCenter": (b"v2f", bytes(8)),
        b"screenWindowWidth": (b"float", struct.pack("<f", 1.0)),
    }
    body = b"".join(
        attribute(name, kind, value)
        for name, (kind, value) in parts.items()
        if name != skip
    )
    return struct.pack("<ii", 20000630, flags) + body + b"\0"


HEADERS = {
    "empty": (b"", "cut off"),
    "text": (b"this is no image at all", "does not begin as one"),
    "a huge side": (header(1 << 30, 1 << 30), "1 to 16384 a side"),
    "negative": (header(-5, 7), "1 to 16384 a side"),
    "a bomb": (header(16384, 16000), "promises|at most"),
    "a thousand channels": (
        header(64, 64, tuple(b"c%d" % k for k in range(1000))),
        "1000 channels",
    ),
    "no channels": (header(channels=()), "no channel"),
    "no window": (header(skip=b"dataWindow"), "no 'dataWindow'"),
    "subsampled": (header(step=2), "subsampled"),
    "an unknown type": (header(pixel=9), "unknown type"),
    "deep": (header(flags=2 | 0x800), "deep"),
    "a name without an end": (
        struct.pack("<ii", 20000630, 2) + b"x" * 5000,
        "does not end",
    ),
    "a long attribute": (
        struct.pack("<ii", 20000630, 2) + b"a\0b\0" + struct.pack("<i", 1 << 30),
        "cut off or too long",
    ),
    "pixels missing": (header(SIZE[1], SIZE[0]), "damaged"),
}


@pytest.mark.parametrize("name", HEADERS)
def test_a_hostile_exr_is_one_line(tmp_path, capfd, name):
    data, message = HEADERS[name]
    folder = good(tmp_path / "capture")
    (folder / "0001.exr").write_bytes(data)
    line = refused(folder, capfd)
    assert any(word in line for word in message.split("|")), line
    assert "0001.exr" in line


def test_no_cut_of_a_file_crashes_or_is_believed(tmp_path):
    folder = good(tmp_path / "capture")
    data = (folder / "0000.exr").read_bytes()
    for end in itertools.chain(range(0, 700, 23), range(700, len(data) - 1, 997)):
        (folder / "cut.exr").write_bytes(data[:end])
        with pytest.raises(InputError):
            exr.read(folder / "cut.exr")


def test_changed_bytes_give_an_image_or_one_line(tmp_path):
    folder = good(tmp_path / "capture")
    data = bytearray((folder / "0000.exr").read_bytes())
    random = np.random.default_rng(1)
    for _ in range(200):
        changed = bytearray(data)
        for at in random.integers(0, 600, 3):
            changed[at] = random.integers(0, 256)
        (folder / "bent.exr").write_bytes(bytes(changed))
        try:
            held = exr.read(folder / "bent.exr")
        except InputError:
            continue
        assert all(plane.size <= exr.MAX_VALUES for plane in held.values())


@pytest.mark.parametrize(
    "name", ["../secret.exr", "/etc/passwd", "a/../../secret.exr", "link/secret.exr"]
)
def test_no_file_outside_the_folder_is_read(tmp_path, capsys, name):
    folder = good(tmp_path / "capture")
    (tmp_path / "secret.exr").write_bytes((folder / "0000.exr").read_bytes())
    (folder / "link").symlink_to(tmp_path)
    text = (folder / "capture.toml").read_text().replace("0000.exr", name)
    (folder / "capture.toml").write_text(text)
    assert "outside its folder" in refused(folder, capsys)


TOML = {
    "no text": (b"\xff\xfe\x00", "not valid TOML"),
    "no TOML": (b"[capture", "not valid TOML"),
    "no frames": (b"[capture]\nfps = 30\n", "no list 'frame'"),
    "frames a number": (b"frame = 3\n", "no list 'frame'"),
    "file a number": (b"[[frame]]\nfile = 3\n", "must be a text"),
    "a control character": (b'[[frame]]\nfile = "a\\u0000b"\n', "must be a text"),
    "jitter NaN": (
        b'[[frame]]\nfile = "0000.exr"\njitter = [nan, 0.0]\n',
        "must be a number",
    ),
    "jitter of three": (
        b'[[frame]]\nfile = "0000.exr"\njitter = [0, 0, 0]\n',
        "must be 2 numbers",
    ),
    "a huge number": (
        b'[[frame]]\nfile = "0000.exr"\nnear = 1' + b"0" * 400 + b"\n",
        "must be a number",
    ),
    "an unknown convention": (
        b'[conventions]\nmotion = "px"\n[[frame]]\nfile = "0000.exr"\n',
        "unknown key 'motion'",
    ),
    "an unknown unit": (
        b'[conventions]\nmotion_unit = "mm"\n[[frame]]\nfile = "0000.exr"\n',
        "motion_unit must be one of",
    ),
    "an unknown layout": (
        b'[capture]\nlayout = "exotic"\n[[frame]]\nfile = "0000.exr"\n',
        "unknown layout 'exotic'",
    ),
    "another size": (
        b'[capture]\nsize = [7, 7]\n[[frame]]\nfile = "0000.exr"\n',
        "size is 7×7",
    ),
    "too deep": (b"a = " + b"[" * 5000 + b"]" * 5000, "not valid TOML"),
}


@pytest.mark.parametrize("name", TOML)
def test_hostile_toml_is_one_line(tmp_path, capsys, name):
    data, message = TOML[name]
    folder = good(tmp_path / "capture")
    (folder / "capture.toml").write_bytes(data)
    assert message in refused(folder, capsys)


JSON = {
    "empty": (b"", "not valid JSON"),
    "a list": (b"[]", "no table"),
    "too deep": (b"[" * 200_000, "not valid JSON"),
    "a long number": (b'{"Version": ' + b"9" * 5000 + b"}", "not valid JSON"),
    "no Version": (b"{}", "Version must be a text"),
    "not UTF-8": (b'{"Version": "\xff"}', "not valid JSON"),
}


@pytest.mark.parametrize("name", JSON)
def test_hostile_json_is_one_line(tmp_path, capsys, name):
    data, message = JSON[name]
    folder = tmp_path / "set"
    folder.mkdir()
    (folder / "0000.json").write_bytes(data)
    assert message in refused(folder, capsys)


def test_a_large_metadata_file_is_not_read_to_its_end(tmp_path, monkeypatch):
    monkeypatch.setattr(fields, "MAX_BYTES", 1000)
    folder = good(tmp_path / "capture")
    (folder / "capture.toml").write_bytes(b"#" * 2000)
    with pytest.raises(InputError, match="larger than"):
        capture.load(folder)


def test_a_folder_that_is_no_capture_is_refused(tmp_path, capsys):
    folder = tmp_path / "empty"
    folder.mkdir()
    assert "or a capture" in refused(folder, capsys)


def test_camera_and_motion_are_refused_for_a_capture(tmp_path, capsys):
    folder = good(tmp_path / "capture")
    for option in ("--camera", "--motion"):
        arguments = ["run", str(folder), option, "pan", "--out", f"{folder}-out"]
        assert cli.main(arguments) == 2
        assert "has its own camera" in capsys.readouterr().err
