"""What the glTF reader must refuse in one sentence."""

import copy
import errno
import random
import struct

import numpy as np
import pytest

from ataa_jax import gltf, pyramids
from ataa_jax.errors import InputError
from ataa_jax.gltf import materials as gltf_materials
from tests.gltf_reading import load, refuse, textured
from tests.gltf_writer import (
    TRIANGLE,
    Writer,
    encode,
    solid,
    triangle_scene,
    write_bytes,
)


def test_missing_file_and_folder(tmp_path):
    refuse(tmp_path / "nothing.glb", "no such file")
    refuse(tmp_path, "folder")


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"", "neither"),
        (b"solid cube", "neither"),
        (b"glTF\2\0", "header"),
        (b"glTF" + struct.pack("<II", 1, 20) + bytes(8), "version 1"),
        (b"glTF" + struct.pack("<II", 2, 12), "JSON chunk"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 999, 0x4E4F534A), "chunk at byte 12"),
        (b"glTF" + struct.pack("<III", 2, 16, 0), "chunk at byte 12"),
        (b"glTF" + struct.pack("<IIII", 2, 20, 0, 0x004E4942), "JSON chunk"),
        (b"{", "does not parse"),
        (b"{" * 100000, "does not parse"),
        (b'{"a":' * 100000, "does not parse"),
        (b'{"a": "\xff"}', "UTF-8"),
        (b"{}", "asset.version"),
        (b'{"asset": {"version": "1.0"}}', "'1.0'"),
        (b'{"asset": {"version": 2}}', "text"),
        (b'{"asset": {"version": "2.0"}}', "no triangles"),
        (b'{"asset": {"version": "2.0"}, "nodes": {}}', "array"),
        (b'{"asset": {"version": "2.0"}, "nodes": [1]}', "object"),
        (b'{"a": ' + b"9" * 5000 + b"}", "does not parse"),
    ],
)
def test_what_is_not_gltf_2(tmp_path, data, word):
    refuse(write_bytes(tmp_path / "a.glb", data), word)


def test_every_truncation_is_noticed(tmp_path):
    data = triangle_scene().glb_bytes()
    for length in range(len(data)):
        refuse(write_bytes(tmp_path / "a.glb", data[:length]))


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("KHR_draco_mesh_compression", "re-export without Draco compression"),
        ("KHR_texture_basisu", "PNG or JPEG"),
        ("ACME_unheard_of", "re-export without it"),
    ],
)
def test_required_extensions_that_are_not_supported(tmp_path, name, advice):
    writer = triangle_scene()
    writer.doc["extensionsRequired"] = [name]
    refuse(writer.glb(tmp_path / "a.glb"), name, advice)


@pytest.mark.parametrize(
    ("uri", "word"),
    [
        ("../secret.bin", "outside"),
        ("%2e%2e/secret.bin", "outside"),
        ("sub/../../secret.bin", "outside"),
        ("/etc/passwd", "outside"),
        ("link.bin", "outside"),
        ("linked/secret.bin", "outside"),
        ("", "outside"),
        ("https://example.org/a.bin", "network"),
        ("//example.org/a.bin", "network"),
        ("file:///etc/passwd", "network"),
        ("absent.bin", "cannot be read"),
        ("sub", "not a regular file"),
        ("a\0b", "outside"),
        ("x" * 5000, "cannot be read"),
        ("data:application/octet-stream,abc", "base64"),
        ("data:;base64,@@@", "base64"),
    ],
)
def test_addresses_stay_in_the_scenes_folder(tmp_path, uri, word):
    folder = tmp_path / "scene"
    (folder / "sub").mkdir(parents=True)
    (tmp_path / "secret.bin").write_bytes(bytes(100))
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    (folder / "linked").symlink_to(tmp_path)
    writer = triangle_scene()
    writer.doc["buffers"] = [{"byteLength": 36, "uri": uri}]
    refuse(writer.glb(folder / "a.glb"), "buffers[0]", word)
    writer = Writer()
    textured(writer)
    writer.doc["images"][0] = {"uri": uri}
    refuse(writer.glb(folder / "b.glb"), "images[0]", word)


