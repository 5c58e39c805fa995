"""Resolve: each pixel from its own source, and what the next frame reads."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import resolve, types
from tests.oracles import resolve as oracle


class Blended(eqx.Module):
    color: jax.Array
    count: jax.Array


def frame(size, seed=0):
    rng = np.random.default_rng(seed)
    method = rng.integers(0, 3, size)
    counter = rng.integers(0, 5, size)

    def image(*channels):
        return jnp.asarray(rng.random((*size, *channels)), jnp.float32)

    gbuffer = types.GBuffer(
        depth=image(),
        motion=image(2),
        motion_valid=jnp.ones(size, bool),
        normal=image(3),
        object=jnp.zeros(size, jnp.int32),
        material=jnp.zeros(size, jnp.int32),
    )
    segmented = types.Segmentation(
        mask=jnp.asarray(method | (counter << 16), jnp.uint32),
        why=jnp.zeros(size, jnp.uint16),
        score=image(),
        luminance=image(),
        depth=image(),
    )
    blended = Blended(color=image(3), count=image() + 3.0)
    return method, segmented, image(3), gbuffer, blended, image(3)


@pytest.mark.parametrize("size", [(7, 9), (1, 1), (5, 4)])
def test_every_pixel_comes_from_its_methods_source(size):
    method, segmented, raw, gbuffer, blended, traced = frame(size)
    params = resolve.default_params(traced_count=8.0)
    out = resolve.resolve(segmented, raw, gbuffer, blended, traced, params)
    sources = (raw, blended.color, traced, blended.count)
    color, count = oracle.resolve(method, *map(np.asarray, sources), 8.0)
    np.testing.assert_array_equal(out.composite, color.astype(np.float32))
    np.testing.assert_array_equal(out.history.count, count.astype(np.float32))


def test_the_history_stores_the_composite_and_the_gbuffer_beside_it():
    _, segmented, raw, gbuffer, blended, traced = frame((6, 5))
    out = resolve.resolve(
        segmented, raw, gbuffer, blended, traced, resolve.default_params()
    )
    np.testing.assert_array_equal(out.history.color, out.composite)
    np.testing.assert_array_equal(out.history.depth, gbuffer.depth)
    np.testing.assert_array_equal(out.history.motion, gbuffer.motion)
    np.testing.assert_array_equal(out.classification.mask, segmented.mask)
    assert bool(out.history.valid)


def test_bad_values_of_any_source_end_here():
    _, segmented, _, gbuffer, blended, _ = frame((6, 5))
    bad = jnp.full((6, 5, 3), jnp.nan, jnp.float32).at[..., 1].set(jnp.inf)
    bad = bad.at[..., 2].set(-1.0)
    blended = Blended(color=bad, count=blended.count)
    out = resolve.resolve(
        segmented, bad, gbuffer, blended, bad, resolve.default_params()
    )
    expected = np.broadcast_to(np.float32([0.0, 65504.0, 0.0]), (6, 5, 3))
    np.testing.assert_array_equal(out.composite, expected)


def test_jit_equals_eager():
    _, *inputs = frame((4, 5))
    params = resolve.default_params()
    jitted = resolve.resolve(*inputs, params)
    with jax.disable_jit():
        eager = resolve.resolve(*inputs, params)
    jax.tree.map(np.testing.assert_array_equal, jitted, eager)
