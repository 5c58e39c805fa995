"""`ataa bench`: what it measures, and that it refuses other pictures."""

import dataclasses
import functools
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pytest

from ataa_jax import bench, verify
from ataa_jax.competitor import library
from ataa_jax.errors import InputError
from tests.test_cli import OBJ, ataa, read


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("scene") / "tile.obj"
    file.write_text(OBJ)
    return file


@pytest.fixture
def one_golden(monkeypatch):
    """For the others `test_verify` renders."""
    monkeypatch.setattr(verify, "SEQUENCES", {"wires": "d"})


@pytest.mark.usefixtures("one_golden")
def test_bench_measures_and_writes_a_table(scene, tmp_path, monkeypatch, capsys):
    small = functools.partial(bench.peak_memory, size=(18, 32))
    monkeypatch.setattr(bench, "peak_memory", small)
    out = tmp_path / "out"
    assert ataa("bench", scene, "--size", "32x18", "--out", out) == 0
    rows = {row["name"]: float(row["value"]) for row in read(out / "bench.csv")}
    assert 0.4 < rows["ATAA 8x rays a pixel"] <= 0.5
    assert rows["ATAA 8x frame"] >= rows["ATAA 8x raster"] > 0.0
    assert rows["SSAA 8x frame"] > 0.0
    for start in ("first", "second"):  # GB; JAX alone takes 0.2
        assert 0.05 < rows[f"peak memory at 32x18, {start} start"] < 2.0
    assert rows["golden wires, changed pixels"] <= verify.CHANGED
    assert rows["golden images within the tolerance"] == 1.0
    assert "ATAA 8x frame" in capsys.readouterr().out


def test_the_first_start_whose_peak_is_measured_compiles(scene, tmp_path, monkeypatch):
    """Whatever the process that asks keeps its programs in."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "asking"))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        asked = (str(scene), (18, 32), str(tmp_path / "own"))
        pool.submit(bench._peak_of_frames, *asked).result()
    assert list((tmp_path / "own" / "programs").rglob("*-cache"))
    assert not list((tmp_path / "asking").glob("jit_call-*"))  # what stages compile to


def test_bench_fails_where_golden_images_have_changed(
    scene, tmp_path, monkeypatch, capsys
):
    """A time that is bought with other pictures does not count."""
    golden = verify.read("wires")
    other = dataclasses.replace(golden, image=255 - golden.image)
    changed = [verify.compare("wires", other, golden)]
    monkeypatch.setattr(verify, "verify", lambda: changed)
    monkeypatch.setattr(bench, "run", lambda *_: [])
    monkeypatch.setattr(bench, "peak_memory", lambda _: [])
    out = tmp_path / "out"
    assert ataa("bench", scene, "--size", "32x18", "--out", out) == 1
    assert "see `ataa verify`" in capsys.readouterr().out
    rows = {row["name"]: float(row["value"]) for row in read(out / "bench.csv")}
    assert rows["golden images within the tolerance"] == 0.0


@pytest.mark.usefixtures("one_golden")
def test_bench_against_mitsuba_measures_both(scene, tmp_path, capsys):
    try:
        library.load()
    except InputError as error:
        pytest.skip(str(error))
    out = tmp_path / "out"
    options = ("--size", "32x18", "--against", "mitsuba", "--out", out)
    assert ataa("bench", scene, *options) == 0
    rows = {row["name"]: float(row["value"]) for row in read(out / "bench.csv")}
    for name in ("Mitsuba 8 spp", "SSAA 8x", "ATAA 8x"):
        low, high = (rows[f"{name}, {which} quartile"] for which in ("first", "third"))
        assert 0.0 < low <= rows[name] <= high
    assert rows["ATAA 8x over Mitsuba 8 spp"] > 0.0
    assert rows["SSAA 8x over Mitsuba 8 spp"] > 0.0
    assert "Mitsuba 8 spp" in capsys.readouterr().out


def test_bench_against_anything_else_is_one_line(scene, tmp_path, capsys):
    out = tmp_path / "out"
    assert ataa("bench", scene, "--against", "foo", "--out", out) == 2
    assert capsys.readouterr().err == "error: --against takes 'mitsuba', not 'foo'\n"
    assert not out.exists()
