"""Tracing from JAX: jit, vmap, gradients, and the life of a tracer."""

import gc
import subprocess
import sys
import weakref
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import embree
from tests import tiny
from tests.tracing import (
    down,
    garden,
    pose,
    rays,
    shared_tracer,
)


def test_jit_eager_and_host_give_the_same_bits(backend):
    tracer = embree.build(garden(groups=3), backend=backend)
    origin, direction = rays(1000)
    arrays = [jnp.asarray(a) for a in (pose(0), origin, direction)]
    host = tracer.intersect_numpy(pose(0), origin, direction)
    eager = embree.intersect(tracer, *arrays)
    jitted = jax.jit(embree.intersect)(tracer, *arrays)
    for hits in (eager, jitted):
        np.testing.assert_array_equal(hits.distance, host.distance)
        np.testing.assert_array_equal(hits.triangle, host.triangle)
        np.testing.assert_array_equal(hits.barycentric, host.barycentric)
        assert hits.triangle.dtype == jnp.int32
    distance, active = np.full(1000, np.float32(2)), np.arange(1000) % 2 == 0
    expected = tracer.occluded_numpy(pose(0), origin, direction, distance, active)
    blocked = jax.jit(embree.occluded)(
        tracer, *arrays, jnp.asarray(distance), jnp.asarray(active)
    )
    np.testing.assert_array_equal(blocked, expected)


def test_tiles_and_hints_pass_through_jit():
    tracer = shared_tracer()
    origin, direction = (jnp.asarray(a) for a in rays(12 * 10))
    still = jnp.asarray(tiny.still())
    plain = embree.intersect(tracer, still, origin, direction)
    tiled = jax.jit(
        lambda o, d: embree.intersect(
            tracer, still, o, d, tile=(12, 10), coherent=False
        )
    )(origin, direction)
    np.testing.assert_array_equal(plain.distance, tiled.distance)


def test_of_two_owners_of_one_key_the_first_takes_nothing_away_from_the_second():
    """Two threads may build the same scene at once."""

    class Owner:
        pass

    key = -1  # of no scene: those are positive
    first, second = Owner(), Owner()
    embree.holding.hold(key, "first's", first)
    embree.holding.hold(key, "second's", second)
    del first
    gc.collect()
    embree.holding.sweep()
    assert embree.holding.find(key) == "second's"
    del second
    gc.collect()
    embree.holding.sweep()
    assert embree.holding.find(key) is None


def test_vmap_over_poses_traces_each():
    tracer = embree.build(garden(groups=3))
    origin, direction = rays(300)
    poses = np.stack([pose(seed) for seed in range(4)])

    def distance(matrices):
        return embree.intersect(
            tracer, matrices, jnp.asarray(origin), jnp.asarray(direction)
        ).distance

    together = jax.jit(jax.vmap(distance))(jnp.asarray(poses))
    for matrices, row in zip(poses, together, strict=True):
        np.testing.assert_array_equal(
            row, tracer.intersect_numpy(matrices, origin, direction).distance
        )


def test_no_gradient_flows_through_tracing():
    tracer = shared_tracer()
    origin, direction = (jnp.asarray(a) for a in rays(64))
    still = jnp.asarray(tiny.still())

    def total(origin):
        hits = embree.intersect(tracer, still, origin, direction)
        blocked = embree.occluded(
            tracer, still, origin, direction, hits.distance * 2, hits.triangle >= 0
        )
        near = jnp.where(blocked, hits.distance, 0.0)
        return jnp.sum(jnp.where(jnp.isfinite(near), near, 0.0)) + jnp.sum(origin)

    np.testing.assert_array_equal(jax.grad(total)(origin), np.ones((64, 3)))


def test_dispatch_is_synchronous():
    assert not jax.config.read("jax_cpu_enable_async_dispatch")


def test_a_tracer_compares_and_hashes_by_identity():
    a, b = embree.build(garden()), embree.build(garden(groups=3))
    assert a == a
    assert a != b
    assert len({a, b, a}) == 2


def test_the_same_scene_gives_the_same_tracer_while_it_lives():
    a = embree.build(garden())
    assert embree.build(garden()) is a
    assert embree.build(garden(), backend="run") is not a
    moved = garden()
    moved = eqx.tree_at(
        lambda s: s.geometry.position, moved, moved.geometry.position + 1.0
    )
    assert embree.build(moved) is not a


def test_a_collected_tracer_frees_embree():
    # Arguments of its own: no other test holds this tracer.
    tracer = embree.build(garden(groups=3), device_config="threads=1")
    origin, direction = rays(100)
    tracer.intersect_numpy(pose(0), origin, direction)
    freed = []
    weakref.finalize(tracer._way._device, freed.append, "device")
    for scene in (*tracer._way._groups, *tracer._way._placed.values()):
        weakref.finalize(scene, freed.append, "scene")
    del tracer, scene
    gc.collect()
    assert sorted(freed) == ["device", "scene", "scene", "scene", "scene"]


def test_scenes_of_equal_shapes_share_a_program():
    traced = []

    @jax.jit
    def distance(tracer, origin, direction):
        traced.append(tracer)
        still = jnp.asarray(tiny.still())
        return embree.intersect(tracer, still, origin, direction).distance

    origin, direction = (jnp.asarray(a) for a in down([0.1], [0.2], height=3.0))
    for height in (0.0, 1.0, 2.0):
        tracer = embree.build(tiny.scene([tiny.floor(height=height)]))
        np.testing.assert_array_equal(
            distance(tracer, origin, direction), [3.0 - height]
        )
    assert len(traced) == 1


def test_rays_to_a_scene_that_was_freed_are_an_error():
    tracer = embree.build(tiny.scene([tiny.floor(height=0.25)]))
    keys = jax.tree.map(lambda key: key, tracer)
    del tracer
    gc.collect()
    origin, direction = (jnp.asarray(a) for a in down([0.0], [0.0]))
    with pytest.raises(jax.errors.JaxRuntimeError, match="was freed"):
        embree.intersect(keys, jnp.asarray(tiny.still()), origin, direction)


LET_GO = """
import gc
import jax
import jax.numpy as jnp
busy = jnp.ones(200_000)  # makes JAX's client before the package can ask for another
from ataa_jax import embree
from tests import tiny, tracing

@jax.jit
def distance(tracer, origin, direction):
    late = jax.lax.fori_loop(0, 1000, lambda _, x: jnp.sin(x) + 1e-3, busy)
    origin += 0.0 * jnp.mean(late)
    return embree.intersect(tracer, jnp.asarray(tiny.still()), origin, direction)

origin, direction = map(jnp.asarray, tracing.down([0.1], [0.2], height=3.0))
for height in (0.0, 1.0):
    tracer = embree.build(tiny.scene([tiny.floor(height=height)]))
    hits = distance(tracer, origin, direction)
    del tracer
    assert not hits.distance.is_ready(), "it ran at once: nothing was shown"
    assert hits.distance[0] == 3.0 - height
del hits
gc.collect()
embree.holding.sweep()
assert len(embree.holding._held) == 0
"""


def test_a_program_under_way_keeps_a_tracer_that_its_owner_let_go():
    done = subprocess.run(
        [sys.executable, "-c", LET_GO],
        cwd=Path(__file__).parents[1], capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
