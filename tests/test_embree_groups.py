"""Rays through groups that move."""

import threading
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import embree, types
from tests import tiny
from tests.tracing import (
    EPS,
    MOVED,
    garden,
    pose,
    rays,
)


def baked(scene, matrices):
    """The same scene with every triangle carried to where its group is."""
    geometry = scene.geometry
    matrix = matrices[np.asarray(geometry.group)].astype(np.float64)
    position = np.einsum(
        "tij,tkj->tki", matrix[:, :, :3], np.asarray(geometry.position)
    )
    position += matrix[:, None, :, 3]
    return types.Scene(
        geometry=types.Geometry(
            position=jnp.asarray(position, jnp.float32),
            normal=geometry.normal,
            uv=geometry.uv,
            material=geometry.material,
            object=geometry.object,
            group=jnp.zeros_like(geometry.group),
        ),
        materials=scene.materials,
        textures=scene.textures,
        lights=scene.lights,
        sky=scene.sky,
    )


@pytest.mark.parametrize("seed", range(3))
def test_moving_a_group_moves_its_triangles(backend, seed):
    scene, matrices = garden(groups=3), pose(seed)
    tracer = embree.build(scene, backend=backend)
    assert tracer.group_count == 3
    origin, direction = rays(4000)
    hits = tracer.intersect_numpy(matrices, origin, direction)
    still = embree.build(baked(scene, matrices))
    there = still.intersect_numpy(tiny.still(), origin, direction)
    same = hits.triangle == there.triangle
    # Rays that graze an edge, or the rim of a hole, may fall on either side of it.
    assert same.mean() > 0.999
    hit = same & (hits.triangle >= 0)
    groups = np.asarray(scene.geometry.group)[hits.triangle[hit]]
    assert set(np.unique(groups)) == {0, 1, 2}
    # Baked corners are rounded to float32, as are transformed rays: at coordinates
    # of up to 20, seen at grazing angles, from distances as small as 0.01.
    np.testing.assert_allclose(
        hits.distance[hit], there.distance[hit], rtol=1e-4, atol=1e-5
    )


def test_groups_come_back_to_the_same_bits(backend):
    tracer = embree.build(garden(groups=3), backend=backend)
    origin, direction = rays(1000)
    first = tracer.intersect_numpy(pose(0), origin, direction)
    for seed in range(1, 20):  # more poses than are kept
        tracer.intersect_numpy(pose(seed), origin, direction)
    again = tracer.intersect_numpy(pose(0), origin, direction)
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_scene_at_rest_is_the_scene_without_groups(backend):
    origin, direction = rays(2000)
    moving = embree.build(garden(groups=3), backend=backend)
    static = embree.build(garden(), backend=backend)
    a = moving.intersect_numpy(tiny.still(3), origin, direction)
    b = static.intersect_numpy(tiny.still(), origin, direction)
    # The identity carries a ray exactly. One that `run` restarts behind a hole is
    # restarted in the hole's own group only: a few roundings more or less.
    tolerance = {"packet": 0, "run": 4 * EPS}[backend]
    np.testing.assert_allclose(a.distance, b.distance, rtol=tolerance)


@pytest.mark.parametrize("scale", [1e-6, 1e6, (1.0, 1e-6, 1e4)])
def test_tiny_and_huge_groups_are_hit(backend, scale):
    stub = tiny.quad()
    stub.group = 1
    tracer = embree.build(tiny.scene([tiny.floor(1, 50), stub]), backend=backend)
    matrices = tiny.still(2)
    matrices[1] = tiny.moved(scale=scale)
    width, height, _ = np.broadcast_to(np.float32(scale), 3) * np.float32(0.25)
    origin = np.float32([[width, height, 3]])
    direction = np.float32([[0, 0, -1]])
    hits = tracer.intersect_numpy(matrices, origin, direction)
    # As large as the coordinates are in the group's space, from there or from here.
    np.testing.assert_allclose(hits.distance, [3], rtol=MOVED)


@pytest.mark.parametrize("scale", [0.0, (1.0, 0.0, 1.0), 1e-30, 1e30, np.nan, np.inf])
def test_a_group_without_an_inverse_is_not_there(backend, scale):
    tracer = embree.build(garden(groups=2), backend=backend)
    matrices = tiny.still(2)
    with np.errstate(invalid="ignore"):
        matrices[1] = tiny.moved(scale=scale)
    origin, direction = rays(3000)
    hits = tracer.intersect_numpy(matrices, origin, direction)
    group = np.asarray(garden(groups=2).geometry.group)
    assert (hits.triangle >= 0).any()
    assert (group[hits.triangle[hits.triangle >= 0]] == 0).all()


def test_group_zero_is_the_world(backend):
    origin, direction = rays(500)
    for groups in (1, 2):
        tracer = embree.build(garden(groups=groups), backend=backend)
        matrices = tiny.still(groups)
        expected = tracer.intersect_numpy(matrices, origin, direction)
        matrices[0] = np.nan
        hits = tracer.intersect_numpy(matrices, origin, direction)
        np.testing.assert_array_equal(hits.distance, expected.distance)
        assert np.isnan(matrices[0]).all()  # the caller's array is its own


def test_threads_that_move_groups_do_not_meet():
    tracer = embree.build(garden(groups=3))
    origin, direction = rays(3000)
    poses = [pose(seed) for seed in range(12)]
    alone = [tracer.intersect_numpy(p, origin, direction) for p in poses]
    gate = threading.Barrier(4)

    def trace(worker):
        gate.wait(timeout=60)
        order = np.random.default_rng(worker).permutation(12)
        return {i: tracer.intersect_numpy(poses[i], origin, direction) for i in order}

    with ThreadPoolExecutor(4) as pool:
        for results in pool.map(trace, range(4)):
            for i, hits in results.items():
                np.testing.assert_array_equal(hits.distance, alone[i].distance)
                np.testing.assert_array_equal(hits.triangle, alone[i].triangle)