def test_images_that_cannot_be_decoded(tmp_path):
    png = encode(solid((1, 2, 3, 4), (16, 16)))
    huge = bytearray(png)
    huge[16:24] = struct.pack(">II", 100000, 100000)
    large = bytearray(png)
    large[16:24] = struct.pack(">II", 9000, 9000)
    gif = encode(solid(1, mode="L"), "GIF")
    for data, word in [
        (png[: len(png) // 2], "not a readable PNG or JPEG"),
        (b"nonsense", "not recognized"),
        (b"", "not recognized"),
        (gif, "not recognized"),
        (bytes(huge), ""),
        (bytes(large), ""),
    ]:
        writer = Writer()
        textured(writer)
        writer.doc["images"][0] = {"bufferView": writer.view(data)}
        refuse(writer.glb(tmp_path / "a.glb"), "images[0]", word)


def test_images_beyond_the_limits(tmp_path, monkeypatch):
    writer = Writer()
    textured(writer)
    monkeypatch.setattr(gltf_materials, "MAX_IMAGE_TEXELS", 3)
    refuse(writer.glb(tmp_path / "a.glb"), "2x2 texels", "scale it down")
    monkeypatch.setattr(gltf_materials, "MAX_IMAGE_TEXELS", 4)
    monkeypatch.setattr(gltf_materials, "MAX_TEXELS", 3)
    refuse(writer.glb(tmp_path / "a.glb"), "2x2 texels", "scale the images down")


def test_an_image_counts_as_often_as_it_is_packed(tmp_path, monkeypatch):
    writer = Writer()
    material = textured(writer)
    monkeypatch.setattr(gltf_materials, "MAX_TEXELS", 4)
    gltf.load(writer.glb(tmp_path / "a.glb"))
    again = writer.add(
        "textures", source=0, sampler=writer.add("samplers", wrapS=33071)
    )
    material["emissiveTexture"] = {"index": again}
    refuse(writer.glb(tmp_path / "b.glb"), "2x2 texels", "scale the images down")


def test_a_full_disk_is_not_laid_to_an_image(tmp_path, monkeypatch):
    writer = Writer()
    textured(writer)

    def full(data, srgb):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pyramids, "load", full)
    with pytest.raises(OSError, match="No space left"):
        gltf.load(writer.glb(tmp_path / "a.glb"))


def test_instances_beyond_the_limit(tmp_path, monkeypatch):
    writer = triangle_scene()
    writer.node(mesh=0)
    monkeypatch.setattr(gltf, "MAX_TRIANGLES", 1)
    refuse(writer.glb(tmp_path / "a.glb"), "triangles", "simplify")


def edit(*keys, value):
    """Returns an edit of a document: sets, or with None deletes, one entry."""

    def apply(doc):
        for key in keys[:-1]:
            doc = doc[key]
        if value is None:
            del doc[keys[-1]]
        else:
            doc[keys[-1]] = value

    return apply


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (edit("accessors", 0, "count", value=4), ["accessors[0]", "needs 48 bytes"]),
        (edit("accessors", 0, "count", value=10**15), ["accessors[0]", "needs"]),
        (edit("accessors", 0, "count", value=10**300), ["count", "integer"]),
        (edit("accessors", 0, "count", value=0), ["count 0"]),
        (edit("accessors", 0, "count", value=-3), ["count", "integer"]),
        (edit("accessors", 0, "count", value=3.0), ["count", "integer"]),
        (edit("accessors", 0, "count", value=None), ["lacks `count`"]),
        (edit("accessors", 0, "byteOffset", value=4), ["needs 40 bytes"]),
        (edit("accessors", 0, "componentType", value=5124), ["5124"]),
        (edit("accessors", 0, "type", value="VEC9"), ["'VEC9'"]),
        (edit("accessors", 0, "type", value="VEC2"), ["VEC3", "VEC2"]),
        (edit("accessors", 0, "bufferView", value=7), ["bufferViews[7]", "only 1"]),
        (edit("bufferViews", 0, "byteStride", value=4), ["byteStride of 4"]),
        (edit("bufferViews", 0, "byteLength", value=99), ["beyond the 36"]),
        (edit("bufferViews", 0, "buffer", value=1), ["buffers[1]", "only 1"]),
        (edit("buffers", value=[{"byteLength": 99}]), ["99 bytes", "only 36"]),
        (edit("buffers", value=[{}]), ["lacks `byteLength`"]),
        (edit("meshes", 0, "primitives", 0, "mode", value=7), ["mode is 7"]),
        (edit("meshes", 0, "primitives", 0, "mode", value=0), ["no triangles"]),
        (edit("meshes", 0, "primitives", 0, "material", value=0), ["materials[0]"]),
        (edit("meshes", 0, "primitives", 0, "indices", value=0), ["SCALAR", "VEC3"]),
        (edit("meshes", 0, "primitives", 0, "attributes", value={}), ["no triangles"]),
        (edit("nodes", 0, "mesh", value=1), ["meshes[1]", "nodes[0]"]),
        (edit("nodes", 0, "mesh", value=-1), ["meshes[-1]"]),
        (edit("nodes", 0, "mesh", value="0"), ["integer"]),
        (edit("nodes", 0, "mesh", value=None), ["no triangles"]),
        (edit("nodes", 0, "children", value=[0]), ["its own ancestor"]),
        (edit("nodes", 0, "children", value=[5]), ["nodes[5]"]),
        (edit("nodes", 0, "camera", value=0), ["cameras[0]", "none"]),
        (edit("nodes", 0, "skin", value=0), ["skins[0]", "none"]),
        (edit("nodes", 0, "scale", value=[1e200] * 3), ["32-bit"]),
        (edit("nodes", 0, "scale", value=[1, 1]), ["3 finite numbers"]),
        (edit("nodes", 0, "scale", value=[1, 1, float("nan")]), ["3 finite numbers"]),
        (edit("nodes", 0, "matrix", value=[1e299] * 16), ["nodes[0]"]),
        (edit("nodes", value=[{"children": [1]}, {"children": [0]}]), ["ancestor"]),
        (
            edit("nodes", value=[{"children": [2]}, {"children": [2]}, {}]),
            ["two parents"],
        ),
        (edit("scenes", value=[{"nodes": [3]}]), ["nodes[3]"]),
        (edit("scenes", value=[{"nodes": []}]), ["no triangles"]),
        (edit("materials", value=[{"alphaMode": "HALF"}]), ["'HALF'"]),
        (edit("materials", value=[{"emissiveFactor": [1, "x", 1]}]), ["finite"]),
        (edit("materials", value=[{"normalTexture": {"index": 0}}]), ["textures[0]"]),
    ],
)
def test_damaged_documents(tmp_path, change, words):
    writer = triangle_scene()
    writer.doc["buffers"] = [{"byteLength": len(writer.data)}]
    change(writer.doc)
    refuse(writer.glb(tmp_path / "a.glb"), *words)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["POSITION", "NORMAL"])
