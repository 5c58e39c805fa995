"""Nearest hits and shadow rays, by both backends; what is refused."""

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

from ataa_jax import embree, errors
from tests import tiny
from tests.oracles import intersect as oracle
from tests.tracing import (
    EPS,
    INF,
    down,
    everything,
    garden,
    rays,
    shared_tracer,
    soup,
)


def test_distance_to_a_plane_is_in_units_of_the_direction(backend):
    tracer = embree.build(tiny.scene([tiny.floor(20, -2.0)]), backend=backend)
    origin, direction = down([0.1, 2.3, -4.0], [0.3, 1.0, 2.0], height=1.0)
    for length in (0.25, 1.0, 8.0):  # powers of two: exact
        hits = tracer.intersect_numpy(
            tiny.still(), origin, direction * np.float32(length)
        )
        np.testing.assert_array_equal(hits.distance, np.full(3, 3 / length))


def test_hits_of_random_triangles_are_those_of_brute_force(backend):
    scene = soup()
    position = np.asarray(scene.geometry.position)
    origin, direction = rays(3000)
    tracer = embree.build(scene, backend=backend)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    distance, triangle, weights = oracle.nearest(position, origin, direction)
    np.testing.assert_array_equal(hits.triangle, triangle)
    hit = triangle >= 0
    assert 0.3 < hit.mean() < 0.9
    # float32 against float64; coordinates are up to 10, distances as small as 0.01.
    np.testing.assert_allclose(hits.distance[hit], distance[hit], rtol=1e-4)
    np.testing.assert_allclose(hits.barycentric[hit], weights[hit], atol=1e-4)


def test_barycentric_weights_give_the_hit_point(backend):
    scene = garden()
    tracer = embree.build(scene, backend=backend)
    origin, direction = rays(2000)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    hit = hits.triangle >= 0
    p0, p1, p2 = np.moveaxis(
        np.asarray(scene.geometry.position)[hits.triangle[hit]], 1, 0
    )
    b1, b2 = hits.barycentric[hit, :1], hits.barycentric[hit, 1:]
    along = origin[hit] + hits.distance[hit, None] * direction[hit]
    point = p0 * (1 - b1 - b2) + p1 * b1 + p2 * b2
    # Coordinates up to 20, a handful of float32 roundings on either side.
    np.testing.assert_allclose(along, point, atol=20 * 16 * EPS)


def test_a_ball_of_triangles_is_hit_between_its_inner_and_outer_sphere(backend):
    tracer = embree.build(tiny.scene([tiny.sphere(32, 64)]), backend=backend)
    origin, direction = rays(4000, spread=1.0, seed=5)
    origin *= 3 / np.linalg.norm(origin, axis=-1, keepdims=True)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    nearest = np.linalg.norm(origin - np.sum(origin * unit, -1)[:, None] * unit, axis=1)
    ahead = np.sum(origin * unit, axis=-1) < 0
    inner = np.cos(np.pi / 64) ** 2  # sagitta of a triangle between 32 × 64 points
    assert (hits.triangle[ahead & (nearest < inner)] >= 0).all()
    assert (hits.triangle[~ahead | (nearest > 1 + 1e-6)] < 0).all()
    hit = hits.triangle >= 0
    radius = np.linalg.norm(
        origin[hit] + hits.distance[hit, None] * direction[hit], axis=-1
    )
    assert inner <= radius.min()
    assert radius.max() <= 1 + 1e-5  # float32 rounding of a distance near 3


def test_both_sides_of_a_triangle_are_hit(backend):
    tracer = embree.build(tiny.scene([tiny.quad()]), backend=backend)
    origin = np.float32([[0.1, 0.2, 1], [0.1, 0.2, -1]])
    hits = tracer.intersect_numpy(tiny.still(), origin, -origin * np.float32([0, 0, 1]))
    # Embree's reciprocal differs in its last bit from one instruction set to another.
    np.testing.assert_allclose(hits.distance, [1, 1], rtol=2.0**-23)


def test_a_miss_has_triangle_minus_one_and_distance_inf(backend):
    tracer = embree.build(tiny.scene([tiny.quad()]), backend=backend)
    hits = tracer.intersect_numpy(
        tiny.still(), np.float32([[0, 0, 1]]), np.float32([[0, 1, 0]])
    )
    assert hits.distance[0] == INF
    assert hits.triangle[0] == -1
    np.testing.assert_array_equal(hits.barycentric, [[0, 0]])


BROKEN = [np.nan, np.inf, -np.inf]


def test_rays_that_are_not_finite_or_have_no_direction_miss(backend):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = down(np.zeros(19), np.zeros(19))
    good = tracer.intersect_numpy(tiny.still(), origin, direction)
    for i, value in enumerate(BROKEN):
        for axis in range(3):
            origin[2 * axis + 6 * i if i < 2 else axis + 12, axis] = value
            direction[2 * axis + 1 + 6 * i if i < 2 else axis + 15, axis] = value
    direction[18] = 0
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    assert (good.triangle >= 0).all()
    assert (hits.triangle == -1).all()
    far = np.full(19, INF)
    blocked = tracer.occluded_numpy(
        tiny.still(), origin, direction, far, everything(19)
    )
    assert not blocked.any()


