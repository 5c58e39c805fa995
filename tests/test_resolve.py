"""Resolve: each pixel from its own source, and what the next frame reads."""

from functools import partial

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


def resolve_samples(*inputs, samples=8, **choices):
    params = resolve.default_params(traced_count=8.0)
    config = resolve.Config(**choices)
    return resolve.resolve(*inputs, params, samples=samples, config=config)


@pytest.mark.parametrize("feedback", [True, False])
@pytest.mark.parametrize("size", [(7, 9), (1, 1), (5, 4)])
def test_every_pixel_comes_from_its_methods_source(size, feedback):
    method, *inputs = frame(size)
    _, raw, _, blended, traced = inputs
    out = resolve_samples(*inputs, traced="replace", feedback=feedback)
    sources = (raw, blended.color, traced, blended.count)
    color, count, stored = oracle.resolve(
        method, *map(np.asarray, sources), 8.0, feedback=feedback
    )
    np.testing.assert_array_equal(out.composite, color.astype(np.float32))
    np.testing.assert_array_equal(out.history.count, count.astype(np.float32))
    np.testing.assert_array_equal(out.history.color, stored.astype(np.float32))


@pytest.mark.parametrize("samples", [2, 4, 8])
@pytest.mark.parametrize("feedback", [True, False])
def test_traced_colours_join_by_their_rays(samples, feedback):
    method, *inputs = frame((7, 9))
    _, raw, _, blended, traced = inputs
    out = resolve_samples(*inputs, samples=samples, feedback=feedback)
    sources = (raw, blended.color, traced, blended.count)
    color, count, stored = oracle.resolve(
        method, *map(np.asarray, sources), 8.0, samples=samples, feedback=feedback
    )
    np.testing.assert_allclose(out.composite, color, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(out.history.color, stored, rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(out.history.count, count.astype(np.float32))


def test_equal_colours_join_to_that_colour_and_no_firefly_outweighs():
    config = resolve.Config()
    _, _, _, _, blended, _ = frame((6, 5))
    seen = resolve.traced_pixel(blended, blended.color, 4, config=config)
    np.testing.assert_allclose(seen, blended.color, rtol=1e-6, atol=1e-7)
    linear = resolve.traced_pixel(
        blended, 2.0 * blended.color, 4, average="linear", config=config
    )
    share = 4.0 / (4.0 + blended.count[..., None])
    np.testing.assert_allclose(linear, blended.color * (1.0 + share), rtol=1e-6)
    # One frame saw the largest radiance, seven rays see 0: the mean of the mapped
    # colours is 1/8, which leads back to 1/7.
    history = Blended(color=jnp.full((6, 5, 3), 65504.0), count=jnp.ones((6, 5)))
    seen = resolve.traced_pixel(history, jnp.zeros((6, 5, 3)), 7, config=config)
    np.testing.assert_allclose(seen, 1.0 / 7.0, rtol=1e-4)


def test_without_feedback_only_the_history_of_traced_pixels_differs():
    method, *inputs = frame((9, 8))
    fed = resolve_samples(*inputs)
    unfed = resolve_samples(*inputs, feedback=False)
    np.testing.assert_array_equal(unfed.composite, fed.composite)
    np.testing.assert_array_equal(unfed.classification.mask, fed.classification.mask)
    for name in ("color", "count"):
        differs = np.asarray(getattr(unfed.history, name) != getattr(fed.history, name))
        differs = differs.reshape(*method.shape, -1).any(axis=-1)
        np.testing.assert_array_equal(differs, method == types.METHOD_ATAA)


def test_the_history_stores_the_composite_and_the_gbuffer_beside_it():
    _, *inputs = frame((6, 5))
    segmented, _, gbuffer, _, _ = inputs
    out = resolve_samples(*inputs)
    np.testing.assert_array_equal(out.history.color, out.composite)
    np.testing.assert_array_equal(out.history.depth, gbuffer.depth)
    np.testing.assert_array_equal(out.history.motion, gbuffer.motion)
    np.testing.assert_array_equal(out.classification.mask, segmented.mask)
    assert bool(out.history.valid)


@pytest.mark.parametrize("traced", ["join", "replace"])
@pytest.mark.parametrize("feedback", [True, False])
def test_bad_values_of_any_source_end_here(feedback, traced):
    _, segmented, _, gbuffer, blended, _ = frame((6, 5))
    bad = jnp.full((6, 5, 3), jnp.nan, jnp.float32).at[..., 1].set(jnp.inf)
    bad = bad.at[..., 2].set(-1.0)
    blended = Blended(color=bad, count=blended.count)
    inputs = (segmented, bad, gbuffer, blended, bad)
    out = resolve_samples(*inputs, feedback=feedback, traced=traced)
    expected = np.broadcast_to(np.float32([0.0, 65504.0, 0.0]), (6, 5, 3))
    # The way into the averaging space and back keeps 2⁻²⁴ of 1/65504: 0.4 %.
    rtol = 0.0 if traced == "replace" else 4e-3
    np.testing.assert_allclose(out.composite, expected, rtol=rtol)
    np.testing.assert_allclose(out.history.color, expected, rtol=rtol)


def test_jit_equals_eager():
    _, *inputs = frame((4, 5))
    for choices in ({"traced": "replace"}, {"traced": "replace", "feedback": False}):
        jitted = resolve_samples(*inputs, **choices)
        with jax.disable_jit():
            eager = resolve_samples(*inputs, **choices)
        jax.tree.map(np.testing.assert_array_equal, jitted, eager)
    jitted = resolve_samples(*inputs)
    with jax.disable_jit():
        eager = resolve_samples(*inputs)
    # A compiled mean may round its last bit differently.
    close = partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-7)
    jax.tree.map(close, jitted, eager)
