"""Supersampling, its cache, and the metrics that compare with it."""

from dataclasses import replace

import numpy as np
import pytest

from ataa_jax import (
    color,
    compare,
    effects,
    methods,
    metrics,
    raster,
    reference,
    sampling,
)
from ataa_jax import world as worlds
from ataa_jax.errors import InputError
from tests.test_pipeline import source

SIZE = (24, 40)


@pytest.fixture(scope="module")
def shot():
    return worlds.shot(worlds.prepare(source()), "still", SIZE)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path))
    return tmp_path


def test_one_sample_is_the_raster_at_mip_zero(shot):
    one = reference.supersample(shot.world, shot.inputs(0), sampling.pattern(1), SIZE)
    config = raster.Config(
        size=SIZE, mip_maps=False, shading=effects.required(shot.world.scene)
    )
    drawn = raster.raster(
        shot.world.scene,
        shot.inputs(0),
        raster.default_params(),
        tracer=shot.world.tracer,
        config=config,
    )
    # There and back through the tone map: a few ulp.
    np.testing.assert_allclose(one.color, drawn.color, rtol=1e-5, atol=1e-6)


def test_more_samples_come_closer_to_the_reference(shot, cache):
    truth = color.display(reference.reference(shot, 0, 64).color)
    errors = [
        metrics.mean_squared_error(
            np.asarray(
                color.display(
                    reference.supersample(
                        shot.world, shot.inputs(0), sampling.pattern(samples), SIZE
                    ).color
                )
            ),
            np.asarray(truth),
        )
        for samples in (1, 2, 4, 8, 16)
    ]
    assert errors == sorted(errors, reverse=True)


def test_the_cache_gives_the_same_bits_and_no_pass_is_rendered(shot, cache):
    first = reference.reference(shot, 0, 4)
    files = list(cache.rglob("*.npz"))
    assert len(files) == 1
    stamp = files[0].stat().st_mtime_ns
    again = reference.reference(shot, 0, 4)
    np.testing.assert_array_equal(first.color, again.color)
    assert files[0].stat().st_mtime_ns == stamp
    reference.reference(shot, 0, 5)
    assert len(list(cache.rglob("*.npz"))) == 2


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 half a file"])
def test_a_damaged_cache_file_is_rendered_anew(shot, cache, damage):
    first = reference.reference(shot, 0, 2)
    (file,) = cache.rglob("*.npz")
    file.write_bytes(damage)
    again = reference.reference(shot, 0, 2)
    np.testing.assert_array_equal(first.color, again.color)


def test_thin_coverage_marks_the_slats_and_nothing_else(shot):
    objects = reference.thin_objects(shot.world.source)
    assert objects.tolist() == [False, False, False, True]
    found = reference.supersample(
        shot.world, shot.inputs(0), sampling.pattern(16), SIZE
    )
    thin = np.asarray(found.thin)
    assert 0.0 < np.mean(thin > 0) < 0.5
    assert np.all((thin >= 0) & (thin <= 1))


def test_another_name_is_another_reference(shot):
    """What is thin is told from names, which no array of the world holds."""
    source = shot.world.source
    meshes = [replace(source.meshes[0], name="wire"), *source.meshes[1:]]
    world = replace(shot.world, source=replace(source, meshes=meshes))
    renamed = replace(shot, world=world)
    assert world.content_hash == shot.world.content_hash
    files = [reference.cache_file(each, 0, 4) for each in (shot, renamed)]
    assert files[0] != files[1]
    keys = [methods.job_key(each, "run", methods.Options()) for each in (shot, renamed)]
    assert keys[0] != keys[1]


def test_equal_images_score_perfectly():
    image = np.random.default_rng(0).random((20, 30, 3), np.float32)
    assert metrics.ssim(image, image) == pytest.approx(1.0)
    assert metrics.psnr(image, image) == float("inf")
    assert metrics.border_error(image, image) == 0.0


def test_ssim_is_undefined_under_eleven_pixels():
    image = np.zeros((10, 40, 3), np.float32)
    assert np.isnan(metrics.ssim(image, image))


def test_psnr_of_a_constant_error_is_its_logarithm():
    image = np.full((12, 12, 3), 0.5)
    assert metrics.psnr(image + 0.1, image) == pytest.approx(20.0)


def test_an_image_that_follows_its_motion_does_not_flicker():
    rng = np.random.default_rng(1)
    previous = rng.random((16, 20, 3))
    image = np.roll(previous, 3, axis=1)
    motion = np.zeros((16, 20, 2))
    motion[..., 0] = -3.0
    valid = np.ones((16, 20), bool)
    valid[:, :3] = False
    assert metrics.flicker(image, previous, motion, valid) == pytest.approx(0.0)
    assert metrics.flicker(image, previous, motion * 0.0, valid) > 0.1


@pytest.mark.skipif(not metrics.flip_available(), reason="flip-evaluator is missing")
def test_flip_is_zero_for_equal_images_and_grows_with_the_error():
    image = np.random.default_rng(2).random((16, 16, 3), np.float32)
    assert metrics.flip(image, image) == pytest.approx(0.0, abs=1e-6)
    assert metrics.flip(np.clip(image + 0.3, 0, 1), image) > 0.05


def test_comparison_runs_every_method_and_orders_them_sensibly(shot, cache):
    options = methods.Options(
        frames=2, lead_in=3, reference_samples=32, budget=float("inf")
    )
    walk = worlds.shot(shot.world, "walk", SIZE)
    result = compare.compare(walk, options)
    assert set(result.images) == {*methods.METHODS, compare.REFERENCE}
    ssim = {name: result.mean(name, "ssim") for name in result.images}
    assert ssim["reference"] == pytest.approx(1.0)
    assert ssim["none"] < ssim["ssaa2"] < ssim["ssaa4"] < ssim["ssaa8"]
    assert ssim["taa"] < ssim["ataa8"]
    assert result.mean("ataa8", "rays_per_pixel") > 0.0
    assert result.mean("taa", "rays_per_pixel") == 0.0


def test_unknown_methods_are_refused():
    with pytest.raises(InputError, match="unknown method 'smaa'"):
        methods.check_methods(["taa", "smaa"])
