"""Tables, strips, plots and files: what they show, and that their bytes never vary."""

import csv
import io
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from ataa_jax import (
    files,
    parameters,
    pipeline,
    raster,
    resolve,
    segmentation,
    taa,
    types,
)
from ataa_jax import fxaa as fxaa_stage
from ataa_jax import report as reports
from ataa_jax.compare import REFERENCE, Comparison
from ataa_jax.errors import InputError
from ataa_jax.report import crops, page, palette, plots, strips, tables
from tests.comparisons import comparison


@pytest.fixture(scope="module")
def result() -> Comparison:
    return comparison()


def tree(folder: Path) -> dict[str, bytes]:
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


# ---- tables


def test_table_has_one_row_a_method_in_the_tables_order(result):
    rows = tables.table(result)
    names = ["none", "fxaa", "taa", "ataa2", "ataa8", "ssaa4", "ssaa8", REFERENCE]
    assert [row[0] for row in rows] == names
    assert all(len(row) == len(tables.HEADER) for row in rows)


def test_a_mean_is_the_mean_over_frames_without_the_undefined(result):
    (row,) = [row for row in tables.table(result) if row[0] == "taa"]
    values = dict(zip(tables.HEADER, row, strict=True))
    own = [s for s in result.scores if s.method == "taa"]
    assert values["ssim"] == f"{np.mean([s.ssim for s in own]):.6f}"
    assert values["flicker"] == f"{own[1].flicker:.8f}"  # frame 0 has none
    # Both are rounded to six digits apart.
    assert abs(float(values["ssim"]) + float(values["one_minus_ssim"]) - 1) < 2e-6


def test_csv_holds_no_time(result, tmp_path):
    tables.write(result, tmp_path)
    for file in tmp_path.iterdir():
        header = file.read_text().splitlines()[0]
        assert "ms" not in header.split(",")
        assert "time" not in header


def test_timings_give_median_and_quartiles_by_hand(result, tmp_path):
    stage_ms = {"taa": {"raster": [1.0, 2.0, 3.0, 4.0, 100.0]}}
    tables.write_timings(stage_ms, 1 << 20, tmp_path / "t.csv")
    rows = list(csv.reader(io.StringIO((tmp_path / "t.csv").read_text())))
    assert rows[1] == ["taa", "raster", "3.000", "2.000", "4.000", "5", "ms"]
    assert rows[3][1:3] == ["peak memory", "1.0"]


def test_best_never_names_the_reference_and_keeps_the_ray_limit(result):
    ssim = tables.COLUMNS[0]
    assert tables.best(result, ssim, float("inf")) == {"ssaa8"}
    cheap = tables.best(result, ssim, 1.0)
    assert cheap
    assert not cheap & {"ssaa4", "ssaa8", REFERENCE}


def test_minus_zero_is_written_as_zero():
    assert files.decimals(-1e-9, 6) == "0.000000"
    assert files.decimals(-0.5, 1) == "-0.5"
    assert files.decimals(float("nan"), 3) == "nan"


# ---- pictures


def test_mask_overlay_is_red_blue_and_yellow_over_grey():
    image = np.full((1, 3, 3), (200, 100, 50), np.uint8)
    overlay = reports.mask_overlay(image, np.array([[0, 1, 2]], np.uint8)).astype(int)
    fxaa, taa_pixel, ataa = overlay[0]
    assert fxaa[0] > fxaa[1] + 80
    assert fxaa[0] > fxaa[2] + 80
    assert taa_pixel[2] > taa_pixel[0] + 30
    assert min(ataa[:2]) > ataa[2] + 80


def test_why_overlay_leaves_pixels_without_reason_grey():
    image = np.full((1, 2, 3), (200, 100, 50), np.uint8)
    overlay = reports.why_overlay(image, np.array([[0, 8]], np.uint8))
    assert len(set(overlay[0, 0].tolist())) == 1
    assert len(set(overlay[0, 1].tolist())) > 1


def test_the_page_names_a_reason_beyond_the_papers_only_where_it_is_seen():
    result = comparison()
    assert "objects" not in {r.name for r in page._reasons(result)}
    result.whys["ataa8"][0][0, 0] |= types.WHY_OBJECT
    assert "objects" in {r.name for r in page._reasons(result)}
    packed = page._map(result.masks["ataa8"][0], result.whys["ataa8"][0]).astype(int)
    np.testing.assert_array_equal(
        packed[..., 1] | packed[..., 2] << 8, result.whys["ataa8"][0]
    )


