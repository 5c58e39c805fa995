"""Sparse rays: the same shading as supersampling, at the asked-for pixels only."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import color, effects, embree, raster, raytrace, sampling
from tests import frames, furnished, tiny
from tests.oracles import raster as oracle

SIZE = (20, 36)


@pytest.fixture(scope="module")
def scene():
    cube = replace(tiny.cube(1.0, (0.4, 0.5, 0.0)), material=1)
    materials = [tiny.Material(), tiny.Material((0.9, 0.3, 0.1, 1.0), roughness=0.4)]
    light = tiny.Light(direction=(-0.6, -0.64, -0.48))
    return tiny.scene([tiny.floor(20.0), cube], materials, lights=[light])


@pytest.fixture(scope="module")
def tracer(scene):
    return embree.build(scene)


def trace(
    scene, tracer, traced, samples=8, chunk=2048, *, shift=(0.0, 0.0), **choices
) -> raytrace.RaytraceOutput:
    config = raytrace.Config(
        samples=samples, chunk=chunk, shading=effects.required(scene), **choices
    )
    return raytrace.raytrace(
        scene,
        frames.inputs((2.0, 1.5, 4.0), jitter=shift),
        jnp.asarray(traced),
        tracer=tracer,
        config=config,
    )


def supersampled(scene, tracer, samples) -> np.ndarray:
    """The same pattern by full-screen raster passes at mip level 0."""
    config = raster.Config(size=SIZE, mip_maps=False, shading=effects.required(scene))
    passes = [
        color.tonemap(
            raster.raster(
                scene,
                frames.inputs((2.0, 1.5, 4.0), jitter=tuple(offset)),
                raster.default_params(),
                tracer=tracer,
                config=config,
            ).color
        )
        for offset in sampling.pattern(samples).tolist()
    ]
    return np.asarray(color.inverse_tonemap(sum(passes) / len(passes)))


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_every_pixel_traced_equals_supersampling(scene, tracer, samples):
    found = trace(scene, tracer, np.ones(SIZE, bool), samples)
    expected = supersampled(scene, tracer, samples)
    # Another order of summation; rays differ in the last bit of their directions.
    close = np.isclose(found.color, expected, rtol=1e-4, atol=1e-5).all(axis=-1)
    assert close.mean() > 0.995
    assert int(found.primary_rays) == SIZE[0] * SIZE[1] * samples


@pytest.mark.parametrize("chunk", [1, 7, 64, 720, 100_000])
def test_the_capacity_changes_nothing(scene, tracer, chunk):
    rng = np.random.default_rng(0)
    traced = rng.random(SIZE) < 0.1
    found = trace(scene, tracer, traced, chunk=chunk)
    expected = trace(scene, tracer, traced, chunk=256)
    # A pixel's packet neighbours change with the chunk, its rays do not.
    np.testing.assert_allclose(found.color, expected.color, rtol=1e-5, atol=1e-6)
    assert int(found.primary_rays) == traced.sum() * 8
    assert int(found.shadow_rays) == int(expected.shadow_rays)


def test_pixels_not_asked_for_stay_black_and_cost_nothing(scene, tracer):
    none = trace(scene, tracer, np.zeros(SIZE, bool))
    assert int(none.primary_rays) == 0
    assert int(none.shadow_rays) == 0
    np.testing.assert_array_equal(none.color, 0.0)
    one = np.zeros(SIZE, bool)
    one[11, 17] = True
    found = np.asarray(trace(scene, tracer, one).color)
    assert np.all(found[11, 17] > 0.0)
    np.testing.assert_array_equal(found[~one], 0.0)


def test_counts_of_pixels_do_not_compile_anew(scene, tracer):
    trace(scene, tracer, np.zeros(SIZE, bool))
    before = raytrace.raytrace._cache_size()
    for count in (1, 5, 200, 720):
        traced = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE) < count
        trace(scene, tracer, traced)
    assert raytrace.raytrace._cache_size() == before


def test_jit_equals_eager(scene, tracer):
    traced = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE) % 37 == 0
    jitted = trace(scene, tracer, traced, chunk=8)
    with jax.disable_jit():
        eager = trace(scene, tracer, traced, chunk=8)
    np.testing.assert_allclose(jitted.color, eager.color, rtol=1e-4, atol=1e-5)


@pytest.fixture(scope="module")
def yard():
    shot = furnished.yard()
    return shot, embree.build(shot.scene)


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_traced_pixels_equal_the_brute_force_oracle(yard, samples):
    shot, tracer = yard
    size = (8, 11)
    traced = np.random.default_rng(3).random(size) < 0.8
    found = raytrace.raytrace(
        shot.scene,
        shot.inputs,  # their jitter must not matter
        jnp.asarray(traced),
        tracer=tracer,
        config=raytrace.Config(
            samples=samples,
            chunk=32,
            footprint="level0",
            shading=effects.required(shot.scene),
        ),
    )
    color, shadow_rays, near = oracle.traced(shot.scene, shot.inputs, size, samples)
    sure = traced & ~near
    # The strips within rounding's reach of an edge or a shadow's border are a
    # hundredth of a pixel wide at most; eight rays meet them more often than one.
    assert np.sum(near) <= 0.05 * near.size
    # As for the raster stage: highlights and noise of 1 a texel, in float32.
    np.testing.assert_allclose(found.color[sure], color[sure], rtol=3e-4, atol=2e-5)
    np.testing.assert_array_equal(np.asarray(found.color)[~traced], 0.0)
    slack = 3 * samples * int(np.sum(traced & near))
    assert abs(int(found.shadow_rays) - shadow_rays[traced].sum()) <= slack


def yard_traced(yard, samples, shift=None, **choices) -> np.ndarray:
    shot, tracer = yard
    inputs = shot.inputs
    if shift is not None:
        inputs = replace(inputs, jitter=jnp.asarray(shift, jnp.float32))
    config = raytrace.Config(
        samples=samples, chunk=256, shading=effects.required(shot.scene), **choices
    )
    every = jnp.ones(shot.size, bool)
    return np.asarray(
        raytrace.raytrace(shot.scene, inputs, every, tracer=tracer, config=config).color
    )


def yard_drawn(yard, offsets, mip_bias=None) -> np.ndarray:
    """The mean of raster passes at some offsets; None: at mip level 0."""
    shot, tracer = yard
    config = raster.Config(
        size=shot.size,
        mip_maps=mip_bias is not None,
        shading=effects.required(shot.scene),
    )
    passes = [
        color.tonemap(
            raster.raster(
                shot.scene,
                replace(shot.inputs, jitter=jnp.asarray(offset, jnp.float32)),
                raster.default_params(mip_bias or 0.0),
                tracer=tracer,
                config=config,
            ).color
        )
        for offset in offsets
    ]
    return np.asarray(color.inverse_tonemap(sum(passes) / len(passes)))


def assert_same_but_for_edges(found, expected):
    # Another packet of rays, another last bit of their directions: at an edge of a
    # triangle, or of a shadow, one of 384 pixels or two may fall to the other side.
    close = np.isclose(found, expected, rtol=1e-3, atol=1e-4).all(axis=-1)
    assert close.mean() > 0.99


def test_at_mip_level_0_and_without_jitter_rays_are_the_papers(yard):
    found = yard_traced(yard, 2, footprint="level0", jitter=False)
    assert_same_but_for_edges(found, yard_drawn(yard, sampling.pattern(2)))


def test_by_default_a_ray_reads_half_its_share_of_the_pixel_and_stands_still(yard):
    named = yard_traced(yard, 2, footprint="sample", footprint_scale=0.5, jitter=False)
    np.testing.assert_array_equal(yard_traced(yard, 2), named)


def test_the_pixels_footprint_reads_what_the_raster_stage_reads(yard):
    found = yard_traced(yard, 1, footprint="pixel")
    expected = yard_drawn(yard, [(0.0, 0.0)], 0.0)
    assert_same_but_for_edges(found, expected)
    unfiltered = yard_traced(yard, 1, footprint="level0")
    changed = np.abs(unfiltered - expected).max(axis=-1) > 1e-2
    assert changed.mean() > 0.3  # the yard's textures are finer than its pixels


@pytest.mark.parametrize(("samples", "levels"), [(2, 0.5), (4, 1.0), (8, 1.5)])
def test_a_samples_footprint_is_its_share_of_the_pixel(yard, samples, levels):
    for scale, finer in ((1.0, 0.0), (0.5, 1.0)):
        found = yard_traced(yard, samples, footprint="sample", footprint_scale=scale)
        drawn = yard_drawn(yard, sampling.pattern(samples), -levels - finer)
        assert_same_but_for_edges(found, drawn)


def test_a_jitter_of_zero_changes_no_bit(yard):
    still = yard_traced(yard, 8, (0.0, 0.0), jitter=True)
    np.testing.assert_array_equal(still, yard_traced(yard, 8, (0.0, 0.0)))


def test_jitter_moves_the_pattern_within_the_pixel(yard):
    shift = np.array([0.3125, -0.4375])
    moved = sampling.pattern(4) + shift
    moved[moved >= 0.5] -= 1.0
    moved[moved < -0.5] += 1.0
    found = yard_traced(yard, 4, shift, jitter=True, footprint="level0")
    assert_same_but_for_edges(found, yard_drawn(yard, moved))
    still = yard_traced(yard, 4, footprint="level0")
    changed = np.abs(found - still).max(axis=-1) > 1e-2
    assert changed.mean() > 0.3