def test_vertices_must_be_finite(tmp_path, bad, name):
    values = TRIANGLE.copy()
    values[1, 2] = bad
    writer = triangle_scene()
    primitive = writer.doc["meshes"][0]["primitives"][0]
    primitive["attributes"][name] = writer.accessor(values)
    refuse(writer.glb(tmp_path / "a.glb"), name, "NaN or infinite")


def test_indices_and_attributes_must_fit_the_positions(tmp_path):
    writer = Writer()
    writer.node(mesh=writer.mesh(indices=np.array([0, 1, 3], np.uint8)))
    refuse(writer.glb(tmp_path / "a.glb"), "vertex 3", "only 3")
    writer = Writer()
    writer.node(mesh=writer.mesh(normal=TRIANGLE[:2]))
    refuse(writer.glb(tmp_path / "a.glb"), "NORMAL", "2 elements for 3 positions")


@pytest.mark.parametrize(
    ("times", "values", "interpolation", "word"),
    [
        ([0, 1], [[0, 0, 0]], "LINEAR", "1 values for 2 keys"),
        ([0, 1], [[0, 0, 0]] * 2, "CUBICSPLINE", "needs 6"),
        ([1, 0], [[0, 0, 0]] * 2, "LINEAR", "increase"),
        ([-1, 0], [[0, 0, 0]] * 2, "LINEAR", "increase"),
        ([0, 1], [[0, 0, 0]] * 2, "BEZIER", "'BEZIER'"),
        ([0, 1], [[0, 0, 0, 1]] * 2, "LINEAR", "VEC3"),
        ([0, np.nan], [[0, 0, 0]] * 2, "LINEAR", "NaN"),
    ],
)
def test_damaged_animations(tmp_path, times, values, interpolation, word):
    writer = triangle_scene()
    writer.animate(0, "translation", times, values, interpolation)
    refuse(writer.glb(tmp_path / "a.glb"), "animations[0]", word)


def test_sparse_indices_must_fit(tmp_path):
    writer = triangle_scene()
    writer.doc["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": writer.view(b"\x09"), "componentType": 5121},
        "values": {"bufferView": writer.view(bytes(12))},
    }
    refuse(writer.glb(tmp_path / "a.glb"), "sparse", "reaches 9")


