"""Fits on captured frames: what they read, what they say, what they refuse."""

import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ataa_jax import capture, cli, color, parameters, pipeline
from ataa_jax import fit as fits
from ataa_jax.capture import check
from ataa_jax.capture.conventions import Conventions
from ataa_jax.cli import fit_sources
from ataa_jax.errors import InputError

DATA = Path(__file__).parents[1] / "data" / "capture"
# As in `test_fit`, whose compiled programs these tests share.
SIZE, FRAMES, LEAD_IN = (24, 40), 2, 1
QUICK = ("--solver", "bfgs", "--steps", "0", "--frames", FRAMES, "--lead-in", LEAD_IN)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Writes a window of the small capture, in the plain layout."""
    read = capture.load(DATA)
    place = tmp_path_factory.mktemp("capture") / "window"
    window = np.s_[33 : 33 + SIZE[0], 60 : 60 + SIZE[1]]

    def images(frame: int) -> dict[str, np.ndarray]:
        drawn, _ = read.draw(frame)
        g = drawn.gbuffer
        held = {"color": drawn.color, "depth": g.depth, "motion": g.motion}
        held |= {"motion_valid": g.motion_valid, "samples8": read.samples(frame, 8)}
        held["reference"] = read.reference(frame)
        return {kind: np.asarray(image)[window] for kind, image in held.items()}

    meta = replace(
        read,
        size=SIZE,
        conventions=Conventions(),
        # A window's camera is not the whole image's.
        frames=tuple(replace(frame, pose=None) for frame in read.frames),
    )
    capture.write(place, meta, map(images, range(len(read.frames))))
    return place


@pytest.fixture(scope="module")
def checked(folder):
    report = check.check(capture.load(folder))
    check.refuse(report)
    return report.capture.after(LEAD_IN)


@pytest.fixture(scope="module")
def fitted(folder, tmp_path_factory):
    """Writes the file of a fit to the capture, held out from itself."""
    place = tmp_path_factory.mktemp("fit")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ATAA_CACHE", str(place / "cache"))
        words = ("--holdout", folder, *QUICK, "-o", place / "a.toml")
        assert ataa("fit", folder, *words) == 0
    return place / "a.toml"


def ataa(*arguments: object) -> int:
    return cli.main([str(argument) for argument in arguments])


def test_a_recording_holds_the_captures_own_images(checked):
    made = fits.record_capture(checked, frames=3)
    assert (made.lead_in, made.truth.shape) == (1, (3, *SIZE, 3))
    assert made.config.raytrace.samples == 8
    drawn, inputs = checked.draw(1)
    place = 2  # of frame 1, after one of the lead-in
    assert np.array_equal(made.frames.color[place], drawn.color)
    assert np.array_equal(made.frames.gbuffer.motion[place], drawn.gbuffer.motion)
    assert np.array_equal(made.frames.jitter[place], inputs.jitter)
    assert np.array_equal(made.frames.traced[place], checked.samples(1, 8))
    shown = color.display(checked.reference(1))
    assert np.array_equal(made.frames.truth[place], shown)
    assert list(made.frames.cut) == [True, False, False, False]


def test_without_sample_images_the_reference_is_traced_and_the_recording_says_so(
    checked,
):
    bare = replace(checked, sample_counts=())
    made = fits.record_capture(bare, frames=1)
    traced = color.display(made.frames.traced[-1])
    assert np.array_equal(traced, made.frames.truth[-1])
    assert made.captured is not None
    assert made.captured.traced == "reference"
    assert "upper bound" in made.captured.notes[-1]


def test_a_fit_to_a_capture_spends_the_budget_and_says_what_it_is_of(fitted):
    table = tomllib.loads(fitted.read_text())
    assert table["budget"] == pipeline.BUDGET
    (row,), (held,) = table["fit"]["scene"], table["fit"]["held_out"]
    assert row["capture"] == {
        "layout": "plain",
        "traced": "samples8",
        "reference_samples": 64,
        "frames": FRAMES,
        "lead_in": LEAD_IN,
    }
    assert len(row["content"]) == 40
    # Held out from itself: the same numbers, under a name of its own.
    assert held["scene"] == f"{row['scene']} (2)"
    assert {**held, "scene": row["scene"]} == row
    # 5 %: within it budgets count as equal.
    assert row["rays"] == pytest.approx(pipeline.BUDGET, rel=0.05)
    assert row["oracle"] >= row["fitted"] > row["taa"]
    assert "8-sample images" in table["fit"]["notes"][0]


def test_the_same_fit_to_a_capture_writes_the_same_bytes(
    folder, fitted, tmp_path, monkeypatch
):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path / "cache"))
    moved = tmp_path / folder.name
    shutil.copytree(folder, moved)
    file = tmp_path / "b.toml"
    assert ataa("fit", moved, "--holdout", moved, *QUICK, "-o", file) == 0
    assert file.read_bytes() == fitted.read_bytes()


def test_a_capture_is_run_by_the_file_of_a_fit_to_it(folder, fitted, tmp_path):
    out = tmp_path / "out"
    words = ("--params", fitted, "--frames", "2", "--out", out)
    assert ataa("run", folder, *words) == 0
    rows = (out / "statistics.csv").read_text().splitlines()
    assert len(rows) == 3
    assert float(parameters.read(fitted)["budget"]) == pipeline.BUDGET


def test_captures_of_one_fit_need_a_number_of_samples_in_common(checked):
    few, none = (replace(checked, sample_counts=c) for c in ((2, 4), ()))
    assert fits.rays_of([]) == fits.rays_of([checked, none]) == 8
    assert fits.rays_of([few, none]) == 4
    with pytest.raises(InputError, match="same number of samples") as found:
        fits.rays_of([checked, few])
    assert "2 and 4" in str(found.value)


def test_a_capture_fixes_the_size_and_rays_of_the_scenes_beside_it(folder):
    asked = fit_sources.Asked(
        size=None, motion="rapid", frames=12, lead_in=8, reference_samples=16
    )
    planned = fit_sources.plan(("builtin", str(folder), "builtin@pan"), asked)
    assert (planned.size, planned.samples) == (SIZE, 8)
    # Of six frames a third at most are not scored.
    assert planned.steps == 2 * (12 + 8) + 6
    alone = fit_sources.plan(("builtin",), asked)
    assert (alone.size, alone.captures) == ((180, 320), {})


def test_a_recording_refuses_frames_that_the_capture_does_not_have(checked):
    for frames in (0, 6):
        with pytest.raises(InputError, match="a fit scores 1 to 5 of them"):
            fits.record_capture(checked, frames=frames)


def test_a_terms_buffer_that_no_capture_has_is_refused(checked):
    made = fits.record_capture(checked, frames=1)
    with pytest.raises(InputError, match="leave 'normal' out"):
        fits.check([made], fits.Options(terms=("luminance", "normal")))


@pytest.mark.parametrize(
    ("given", "word"),
    [
        (["FOLDER@pan"], "leave out '@pan'"),
        (["FOLDER", "--motion", "rapid"], "leave out --motion"),
        (["FOLDER", "--camera", "pan"], "--camera"),
        (["FOLDER", "--reference-samples", "16"], "leave out --reference-samples"),
        (["FOLDER", "--size", "320x180"], "40x24 pixels where --size asks for 320x180"),
        (["builtin", "FOLDER", "--size", "32x18"], "leave out --size"),
        (["FOLDER", "--terms", "luminance,material"], "leave 'material' out"),
        (["FOLDER", "--budget", "9"], "at most 8 rays"),
        (["builtin", "--holdout", DATA.parent], "or a capture"),
    ],
)
def test_options_that_make_no_sense_on_a_capture_are_one_line(
    given, word, folder, tmp_path, capsys
):
    file = tmp_path / "p.toml"
    words = [str(each).replace("FOLDER", str(folder)) for each in given]
    assert ataa("fit", *words, "-o", file) == cli.BAD_INPUT
    told = capsys.readouterr().err
    assert word in told
    assert told.count("\n") == 1
    assert not file.exists()


def test_a_capture_that_contradicts_itself_or_has_no_reference_is_refused(
    folder, tmp_path, capsys
):
    read = capture.load(folder)
    kinds = ("color", "depth", "motion", "samples8", "reference")
    for name, without, words in (
        ("blind", "reference", "no reference to fit against"),
        ("shaken", "samples8", "jitter"),
    ):
        frames = read.frames
        if name == "shaken":
            frames = tuple(replace(frame, jitter=None) for frame in frames)
        images = [
            {kind: read.pixels(k, kind) for kind in kinds if kind != without}
            for k in range(len(frames))
        ]
        place = tmp_path / name
        capture.write(place, replace(read, frames=frames), images)
        assert ataa("fit", place, "-o", tmp_path / "p.toml") == cli.BAD_INPUT
        told = capsys.readouterr().err
        assert words in told
        assert told.count("\n") == 1
    assert not (tmp_path / "p.toml").exists()
