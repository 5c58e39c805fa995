"""The glTF reader on real scenes."""

import numpy as np
import pytest

from ataa_jax import gltf
from tests.gltf_reading import ULP
from tests.scenes import scene_path


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
