"""The glTF reader: what it must understand, and what it must refuse in one sentence."""

import copy
import random
import struct
import zlib

import numpy as np
import pytest

from ataa_jax import gltf, types
from ataa_jax.errors import InputError
from ataa_jax.gltf import materials as gltf_materials
from tests.gltf_writer import (
    TRIANGLE,
    Writer,
    encode,
    solid,
    triangle_scene,
    write_bytes,
)
from tests.scenes import scene_path

QUARTER = np.sqrt(0.5)  # sine and cosine of a quarter turn's half angle
# Positions are float32 of float64 products of small numbers: an ulp or two of 1.
ULP = 3e-7


def load(writer, tmp_path):
    return gltf.load(writer.glb(tmp_path / "scene.glb"))


def corners(mesh):
    """Returns the corners of a mesh's triangles, (t, 3, 3)."""
    return mesh.position[mesh.triangles]


def planes(mesh):
    a, b, c = corners(mesh).transpose(1, 0, 2)
    plane = np.cross(b - a, c - a)
    return plane / np.linalg.norm(plane, axis=1, keepdims=True)


def refuse(path, *words):
    """Checks that loading fails in one sentence that has all `words` in it."""
    with pytest.raises(InputError) as caught:
        gltf.load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    for word in words:
        assert word in message
    return message


# --- Real scenes ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "triangles", "groups", "cameras", "lights", "duration"),
    [  # counted by an independent walk over the files' JSON
        ("sponza.glb", 262267, 1, 1, 4, 0.0),
        ("modern_house.glb", 627309, 2, 2, 0, 1.5),
        ("dutch_ship.glb", 69162, 1, 0, 0, 0.0),
        ("littlest_tokyo.glb", 88978, 40, 0, 0, 10.0),
        ("cesium_milk_truck.glb", 3624, 3, 0, 0, 1.25),
    ],
)
def test_real_scenes_load(name, triangles, groups, cameras, lights, duration):
    scene = gltf.load(scene_path(name))
    assert sum(len(mesh.triangles) for mesh in scene.meshes) == triangles
    assert len(scene.group_names) == groups
    assert len(scene.cameras) == cameras
    assert len(scene.lights) == lights
    assert scene.duration == pytest.approx(duration, abs=1e-6)
    moved = scene.transforms(0.4)
    assert moved.shape == (groups, 3, 4)
    assert moved.dtype == np.float32
    np.testing.assert_array_equal(moved[0], np.eye(3, 4))
    for mesh in scene.meshes:
        assert mesh.position.dtype == np.float32
        assert mesh.triangles.dtype == np.int32
        assert mesh.triangles.max() < len(mesh.position)
        assert mesh.normal is not None
        length = np.linalg.norm(mesh.normal, axis=1)
        np.testing.assert_allclose(length, 1, atol=1e-6)  # float32 of a unit vector
        assert mesh.material < len(scene.materials)


def test_truck_wheels_turn_about_their_axles():
    scene = gltf.load(scene_path("cesium_milk_truck.glb"))
    start, quarter = scene.transforms(0.0), scene.transforms(scene.duration / 4)
    for group in (1, 2):
        np.testing.assert_allclose(start[group, :, 3], quarter[group, :, 3], atol=ULP)
        # z is the axle; the others turn
        np.testing.assert_allclose(start[group, :, 2], quarter[group, :, 2], atol=ULP)
        assert np.abs(start[group, :, 1] - quarter[group, :, 1]).max() > 0.5


# --- Accessors ------------------------------------------------------------------------


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


# --- Nodes ----------------------------------------------------------------------------


def test_instances_are_baked_into_the_world(tmp_path):
    writer = Writer()
    mesh = writer.mesh()
    writer.node(mesh=mesh, name="one", translation=[1, 2, 3])
    child = writer.node(mesh=mesh, name="two", translation=[1, 0, 0])
    writer.node(
        children=[child], rotation=[0, 0, QUARTER, QUARTER], translation=[0, 0, 5]
    )
    scene = load(writer, tmp_path)
    assert [m.name for m in scene.meshes] == ["one", "two"]
    np.testing.assert_array_equal(
        corners(scene.meshes[0])[0], np.add(TRIANGLE, [1, 2, 3])
    )
    np.testing.assert_allclose(
        corners(scene.meshes[1])[0], [[0, 1, 5], [0, 2, 5], [-1, 1, 5]], atol=ULP
    )