def test_why_overlay_colours_every_reason_by_itself():
    bits = np.array([[r.bits for r in palette.REASONS]], np.uint16)
    image = np.zeros((1, bits.size, 3), np.uint8)
    overlay = reports.why_overlay(image, bits)[0]
    for shown, reason in zip(overlay, palette.REASONS, strict=True):
        np.testing.assert_array_equal(
            shown, np.round(np.multiply(reason.color, reason.alpha))
        )


def test_crops_lie_apart_inside_the_image_at_the_greatest_error():
    result = comparison((90, 160), 1)
    truth = result.images[REFERENCE][0]
    image = truth.copy()
    image[40:44, 100:104] ^= 255
    result.images["taa"] = [image]
    chosen = crops.choose(result, 0, count=4, size=(18, 32))
    covered = np.zeros((90, 160), int)
    for crop in chosen:
        assert crop.of(covered).shape == (18, 32)
        crop.of(covered)[...] += 1
    assert covered.max() == 1
    assert covered[40:44, 100:104].all()
    assert [crop.name for crop in chosen] == list("ABCD"[: len(chosen)])


def test_crops_are_cut_to_a_tiny_image():
    (crop,) = crops.choose(comparison((5, 7), 1), 0)
    assert (crop.row, crop.column, crop.height, crop.width) == (0, 0, 5, 7)


@pytest.mark.parametrize("size", [(1, 1), (18, 32), (40, 30), (90, 160)])
def test_figures_are_drawn_at_any_size(size):
    result = comparison(size, 1)
    assert strips.strip(result).width > 0
    assert len(strips.hero(result)) <= strips.HERO_LIMIT_BYTES


def test_figures_are_drawn_without_any_adaptive_method():
    result = comparison((18, 32), 1)
    for name in ("ataa2", "ataa8", "taa"):
        result.images.pop(name)
        result.masks.pop(name, None)
        result.whys.pop(name, None)
    result.scores = [s for s in result.scores if s.method in result.images]
    assert strips.strip(result).width > 0
    assert len(strips.hero(result)) > 0
    assert "<html" in page.render(result)


def test_traced_cutout_is_dark_where_nothing_was_traced():
    image = np.full((90, 160, 3), 200, np.uint8)
    method = np.ones((90, 160), np.uint8)
    method[:, 150:] = 2
    out = strips.traced_cutout(image, method)
    assert (out[:, :60] == 200).all()
    assert (out[:, 100:150] < 40).all()
    assert (out[:, 150:] == 200).all()


# ---- bytes


def test_equal_input_gives_equal_bytes_except_times(tmp_path):
    for name in ("a", "b"):
        again = comparison((18, 32), 2)
        if name == "b":
            again.stage_ms["taa"] = {"raster": [7.0]}
            again.peak_memory_bytes = 1
        reports.write(again, tmp_path / name)
    first, second = tree(tmp_path / "a"), tree(tmp_path / "b")
    assert first.keys() == second.keys()
    different = {name for name in first if first[name] != second[name]}
    assert different == {"timings.csv"}


def test_report_has_every_frame_mask_and_reason(tmp_path, result):
    reports.write_frames(result, tmp_path)
    image = np.asarray(Image.open(tmp_path / "frames/taa/0001.png"))
    np.testing.assert_array_equal(image, result.images["taa"][1])
    assert (tmp_path / "mask/ataa8/0001.png").is_file()
    assert (tmp_path / "why/ataa2/0000.png").is_file()


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_plots_carry_no_date_and_no_program(result, suffix):
    data = plots.render(plots.ssim_over_frames, result, suffix)
    assert b"Matplotlib" not in data
    assert b"<dc:date>" not in data


# ---- page


def test_page_is_one_file_without_external_resources(result):
    text = page.render(result)
    for word in ("http://", "https://", 'src="//', "@import", "url("):
        found = text.replace("http://www.w3.org/2000/svg", "")
        assert word not in found, word


def test_page_escapes_what_the_scene_says(result):
    text = page.render(result)
    assert "<b>not</b> markup" not in text
    assert "&lt;b&gt;not&lt;/b&gt; markup" in text


def test_page_lowers_quality_then_leaves_out_frames(result):
    full = page.render(result)
    strip_bytes = full.index('data-testid="strip"')
    small = page.render(result, limit_bytes=1)
    assert strip_bytes > 0
    assert len(small) < len(full)
    assert "one of 2 frames" in small


