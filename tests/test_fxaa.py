"""FXAA: the oracle, symmetries, sparse = full, and what passes unchanged."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ataa_jax import color, fxaa
from tests.oracles import fxaa as oracle

CONFIG = fxaa.Config(preset=12)  # the quickest to compile; the oracle test has all
PARAMS = fxaa.default_params()


def edges(size, seed=0):
    """A slanted edge with some noise: long spans and lone pixels both."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : size[0], 0 : size[1]]
    step = (y > 0.2 * x + rng.uniform(0, size[0] / 2)).astype(float)
    image = 0.15 + 0.6 * step[..., None] * rng.uniform(0.5, 1.0, 3)
    image = image + 0.2 * (rng.random(size) < 0.1)[..., None]
    return jnp.asarray(image + 0.02 * rng.random((*size, 3)), jnp.float32)


@pytest.mark.parametrize(
    ("preset", "size"),
    [(12, (17, 33)), (29, (17, 33)), (39, (17, 33)), (12, (1, 1)), (12, (1, 7))],
)
def test_every_preset_agrees_with_the_oracle(preset, size):
    for seed in range(3):
        image = edges(size, seed)
        got = fxaa.fxaa(image, PARAMS, config=fxaa.Config(preset=preset))
        expected = oracle.fxaa(np.asarray(image), PARAMS, preset)
        np.testing.assert_allclose(got, expected, atol=1e-5)  # float32 positions


def test_a_horizontal_step_by_hand():
    # Rows 0 0 | 1 1 over the whole width: no end is found within the span, so only the
    # subpixel shift is left. s = |(2(0 + 1 + 0 + 0) + 0 + 0 + 1 + 1)/12 − 0| / 1 = 1/3;
    # (s²(3 − 2s))² · 0.75 = (7/27)² · 0.75 = 0.0504115.
    image = np.zeros((4, 41, 3), np.float32)
    image[2:] = 1.0
    out = np.asarray(fxaa.fxaa(jnp.asarray(image), PARAMS, config=CONFIG))[:, 20, 0]
    np.testing.assert_allclose(out, [0.0, 0.0504115, 0.9495885, 1.0], atol=1e-6)


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0])
def test_a_constant_image_passes_unchanged(value):
    image = jnp.full((9, 21, 3), value, jnp.float32)
    np.testing.assert_array_equal(fxaa.fxaa(image, PARAMS, config=CONFIG), image)
    zero = fxaa.default_params(edge_threshold=0.0, edge_threshold_min=0.0)
    np.testing.assert_array_equal(fxaa.fxaa(image, zero, config=CONFIG), image)


@settings(max_examples=10)
@given(seed=st.integers(0, 100), share=st.sampled_from([0.0, 0.05, 0.5, 1.0]))
def test_sparse_equals_full_where_needed_and_passes_the_rest_bit_by_bit(seed, share):
    image = edges((17, 33), seed)
    needed = np.random.default_rng(seed).random((17, 33)) < share
    config = fxaa.Config(preset=12, chunk=64)
    full = np.asarray(fxaa.fxaa(image, PARAMS, config=config))
    out = np.asarray(
        fxaa.fxaa_sparse(image, jnp.asarray(needed), PARAMS, config=config)
    )
    np.testing.assert_array_equal(out[needed], full[needed])
    np.testing.assert_array_equal(out[~needed], np.asarray(image)[~needed])


@pytest.mark.parametrize("chunk", [1, 50])
def test_the_chunk_size_changes_nothing(chunk):
    image = edges((9, 21))
    out = fxaa.fxaa(image, PARAMS, config=fxaa.Config(preset=12, chunk=chunk))
    np.testing.assert_array_equal(out, fxaa.fxaa(image, PARAMS, config=CONFIG))


def test_a_batch_of_pixels_equals_the_whole():
    image = edges((9, 21))
    y, x = (jnp.asarray(i.reshape(-1), jnp.int32) for i in np.mgrid[0:9, 0:21])
    got = fxaa.fxaa_at(image, color.luma(image), y, x, PARAMS, config=CONFIG)
    whole = fxaa.fxaa(image, PARAMS, config=CONFIG)
    # The two programs contract products and sums differently.
    np.testing.assert_allclose(got.reshape(9, 21, 3), whole, atol=1e-6)


@settings(max_examples=10)
@given(seed=st.integers(0, 100))
def test_the_result_lies_in_the_hull_of_the_image(seed):
    image = edges((17, 33), seed)
    out = np.asarray(fxaa.fxaa(image, PARAMS, config=CONFIG))
    assert out.min() >= np.min(image) - 1e-6
    assert out.max() <= np.max(image) + 1e-6


def test_higher_thresholds_filter_fewer_pixels():
    image = edges((17, 33))
    changed = [
        int(
            np.sum(
                np.asarray(
                    fxaa.fxaa(
                        image, fxaa.default_params(edge_threshold=t), config=CONFIG
                    )
                    != image
                )
            )
        )
        for t in (0.063, 0.166, 0.9)
    ]
    assert changed == sorted(changed, reverse=True)
    assert changed[0] > changed[-1]


def test_jit_equals_eager():
    image = edges((5, 8))
    jitted = fxaa.fxaa(image, PARAMS, config=CONFIG)
    with jax.disable_jit():
        eager = fxaa.fxaa(image, PARAMS, config=CONFIG)
    np.testing.assert_allclose(jitted, eager, atol=1e-6)  # one rounding against two
