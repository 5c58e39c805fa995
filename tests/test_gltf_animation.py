"""Animation of glTF: interpolation, groups, takes, skins."""

import numpy as np
import pytest

from tests.gltf_reading import QUARTER, ULP, corners, load
from tests.gltf_writer import (
    TRIANGLE,
    Writer,
    triangle_scene,
)


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
