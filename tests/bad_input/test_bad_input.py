"""Every spoiled file ends in a picture or in one clear sentence; see `harness`."""

import shutil
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from tests.bad_input import corpus
from tests.bad_input.harness import Reader
from tests.bad_input.reduced import reduced
from tests.gltf_writer import Writer
from tests.scenes import scene_path

DATA = Path(__file__).parents[2] / "data"
SCENES = (
    *("cesium_milk_truck", "dutch_ship", "littlest_tokyo", "modern_house", "sponza"),
)


@cache
def small(name: str) -> Writer:
    return reduced(scene_path(f"{name}.glb"))


@pytest.fixture(scope="module")
def truck(tmp_path_factory):
    return small("cesium_milk_truck").glb(tmp_path_factory.mktemp("truck") / "a.glb")


@pytest.fixture(scope="module")
def reader(tmp_path_factory, truck):
    with Reader(tmp_path_factory.mktemp("bad_input"), truck) as reader:
        yield reader


def faults_of(
    reader: Reader, kind: str, rounds: range, ends: Counter[str] | None = None
) -> list[str]:
    """Returns what went wrong with a kind's files, one file a scene and round.

    Adds to `ends` how each of them ended.
    """
    faults = []
    for index in (len(SCENES) * r + s for r in rounds for s in range(len(SCENES))):
        name = SCENES[index % len(SCENES)]
        folder = reader.folder / "scene"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        seed = index * len(corpus.KINDS) + corpus.KINDS.index(kind)
        done, file = corpus.write(small(name), seed, folder, reader.bait)
        assert done == kind
        end, fault = reader.verdict(reader.run(file))
        if ends is not None:
            ends[end] += 1
        if fault:
            faults.append(f"seed {seed}, {name}: {fault}")
    return faults


@pytest.mark.parametrize("kind", corpus.KINDS)
def test_a_spoiled_scene_ends_in_a_picture_or_in_one_sentence(reader, kind):
    assert faults_of(reader, kind, range(1)) == []


@pytest.mark.hard
@pytest.mark.parametrize("kind", corpus.KINDS)
def test_every_spoiled_scene_ends_in_a_picture_or_in_one_sentence(
    reader, kind, record_property
):
    ends: Counter[str] = Counter()
    faults = faults_of(reader, kind, range(1, 21), ends)
    record_property("files", ends.total())
    record_property("pictures", ends["image"])
    record_property("refused", ends["refused"])
    assert faults == []


@pytest.mark.parametrize(
    ("option", "sound"),
    [("--params", "fitted.toml"), ("--camera", "keyframes.toml")],
)
def test_a_spoiled_table_ends_in_a_picture_or_in_one_sentence(
    reader, truck, tmp_path, option, sound
):
    text = (DATA / sound).read_text()
    found = {}
    for seed in range(40):
        file = tmp_path / f"{seed}.toml"
        file.write_bytes(corpus.tables(text, seed))
        ended, fault = reader.verdict(reader.run(truck, option, str(file)))
        assert not fault, (seed, fault)
        found[ended] = found.get(ended, 0) + 1
    assert set(found) == {"image", "refused"}


def test_a_spoiled_cache_file_is_not_believed(reader, truck):
    _, fault = reader.verdict(reader.run(truck))
    assert not fault
    picture = reader.out / "frames" / "0000.png"
    expected = picture.read_bytes()
    files = [file for file in reader.cache.rglob("*.npz") if file.is_file()]
    assert files
    for seed in range(6):
        for file in files:
            file.write_bytes(corpus.archive(file.read_bytes(), seed))
        _, fault = reader.verdict(reader.run(truck))
        assert not fault, (seed, fault)
        assert picture.read_bytes() == expected


def test_the_sound_copies_render(reader, tmp_path):
    for name in SCENES:
        seen = reader.run(small(name).glb(tmp_path / f"{name}.glb"))
        assert reader.verdict(seen) == ("image", "")


def test_the_watch_notices_a_file_from_outside(reader, truck):
    # What the other tests rely on: the same process, asked to read where it must not.
    kept, link = reader.bait.read_bytes(), reader.folder / "linked.glb"
    link.symlink_to(reader.bait)
    try:
        shutil.copy(truck, reader.bait)
        _, fault = reader.verdict(reader.run(link))
    finally:
        reader.bait.write_bytes(kept)
    assert "opens" in fault


def test_the_watch_notices_a_folder_made_elsewhere(reader, truck, tmp_path):
    _, fault = reader.verdict(reader.run(truck, "--out", str(tmp_path / "elsewhere")))
    assert "os.mkdir" in fault
    assert "elsewhere" in fault
