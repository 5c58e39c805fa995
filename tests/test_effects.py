"""Effects: what a scene calls for, and that the rest changes nothing."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ataa_jax import effects, pipeline, raster, scene, shading
from ataa_jax import world as worlds
from ataa_jax.errors import InputError
from tests.test_pipeline import source

SIZE = (18, 32)


@pytest.fixture(scope="module")
def world():
    return worlds.prepare(source())


def draw(world, config: shading.Config) -> np.ndarray:
    shot = worlds.shot(world, "still", SIZE)
    out = raster.raster(
        world.scene,
        shot.inputs(0),
        raster.default_params(),
        tracer=world.tracer,
        config=raster.Config(size=SIZE, shading=config),
    )
    return np.asarray(out.color)


def test_a_plain_scene_calls_for_shadows_and_sky_only(world):
    on = {effect.name for effect in world.looked if effect.on}
    assert on == {"shadows", "sky", "camera-motion"}
    assert all(effect.reason for effect in world.looked)
    assert {effect.name for effect in world.looked} == set(effects.NAMES)


def test_an_effect_that_is_not_called_for_changes_no_bit(world):
    needed = effects.required(world.scene)
    expected = draw(world, needed)
    for field in fields(shading.Config):
        if not getattr(needed, field.name):
            found = draw(world, replace(needed, **{field.name: True}))
            np.testing.assert_array_equal(found, expected, err_msg=field.name)


def test_a_textured_emissive_scene_calls_for_both():
    white = np.full((2, 2, 4), 255, np.uint8)
    base = source()
    lit = replace(base.materials[0], emissive=(1.0, 0.5, 0.2), base_color_texture=0)
    packed, _ = scene.pack(
        replace(
            base,
            materials=[lit, *base.materials[1:]],
            textures=[scene.TextureSource(white, srgb=True)],
        )
    )
    config = effects.required(packed)
    assert config.base_color_textures
    assert config.emission
    assert not config.emissive_textures
    assert not config.normal_maps


def test_a_subset_leaves_the_rest_out():
    bare = worlds.prepare(source(), wish=effects.parse("sky"))
    assert bare.shading == shading.Config(
        **{field.name: field.name == "sky" for field in fields(shading.Config)}
    )
    shot = worlds.shot(bare, "walk", SIZE)
    assert not shot.camera_moves
    out = raster.raster(
        bare.scene,
        shot.inputs(3),
        raster.default_params(),
        tracer=bare.tracer,
        config=raster.Config(size=SIZE, shading=bare.shading),
    )
    assert int(out.shadow_rays) == 0


def test_all_changes_nothing():
    """Every effect compiled in, those that the scene does not call for included."""
    plain = worlds.prepare(source(moving=True))
    full = worlds.prepare(source(moving=True), wish=effects.parse("all"))
    assert full.shading != plain.shading
    for world, expected in ((full, True), (plain, True)):
        shot = worlds.shot(world, "walk", SIZE)
        assert shot.effects.camera_motion == shot.effects.object_motion == expected
    a, b = (
        [world_frame(world, index) for index in range(3)] for world in (plain, full)
    )
    np.testing.assert_array_equal(a, b)


def world_frame(world, index: int) -> np.ndarray:
    shot = worlds.shot(world, "walk", SIZE)
    config, params = pipeline.preset("tuned", world.scene, SIZE, selection=shot.effects)
    output, _ = pipeline.frame(
        pipeline.init(SIZE),
        shot.inputs(index),
        params,
        scene=world.scene,
        tracer=world.tracer,
        config=config,
    )
    return np.asarray(output.image)


def test_a_still_sequence_compiled_without_motion_has_the_same_frames(world):
    shot = worlds.shot(world, "still", SIZE)
    assert not shot.effects.camera_motion
    assert not shot.effects.object_motion

    def buffers(**motion):
        config = raster.Config(size=SIZE, shading=world.shading, **motion)
        out = raster.raster(
            world.scene,
            shot.inputs(2, np.array([0.2, -0.3], np.float32)),
            raster.default_params(),
            tracer=world.tracer,
            config=config,
        )
        return out.gbuffer

    general = buffers()
    fixed = buffers(camera_motion=False, object_motion=False)
    np.testing.assert_array_equal(fixed.motion, general.motion)
    np.testing.assert_array_equal(fixed.motion_valid, general.motion_valid)


def test_what_the_scene_cannot_have_is_said():
    asked = worlds.prepare(source(), wish=effects.parse("normal-maps,shadows"))
    (said,) = [note for note in asked.notes if "asked for" in note]
    assert "normal-maps" in said
    assert "0 of 4 materials" in said


@pytest.mark.parametrize("text", ["", " , ", "shadow", "no-fog", "all,fog"])
def test_unknown_effects_are_refused(text):
    with pytest.raises(InputError, match="--effects"):
        effects.parse(text)


def test_names_make_a_subset_and_no_makes_an_exception():
    assert effects.parse("no-sky").keeps("shadows")
    assert not effects.parse("no-sky").keeps("sky")
    assert not effects.parse("shadows").keeps("sky")
    assert effects.parse("all").keeps("sky")
    assert effects.parse("all").everything
    assert not effects.parse("all,no-sky").keeps("sky")
