"""Raster stage against its brute-force oracle, pixel by pixel."""

import functools

import jax
import numpy as np
import pytest

from ataa_jax import effects, embree, raster
from tests import frames, furnished
from tests.oracles import raster as oracle

# Pixels of a shot and its views whose ray passes an edge, a mask's border or a shadow's
# within rounding's reach (`near_color` of the oracle) may differ, all others may not.
# The strip beside an edge is about 2^-18 of the scene wide, beside a shadow's 2^-13 or
# a hundredth of a pixel; few pixels hold more than one edge: at most 1 % are in one.
NEAR_SHARE = 0.01
VIEWS = 5


@functools.cache
def drawn(build) -> list[tuple[raster.RasterOutput, oracle.Image]]:
    """A shot's own frame, then views from seeded cameras, by the stage and oracle."""
    shot = build()
    tracer = embree.build(shot.scene)
    config = raster.Config(size=shot.size, shading=effects.required(shot.scene))
    pairs = []
    for inputs, bias in [(shot.inputs, shot.mip_bias), *views(shot)]:
        found = raster.raster(
            shot.scene,
            inputs,
            raster.default_params(bias),
            tracer=tracer,
            config=config,
        )
        expected = oracle.draw(shot.scene, inputs, shot.size, bias)
        pairs.append((jax.tree.map(np.asarray, found), expected))
    return pairs


def views(shot: furnished.Shot) -> list[tuple[object, float]]:
    """Cameras around the shot's, with their jitter and mip bias."""
    rng = np.random.default_rng(7)
    result = []
    for _ in range(VIEWS):
        eye = np.asarray(shot.inputs.camera.world_from_view)[:3, 3]
        eye = eye + rng.uniform(-0.5, 0.5, 3)
        target = rng.uniform(-0.5, 0.5, 3)
        step, turn = rng.uniform(-0.15, 0.15, (2, 3))
        inputs = frames.inputs(
            tuple(eye), tuple(target),
            previous_eye=tuple(eye + step), previous_target=tuple(target + turn),
            jitter=tuple(rng.uniform(-0.5, 0.5, 2)), fov_y=rng.uniform(0.5, 1.3),
            groups=np.asarray(shot.inputs.world_from_group),
            previous_groups=np.asarray(shot.inputs.previous_world_from_group),
        )  # fmt: skip
        result.append((inputs, float(rng.uniform(-1.5, 1.5))))
    return result


@pytest.fixture(params=furnished.SHOTS, ids=lambda build: build.__name__)
def pairs(request):
    return drawn(request.param)


def test_few_pixels_lie_within_roundings_reach_of_an_edge(pairs):
    assert np.mean([e.near_color for _, e in pairs]) <= NEAR_SHARE


def test_object_and_material_ids_are_the_nearest_solid_triangles(pairs):
    for found, expected in pairs:
        sure = ~expected.near
        for name in ("object", "material"):
            ids = getattr(found.gbuffer, name)
            np.testing.assert_array_equal(ids[sure], getattr(expected, name)[sure])


def test_depth_is_along_the_view_axis_and_infinite_on_the_sky(pairs):
    for found, expected in pairs:
        sky = ~expected.near & (expected.object < 0)
        assert np.all(np.isposinf(found.gbuffer.depth[sky]))
        # A ray that rounding shifts meets the plane elsewhere, the farther the flatter
        # it lies to the view; that far may depth err, and by a last bit or two.
        hit = ~expected.near & (expected.object >= 0)
        error = np.abs(found.gbuffer.depth[hit] - expected.depth[hit])
        assert np.all(error <= expected.shift[hit] + 2.0**-22 * expected.depth[hit])


def test_normals_are_the_interpolated_ones_toward_the_viewer(pairs):
    for found, expected in pairs:
        sure = ~expected.near
        # As for depth, for the weights of three unit vectors.
        error = np.abs(found.gbuffer.normal[sure] - expected.normal[sure]).max(axis=-1)
        assert np.all(error <= 2 * expected.slack[sure] + 2.0**-22)


def test_motion_leads_to_the_same_point_of_the_previous_image(pairs):
    for found, expected in pairs:
        valid = ~expected.near & expected.motion_valid
        # Positions to 2^-23 of 8 units, 1 unit away, in pixels of 0.05.
        np.testing.assert_allclose(
            found.gbuffer.motion[valid], expected.motion[valid], atol=2e-5
        )
        # Outside the view the vector grows without bounds, and so does its rounding:
        # the stage bounds it, and only its direction out of the image is of use.
        bound = 4.0 * max(valid.shape)
        outside = ~expected.near & ~expected.motion_valid
        outside &= np.isfinite(expected.motion).all(axis=-1)
        np.testing.assert_allclose(
            found.gbuffer.motion[outside],
            np.clip(expected.motion[outside], -bound, bound),
            rtol=1e-3,
            atol=1e-4,
        )
        assert np.all(np.isfinite(found.gbuffer.motion))


def test_motion_is_exactly_zero_where_nothing_moved():
    (found, expected), *_ = drawn(furnished.workshop)
    still = ~expected.near & np.all(np.abs(expected.motion) < 1e-9, axis=-1)
    # The sky, the bench, and the lamp, which rests in a rigid group of its own.
    assert set(np.unique(expected.object[still])) == {-1, 0, 2}
    assert set(np.unique(expected.object[~still & ~expected.near])) == {1, 3}
    np.testing.assert_array_equal(found.gbuffer.motion[still], 0.0)
    assert np.all(found.gbuffer.motion[~still & ~expected.near] != 0.0)


def test_motion_is_valid_where_the_point_was_inside_the_previous_view(pairs):
    for found, expected in pairs:
        height, width = expected.near.shape
        y, x = np.mgrid[:height, :width] + 0.5
        x, y = x + expected.motion[..., 0], y + expected.motion[..., 1]
        border = np.minimum(
            np.abs(np.abs(x - width / 2) - width / 2),
            np.abs(np.abs(y - height / 2) - height / 2),
        )
        # NaN, a point behind the camera, compares as not on the border.
        sure = ~expected.near & ~(border < 1e-3)
        np.testing.assert_array_equal(
            found.gbuffer.motion_valid[sure], expected.motion_valid[sure]
        )


def test_colors_are_the_materials_under_all_lights(pairs):
    for found, expected in pairs:
        sure = ~expected.near_color
        # Texture coordinates of 4 to 2^-22 are 1e-5 of a texel, and a texel differs
        # from its neighbour by up to 1. Highlights: n · h to 2^-23 over α² of about
        # 5e-4, the glossiest texels of the ball.
        np.testing.assert_allclose(
            found.color[sure], expected.color[sure], rtol=3e-4, atol=2e-5
        )


def test_shadow_rays_are_one_a_light_that_faces_the_surface(pairs):
    for found, expected in pairs:
        # A pixel that is not sure may have any count from none to one a light.
        slack = int(np.sum(expected.near_color)) * 3
        assert abs(int(found.shadow_rays) - expected.shadow_rays.sum()) <= slack
        assert int(found.primary_rays) == expected.near.size


def test_the_shots_show_what_they_are_for():
    seen = {build: [e for _, e in drawn(build)] for build in furnished.SHOTS}
    for images in seen.values():
        assert all(np.any(e.object < 0) for e in images)
        assert sum(e.shadows.sum() for e in images) > 10
        assert sum((~e.motion_valid).sum() for e in images) > 10
    assert set(np.unique(seen[furnished.yard][0].object)) == {-1, 0, 1, 2, 3}
    assert np.any(np.isnan(seen[furnished.corridor][0].motion))  # behind the camera