def test_zeros_without_a_buffer_are_bounded(tmp_path):
    writer = triangle_scene()
    accessor = writer.doc["accessors"][0]
    del accessor["bufferView"]
    accessor["count"] = 10**12
    refuse(writer.glb(tmp_path / "a.glb"), "accessors[0]", "split the mesh")


def rich():
    """Returns a document that uses everything that is read, small."""
    writer = Writer()
    material = textured(
        writer, extensions={"KHR_texture_transform": {"scale": [2, 2], "rotation": 1}}
    )
    material["extensions"] = {
        "KHR_materials_emissive_strength": {"emissiveStrength": 2}
    }
    material["normalTexture"] = {"index": 0, "scale": 1, "texCoord": 0}
    material["alphaCutoff"] = 0.5
    writer.add("samplers", wrapS=33071, wrapT=33648)
    writer.doc["textures"][0]["sampler"] = 0
    writer.doc["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [
                {
                    "type": "spot",
                    "range": 3,
                    "color": [1, 1, 1],
                    "intensity": 2,
                    "spot": {"innerConeAngle": 0.1, "outerConeAngle": 0.5},
                }
            ]
        }
    }
    camera = writer.add("cameras", type="perspective", perspective={"yfov": 1})
    skinned = writer.mesh(
        indices=np.arange(3),
        joints_0=np.zeros((3, 4), np.uint8),
        weights_0=np.ones((3, 4), np.float32),
        normal=np.float32([[0, 0, 1]] * 3),
    )
    skin = writer.add(
        "skins",
        joints=[0],
        inverseBindMatrices=writer.accessor(np.eye(4, dtype=np.float32)[None]),
    )
    writer.node(mesh=skinned, skin=skin, name="skinned")
    writer.node(
        camera=camera,
        children=[0],
        translation=[1, 2, 3],
        rotation=[0, 0, 0, 1],
        scale=[1, 1, 1],
        extensions={"KHR_lights_punctual": {"light": 0}},
    )
    writer.node(matrix=np.eye(4).ravel().tolist(), mesh=0)
    writer.animate(2, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]])
    values = np.arange(18.0).reshape(6, 3)
    writer.animate(2, "translation", [0, 1], values, "CUBICSPLINE")
    writer.doc["scenes"] = [{"nodes": [1, 2, 3]}]
    writer.doc["scene"] = 0
    writer.doc["buffers"] = [{"byteLength": len(writer.data)}]
    writer.doc["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": writer.view(b"\1\0\0\0"), "componentType": 5121},
        "values": {"bufferView": writer.view(bytes(12)), "byteOffset": 0},
    }
    writer.doc["buffers"][0]["byteLength"] = len(writer.data)
    return writer


def load_or_refuse(path):
    """Returns a scene, or None where it is refused in one printable sentence."""
    try:
        return gltf.load(path)
    except InputError as error:
        message = str(error)
    assert "\n" not in message
    message.encode()
    return None


def places(value, at=()):
    """Yields the path of every entry of a JSON document."""
    if isinstance(value, dict | list):
        for key in value if isinstance(value, dict) else range(len(value)):
            yield (*at, key)
            yield from places(value[key], (*at, key))


def test_one_wrong_value_anywhere_is_an_input_error_or_harmless(tmp_path):
    writer = rich()
    original = writer.doc
    assert len(load(writer, tmp_path).meshes) == 3
    odd = [None, True, -1, 2, 3.5, 10**9, 1e308, float("nan"), "", "\ud800", [], {}]
    odd += [[[]], [None], 10**400]
    dice = random.Random(3)
    refused = 0
    for place in list(places(original)):
        for value in dice.sample(odd, 2):
            writer.doc = copy.deepcopy(original)
            edit(*place, value=value)(writer.doc)
            scene = load_or_refuse(writer.glb(tmp_path / "a.glb"))
            refused += scene is None
            if scene is not None:
                assert scene.transforms(0.4).dtype == np.float32
    assert refused > 200


def test_random_bytes_are_input_errors_or_harmless(tmp_path):
    data = rich().glb_bytes()
    dice = random.Random(7)
    for _ in range(150):
        damaged = bytearray(data)
        for _ in range(dice.choice((1, 4, 40))):
            damaged[dice.randrange(len(data))] = dice.randrange(256)
        load_or_refuse(write_bytes(tmp_path / "a.glb", bytes(damaged)))
