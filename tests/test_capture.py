"""Captured frames: what was written is read, and antialiased as if it were rendered."""

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from ataa_jax import capture, cli, methods, pipeline, world
from ataa_jax.capture import exr
from tests import captures


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("capture") / "built-in"
    meta, frames = captures.rendered()
    capture.write(place, meta, frames)
    return place


def ataa(*arguments: object) -> int:
    return cli.main([str(argument) for argument in arguments])


def test_what_was_written_is_read(folder):
    meta, frames = captures.rendered()
    read = capture.load(folder)
    assert read.size == meta.size
    assert read.sample_counts == (2, 4, 8)
    for index, held in enumerate(frames):
        for kind, image in held.items():
            stored = read.pixels(index, kind)
            assert stored is not None
            expected = image if image.ndim == 3 else image[..., None]
            assert np.array_equal(stored, expected.astype(np.float32))
        assert read.frames[index].jitter == meta.frames[index].jitter


def test_a_capture_gives_the_renderers_own_frames(folder):
    # Same colours, G-buffer and jitter, and the same pixels traced by the same samples,
    # at mip level 0 as the paper's: TAA must be equal bit by bit; ATAA differs where
    # rays and supersampling round.
    shot = world.shot(captures.built_in(), "walk", captures.SIZE, motion=0.03)
    read = capture.load(folder)
    for name, tolerance in (("taa", 0.0), ("ataa8_paper", 2e-3)):
        options = methods.Options(frames=captures.FRAMES, lead_in=0)
        ours = methods.runner(name, shot, options)
        theirs = methods.runner(name, read, options)
        drawn, captured = methods.Drawer(shot), methods.Drawer(read)
        for frame in range(captures.FRAMES):
            drawn.start(frame)
            captured.start(frame)
            a, b = ours.run(frame, drawn), theirs.run(frame, captured)
            assert np.abs(a - b).max() <= tolerance
            assert ours.shares == theirs.shares
            if ours.method is not None and theirs.method is not None:
                assert np.array_equal(ours.method, theirs.method)


def test_run_writes_frames_and_masks_in_the_captures_layout(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert ataa("run", folder, "--method", "ataa8", "--out", out) == 0
    assert "no ray was traced" in capsys.readouterr().out
    assert "8-sample images" in (out / "notes.txt").read_text()
    file = out / "antialiased/0003.exr"
    held = exr.read(file)
    assert set(held) == {"R", "G", "B", "mask.method", "mask.hold", "mask.why"}
    assert set(np.unique(held["mask.method"])) <= {0, 1, 2}
    with OpenEXR.File(str(file)) as image:
        assert "no ray was traced" in image.header()["ataa.rays"]
    with Image.open(out / "mask/0003.png") as picture:
        assert picture.size == (captures.SIZE[1], captures.SIZE[0])


def test_compare_scores_a_capture_against_its_reference(folder, tmp_path, capsys):
    out = tmp_path / "out"
    words = ("--method", "none,taa,ataa8,ssaa8", "--jobs", "2", "--out", out)
    assert ataa("compare", folder, *words) == 0
    assert "no worker was needed" in capsys.readouterr().out
    table = (out / "scores.csv").read_text()
    assert "ataa8" in table
    assert "no ray was traced" in (out / "index.html").read_text()


def test_without_samples_the_reference_stands_in_and_says_so(folder):
    read = capture.load(folder)
    kind, sentence = read.stand_in(8)
    assert kind == "samples8"
    bare = capture.Capture(**{**vars(read), "sample_counts": (), "notes": []})
    kind, sentence = bare.stand_in(8)
    assert kind == "reference"
    assert "upper bound" in sentence


def test_the_reference_does_not_stand_in_beside_sample_images(folder):
    read = capture.load(folder)
    few = capture.Capture(**{**vars(read), "sample_counts": (8,)})
    named = set(methods.captured_methods(few))
    assert {"taa", "ataa8", "ataa8_ue4", "ssaa8"} <= named
    assert not {"ataa2", "ataa4", "ssaa2", "ssaa16"} & named
    none = capture.Capture(**{**vars(read), "sample_counts": ()})
    assert {"ataa2", "ataa4", "ataa8"} <= set(methods.captured_methods(none))


def test_antialias_without_scene_or_stand_in_is_refused(folder):
    read = capture.load(folder)
    drawn, inputs = read.draw(0)
    config, params = pipeline.preset("tuned", None, read.size)
    with pytest.raises(ValueError, match="scene and its tracer"):
        pipeline.antialias(
            pipeline.init(read.size), drawn, inputs, params, config=config
        )
