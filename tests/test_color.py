"""Colour: inverses, ranges and published values."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ataa_jax import color

colors = st.lists(st.floats(0.0, 1000.0, width=32), min_size=3, max_size=3)


def as_pixel(values):
    return jnp.asarray(values, jnp.float32)[None, :]


@given(colors)
def test_the_tone_map_is_below_one_and_its_inverse_is_exact(values):
    x = as_pixel(values)
    t = color.tonemap(x)
    assert np.all(np.asarray(t) < 1.0)
    # A rounding of t, 6e-8, is amplified by 1 + max(x) on the way back; three of them.
    limit = 2e-7 * (1.0 + np.max(values)) * max(np.max(values), 1.0)
    np.testing.assert_allclose(color.inverse_tonemap(t), x, rtol=0, atol=limit)


@pytest.mark.parametrize("average", ["tonemap", "linear"])
def test_nothing_but_radiance_enters_the_averaging_space(average):
    bad = jnp.asarray([[np.nan, -1.0, np.inf], [-np.inf, 0.5, 1e38]], jnp.float32)
    t = np.asarray(color.to_average(bad, average))
    assert np.all(np.isfinite(t))
    assert np.all(t >= 0.0)
    assert t[0, 0] == 0.0
    assert t[0, 1] == 0.0
    back = np.asarray(color.from_average(jnp.asarray(t), average))
    assert np.all(np.isfinite(back))
    assert np.all(
        back <= color.MAX_RADIANCE * 1.01
    )  # float32 next to 1: half a percent


def test_the_inverse_tone_map_stays_finite_at_one_and_beyond():
    t = jnp.asarray([[1.0, 0.5, 0.0], [2.0, 1.0, 0.0]], jnp.float32)
    assert np.all(np.isfinite(color.inverse_tonemap(t)))


@given(colors)
def test_ycocg_is_inverted(values):
    x = as_pixel(values)
    back = color.rgb(color.ycocg(x))
    np.testing.assert_allclose(back, x, atol=4e-7 * max(1.0, np.max(values)))


def test_ycocg_of_primaries():
    primaries = jnp.eye(3, dtype=jnp.float32)
    expected = [[0.25, 0.5, -0.25], [0.5, 0.0, 0.5], [0.25, -0.5, -0.25]]
    np.testing.assert_array_equal(color.ycocg(primaries), expected)


def test_srgb_has_the_standards_values_and_is_inverted():
    # IEC 61966-2-1: middle grey 0.18 encodes to 0.4614; the pieces meet at 0.0031308.
    x = jnp.asarray([0.0, 0.0031308, 0.18, 1.0], jnp.float32)
    expected = [0.0, 0.0404499, 0.4613561, 1.0]
    np.testing.assert_allclose(color.srgb_encode(x), expected, atol=1e-6)
    grid = jnp.linspace(0.0, 1.0, 1001, dtype=jnp.float32)
    np.testing.assert_allclose(
        color.srgb_decode(color.srgb_encode(grid)), grid, atol=1e-6
    )


def test_white_has_luma_one():
    np.testing.assert_allclose(color.luma(as_pixel([1.0, 1.0, 1.0])), 1.0, atol=1e-7)


@given(colors, st.floats(0.015625, 8.0, width=32))
def test_display_is_in_range_and_exposure_multiplies(values, exposure):
    x = as_pixel(values)
    shown = np.asarray(color.display(x, exposure))
    assert np.all((shown >= 0.0) & (shown <= 1.0))
    np.testing.assert_allclose(shown, color.display(x * exposure), atol=1e-6)
