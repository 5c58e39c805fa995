"""What is supplied to scenes that bring no light, no sky and no camera."""

from dataclasses import replace

import numpy as np
import pytest

from ataa_jax import lighting, types
from ataa_jax import world as worlds
from ataa_jax.camera import look_at
from ataa_jax.errors import InputError
from ataa_jax.scene import CameraSource, LightSource, SceneSource
from tests import tiny
from tests.test_pipeline import mesh, source

WHITE = replace(source().materials[0], name="white", base_color=(0.8, 0.8, 0.8, 1.0))


def bare(parts: list[tiny.Part], **fields) -> SceneSource:
    meshes = [mesh(part, f"part {i}", 0) for i, part in enumerate(parts)]
    return SceneSource("bare", meshes, [WHITE], **fields)


def room_camera() -> CameraSource:
    return CameraSource(
        "inside", look_at(np.array([0.0, 0.0, 3.5]), np.zeros(3)), np.radians(60)
    )


def test_outdoors_a_sun_and_a_sky_are_supplied_and_told():
    world = worlds.prepare(bare([tiny.floor(20.0), tiny.cube(2.0)]))
    assert [light.kind for light in world.lights] == [types.LIGHT_DIRECTIONAL]
    told = " ".join(world.notes)
    assert "a sun was supplied" in told
    assert "sky" in told
    assert float(world.scene.sky.visibility) > 0.5


def test_indoors_point_lights_are_placed_in_the_room_and_the_sky_is_shut_out():
    world = worlds.prepare(bare([tiny.cube(8.0)], cameras=[room_camera()]))
    assert {light.kind for light in world.lights} == {types.LIGHT_POINT}
    for light in world.lights:
        assert np.all(np.abs(light.position) < 4.0)
    # A few of the 73,728 rays start in the very corners of the room.
    assert float(world.scene.sky.visibility) < 1e-3
    assert sum("cd" in note for note in world.notes) == len(world.lights)


def test_authored_lights_are_kept():
    lamp = LightSource(types.LIGHT_POINT, (9.0, 9.0, 9.0), position=(0.0, 3.0, 0.0))
    world = worlds.prepare(bare([tiny.floor(20.0)], lights=[lamp]))
    assert world.lights == [lamp]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_the_framing_camera_sees_the_scene_at_any_scale(scale):
    part = tiny.sphere(radius=scale)
    world = worlds.prepare(bare([part]))
    camera = world.camera(None)
    points = lighting.look(
        world.tracer, world.scene, world.source.transforms(0.0), camera
    )
    assert 0.1 < points.hit.mean() < 0.8
    assert world.focus(camera) == pytest.approx(2.5 * scale, rel=0.5)


def test_exposure_makes_the_picture_independent_of_the_lights_unit():
    lamps = [
        [LightSource(types.LIGHT_DIRECTIONAL, (s, s, s), direction=(-0.3, -1.0, -0.2))]
        for s in (1.0, 50_000.0)
    ]
    parts = [tiny.floor(20.0), tiny.cube(2.0)]
    exposed = [
        worlds.prepare(bare(parts, lights=lamp)).scene.lights.intensity
        for lamp in lamps
    ]
    np.testing.assert_allclose(exposed[0], exposed[1], rtol=1e-3)


def test_a_missing_camera_is_named_with_those_there_are():
    world = worlds.prepare(bare([tiny.floor(2.0)], cameras=[room_camera()]))
    with pytest.raises(InputError, match=r"no camera 'x'.*inside"):
        world.camera("x")


def test_a_missing_scene_is_one_clear_sentence(tmp_path):
    for name in ("none.glb", "none.obj"):
        with pytest.raises(InputError, match=name):
            worlds.load(tmp_path / name)


def test_content_hash_follows_the_content():
    first = worlds.prepare(bare([tiny.floor(2.0)], cameras=[room_camera()]))
    same = worlds.prepare(bare([tiny.floor(2.0)], cameras=[room_camera()]))
    other = worlds.prepare(bare([tiny.floor(3.0)], cameras=[room_camera()]))
    assert first.content_hash == same.content_hash
    assert first.content_hash != other.content_hash


def test_a_still_path_of_a_still_scene_has_equal_cameras():
    world = worlds.prepare(source())
    shot = worlds.shot(world, "still", (9, 16))
    inputs = shot.inputs(3)
    np.testing.assert_array_equal(
        inputs.camera.world_from_view, inputs.previous_camera.world_from_view
    )
    assert not bool(inputs.cut)
    assert bool(shot.inputs(0).cut)