def test_a_matrix_is_column_major(tmp_path):
    writer = Writer()
    matrix = [2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 1, 0, 7, 8, 9, 1]
    writer.node(mesh=writer.mesh(), matrix=matrix)
    np.testing.assert_array_equal(
        corners(load(writer, tmp_path).meshes[0])[0], TRIANGLE * [2, 3, 1] + [7, 8, 9]
    )


def test_only_the_default_scene_is_shown(tmp_path):
    writer = Writer()
    mesh = writer.mesh()
    writer.node(mesh=mesh, name="shown")
    writer.node(mesh=mesh, name="hidden")
    writer.doc["scenes"] = [{"nodes": [1]}, {"nodes": [0]}]
    writer.doc["scene"] = 1
    assert [m.name for m in load(writer, tmp_path).meshes] == ["shown"]


def test_mirroring_keeps_the_outside_outside(tmp_path):
    writer = Writer()
    normal = np.tile(np.float32([0, 0, 1]), (3, 1))
    mesh = writer.mesh(normal=normal)
    writer.node(mesh=mesh)
    writer.node(mesh=mesh, scale=[-1, 1, 1])
    writer.node(mesh=mesh, scale=[-1, -1, -1])
    for scene_mesh, z in zip(load(writer, tmp_path).meshes, (1, 1, -1), strict=True):
        np.testing.assert_allclose(planes(scene_mesh), [[0, 0, z]], atol=ULP)
        np.testing.assert_allclose(scene_mesh.normal[0], [0, 0, z], atol=ULP)


def test_normals_follow_the_inverse_transpose(tmp_path):
    slope = np.array([[0, 0, 0], [1, 0, -1], [0, 1, 0]], np.float32)
    normal = np.tile(np.float32([QUARTER, 0, QUARTER]), (3, 1))
    writer = Writer()
    mesh = writer.mesh(slope, normal=normal)
    writer.node(mesh=mesh, scale=[4, 1, 1])
    writer.node(mesh=mesh, scale=[4, 1, 0])  # flat, yet its normal is defined
    first, second = load(writer, tmp_path).meshes
    np.testing.assert_allclose(first.normal, planes(first).repeat(3, 0), atol=ULP)
    np.testing.assert_allclose(second.normal[0], [0, 0, 1], atol=ULP)


def test_zero_normals_become_those_of_the_triangles(tmp_path):
    writer = Writer()
    writer.node(mesh=writer.mesh(normal=np.zeros((3, 3), np.float32)))
    np.testing.assert_array_equal(
        load(writer, tmp_path).meshes[0].normal, np.tile([0, 0, 1], (3, 1))
    )


def test_missing_normals_stay_missing(tmp_path):
    assert load(triangle_scene(), tmp_path).meshes[0].normal is None


def test_cameras_lose_their_scale(tmp_path):
    writer = triangle_scene()
    camera = writer.add(
        "cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1}
    )
    flat = writer.add("cameras", type="orthographic", orthographic={})
    child = writer.node(
        camera=camera, name="eye", rotation=[0, QUARTER, 0, QUARTER], scale=[2, 2, 2]
    )
    writer.node(children=[child], scale=[1, -3, 1], translation=[4, 5, 6])
    writer.node(camera=flat, name="plan")
    scene = load(writer, tmp_path)
    assert [c.name for c in scene.cameras] == ["eye"]
    pose = scene.cameras[0].world_from_view
    assert scene.cameras[0].fov_y == 0.7
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose) == pytest.approx(1)
    np.testing.assert_allclose(pose[:3, 2], [1, 0, 0], atol=1e-12)  # looks along −x
    np.testing.assert_allclose(pose[:3, 3], [4, 5, 6])
    assert scene.warnings == ["camera 'plan' is not a perspective one; left out"]


