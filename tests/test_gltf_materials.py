"""Materials of glTF: their numbers, images and texture coordinates."""

import struct
import zlib

import numpy as np
import pytest

from ataa_jax import types
from tests.gltf_reading import load, textured
from tests.gltf_writer import (
    Writer,
    encode,
    solid,
)


def test_material_fields(tmp_path):
    writer = Writer()
    writer.add(
        "materials",
        name="lamp",
        pbrMetallicRoughness={
            "baseColorFactor": [0.1, 0.2, 0.3, 0.4],
            "metallicFactor": 0.5,
            "roughnessFactor": 0.6,
        },
        emissiveFactor=[1, 0.5, 0],
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 10}},
        alphaMode="MASK",
        alphaCutoff=0.25,
        doubleSided=True,
    )
    writer.node(mesh=writer.mesh(material=0))
    (material,) = load(writer, tmp_path).materials
    assert material.name == "lamp"
    assert material.base_color == (0.1, 0.2, 0.3, 0.4)
    assert (material.metallic, material.roughness) == (0.5, 0.6)
    assert material.emissive == (10.0, 5.0, 0.0)
    assert (material.alpha_mode, material.alpha_cutoff) == ("MASK", 0.25)
    assert material.double_sided
    assert material.base_color_texture == types.NO_TEXTURE


def test_blended_materials_and_transmission_are_read(tmp_path):
    writer = Writer()
    writer.add("materials", name="glass", alphaMode="BLEND")
    glass = {"KHR_materials_transmission": {"transmissionFactor": 0.75}}
    writer.add("materials", name="water", alphaMode="BLEND", extensions=glass)
    for index in range(2):
        writer.node(mesh=writer.mesh(material=index))
    scene = load(writer, tmp_path)
    assert [m.alpha_mode for m in scene.materials] == ["BLEND", "BLEND"]
    assert [m.transmission for m in scene.materials] == [0.0, 0.75]
    assert scene.warnings == []


@pytest.mark.parametrize(
    ("code", "wrap"),
    [
        (10497, types.WRAP_REPEAT),
        (33071, types.WRAP_CLAMP),
        (33648, types.WRAP_MIRROR),
    ],
)
def test_wrap_modes(tmp_path, code, wrap):
    writer = Writer()
    textured(writer)
    sampler = writer.add("samplers", wrapS=code)
    writer.doc["textures"][0]["sampler"] = sampler
    (texture,) = load(writer, tmp_path).textures
    assert (texture.wrap_u, texture.wrap_v) == (wrap, types.WRAP_REPEAT)
    np.testing.assert_array_equal(texture.texels, np.tile((10, 20, 30, 40), (2, 2, 1)))


def test_textures_are_shared_unless_their_encoding_differs(tmp_path):
    writer = Writer()
    material = textured(writer)
    writer.add("textures", source=0)
    again = writer.add("images", bufferView=writer.doc["images"][0]["bufferView"])
    writer.add("textures", source=again)
    material["pbrMetallicRoughness"]["metallicRoughnessTexture"] = {"index": 1}
    material["normalTexture"] = {"index": 2, "scale": 0.5}
    material["emissiveTexture"] = {"index": 0}
    scene = load(writer, tmp_path)
    (found,) = scene.materials
    assert [t.srgb for t in scene.textures] == [True, False]
    assert found.base_color_texture == found.emissive_texture == 0
    assert found.metallic_roughness_texture == found.normal_texture == 1
    assert found.normal_scale == 0.5
    np.testing.assert_array_equal(scene.textures[0].texels, scene.textures[1].texels)


@pytest.mark.parametrize(
    ("image", "kind", "expected"),
    [
        (solid(0x8000, mode="I;16"), "PNG", (128, 128, 128, 255)),  # 32768/257: 127.5
        (solid(100, mode="L"), "PNG", (100, 100, 100, 255)),
        (solid((100, 50), mode="LA"), "PNG", (100, 100, 100, 50)),
        (solid((1, 2, 3), mode="RGB"), "PNG", (1, 2, 3, 255)),
        (solid(1, mode="1"), "PNG", (255, 255, 255, 255)),
        (solid((90, 90, 90), mode="RGB"), "JPEG", (90, 90, 90, 255)),
    ],
)
def test_images_become_8_bit_rgba(tmp_path, image, kind, expected):
    writer = Writer()
    textured(writer)
    writer.doc["images"][0] = {"bufferView": writer.view(encode(image, kind))}
    texels = load(writer, tmp_path).textures[0].texels
    assert texels.dtype == np.uint8
    np.testing.assert_array_equal(texels, np.tile(expected, (2, 2, 1)))


def test_images_beside_the_scene_and_inline(tmp_path):
    (tmp_path / "maps").mkdir()
    solid((1, 2, 3, 4)).save(tmp_path / "maps" / "a b.png")
    for uri in ("maps/a%20b.png", "maps/../maps/a b.png"):
        writer = Writer()
        textured(writer)
        writer.doc["images"][0] = {"uri": uri}
        assert tuple(load(writer, tmp_path).textures[0].texels[0, 0]) == (1, 2, 3, 4)


def test_a_shared_texture_transform_is_baked(tmp_path):
    transform = {"offset": [0.5, 0.25], "scale": [2, 3], "rotation": np.pi / 2}
    extensions = {"KHR_texture_transform": transform}
    writer = Writer()
    material = textured(writer, extensions=extensions)
    material["emissiveTexture"] = {"index": 0, "extensions": extensions}
    scene = load(writer, tmp_path)
    # scaled, turned counter-clockwise as seen with v down, then moved
    np.testing.assert_allclose(
        scene.meshes[0].uv, [[0.5, 0.25], [0.5, -1.75], [3.5, 0.25]], atol=1e-6
    )
    assert scene.warnings == []


def test_differing_texture_transforms_are_warned_of(tmp_path):
    writer = Writer()
    material = textured(writer)
    material["name"] = "brick"
    transform = {"KHR_texture_transform": {"scale": [2, 2]}}
    material["emissiveTexture"] = {"index": 0, "extensions": transform}
    scene = load(writer, tmp_path)
    np.testing.assert_array_equal(scene.meshes[0].uv, [[0, 0], [1, 0], [0, 1]])
    assert "'brick'" in scene.warnings[0]


def test_a_material_chooses_its_texture_coordinates(tmp_path):
    writer = Writer()
    textured(writer, texCoord=1)
    second = writer.accessor(np.array([[5, 5], [6, 6], [7, 7]], np.float32))
    writer.doc["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = second
    np.testing.assert_array_equal(
        load(writer, tmp_path).meshes[0].uv, [[5, 5], [6, 6], [7, 7]]
    )


def test_16_bit_colour_is_reduced(tmp_path):
    # Pillow writes no 16-bit RGB, so this PNG is put together here: one texel.
    def chunk(kind, body):
        crc = struct.pack(">I", zlib.crc32(kind + body))
        return struct.pack(">I", len(body)) + kind + body + crc

    png = b"\x89PNG\r\n\x1a\n" + chunk(
        b"IHDR", struct.pack(">IIBBBBB", 1, 1, 16, 2, 0, 0, 0)
    )
    png += chunk(b"IDAT", zlib.compress(b"\0" + struct.pack(">HHH", 0x1234, 0, 0xFFFF)))
    png += chunk(b"IEND", b"")
    writer = Writer()
    textured(writer)
    writer.doc["images"][0] = {"bufferView": writer.view(png)}
    texels = load(writer, tmp_path).textures[0].texels
    assert tuple(texels[0, 0]) == (0x12, 0, 0xFF, 255)
