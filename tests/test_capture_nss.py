"""Arm's NSS data set layout, written here by its specification and by nothing else."""

import json
import math
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from ataa_jax import capture, cli
from ataa_jax.capture import check
from tests import captures

NEAR = 0.25


def exr(file: Path, **channels: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    with OpenEXR.File(header, planes) as image:
        image.write(str(file))


def view_projection(frame, far: float, *, rows: bool) -> list[float]:
    """A left-handed engine's matrix, depth from 0 to 1, column by column.

    rows: it multiplies row vectors, as Direct3D's does; else columns.
    """
    pose = frame.pose
    right, up, back = pose.world_from_view[:3, :3].T
    eye = pose.world_from_view[:3, 3]
    view = np.array(
        [
            [*right, -right @ eye],
            [*up, -up @ eye],
            [*-back, back @ eye],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    a = 1.0 if math.isinf(far) else far / (far - NEAR)
    projection = np.array(
        [
            [1.0 / pose.tan_half[0], 0.0, 0.0, 0.0],
            [0.0, 1.0 / pose.tan_half[1], 0.0, 0.0],
            [0.0, 0.0, a, -a * NEAR],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    matrix = projection @ view  # of column vectors
    stored = matrix.T if rows else matrix
    return [float(x) for x in stored.ravel(order="F")]


def write(
    folder: Path,
    *,
    sign: float = -1.0,  # −1: current − previous
    flip: float = 1.0,  # −1: v upward, and so the jitter
    far: float = math.inf,
    reverse: bool = False,
    rows: bool = True,
    ratio: int = 1,
    cut: int | None = None,
) -> Path:
    """Writes sequence 0000; the specification's words are in the comments."""
    meta, frames = captures.rendered()
    height, width = meta.size
    entries = []
    for number, (frame, held) in enumerate(zip(meta.frames, frames, strict=True)):
        name = f"0000/{number:04d}.exr"
        half = {
            c: held["color"][..., k].astype(np.float16) for k, c in enumerate("RGB")
        }
        # color: R16G16B16A16_SFLOAT, jittered, linear HDR.
        ones = np.ones(meta.size, np.float16)
        exr(folder / f"x{ratio}/color" / name, **half, A=ones)
        # ground_truth: R16G16B16A16_SFLOAT, 16 samples averaged under the tone map.
        truth = held["reference"].astype(np.float16)
        truth = truth.repeat(ratio, axis=0).repeat(ratio, axis=1)
        big = np.ones(truth.shape[:2], np.float16)
        planes = {c: truth[..., k] for k, c in enumerate("RGB")}
        exr(folder / "ground_truth" / name, **planes, A=big)
        # depth: R32_SFLOAT, jittered, forward-Z unless ReverseZ.
        z = held["depth"].astype(np.float64)
        a = 1.0 if math.isinf(far) else far / (far - NEAR)
        d = np.where(np.isinf(z), 1.0, np.minimum(a * (1.0 - NEAR / z), 1.0))
        d = (1.0 - d if reverse else d).astype(np.float32)
        exr(folder / f"x{ratio}/depth" / name, R=d)
        # motion: R16G16_SFLOAT, non-jittered, in UV space; the sign is not stated.
        uv = held["motion"] * sign * np.array([1.0, flip]) / (width, height)
        uv = uv.astype(np.float16)
        exr(folder / f"x{ratio}/motion" / name, R=uv[..., 0], G=uv[..., 1])
        exr(folder / "motion_gt" / name, R=uv[..., 0], G=uv[..., 1])
        assert frame.jitter is not None
        assert frame.pose is not None
        x, y = frame.jitter[0], flip * frame.jitter[1]
        entry = {
            "Frame": number,
            "FovX": 2.0 * math.atan(frame.pose.tan_half[0]),
            "FovY": 2.0 * math.atan(frame.pose.tan_half[1]),
            "CameraNearPlane": NEAR,
            "CameraFarPlane": -1.0 if math.isinf(far) else far,
            "ViewProjection": view_projection(frame, far, rows=rows),
            "Jitter": {"X": x, "Y": y},
            "NormalizedPerRatioJitter": [{"X": x / width, "Y": y / height}],
            "Exposure": 1.0,
        }
        if cut is not None:
            entry["CameraCut"] = number in (0, cut)
        entries.append(entry)
    table = {
        "Version": "1.0.1",
        "EmulatedFramerate": 60,
        "TargetResolution": {"X": ratio * width, "Y": ratio * height},
        "Samples": {"Sequence": "Halton", "Count": 16, "Quantized": False},
        "ReverseZ": reverse,
        "UpscalingRatiosIndices": {f"x{ratio}_index": 0},
        "Frames": entries,
    }
    (folder / "0000.json").write_text(json.dumps(table))
    return folder


OPTIONS: list[dict] = [
    {},
    {"sign": 1.0, "rows": False, "far": 500.0},
    {"flip": -1.0, "reverse": True},
    {"sign": 1.0, "flip": -1.0, "ratio": 2, "far": 400.0, "reverse": True},
]


@pytest.mark.parametrize("options", OPTIONS, ids=str)
def test_a_data_set_by_the_specification_is_read(tmp_path, options):
    report = check.check(capture.load(write(tmp_path / "set", **options)))
    assert [f.sentence for f in report.findings if f.severity != check.NOTE] == []
    read = report.capture
    meta, frames = captures.rendered()
    for index, held in enumerate(frames):
        drawn, inputs = read.draw(index)
        # Half floats: 2⁻¹¹ of the value, or 2⁻²⁵ near 0.
        assert np.allclose(drawn.color, held["color"], rtol=5e-4, atol=6e-8)
        truth = read.reference(index)
        assert truth is not None
        assert np.allclose(truth, held["reference"], rtol=1e-3, atol=1e-6)
        moving = held["motion_valid"]
        # Motions beyond the image, clipped or not, are invalid alike.
        limit = 5e-4 * np.abs(held["motion"]) + 1e-4
        error = np.abs(np.asarray(drawn.gbuffer.motion) - held["motion"])
        assert (error <= limit)[moving].all()
        # 1/z is what device depth resolves: float32's step near 1, over the near plane.
        assert np.allclose(
            1.0 / np.asarray(drawn.gbuffer.depth),
            1.0 / held["depth"],
            rtol=1e-5,
            atol=5e-7,
        )
        assert np.allclose(inputs.jitter, meta.frames[index].jitter, atol=1e-7)


def test_the_camera_is_read_out_of_either_matrix(tmp_path):
    meta, _ = captures.rendered()
    for rows in (True, False):
        read = capture.load(write(tmp_path / str(rows), rows=rows))
        for found, frame in zip(read.frames, meta.frames, strict=True):
            assert found.pose is not None
            assert frame.pose is not None
            # Left-handed axes span the same camera; sixteen single floats in JSON.
            assert np.allclose(
                found.pose.world_from_view, frame.pose.world_from_view, atol=1e-5
            )


def test_an_unflagged_infinite_far_plane_is_named(tmp_path):
    folder = write(tmp_path / "set")
    table = json.loads((folder / "0000.json").read_text())
    for entry in table["Frames"]:
        entry["CameraFarPlane"] = 1000.0
    (folder / "0000.json").write_text(json.dumps(table))
    found = check.check(capture.load(folder)).errors
    assert [finding.name for finding in found] == ["infinite far plane"]
    assert "CameraFarPlane is 1000" in found[0].evidence


def test_a_wrong_reverse_z_is_named(tmp_path):
    folder = write(tmp_path / "set", reverse=True)
    text = (folder / "0000.json").read_text()
    (folder / "0000.json").write_text(text.replace('Z": true', 'Z": false'))
    found = check.check(capture.load(folder)).errors
    assert [finding.name for finding in found] == ["reversed depth"]


def test_a_camera_cut_resets_the_history(tmp_path, capsys):
    folder = write(tmp_path / "set", cut=3)
    out = tmp_path / "out"
    arguments = ["run", str(folder), "--method", "ataa8", "--out", str(out)]
    assert cli.main(arguments) == 0
    assert "reference itself" in capsys.readouterr().out
    rows = (out / "statistics.csv").read_text().splitlines()[1:]
    new = [float(row.split(",")[1]) == 1.0 for row in rows]
    assert new == [True, False, False, True, False, False]
    assert (out / "x1/antialiased/0000/0003.exr").is_file()


def test_ratios_that_are_not_whole_are_refused_with_a_word(tmp_path):
    folder = write(tmp_path / "set")
    (folder / "x1").rename(folder / "x1_5")
    with pytest.raises(ValueError, match="x1_5"):
        capture.load(folder)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("Version", None, "Version"),
        ("ReverseZ", "no", "true or false"),
        ("TargetResolution", {"X": 96}, "Y must be"),
        ("TargetResolution", {"X": 1 << 40, "Y": 9}, "X must be"),
        ("Frames", [], "no list 'Frames'"),
        ("Frames", 3, "no list 'Frames'"),
        ("Frames", [7], "no table"),
        ("Samples", {}, "Count"),
    ],
)
def test_metadata_that_is_not_the_specifications_is_refused(
    tmp_path, capsys, name, value, message
):
    folder = write(tmp_path / "set")
    table = json.loads((folder / "0000.json").read_text())
    table[name] = value
    (folder / "0000.json").write_text(json.dumps(table))
    assert cli.main(["check", str(folder)]) == 2
    line = capsys.readouterr().err
    assert message in line
    assert line.count("\n") == 1


def test_full_hd_frames_are_read_within_a_second_each(tmp_path):
    size = (1080, 1920)
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float32)
    noise = np.random.default_rng(0).random(size, np.float32)
    image = (0.5 + 0.5 * np.sin(0.02 * x + 0.01 * y) + 0.1 * noise).astype(np.float16)
    folder = tmp_path / "set"
    frames = 3  # of ten: the time a frame is the same
    for number in range(frames):
        name = f"0000/{number:04d}.exr"
        planes = {"R": image, "G": image, "B": image, "A": image}
        exr(folder / "x1/color" / name, **planes)
        exr(folder / "ground_truth" / name, **planes)
        exr(folder / "x1/depth" / name, R=0.5 + 0.4 * noise)
        flow = (1e-3 * noise).astype(np.float16)
        exr(folder / "x1/motion" / name, R=flow, G=flow)
    small = write(tmp_path / "small")
    table = json.loads((small / "0000.json").read_text())
    table["TargetResolution"] = {"X": size[1], "Y": size[0]}
    table["Frames"] = table["Frames"][:frames]
    (folder / "0000.json").write_text(json.dumps(table))
    read = capture.load(folder)
    assert read.size == size
    read.draw(0)  # compiles nothing, but imports
    # Of the processor: other work on the machine slows no reader.
    start = time.process_time()
    for index in range(1, frames):
        read.draw(index)
        assert read.reference(index) is not None
    assert (time.process_time() - start) / (frames - 1) < 1.0
