"""Nodes of glTF: what is placed where, and which way it faces."""

import numpy as np
import pytest

from ataa_jax import types
from tests.gltf_reading import QUARTER, ULP, corners, load, planes
from tests.gltf_writer import (
    TRIANGLE,
    Writer,
    triangle_scene,
)


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
