"""Accessors of glTF: strides, integers, sparse entries, modes and indices."""

import numpy as np
import pytest

from ataa_jax import gltf
from tests.gltf_reading import ULP, corners, load
from tests.gltf_writer import (
    TRIANGLE,
    Writer,
    solid,
    triangle_scene,
)


def test_json_with_inline_and_separate_buffers_equals_binary(tmp_path):
    writer = triangle_scene()
    scenes = [
        gltf.load(writer.glb(tmp_path / "a.glb")),
        gltf.load(writer.gltf(tmp_path / "b.gltf")),
        gltf.load(writer.gltf(tmp_path / "c.gltf", uri="c%20d.bin"))
        if (tmp_path / "c d.bin").write_bytes(bytes(writer.data))
        else None,
    ]
    for scene in scenes:
        np.testing.assert_array_equal(corners(scene.meshes[0])[0], TRIANGLE)
        assert scene.materials[scene.meshes[0].material].name == "default"
        assert scene.duration == 0.0
        assert scene.warnings == []


def test_byte_order_mark_is_accepted(tmp_path):
    path = triangle_scene().gltf(tmp_path / "a.gltf")
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert len(gltf.load(path).meshes) == 1


@pytest.mark.parametrize("stride", [12, 16, 40])
def test_strides_skip_what_lies_between(tmp_path, stride):
    writer = Writer()
    position = writer.accessor(TRIANGLE, stride=stride)
    mesh = writer.add("meshes", primitives=[{"attributes": {"POSITION": position}}])
    writer.node(mesh=mesh)
    np.testing.assert_array_equal(
        corners(load(writer, tmp_path).meshes[0])[0], TRIANGLE
    )


@pytest.mark.parametrize(
    ("dtype", "stored", "expected"),
    [
        (np.uint8, [0, 51, 255], [0.0, 0.2, 1.0]),
        (np.uint16, [0, 13107, 65535], [0.0, 0.2, 1.0]),
        (np.int8, [-128, -127, 127], [-1.0, -1.0, 1.0]),
        (np.int16, [-32768, -32767, 32767], [-1.0, -1.0, 1.0]),
    ],
)
def test_normalized_integers(tmp_path, dtype, stored, expected):
    writer = Writer()
    material = writer.add(
        "materials",
        pbrMetallicRoughness={
            "baseColorTexture": {
                "index": writer.add("textures", source=writer.image(solid("red")))
            }
        },
    )
    uv = np.stack([stored, stored], axis=1).astype(dtype)
    primitive = writer.primitive(material=material)
    primitive["attributes"]["TEXCOORD_0"] = writer.accessor(uv, normalized=True)
    writer.node(mesh=writer.add("meshes", primitives=[primitive]))
    found = load(writer, tmp_path).meshes[0].uv
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-7)  # float32 quotient


def test_quantized_positions(tmp_path):
    writer = Writer()
    writer.doc["extensionsRequired"] = ["KHR_mesh_quantization"]
    position = writer.accessor((TRIANGLE * 100).astype(np.int16), stride=8)
    mesh = writer.add("meshes", primitives=[{"attributes": {"POSITION": position}}])
    writer.node(mesh=mesh, scale=[0.01] * 3)
    found = corners(load(writer, tmp_path).meshes[0])[0]
    np.testing.assert_allclose(found, TRIANGLE, atol=ULP)


@pytest.mark.parametrize("with_base", [True, False])
def test_sparse_entries_replace_the_base_or_zeros(tmp_path, with_base):
    writer = Writer()
    sparse = {
        "count": 2,
        "indices": {
            "bufferView": writer.view(np.array([1, 2], np.uint8).tobytes()),
            "componentType": 5121,
        },
        "values": {
            "bufferView": writer.view(
                np.array([[5, 0, 0], [0, 6, 0]], np.float32).tobytes()
            )
        },
    }
    index = writer.accessor(TRIANGLE + np.float32(1), sparse=sparse)
    if not with_base:
        del writer.doc["accessors"][index]["bufferView"]
    mesh = writer.add("meshes", primitives=[{"attributes": {"POSITION": index}}])
    writer.node(mesh=mesh)
    first = [1, 1, 1] if with_base else [0, 0, 0]
    np.testing.assert_array_equal(
        corners(load(writer, tmp_path).meshes[0])[0], [first, [5, 0, 0], [0, 6, 0]]
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32])
@pytest.mark.parametrize(
    ("mode", "indices", "expected"),
    [
        (4, [2, 1, 0, 1, 2, 3], [[2, 1, 0], [1, 2, 3]]),
        # the specification's own formulas (3.7.2.1)
        (5, [0, 1, 2, 3], [[0, 1, 2], [1, 3, 2]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
        (5, [0, 1, 2, 2, 3, 0], [[0, 1, 2], [2, 0, 3]]),  # stitches are dropped
    ],
)
def test_modes_and_index_types(tmp_path, dtype, mode, indices, expected):
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    writer = Writer()
    writer.node(mesh=writer.mesh(square, np.array(indices, dtype), mode=mode))
    mesh = load(writer, tmp_path).meshes[0]
    np.testing.assert_array_equal(mesh.triangles, expected)


def test_points_and_lines_are_left_out_with_a_warning(tmp_path):
    writer = triangle_scene()
    for mode in range(4):
        writer.node(mesh=writer.mesh(mode=mode))
    scene = load(writer, tmp_path)
    assert len(scene.meshes) == 1
    assert scene.warnings == ["points and lines are left out"]


def test_unused_vertices_are_dropped(tmp_path):
    many = np.arange(300, dtype=np.float32).reshape(100, 3)
    writer = Writer()
    writer.node(mesh=writer.mesh(many, np.array([90, 5, 7], np.uint16), normal=many))
    mesh = load(writer, tmp_path).meshes[0]
    np.testing.assert_array_equal(corners(mesh)[0], many[[90, 5, 7]])
    assert len(mesh.position) == len(mesh.normal) == 3
