"""The command line: what it writes, what it says, and how it refuses."""

import csv
import functools
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ataa_jax import cli, effects, paths, world
from ataa_jax.methods import METHODS
from tests.gltf_writer import triangle_scene

DATA = Path(__file__).parents[1] / "data"
OBJ = """\
o tile
v -1 0 1
v 1 0 1
v 1 0 -1
v -1 0 -1
v 0.2 1 0
vn 0 1 0
f 1//1 2//1 3//1
f 1//1 3//1 4//1
f 1//1 2//1 5//1
"""
TINY = ("--size", "32x18", "--frames", "2")


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("scene") / "tile.obj"
    file.write_text(OBJ)
    return file


@pytest.fixture(autouse=True)
def cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture(autouse=True, scope="module")
def one_world():
    # To prepare a world is to build its tracer and to measure its light.
    prepare, kept = world.prepare, {}

    def kept_world(source, **options):
        key = (id(source), *options.items())  # `read` keeps its sources
        if key not in kept:
            kept[key] = prepare(source, **options)
        return kept[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world, "read", functools.cache(world.read))
        patch.setattr(world, "prepare", kept_world)
        yield


def ataa(*arguments: object) -> int:
    return cli.main([str(argument) for argument in arguments])


def read(file: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(file.read_text().splitlines()))


def names(folder: Path) -> set[str]:
    return {
        file.relative_to(folder).as_posix()
        for file in folder.rglob("*")
        if file.is_file()
    }


# ---- run