def test_lights_are_placed_and_scaled_by_intensity(tmp_path):
    writer = triangle_scene()
    writer.doc["extensionsRequired"] = ["KHR_lights_punctual"]
    writer.doc["extensions"] = {
        "KHR_lights_punctual": {
            "lights": [
                {"type": "directional", "color": [1, 0.5, 0], "intensity": 4},
                {"type": "point", "range": 7, "name": "bulb"},
                {"type": "spot", "spot": {"innerConeAngle": 0.1, "outerConeAngle": 1}},
            ]
        }
    }
    for index in range(3):
        writer.node(
            translation=[index, 0, 0],
            rotation=[-QUARTER, 0, 0, QUARTER],  # −z turns to −y
            extensions={"KHR_lights_punctual": {"light": index}},
        )
    sun, bulb, spot = load(writer, tmp_path).lights
    assert sun.kind == types.LIGHT_DIRECTIONAL
    assert sun.intensity == (4.0, 2.0, 0.0)
    np.testing.assert_allclose(sun.direction, [0, -1, 0], atol=1e-12)
    assert (bulb.kind, bulb.name, bulb.range) == (types.LIGHT_POINT, "bulb", 7.0)
    assert bulb.position == (1.0, 0.0, 0.0)
    assert spot.kind == types.LIGHT_SPOT
    assert (spot.inner_cone_angle, spot.outer_cone_angle) == (0.1, 1.0)
    assert spot.range == np.inf


# --- Animation ------------------------------------------------------------------------


def animated(tmp_path, path, times, values, interpolation="LINEAR"):
    writer = triangle_scene()
    writer.doc["nodes"][0]["name"] = "mover"
    writer.animate(0, path, times, values, interpolation)
    return load(writer, tmp_path)


def test_linear_translation_is_held_and_loops(tmp_path):
    scene = animated(tmp_path, "translation", [1, 3], [[0, 0, 0], [4, 0, 0]])
    assert scene.group_names == ["static", "mover"]
    assert scene.meshes[0].group == 1
    assert scene.duration == 3.0
    np.testing.assert_array_equal(corners(scene.meshes[0])[0], TRIANGLE)
    found = [scene.transforms(t)[1, 0, 3] for t in (0.0, 1.0, 2.0, 2.5, 3.0, 5.0, -0.5)]
    np.testing.assert_allclose(found, [0, 0, 2, 3, 0, 2, 3], atol=ULP)


def test_step_keeps_each_key_until_the_next(tmp_path):
    values = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]
    scene = animated(tmp_path, "translation", [0, 1, 2], values, "STEP")
    found = [scene.transforms(t)[1, 0, 3] for t in (0.0, 0.99, 1.0, 1.99)]
    np.testing.assert_array_equal(found, [0, 0, 1, 1])


@pytest.mark.parametrize("sign", [1, -1])
def test_rotations_turn_evenly_along_the_shorter_arc(tmp_path, sign):
    end = sign * np.array([0, 0, QUARTER, QUARTER])
    scene = animated(tmp_path, "rotation", [0, 1], [[0, 0, 0, 1], end])
    for time in (0.25, 0.5, 0.75):
        matrix = scene.transforms(time)[1]
        angle = np.arctan2(matrix[1, 0], matrix[0, 0])
        assert angle == pytest.approx(time * np.pi / 2, abs=1e-6)  # float32 entries


def test_cubic_spline_follows_its_tangents(tmp_path):
    # in-tangent, value, out-tangent of each key; over two seconds
    zero = [0, 0, 0]
    values = [zero, zero, [3, 0, 0], [-1, 0, 0], [4, 0, 0], zero]
    scene = animated(tmp_path, "translation", [0, 2], values, "CUBICSPLINE")
    time = np.array([0.0, 0.5, 1.0, 1.7])
    s = time / 2
    expected = (
        (s**3 - 2 * s**2 + s) * 2 * 3
        + (3 * s**2 - 2 * s**3) * 4
        + (s**3 - s**2) * 2 * -1
    )
    found = [scene.transforms(t)[1, 0, 3] for t in time]
    np.testing.assert_allclose(found, expected, atol=2 * ULP)