def test_a_broken_ray_leaves_its_packet_alone(backend):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = rays(160)
    whole = tracer.intersect_numpy(tiny.still(), origin, direction)
    direction[::5] = np.nan
    some = tracer.intersect_numpy(tiny.still(), origin, direction)
    keep = np.arange(160) % 5 != 0
    np.testing.assert_array_equal(some.distance[keep], whole.distance[keep])
    assert (some.triangle[~keep] == -1).all()


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 5000])
def test_any_number_of_rays_is_traced(backend, count):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = rays(5000)
    whole = tracer.intersect_numpy(tiny.still(), origin, direction)
    part = tracer.intersect_numpy(tiny.still(), origin[:count], direction[:count])
    np.testing.assert_array_equal(part.distance, whole.distance[:count])
    blocked = tracer.occluded_numpy(
        tiny.still(),
        origin[:count],
        direction[:count],
        np.full(count, INF),
        everything(count),
    )
    np.testing.assert_array_equal(blocked, whole.triangle[:count] >= 0)


@hypothesis.given(st.integers(1, 40), st.integers(1, 70), st.booleans())
@hypothesis.settings(max_examples=30)
def test_tiles_change_the_order_of_tracing_only(height, width, coherent):
    tracer = shared_tracer()
    origin, direction = rays(height * width, seed=height)
    plain = tracer.intersect_numpy(tiny.still(), origin, direction)
    tiled = tracer.intersect_numpy(
        tiny.still(), origin, direction, tile=(height, width), coherent=coherent
    )
    np.testing.assert_array_equal(tiled.distance, plain.distance)
    np.testing.assert_array_equal(tiled.triangle, plain.triangle)
    far = np.full(height * width, np.float32(2))
    active = np.arange(height * width) % 3 > 0
    blocked = tracer.occluded_numpy(
        tiny.still(),
        origin,
        direction,
        far,
        active,
        tile=(height, width),
        coherent=coherent,
    )
    np.testing.assert_array_equal(blocked, active & (plain.distance < far))


def test_an_empty_scene_is_missed(backend):
    nothing = tiny.scene([tiny.Part(np.zeros((0, 3, 3), np.float32))])
    tracer = embree.build(nothing, backend=backend)
    assert tracer.group_count == 1
    origin, direction = rays(20)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    assert (hits.triangle == -1).all()


def test_occlusion_is_open_at_both_ends(backend):
    tracer = embree.build(tiny.scene([tiny.floor()]), backend=backend)
    origin, direction = down([0.3] * 6, [0.4] * 6, height=2.0)
    origin[4:, 1] = 0.0  # on the floor: that hit is at distance 0
    above = np.nextafter(np.float32(2), INF)
    distance = np.float32([2.0, above, INF, 1.0, INF, 1.0])
    blocked = tracer.occluded_numpy(
        tiny.still(), origin, direction, distance, everything(6)
    )
    np.testing.assert_array_equal(blocked, [False, True, True, False, False, False])
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    np.testing.assert_array_equal(hits.distance, [2, 2, 2, 2, INF, INF])


@pytest.mark.parametrize("distance", [0.0, -1.0, -np.inf, np.nan, 1e-45])
def test_no_length_no_occlusion(backend, distance):
    tracer = embree.build(tiny.scene([tiny.floor()]), backend=backend)
    origin, direction = down([0.0], [0.0])
    far = np.float32([distance])
    assert not tracer.occluded_numpy(
        tiny.still(), origin, direction, far, everything(1)
    ).any()


def test_occlusion_is_a_nearest_hit_within_the_distance(backend):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = rays(6000)
    distance = np.random.default_rng(1).exponential(0.5, 6000).astype(np.float32)
    active = np.random.default_rng(2).random(6000) < 0.6
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    blocked = tracer.occluded_numpy(tiny.still(), origin, direction, distance, active)
    np.testing.assert_array_equal(blocked, active & (hits.distance < distance))
    assert 0.1 < blocked.mean() < 0.6


def test_mistakes_are_named():
    tracer = embree.build(garden(groups=3))
    origin, direction = rays(10)
    with pytest.raises(errors.InputError, match=r"needs \(3, 3, 4\)"):
        tracer.intersect_numpy(tiny.still(2), origin, direction)
    with pytest.raises(errors.InputError, match="both must be"):
        tracer.intersect_numpy(tiny.still(3), origin, direction[:5])
    with pytest.raises(errors.InputError, match="image of 12 pixels"):
        tracer.intersect_numpy(tiny.still(3), origin, direction, tile=(3, 4))
    with pytest.raises(errors.InputError, match="as many distances"):
        tracer.occluded_numpy(
            tiny.still(3), origin, direction, np.ones(9), everything(10)
        )
    with pytest.raises(errors.InputError, match="choose one of auto, packet, run"):
        embree.build(garden(), backend="gpu")


def test_ids_out_of_range_are_named():
    part = tiny.quad()
    part.material = 3
    with pytest.raises(errors.InputError, match="the scene has 1"):
        embree.build(tiny.scene([part]))
    part = tiny.quad()
    part.group = -1
    with pytest.raises(errors.InputError, match="is negative"):
        embree.build(tiny.scene([part]))