# ---- files


def test_a_failing_block_leaves_nothing(tmp_path):
    def fail(out: Path) -> None:
        with files.output_folder(out) as folder:
            (folder / "half.txt").write_text("x")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail(tmp_path / "deep" / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_later_run_replaces_what_an_earlier_one_wrote(tmp_path):
    out = tmp_path / "out"
    for names in (["frames/0.png", "frames/1.png", "a.csv"], ["frames/0.png"]):
        with files.output_folder(out) as folder:
            for name in names:
                files.write_bytes(folder / name, b"x")
    assert set(tree(out)) == {"frames/0.png", files.MANIFEST}


def test_a_folder_of_other_origin_is_refused(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with (
        pytest.raises(InputError, match=r"thesis\.txt"),
        files.output_folder(tmp_path),
    ):
        pass
    assert [f.name for f in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_manifest_cannot_delete_outside_its_folder(tmp_path):
    (tmp_path / "keep.txt").write_text("mine")
    out = tmp_path / "out"
    out.mkdir()
    (out / files.MANIFEST).write_text("../keep.txt\n")
    with files.output_folder(out) as folder:
        files.write_text(folder / "new.txt", "x")
    assert (tmp_path / "keep.txt").read_text() == "mine"


def test_an_output_below_a_file_is_an_input_error(tmp_path):
    (tmp_path / "file").write_text("x")
    with (
        pytest.raises(InputError, match="cannot be written"),
        files.output_folder(tmp_path / "file" / "out"),
    ):
        pass


def test_exr_reads_back_the_same_floats(tmp_path):
    import OpenEXR

    color = np.random.default_rng(0).random((5, 7, 3), np.float32) * 100
    for name in ("a.exr", "b.exr"):
        files.write_exr(tmp_path / name, color)
    with OpenEXR.File(str(tmp_path / "a.exr")) as image:
        np.testing.assert_array_equal(image.channels()["RGB"].pixels, color)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_video_is_the_same_every_time_and_takes_odd_sizes(tmp_path):
    frames = [np.full((17, 33, 3), 40 * i, np.uint8) for i in range(3)]
    for name in ("a.mp4", "b.mp4"):
        files.write_video(tmp_path / name, frames, 30.0)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data[4:8] == b"ftyp"
    assert data == (tmp_path / "b.mp4").read_bytes()


# ---- parameters


@pytest.fixture
def params() -> pipeline.Params:
    return pipeline.Params(
        raster=raster.default_params(-1.5),
        taa=taa.PRESETS["tuned"][1],
        segmentation=segmentation.default_params(),
        resolve=resolve.default_params(),
        fxaa=fxaa_stage.default_params(),
        budget=jnp.asarray(0.3, jnp.float32),
    )


def test_parameters_read_back_bit_for_bit(params, tmp_path):
    import jax

    parameters.save(params, tmp_path / "p.toml")
    changed = jax.tree.map(lambda leaf: leaf * 0 + 9, params)
    loaded = parameters.load(tmp_path / "p.toml", changed)
    for a, b in zip(jax.tree.leaves(params), jax.tree.leaves(loaded), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
        assert np.asarray(a).dtype == np.asarray(b).dtype


def test_parameters_of_a_file_change_only_what_it_names(params, tmp_path):
    (tmp_path / "p.toml").write_text("budget = inf\n[raster]\nmip_bias = -0.25\n")
    loaded = parameters.load(tmp_path / "p.toml", params)
    assert float(loaded.raster.mip_bias) == -0.25
    assert float(loaded.budget) == float("inf")
    assert loaded.taa.count_limit is params.taa.count_limit


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nonsense = 1", "unknown key 'nonsense'"),
        ("[taa]\nnonsense = 1", "unknown key 'taa.nonsense'"),
        ("taa = 1", "must be a table"),
        ("[raster]\nmip_bias = 'a'", "must be a number"),
        ("[raster]\nmip_bias = true", "must be a number"),
        ("[raster]\nmip_bias = [1, 2]", "must be a number"),
        ("[raster]\nmip_bias = nan", "must be finite"),
        ("budget = -1", "must be at least 0"),
        ("= 1", "not valid TOML"),
    ],
)
def test_a_bad_parameter_file_says_what_is_wrong(params, tmp_path, text, message):
    file = tmp_path / "p.toml"
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        parameters.load(file, params)


def test_a_missing_parameter_file_is_an_input_error(params, tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        parameters.load(tmp_path / "none.toml", params)