def test_cubic_rotations_stay_rotations(tmp_path):
    zero = [0, 0, 0, 0]
    values = [zero, [0, 0, 0, 1], zero, zero, [0, 1, 0, 0], zero]
    scene = animated(tmp_path, "rotation", [0, 1], values, "CUBICSPLINE")
    matrix = scene.transforms(0.3)[1, :, :3]
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)  # float32


def test_normalized_integer_rotations(tmp_path):
    writer = triangle_scene()
    writer.animate(0, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]])
    sampler = writer.doc["animations"][0]["samplers"][0]
    keys = np.array([[0, 0, 0, 32767], [0, 0, 32767, 0]], np.int16)
    sampler["output"] = writer.accessor(keys, normalized=True)
    scene = load(writer, tmp_path)
    np.testing.assert_allclose(scene.transforms(0.5)[1, 1, 0], 1, atol=ULP)


def test_groups_hang_on_the_nearest_animated_ancestor(tmp_path):
    writer = Writer()
    mesh = writer.mesh()
    leaf = writer.node(mesh=mesh, name="leaf", translation=[1, 0, 0])
    joint = writer.node(children=[leaf], name="joint")
    still = writer.node(children=[joint], name="still", translation=[0, 10, 0])
    body = writer.node(children=[still], mesh=mesh, name="body")
    writer.node(children=[body], translation=[0, 0, 100])
    writer.node(mesh=mesh, name="ground")
    writer.animate(joint, "rotation", [0, 1], [[0, 0, 0, 1], [0, 0, 1, 0]])
    writer.animate(body, "translation", [0, 2], [[0, 0, 0], [2, 0, 0]])
    scene = load(writer, tmp_path)
    group = {m.name: m.group for m in scene.meshes}
    assert scene.group_names == ["static", "body", "joint"]
    assert group == {"body": 1, "leaf": 2, "ground": 0}
    leaf_mesh = next(m for m in scene.meshes if m.name == "leaf")
    np.testing.assert_array_equal(leaf_mesh.position[0], [1, 0, 0])  # joint's space
    assert scene.duration == 2.0
    body_pose, joint_pose = scene.transforms(1.0)[1:]
    np.testing.assert_allclose(body_pose[:, 3], [1, 0, 100], atol=ULP)
    np.testing.assert_allclose(joint_pose[:, 3], [1, 10, 100], atol=ULP)
    # half a turn about z: (1, 0, 0) in the joint's space goes to −x
    np.testing.assert_allclose(joint_pose @ [1, 0, 0, 1], [0, 10, 100], atol=4 * ULP)


