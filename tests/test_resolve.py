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


@pytest.mark.parametrize("feedback", [True, False])
@pytest.mark.parametrize("size", [(7, 9), (1, 1), (5, 4)])
def test_every_pixel_comes_from_its_methods_source(size, feedback):
    method, segmented, raw, gbuffer, blended, traced = frame(size)
    params = resolve.default_params(traced_count=8.0)
    config = resolve.Config(feedback=feedback)
    out = resolve.resolve(
        segmented, raw, gbuffer, blended, traced, params, config=config
    )
    sources = (raw, blended.color, traced, blended.count)
    color, count, stored = oracle.resolve(
        method, *map(np.asarray, sources), 8.0, feedback=feedback
    )
    np.testing.assert_array_equal(out.composite, color.astype(np.float32))
    np.testing.assert_array_equal(out.history.count, count.astype(np.float32))
    np.testing.assert_array_equal(out.history.color, stored.astype(np.float32))


def test_without_feedback_only_the_history_of_traced_pixels_differs():
    method, *inputs = frame((9, 8))
    params = resolve.default_params(traced_count=8.0)
    fed = resolve.resolve(*inputs, params, config=resolve.Config())
    unfed = resolve.resolve(*inputs, params, config=resolve.Config(feedback=False))
    np.testing.assert_array_equal(unfed.composite, fed.composite)
    np.testing.assert_array_equal(unfed.classification.mask, fed.classification.mask)
    for name in ("color", "count"):
        differs = np.asarray(getattr(unfed.history, name) != getattr(fed.history, name))
        differs = differs.reshape(*method.shape, -1).any(axis=-1)
        np.testing.assert_array_equal(differs, method == types.METHOD_ATAA)


def test_the_history_stores_the_composite_and_the_gbuffer_beside_it():
    _, segmented, raw, gbuffer, blended, traced = frame((6, 5))
    out = resolve.resolve(
        segmented, raw, gbuffer, blended, traced, resolve.default_params(),
        config=resolve.Config(),
    )  # fmt: skip
    np.testing.assert_array_equal(out.history.color, out.composite)
    np.testing.assert_array_equal(out.history.depth, gbuffer.depth)
    np.testing.assert_array_equal(out.history.motion, gbuffer.motion)
    np.testing.assert_array_equal(out.classification.mask, segmented.mask)
    assert bool(out.history.valid)


@pytest.mark.parametrize("feedback", [True, False])
def test_bad_values_of_any_source_end_here(feedback):
    _, segmented, _, gbuffer, blended, _ = frame((6, 5))
    bad = jnp.full((6, 5, 3), jnp.nan, jnp.float32).at[..., 1].set(jnp.inf)
    bad = bad.at[..., 2].set(-1.0)
    blended = Blended(color=bad, count=blended.count)
    out = resolve.resolve(
        segmented, bad, gbuffer, blended, bad, resolve.default_params(),
        config=resolve.Config(feedback=feedback),
    )  # fmt: skip
    expected = np.broadcast_to(np.float32([0.0, 65504.0, 0.0]), (6, 5, 3))
    np.testing.assert_array_equal(out.composite, expected)
    np.testing.assert_array_equal(out.history.color, expected)


def test_jit_equals_eager():
    _, *inputs = frame((4, 5))
    params = resolve.default_params()
    for config in (resolve.Config(), resolve.Config(feedback=False)):
        jitted = resolve.resolve(*inputs, params, config=config)
        with jax.disable_jit():
            eager = resolve.resolve(*inputs, params, config=config)
        jax.tree.map(np.testing.assert_array_equal, jitted, eager)
