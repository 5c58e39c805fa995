"""Sample sets: means, ranges, and the independence of the reference."""

import numpy as np
import pytest

from ataa_jax import sampling
from ataa_jax.errors import InputError


@pytest.mark.parametrize("samples", [1, 2, 4, 8])
def test_d3d_patterns_have_zero_mean_and_stay_in_the_pixel(samples):
    points = sampling.pattern(samples)
    assert points.shape == (samples, 2)
    assert points.dtype == np.float32
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-7)
    assert np.all((points >= -0.5) & (points < 0.5))


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_traced_patterns_are_n_rooks(samples):
    # In a grid of n×n cells every row and every column holds exactly one sample.
    cells = np.floor((sampling.pattern(samples) + 0.5) * samples).astype(int)
    if samples == 8:  # on sixteenths, D3D's 8x falls on cell borders: 16 rows, 8 used
        cells = ((sampling.pattern(samples) + 0.5) * 16).astype(int)
    assert len(set(cells[:, 0])) == samples
    assert len(set(cells[:, 1])) == samples


def test_halton_jitter_is_the_radical_inverse_from_index_one():
    points = sampling.halton_jitter(4, centred=False) + 0.5
    np.testing.assert_allclose(points[:, 0], [1 / 2, 1 / 4, 3 / 4, 1 / 8])
    np.testing.assert_allclose(points[:, 1], [1 / 3, 2 / 3, 1 / 9, 4 / 9], rtol=1e-6)
    np.testing.assert_allclose(sampling.halton_jitter(8).mean(axis=0), 0, atol=1e-7)


@pytest.mark.parametrize("samples", [1, 16, 64, 256])
def test_reference_set_is_centred_and_shares_no_point_with_tested_patterns(samples):
    points = sampling.reference_pattern(samples)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-7)
    assert np.abs(points).max() < 0.5 + 0.5 / samples**0.5
    for other in (2, 4, 8, 16, 32):
        gap = np.abs(points[:, None] - sampling.pattern(other)[None]).max(axis=-1)
        assert samples == 1 or gap.min() > 1e-5


def test_a_count_below_one_is_refused():
    with pytest.raises(InputError, match="at least 1"):
        sampling.pattern(0)
    with pytest.raises(InputError, match="at least 1"):
        sampling.reference_pattern(0)