def test_moving_groups_below_a_mirror_keep_their_outside(tmp_path):
    writer = Writer()
    child = writer.node(mesh=writer.mesh(normal=np.float32([[0, 0, 1]] * 3)))
    writer.node(children=[child], scale=[-1, 1, 1])
    writer.animate(child, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
    scene = load(writer, tmp_path)
    matrix = scene.transforms(0.5)[1]
    mesh = scene.meshes[0]
    a, b, c = (corners(mesh)[0] @ matrix[:, :3].T) + matrix[:, 3]
    assert np.cross(b - a, c - a)[2] > 0


def test_constant_channels_pose_without_moving(tmp_path):
    scene = animated(tmp_path, "translation", [0, 1], [[5, 0, 0], [5, 0, 0]])
    assert scene.group_names == ["static"]
    assert scene.duration == 0.0
    np.testing.assert_array_equal(
        corners(scene.meshes[0])[0], np.add(TRIANGLE, [5, 0, 0])
    )
    np.testing.assert_array_equal(scene.transforms(0.7), np.eye(3, 4)[None])


def test_another_take_of_the_same_nodes_is_not_played(tmp_path):
    writer = triangle_scene()
    writer.animate(0, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
    second = writer.animate(0, "translation", [0, 9], [[0, 0, 0], [9, 0, 0]])
    writer.doc["animations"][second]["name"] = "take two"
    scene = load(writer, tmp_path)
    assert scene.duration == 1.0
    assert "take two" in scene.warnings[0]


def test_animated_cameras_and_lights_stay_as_at_the_start(tmp_path):
    writer = triangle_scene()
    camera = writer.add("cameras", type="perspective", perspective={"yfov": 1})
    writer.doc["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    node = writer.node(
        camera=camera,
        name="rig",
        extensions={"KHR_lights_punctual": {"light": 0}},
    )
    writer.animate(node, "translation", [0, 1], [[3, 0, 0], [4, 0, 0]])
    scene = load(writer, tmp_path)
    np.testing.assert_array_equal(scene.cameras[0].world_from_view[:3, 3], [3, 0, 0])
    assert scene.lights[0].position == (3.0, 0.0, 0.0)
    assert sorted(scene.warnings) == [
        "camera 'rig' is animated; it stays as at t = 0",
        "light 'rig' is animated; it stays as at t = 0",
    ]


def test_skins_are_drawn_in_their_first_pose(tmp_path):
    writer = Writer()
    mesh = writer.mesh(
        joints_0=np.array([[0, 0, 0, 0], [1, 0, 0, 0], [0, 1, 0, 0]], np.uint8),
        weights_0=np.array([[1, 0, 0, 0], [1, 0, 0, 0], [0.5, 0.5, 0, 0]], np.float32),
        normal=np.float32([[0, 0, 1]] * 3),
    )
    first = writer.node(translation=[0, 0, 2])
    second = writer.node(translation=[0, 8, 0])
    inverse = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    inverse[1, 3, :3] = [10, 0, 0]  # column-major: the translation
    skin = writer.add(
        "skins", joints=[first, second], inverseBindMatrices=writer.accessor(inverse)
    )
    writer.node(mesh=mesh, skin=skin, translation=[500, 0, 0])  # ignored
    writer.animate(second, "translation", [0, 1], [[0, 4, 0], [0, 5, 0]])
    scene = load(writer, tmp_path)
    np.testing.assert_allclose(
        corners(scene.meshes[0])[0], [[0, 0, 2], [11, 4, 0], [5, 3, 1]], atol=4 * ULP
    )
    assert scene.meshes[0].group == 0
    assert scene.warnings == [
        "skinned meshes stand still, in their pose of t = 0: 1 triangles"
    ]


def test_ignored_features_are_named(tmp_path):
    writer = Writer()
    writer.doc["extensionsUsed"] = ["KHR_materials_clearcoat", "KHR_lights_punctual"]
    primitive = writer.primitive(targets=[{}])
    primitive["attributes"]["COLOR_0"] = writer.accessor(TRIANGLE)
    writer.node(mesh=writer.add("meshes", primitives=[primitive]))
    writer.animate(0, "weights", [0, 1], [0, 1])
    assert sorted(load(writer, tmp_path).warnings) == [
        "animation of 'weights' is ignored",
        "ignored the extensions KHR_materials_clearcoat",
        "morph targets are ignored",
        "vertex colours are ignored",
    ]


# --- Materials ------------------------------------------------------------------------


def textured(writer, **info):
    """Adds a textured triangle and returns its material's record."""
    image = writer.image(solid((10, 20, 30, 40)))
    texture = writer.add("textures", source=image)
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": texture} | info}}
    writer.doc["materials"] = [material]
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    writer.node(mesh=writer.mesh(texcoord_0=uv, material=0))
    return material


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


def test_blended_materials_pass_with_one_warning(tmp_path):
    writer = Writer()
    for name in ("glass", "water"):
        writer.add("materials", name=name, alphaMode="BLEND")
    for index in range(2):
        writer.node(mesh=writer.mesh(material=index))
    scene = load(writer, tmp_path)
    assert [m.alpha_mode for m in scene.materials] == ["BLEND", "BLEND"]
    assert scene.warnings == [
        "blended materials are drawn where alpha >= 0.5, skipped elsewhere: 'glass', "
        "'water'"
    ]


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
    assert scene.textures[0].texels is scene.textures[1].texels


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


# --- Refusals -------------------------------------------------------------------------


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
    refuse(writer.glb(tmp_path / "a.glb"), "2x2 texels", "scale the textures down")
    monkeypatch.setattr(gltf_materials, "MAX_IMAGE_TEXELS", 4)
    monkeypatch.setattr(gltf_materials, "MAX_TEXELS", 3)
    refuse(writer.glb(tmp_path / "a.glb"), "2x2 texels", "scale the textures down")


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
