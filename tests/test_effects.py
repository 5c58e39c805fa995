"""Effects: what a scene calls for, and that the rest changes nothing."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ataa_jax import effects, raster, scene, shading
from ataa_jax import world as worlds
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
    on = {effect.name for effect in effects.look(world.scene) if effect.on}
    assert on == {"shadows", "sky"}
    assert all(effect.reason for effect in effects.look(world.scene))


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
