"""Mip pyramids of encoded images, and what is kept of them."""

import io

import numpy as np
import pytest
from PIL import Image

from ataa_jax import cache, mipmap, pyramids, scene


@pytest.fixture(autouse=True)
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path))
    return tmp_path / "pyramids"


def noise(seed: int = 0, size: tuple[int, int] = (150, 130)) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*size, 4), np.uint8)


def png(texels: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(texels).save(stream, "PNG")
    return stream.getvalue()


@pytest.mark.parametrize("srgb", [True, False])
def test_made_or_read_the_levels_are_the_same(folder, srgb):
    image = noise()
    made = pyramids.load(png(image), srgb)
    assert len(list(folder.iterdir())) == 1
    read = pyramids.load(png(image), srgb)
    for found in (made, read):
        np.testing.assert_array_equal(found.texels, image)
        for level, wanted in zip(
            found.levels, mipmap.pyramid(image, srgb), strict=True
        ):
            assert level.dtype == np.uint32
            np.testing.assert_array_equal(level, wanted)
    assert made.digest == read.digest


def test_what_is_kept_is_read(folder):
    """Shown by another image in its place, whose checksum is right."""
    pyramids.load(png(noise(0)), True)
    (file,) = folder.iterdir()
    other = pyramids.load(png(noise(1)), True)
    (swapped,) = set(folder.iterdir()) - {file}
    swapped.replace(file)
    found = pyramids.load(png(noise(0)), True)
    np.testing.assert_array_equal(found.texels, other.texels)


@pytest.mark.parametrize(
    "damage", ["cut", "flipped", "empty", "another size", "method", "header"]
)
def test_what_is_damaged_is_made_anew(folder, damage):
    image = noise()
    pyramids.load(png(image), True)
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    if damage == "cut":
        file.write_bytes(whole[: len(whole) // 2])
    elif damage == "flipped":
        middle = len(whole) // 2
        file.write_bytes(
            whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
        )
    elif damage == "method":  # how the archive's list says that it is packed
        at = whole.rindex(b"PK\x01\x02") + 10
        file.write_bytes(whole[:at] + b"\x63" + whole[at + 1 :])
    elif damage == "header":  # of the array
        file.write_bytes(whole.replace(b"{'descr'", b"{ descr'"))
    elif damage == "empty":
        file.write_bytes(b"")
    else:
        cache.write(file, np.zeros(7, np.uint32))
    np.testing.assert_array_equal(pyramids.load(png(image), True).texels, image)
    assert file.read_bytes() == whole


def test_encodings_are_kept_apart_and_small_images_not_at_all(folder):
    image = noise()
    digests = {pyramids.load(png(image), srgb).digest for srgb in (True, False)}
    assert len(digests) == len(list(folder.iterdir())) == 2
    pyramids.load(png(noise(size=(64, 64))), True)
    assert len(list(folder.iterdir())) == 2


def packed(*images: np.ndarray):
    found = [pyramids.load(png(image), True) for image in images]
    corners = np.eye(3, dtype=np.float32)
    return scene.pack(
        scene.SceneSource(
            name="triangle",
            meshes=[scene.MeshSource("t", corners, np.arange(3)[None], 0)],
            materials=[scene.MaterialSource()],
            textures=[
                scene.TextureSource(each.texels, srgb=True, pyramid=each)
                for each in found
            ],
        )
    )[0]


def test_a_scene_is_hashed_by_what_its_images_are(folder):
    first = packed(noise(0), noise(1))
    again = packed(noise(0), noise(1))  # from the cache
    np.testing.assert_array_equal(first.textures.texels, again.textures.texels)
    one = cache.content_hash(first)
    assert one == cache.content_hash(again)
    changed = noise(1)
    changed[3, 4, 0] ^= 1
    others = [packed(noise(0), changed), packed(noise(1), noise(0)), packed(noise(0))]
    hashes = {one, *map(cache.content_hash, others)}
    assert len(hashes) == 4


def test_textures_are_the_same_with_and_without_a_known_pyramid():
    known = packed(noise(0), noise(1, (9, 14)))
    plain = scene.TextureSource(noise(0), srgb=True)
    odd = scene.TextureSource(noise(1, (9, 14)), srgb=True)
    source = scene.SceneSource(
        name="triangle",
        meshes=[
            scene.MeshSource("t", np.eye(3, dtype=np.float32), np.arange(3)[None], 0)
        ],
        materials=[scene.MaterialSource()],
        textures=[plain, odd],
    )
    made = scene.pack(source)[0]
    np.testing.assert_array_equal(known.textures.texels, made.textures.texels)
    np.testing.assert_array_equal(
        known.textures.level_offset, made.textures.level_offset
    )
