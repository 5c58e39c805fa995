"""Raster stage and shading on scenes whose pixels can be worked out by hand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import effects, embree, raster
from tests import frames, tiny
from tests.oracles import shading as oracle

SIZE = (18, 32)
BLACK_SKY = tiny.Sky((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def draw(scene, inputs, size=SIZE, **options) -> raster.RasterOutput:
    config = raster.Config(size=size, shading=effects.required(scene), **options)
    return raster.raster(
        scene,
        inputs,
        raster.default_params(),
        tracer=embree.build(scene),
        config=config,
    )


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_radiance_equals_the_brdf_oracle(roughness, metallic):
    toward = np.array([0.3, 0.8, 0.4])
    toward /= np.linalg.norm(toward)
    material = tiny.Material(
        (0.8, 0.5, 0.2, 1.0), metallic=metallic, roughness=roughness
    )
    light = tiny.Light(direction=tuple(-toward), intensity=(3.0, 2.0, 1.0))
    scene = tiny.scene([tiny.floor(100.0)], [material], lights=[light], sky=BLACK_SKY)
    eye = np.array([0.0, 2.0, 5.0])
    out = draw(scene, frames.inputs(tuple(eye), (0.0, 0.0, 0.0)), size=(1, 1))
    view = eye / np.linalg.norm(eye)
    expected = oracle.reflect(
        np.array([0.8, 0.5, 0.2]), metallic, roughness, np.array([0.0, 1, 0]), view,
        toward,
    ) * np.array([3.0, 2.0, 1.0])  # fmt: skip
    # At roughness 0 the highlight's exponent magnifies float32 cosines 1e5 times.
    rtol = 2e-2 if roughness == 0.0 else 1e-4
    np.testing.assert_allclose(out.color[0, 0], expected, rtol=rtol, atol=1e-7)


def test_point_and_spot_lights_fall_off_as_the_extension_says():
    def brightness(**light) -> float:
        lamp = tiny.Light(**{"position": (0.0, 2.0, 0.0), "kind": 1, **light})
        scene = tiny.scene([tiny.floor(50.0)], lights=[lamp], sky=BLACK_SKY)
        inputs = frames.inputs((0.0, 6.0, 0.01), (0.0, 0.0, 0.0))
        return float(draw(scene, inputs, size=(1, 1)).color[0, 0, 0])

    base = brightness()
    assert brightness(position=(0.0, 4.0, 0.0)) == pytest.approx(base / 4, rel=1e-3)
    assert brightness(range=2.0) == 0.0
    assert brightness(range=4.0) == pytest.approx(base * (1 - 1 / 16), rel=1e-3)
    spot = {"kind": 2, "direction": (0.0, -1.0, 0.0), "cos_inner": 0.9}
    assert brightness(**spot, cos_outer=0.5) == pytest.approx(base, rel=1e-5)
    aside = {**spot, "direction": (1.0, 0.0, 0.0)}
    assert brightness(**aside, cos_outer=0.5) == 0.0


def test_depth_is_the_planes_distance_along_the_view_axis():
    scene = tiny.scene([tiny.quad(20.0)])
    out = draw(scene, frames.inputs((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)))
    np.testing.assert_allclose(out.gbuffer.depth, 5.0, rtol=1e-6)
    np.testing.assert_allclose(
        out.gbuffer.normal, np.broadcast_to([0.0, 0.0, 1.0], (*SIZE, 3)), atol=1e-6
    )


def test_sky_pixels_have_infinite_depth_and_the_skys_own_radiance():
    sky = tiny.Sky((0.1, 0.2, 0.9), (0.5, 0.6, 0.7), (0.2, 0.1, 0.0))
    scene = tiny.scene([tiny.quad(0.01, (0.0, -50.0, 0.0))], sky=sky)
    out = draw(scene, frames.inputs((0.0, 0.0, 5.0), (0.0, 1000.0, 4.9)))
    assert np.all(np.isinf(out.gbuffer.depth))
    assert np.all(out.gbuffer.object == -1)
    middle = np.asarray(out.color)[9, 16]
    np.testing.assert_allclose(middle, [0.1, 0.2, 0.9], rtol=1e-2)


def test_a_translation_predicts_its_motion_vectors():
    # A plane at depth 5 and a camera that moved by 0.1 to the right: every point was
    # 0.1 / (5 · pixel size) further right in the previous image.
    scene = tiny.scene([tiny.quad(40.0)])
    out = draw(
        scene,
        frames.inputs(
            (0.0, 0.0, 5.0), (0.0, 0.0, 0.0),
            previous_eye=(-0.1, 0.0, 5.0), previous_target=(-0.1, 0.0, 0.0),
            jitter=(0.3, -0.2),
        ),
    )  # fmt: skip
    pixel = 2 * np.tan(0.45) / SIZE[0]
    motion = np.asarray(out.gbuffer.motion)
    np.testing.assert_allclose(motion[..., 0], 0.1 / (5 * pixel), rtol=1e-4)
    np.testing.assert_allclose(motion[..., 1], 0.0, atol=1e-4)
    # Only what was beyond the right edge has no previous position.
    valid = np.asarray(out.gbuffer.motion_valid)
    x = np.arange(SIZE[1]) + 0.5 + motion[0, 0, 0]
    np.testing.assert_array_equal(valid, np.broadcast_to(x <= SIZE[1], SIZE))


def test_a_moving_object_has_its_own_motion_and_the_still_floor_none():
    # Two groups: a floor, and a cube that moved by +0.2 in x since the last frame.
    cube = replace(tiny.cube(1.0, (0.0, 0.5, 0.0)), group=1)
    scene = tiny.scene([tiny.floor(40.0), cube])
    now = np.stack([tiny.still()[0], tiny.moved((0.2, 0.0, 0.0))])
    then = tiny.still(2)
    inputs = frames.inputs(groups=now, previous_groups=then)
    out = draw(scene, inputs, size=(36, 64))
    object_ids = np.asarray(out.gbuffer.object)
    motion = np.asarray(out.gbuffer.motion)
    assert np.any(object_ids == 1)
    np.testing.assert_array_equal(motion[object_ids == 0], 0.0)
    assert np.all(motion[object_ids == 1][:, 0] < -0.5)


def test_nothing_moves_gives_motion_of_exactly_zero():
    scene = tiny.scene([tiny.floor(), tiny.sphere()])
    out = draw(scene, frames.inputs((1.3, 2.1, 4.7), jitter=(0.21, 0.17)))
    np.testing.assert_array_equal(out.gbuffer.motion, 0.0)
    assert np.all(out.gbuffer.motion_valid)


def test_jitter_moves_the_sample_by_its_pixels():
    scene = tiny.scene([tiny.floor(), tiny.cube()])
    size = (20, 20)
    at_centre = draw(scene, frames.inputs(), size=size)
    shifted = draw(scene, frames.inputs(jitter=(1.0, 2.0)), size=size)
    np.testing.assert_allclose(
        at_centre.gbuffer.depth[2:, 1:], shifted.gbuffer.depth[:-2, :-1], rtol=1e-5
    )


def test_shadow_falls_where_the_light_is_blocked_and_nowhere_else():
    light = tiny.Light(direction=(0.0, -1.0, 0.0))
    occluder = tiny.floor(2.0, height=1.0)
    scene = tiny.scene([tiny.floor(50.0), occluder], lights=[light], sky=BLACK_SKY)
    inputs = frames.inputs((0.0, 3.0, 8.0), (0.0, 0.0, 0.0))
    out = draw(scene, inputs, size=(90, 160), mip_maps=False)
    tracer = embree.build(scene)
    off = replace(effects.required(scene), shadows=False)
    config = raster.Config(size=(90, 160), shading=off)
    unshadowed = raster.raster(
        scene, inputs, raster.default_params(), tracer=tracer, config=config
    )
    on_floor = np.asarray(out.gbuffer.object) == 0
    dark = np.asarray(out.color)[..., 0] == 0.0
    lit = np.asarray(unshadowed.color)[..., 0] > 0.0
    hit = np.isfinite(np.asarray(out.gbuffer.depth))
    assert np.all(lit == hit)
    assert 0.01 < np.mean(dark[on_floor]) < 0.2
    assert not np.any(dark & hit & ~on_floor)  # no acne on the occluder itself
    assert int(unshadowed.shadow_rays) == 0
    assert int(out.shadow_rays) == hit.sum()


def test_without_shadows_the_program_holds_no_shadow_callback():
    scene = tiny.scene([tiny.floor(), tiny.cube()])
    tracer = embree.build(scene)

    def callbacks(**off) -> int:
        called_for = replace(effects.required(scene), **off)
        config = raster.Config(size=SIZE, shading=called_for)
        jaxpr = jax.make_jaxpr(
            lambda s, i, p: raster.raster(s, i, p, tracer=tracer, config=config)
        )(scene, frames.inputs(), raster.default_params())
        return str(jaxpr).count("pure_callback[")

    assert callbacks(shadows=True) == 2
    assert callbacks(shadows=False) == 1


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 3)])
def test_odd_sizes_render_finite(size):
    scene = tiny.scene([tiny.floor(), tiny.cube()])
    out = draw(scene, frames.inputs(), size=size)
    assert out.color.shape == (*size, 3)
    assert np.all(np.isfinite(out.color))


def test_a_scene_scaled_by_a_power_of_two_draws_the_same_bits():
    def render(scale: float) -> raster.RasterOutput:
        parts = [tiny.floor(20.0), tiny.cube(), tiny.sphere(radius=0.7)]
        parts = [replace(p, position=p.position * np.float32(scale)) for p in parts]
        scene = tiny.scene(parts, lights=[tiny.Light(direction=(-0.6, -0.64, -0.48))])
        eye = (3.0 * scale, 2.0 * scale, 4.0 * scale)
        return draw(scene, frames.inputs(eye), size=(36, 64))

    base = render(1.0)
    for scale in (2.0**10, 2.0**-10):
        scaled = render(scale)
        np.testing.assert_array_equal(base.gbuffer.object, scaled.gbuffer.object)
        np.testing.assert_array_equal(
            base.gbuffer.depth, scaled.gbuffer.depth / np.float32(scale)
        )
        np.testing.assert_array_equal(base.color, scaled.color)


def test_parameters_do_not_retrace():
    scene = tiny.scene([tiny.floor()])
    tracer = embree.build(scene)
    config = raster.Config(size=SIZE, shading=effects.required(scene))
    sizes = set()
    for bias in (0.0, -1.0, 3.5):
        raster.raster(
            scene,
            frames.inputs(),
            raster.Params(mip_bias=jnp.asarray(bias, jnp.float32)),
            tracer=tracer,
            config=config,
        )
        sizes.add(raster.raster._cache_size())
    assert len(sizes) == 1


def test_material_ids_name_the_material_of_the_object():
    cube = replace(tiny.cube(), material=1)
    scene = tiny.scene([tiny.floor(), cube], [tiny.Material(), tiny.Material()])
    out = draw(scene, frames.inputs())
    ids = np.asarray(out.gbuffer.object)
    np.testing.assert_array_equal(
        np.asarray(out.gbuffer.material)[ids >= 0], ids[ids >= 0]
    )
