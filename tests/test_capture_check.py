"""A capture is checked before it is believed: each mistake is found by its name."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ataa_jax import capture, cli
from ataa_jax.capture import check
from tests.captures import FRAMES, SIZE, Draft, displayed, draft, tonemapped


def errors(draft: Draft, folder) -> list[check.Finding]:
    return check.check(capture.load(draft.write(folder))).errors


def mirrored(m: np.ndarray) -> np.ndarray:
    return m * np.array([1.0, -1.0], np.float32)


def flip_y(d: Draft) -> None:
    d.paint("motion", mirrored)


def swap_axes(d: Draft) -> None:
    d.paint("motion", lambda m: m[..., ::-1])


def turn_sign(d: Draft) -> None:
    d.paint("motion", lambda m: -m)


def ndc_for_uv(d: Draft) -> None:
    d.uv().paint("motion", lambda m: 2.0 * m)


def pixels_for_uv(d: Draft) -> None:
    d.declare(motion_unit="uv")


def half_resolution_pixels(d: Draft) -> None:
    d.paint("motion", lambda m: 0.5 * m)


def half_resolution_enlarged(d: Draft) -> None:
    d.paint("motion", lambda m: m[::2, ::2].repeat(2, axis=0).repeat(2, axis=1))


def jitter_in_motion(d: Draft) -> None:
    before = np.zeros(2)
    for held, frame in zip(d.images, d.meta.frames, strict=True):
        now = np.asarray(frame.jitter)
        held["motion"] = (held["motion"] + (now - before)).astype(np.float32)
        before = now


def motion_of_the_next_frame(d: Draft) -> None:
    motions = [held["motion"] for held in d.images]
    for held, motion in zip(d.images, [*motions[1:], motions[-1]], strict=True):
        held["motion"] = motion


def motion_of_the_frame_before(d: Draft) -> None:
    motions = [held["motion"] for held in d.images]
    for held, motion in zip(d.images, [motions[0], *motions[:-1]], strict=True):
        held["motion"] = motion


def reversed_depth(d: Draft) -> None:
    d.device(reverse=True).declare(depth="device")


def forward_for_reversed(d: Draft) -> None:
    d.device().declare(depth="device reversed")


def device_for_linear(d: Draft) -> None:
    d.device().declare(depth="linear")


def distance_for_linear(d: Draft) -> None:
    height, width = SIZE
    pose = d.meta.frames[0].pose
    assert pose is not None
    y, x = np.mgrid[:height, :width] + 0.5
    u = (2.0 * x / width - 1.0) * pose.tan_half[0]
    v = (2.0 * y / height - 1.0) * pose.tan_half[1]
    length = np.sqrt(1.0 + u * u + v * v).astype(np.float32)
    d.paint("depth", lambda z: z * length)


def infinite_far_plane(d: Draft) -> None:
    d.device(float("inf")).each(lambda f: replace(f, far=30.0))


def display_for_linear(d: Draft) -> None:
    d.paint("color", displayed).paint("reference", displayed)


def tonemapped_for_linear(d: Draft) -> None:
    d.paint("color", tonemapped).paint("reference", tonemapped)


def tonemapped_reference(d: Draft) -> None:
    d.paint("reference", tonemapped)


def jitter_not_recorded(d: Draft) -> None:
    d.each(lambda f: replace(f, jitter=None))


def jitter_not_rendered(d: Draft) -> None:
    for held in d.images:
        held["color"] = held["center"]


def jitter_turned(d: Draft) -> None:
    d.each(lambda f: replace(f, jitter=(-f.jitter[0], -f.jitter[1])))  # type: ignore[index]


def jitter_y_up(d: Draft) -> None:
    d.each(lambda f: replace(f, jitter=(f.jitter[0], -f.jitter[1])))  # type: ignore[index]


def dropped_and_renumbered(d: Draft) -> None:
    del d.images[3]
    frames = (*d.meta.frames[:3], *d.meta.frames[4:])
    frames = tuple(replace(f, number=k) for k, f in enumerate(frames))
    d.meta = replace(d.meta, frames=frames)


def dropped(d: Draft) -> None:
    del d.images[3]
    d.meta = replace(d.meta, frames=(*d.meta.frames[:3], *d.meta.frames[4:]))


def frozen(d: Draft) -> None:
    d.images[4]["color"] = d.images[3]["color"]


def smaller_frame(d: Draft) -> None:
    d.images[2] = {kind: image[:-2] for kind, image in d.images[2].items()}


# By camera and images; in each the only change is the mistake.
MISTAKES: list[tuple[Callable[[Draft], None], str]] = [
    (flip_y, "flipped y"),
    (swap_axes, "swapped axes"),
    (turn_sign, "motion sign"),
    (ndc_for_uv, "motion unit"),
    (pixels_for_uv, "motion unit"),
    (half_resolution_pixels, "half-resolution motion"),
    (half_resolution_enlarged, "half-resolution motion"),
    (jitter_in_motion, "jitter in motion"),
    (motion_of_the_next_frame, "off by one frame"),
    (motion_of_the_frame_before, "off by one frame"),
    (reversed_depth, "reversed depth"),
    (forward_for_reversed, "reversed depth"),
    (device_for_linear, "non-linear depth"),
    (distance_for_linear, "non-linear depth"),
    (infinite_far_plane, "infinite far plane"),
    (display_for_linear, "encoded colour"),
    (tonemapped_for_linear, "encoded colour"),
    (tonemapped_reference, "encoded reference"),
    (jitter_not_recorded, "missing jitter"),
    (jitter_not_rendered, "missing jitter"),
    (jitter_turned, "jitter sign"),
    (jitter_y_up, "jitter sign"),
    (dropped, "dropped frame"),
    (dropped_and_renumbered, "dropped frame"),
    (frozen, "frozen frame"),
    (smaller_frame, "resolution change"),
]
# What the images alone can tell.
BLIND = [flip_y, swap_axes, turn_sign, ndc_for_uv, pixels_for_uv, jitter_in_motion]


def label(value: object) -> str:
    return getattr(value, "__name__", "").replace("_", "-") or str(value)


@pytest.mark.parametrize(("mistake", "name"), MISTAKES, ids=label)
def test_a_mistake_is_found_by_its_name_and_nothing_else(tmp_path, mistake, name):
    made = draft()
    mistake(made)
    found = errors(made, tmp_path / "capture")
    assert {finding.name for finding in found} == {name}
    assert all(any(c.isdigit() for c in f.evidence) or f.name == "missing jitter"
               or f.name == "frozen frame" for f in found)  # fmt: skip
    assert all(finding.remedy for finding in found)


@pytest.mark.parametrize("mistake", BLIND, ids=label)
def test_without_a_camera_the_images_tell(tmp_path, mistake):
    name = dict(MISTAKES)[mistake]
    made = draft()
    mistake(made)
    found = errors(made.blind(), tmp_path / "capture")
    assert {finding.name for finding in found} == {name}


CORRECT: dict[str, Callable[[Draft], object]] = {
    "as rendered": lambda d: d,
    "uv": lambda d: d.uv(),
    "current − previous, y up": lambda d: d.paint(
        "motion", lambda m: -mirrored(m)
    ).declare(motion_sign="current - previous", motion_y="up"),
    "device depth": lambda d: d.device(),
    "reversed depth, infinite": lambda d: d.device(float("inf"), reverse=True),
    "no camera": lambda d: d.blind(),
    "no reference": lambda d: d.without("reference"),
    "no camera, no reference": lambda d: d.blind().without("reference"),
    "display, and says so": lambda d: (
        d.paint("color", displayed)
        .paint("reference", displayed)
        .declare(color="display")
    ),
    "jitter in motion, and says so": lambda d: (
        jitter_in_motion(d),
        d.declare(motion_jittered=True),
    ),
    "dim": lambda d: d.paint("color", lambda c: 0.05 * c).paint(
        "reference", lambda c: 0.05 * c
    ),
}


@pytest.mark.parametrize("name", CORRECT)
def test_a_correct_capture_has_no_errors_and_no_warnings(tmp_path, name):
    made = draft()
    CORRECT[name](made)
    report = check.check(capture.load(made.write(tmp_path / "capture")))
    assert [f.sentence for f in report.findings if f.severity != check.NOTE] == []


def test_nan_pixels_are_counted(tmp_path):
    made = draft()
    made.images[2]["color"] = made.images[2]["color"].copy()
    made.images[2]["color"][3, 4:7] = np.nan
    report = check.check(capture.load(made.write(tmp_path / "capture")))
    (found,) = [f for f in report.findings if f.name == "NaN or inf pixels"]
    assert "3 pixels of color" in found.evidence
    assert found.where == "frame 2"
    assert report.errors == []


def test_a_camera_that_only_stands_confirms_no_depth(tmp_path):
    made = draft().paint("motion", np.zeros_like)
    first = made.meta.frames[0].pose
    made.each(lambda f: replace(f, pose=first))
    report = check.check(capture.load(made.write(tmp_path / "capture")))
    assert "not confirmed" in dict(report.facts)["depth"]
    moving = check.check(capture.load(draft().write(tmp_path / "moving")))
    assert "depth" not in dict(moving.facts)


def test_frames_that_are_mostly_new_are_warned_of_unless_they_are_cuts(tmp_path):
    made = draft().blind()
    made.images[3]["motion"] = made.images[3]["motion"] + np.float32(500.0)
    report = check.check(capture.load(made.write(tmp_path / "told not")))
    (found,) = [f for f in report.findings if f.name == "mostly new"]
    assert (found.severity, found.where) == (check.WARNING, "frame 3")
    assert found.evidence.startswith("100% of the pixels")
    made.each(lambda f: replace(f, cut=f.number in (0, 3)))
    report = check.check(capture.load(made.write(tmp_path / "told")))
    assert report.findings == []


def test_a_contradiction_stops_run_and_names_both_readings(tmp_path, capsys):
    made = draft()
    turn_sign(made)
    folder = made.write(tmp_path / "capture")
    out = tmp_path / "out"
    assert cli.main(["run", str(folder), "--method", "taa", "--out", str(out)]) == 2
    line = capsys.readouterr().err
    assert "'previous - current'" in line
    assert "'current - previous'" in line
    assert line.count("\n") == 1
    assert not out.exists()


def test_check_prints_a_report(tmp_path, capsys):
    folder = draft().write(tmp_path / "good")
    assert cli.main(["check", str(folder)]) == 0
    out = capsys.readouterr().out
    assert f"{FRAMES} frames" in out
    assert "no contradiction" in out
    made = draft()
    flip_y(made)
    folder = made.write(tmp_path / "bad")
    assert cli.main(["check", str(folder)]) == 2
    captured = capsys.readouterr()
    assert "flipped y" in captured.out
    assert "motion_y" in captured.out