@pytest.fixture(scope="module")
def film(scene, one_world, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("film") / "out"
    assert ataa("run", scene, *TINY, "--exr", "--out", out) == 0
    return out


def test_run_writes_frames_masks_counts_and_a_video(film):
    frames = {
        f"{kind}/000{i}.png" for kind in ("frames", "mask", "why") for i in (0, 1)
    }
    others = {"statistics.csv", "timings.csv", "video.mp4", "MANIFEST.txt"}
    assert names(film) == frames | others | {"exr/0000.exr", "exr/0001.exr"}


def test_run_counts_every_pixel_once(film):
    rows = read(film / "statistics.csv")
    assert [row["frame"] for row in rows] == ["0", "1"]
    for row in rows:
        shares = [float(row[f"{name}_share"]) for name in ("fxaa", "taa", "ataa")]
        assert sum(shares) == pytest.approx(1.0, abs=2e-6)  # six digits each
        assert float(row["rays_per_pixel"]) == pytest.approx(8 * shares[2], abs=1e-5)
    assert float(rows[0]["fxaa_share"]) == 1.0  # the first frame is all new


def test_run_exr_is_what_the_png_shows(film):
    import jax.numpy as jnp
    import OpenEXR

    from ataa_jax import color

    with OpenEXR.File(str(film / "exr/0001.exr")) as image:
        linear = image.channels()["RGB"].pixels
    shown = np.asarray(color.display(jnp.asarray(linear)))
    png = np.asarray(Image.open(film / "frames/0001.png"))
    # Half a step of rounding to 8 bits, and float32.
    assert np.abs(shown * 255 - png).max() < 0.51


def test_run_keeps_times_apart(film):
    assert "ms" not in (film / "statistics.csv").read_text()
    stages = {row["stage"] for row in read(film / "timings.csv")}
    assert {"raster", "taa", "raytrace"} <= stages


def test_run_twice_writes_the_same_bytes_except_times(film, scene, tmp_path, capsys):
    out = tmp_path / "again"
    assert ataa("run", scene, *TINY, "--exr", "--out", out) == 0
    told = capsys.readouterr().out.splitlines()[-1]
    assert told == (
        f"Wrote {out}: frames/, mask/, why/, exr/, video.mp4, statistics.csv, "
        "timings.csv"
    )
    different = {
        name
        for name in names(film)
        if (film / name).read_bytes() != (out / name).read_bytes()
    }
    assert different == {"timings.csv"}


@pytest.mark.parametrize("method", ["none", "fxaa", "ssaa2", "taa"])
def test_run_takes_every_kind_of_method(scene, tmp_path, capsys, method):
    out = tmp_path / "out"
    arguments = ("--size", "32x18", "--frames", "1", "--method", method)
    assert ataa("run", scene, *arguments, "--out", out) == 0
    with Image.open(out / "frames/0000.png") as image:
        assert image.size == (32, 18)
    assert not (out / "mask").exists()
    told = capsys.readouterr().out.splitlines()[-1]
    assert told == f"Wrote {out}: frames/, video.mp4, statistics.csv, timings.csv"


def test_run_reads_parameters(scene, tmp_path):
    file = tmp_path / "p.toml"
    file.write_text("[segmentation]\nthreshold = 2.0\n")  # scores end at 1
    out = tmp_path / "out"
    assert ataa("run", scene, *TINY, "--params", file, "--out", out) == 0
    rows = read(out / "statistics.csv")
    assert float(rows[1]["ataa_share"]) == 0.0


# ---- compare, info


def test_compare_writes_the_whole_report(scene, tmp_path, capsys):
    out = tmp_path / "out"
    chosen = ("--method", "none,taa", "--method", "ataa8", "--reference-samples", 2)
    arguments = (*TINY, "--lead-in", 1, *chosen)
    assert ataa("compare", scene, *arguments, "--out", out) == 0
    written = names(out)
    assert {
        "index.html",
        "strip.png",
        "hero.png",
        "scores.csv",
        "timings.csv",
    } <= written
    assert "plots/ssim.svg" in written
    methods = [row["method"] for row in read(out / "scores.csv")]
    assert methods == ["none", "taa", "ataa8", "reference"]
    assert "ATAA 8x" in capsys.readouterr().out


def test_info_tells_what_is_there_and_why(scene, capsys):
    assert ataa("info", scene) == 0
    out = capsys.readouterr().out
    for word in ("Triangles", "3", "Cameras", "Lights", "shadows", "no camera"):
        assert word in out


def test_info_shows_names_with_brackets_as_they_are(tmp_path, capsys):
    writer = triangle_scene()
    lens = writer.add("cameras", type="perspective", perspective={"yfov": 1})
    for name in ("[red]", "[/b]"):
        writer.node(camera=lens, name=name, translation=[0, 0, 5])
    assert ataa("info", writer.glb(tmp_path / "[bold].glb")) == 0
    out = capsys.readouterr().out
    for name in ("[bold]", "[red]", "[/b]"):
        assert name in out


def test_a_run_starts_at_the_camera_that_has_the_exact_name(tmp_path):
    writer = triangle_scene()
    lens = writer.add("cameras", type="perspective", perspective={"yfov": 1})
    writer.node(camera=lens, name="main", translation=[0, 0, 2])
    writer.node(camera=lens, name="orbit", translation=[0, 0, 40])
    file = writer.glb(tmp_path / "a.glb")
    shown = {}
    for camera in ("main", "orbit", "orbit:still", "main:still"):
        out = tmp_path / camera.replace(":", "-")
        arguments = ("--method", "none", "--size", "32x18", "--frames", 1)
        assert ataa("run", file, *arguments, "--camera", camera, "--out", out) == 0
        shown[camera] = (out / "frames/0000.png").read_bytes()
    assert shown["orbit"] == shown["orbit:still"]  # frame 0 of a walk is its start
    assert shown["main"] == shown["main:still"] != shown["orbit"]


def test_info_counts_instances_of_shared_meshes(tmp_path, capsys):
    writer = triangle_scene()
    writer.node(mesh=writer.mesh())
    assert ataa("info", writer.glb(tmp_path / "two.glb")) == 0
    assert "instances" not in capsys.readouterr().out
    writer.node(mesh=0, translation=[2, 0, 0])
    assert ataa("info", writer.glb(tmp_path / "three.glb")) == 0
    assert "3, instances of 2 meshes" in capsys.readouterr().out


def test_info_passes_on_what_the_reader_missed(tmp_path, capsys):
    file = tmp_path / "tile.obj"
    file.write_text(f"mtllib gone.mtl\n{OBJ}")
    assert ataa("info", file) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "the file gone.mtl, which the scene names, does not exist: left out" in out


# ---- refusals


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("run", "SCENE", "--size", "0x0"), "--size must be WIDTHxHEIGHT"),
        (("run", "SCENE", "--size", "abc"), "not 'abc'"),
        (("run", "SCENE", "--size", "16385x1"), "1 to 16384 pixels"),
        (("run", "SCENE", "--size", "-3x4"), "--size must be"),
        (("run", "SCENE", "--size", "4x4x4"), "--size must be"),
        (("run", "SCENE", "--frames", "0"), "--frames must be at least 1"),
        (("run", "SCENE", "--frames", "two"), "--frames"),
        (("run", "SCENE", "--lead-in", "-1"), "--lead-in must be at least 0"),
        (("run", "SCENE", "--method", "msaa"), "unknown method 'msaa'; known are none"),
        (("run", "SCENE", "--preset", "ue5"), "unknown preset 'ue5'"),
        (("run", "SCENE", "--budget", "-1"), "--budget must be at least 0"),
        (("run", "SCENE", "--budget", "nan"), "--budget must be at least 0"),
        (("run", "SCENE", "--motion", "fast"), "--motion must be typical, rapid or"),
        (("run", "SCENE", "--motion", "-1"), "from 0 to 1, not '-1'"),
        (("run", "SCENE", "--camera", "north"), "no camera 'north'"),
        (("run", "SCENE", "--camera", "north:fly"), "are still, pan, orbit, dolly"),
        (("bench", "SCENE", "--camera", "north:pan"), "no camera 'north'"),
        (("run", ""), "the scene's name is empty"),
        (("run", "SCENE", "--method", "taa,fxaa"), "takes one method, not 'taa,fxaa'"),
        (("run", "FOLDER"), "is a folder; give the path of a file"),
        (("run", "SCENE", "--out", "SCENE"), "is a file; give a new or empty folder"),
        (("run", "SCENE", "--camera", "none.toml"), "none.toml cannot be read"),
        (("run", "SCENE", "--params", "none.toml"), "none.toml cannot be read"),
        (("run", "none.obj"), "none.obj"),
        (("run", "none.glb"), "none.glb"),
        (("run",), "SCENE"),
        (("run", "SCENE", "--bogus"), "--bogus"),
        (("paint", "SCENE"), "paint"),
        (("compare", "SCENE", "--reference-samples", "0"), "at least 1"),
        (("compare", "SCENE", "--method", "taa,msaa"), "unknown method 'msaa'"),
        (("info", "none.glb"), "none.glb"),
        (("bench", "SCENE", "--size", "1"), "--size must be"),
    ],
)
def test_a_mistake_is_one_line_and_leaves_nothing(
    scene, tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    places = {"SCENE": str(scene), "FOLDER": str(scene.parent)}
    given = [places.get(word, word) for word in arguments]
    assert ataa(*given) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("error: ")
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_output_is_refused_before_the_scene_is_read(tmp_path, capsys):
    (tmp_path / "file").write_text("x")
    assert ataa("run", "none.glb", "--out", tmp_path / "file" / "out") == 2
    message = f"cannot be written, for {tmp_path / 'file'} is a file"
    assert message in capsys.readouterr().err


def test_traceback_shows_where_an_error_came_from(capsys):
    assert ataa("run", "none.glb", "--size", "abc", "--traceback") == 2
    assert "Traceback" in capsys.readouterr().err


def test_ctrl_c_is_one_line_and_leaves_nothing(scene, tmp_path, monkeypatch, capsys):
    from ataa_jax import film

    def interrupt(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(film, "shoot", interrupt)
    out = tmp_path / "out"
    assert ataa("run", scene, *TINY, "--out", out) == 130
    assert capsys.readouterr().err == "interrupted\n"
    assert not out.exists()


def test_a_failure_of_the_program_is_told_apart(scene, tmp_path, monkeypatch, capsys):
    from ataa_jax import film

    def fail(*arguments: object, **options: object) -> None:
        raise RuntimeError("a\nb")

    monkeypatch.setattr(film, "shoot", fail)
    assert ataa("run", scene, *TINY, "--out", tmp_path / "out") == 1
    assert capsys.readouterr().err.startswith("error: unexpected RuntimeError: a b;")


# ---- help and paths


def test_help_names_every_command_without_importing_jax():
    script = (
        "import sys; from ataa_jax import cli; code = cli.main(['--help']); "
        "assert 'jax' not in sys.modules; sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        check=False,
        cwd=DATA.parent,
    )
    assert done.returncode == 0, done.stderr
    for command in ("demo", "info", "run", "compare", "bench"):
        assert command in done.stdout


def test_no_arguments_show_the_help(capsys):
    assert ataa() == 0
    assert "compare" in capsys.readouterr().out


def test_help_names_every_kind_of_method(capsys):
    assert ataa("compare", "--help") == 0
    out = capsys.readouterr().out
    families = {name.rstrip("0123456789") for name in METHODS if "_" not in name}
    for family in families:
        assert family in out


PATHS = [file for file in sorted(DATA.glob("*.toml")) if file.stem in paths.KINDS]


@pytest.mark.parametrize("file", PATHS, ids=lambda f: f.stem)
def test_every_path_of_the_data_folder_loads(file):
    path = paths.load(str(file))
    assert path.kind == file.stem
    assert set(tomllib.loads(file.read_text())) >= {"kind", "fps"}


# ---- effects


def test_info_lists_the_effects_with_their_reasons_and_rays(scene, capsys):
    assert ataa("info", scene) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "1 of 1 lights cast them" in shown
    assert "rays a pixel" in shown
    for name in effects.NAMES:
        assert name in shown


def test_an_effect_that_the_scene_cannot_have_is_said(scene, capsys):
    assert ataa("info", scene, "--effects", "normal-maps,sky") == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "effect normal-maps was asked for, but the scene has none" in shown
    assert "left out" in shown


@pytest.mark.parametrize("command", ["info", "run", "compare"])
def test_an_unknown_effect_is_refused(scene, command, capsys, tmp_path):
    out = [] if command == "info" else ["--out", tmp_path / "out"]
    assert ataa(command, scene, "--effects", "fog", *out) == 2
    assert "there is no effect 'fog'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_run_without_shadows_casts_no_shadow_rays(scene, tmp_path):
    out = tmp_path / "out"
    options = ("--effects", "no-shadows", "--out", out)
    assert ataa("run", scene, *TINY, *options) == 0
    assert {row["shadow_rays"] for row in read(out / "statistics.csv")} == {"0"}
