"""The packed mask, its budget, and the lists of pixels that sparse stages work on."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ataa_jax import compact, segmentation, types
from tests.oracles import segmentation as oracle


@settings(max_examples=30)
@given(
    seed=st.integers(0, 1000),
    levels=st.sampled_from([1, 3, 1000]),
    allowed=st.integers(-1, 110),
)
def test_the_budget_goes_to_the_highest_scores_then_to_the_first_pixels(
    seed, levels, allowed
):
    rng = np.random.default_rng(seed)
    size = (9, 11)
    method = rng.integers(0, 3, size)
    score = (rng.integers(0, levels, size) / levels).astype(np.float32)
    zeros = jnp.zeros(size, jnp.float32)
    wanted = types.Segmentation(
        mask=jnp.asarray(method | (3 << 16), jnp.uint32),
        why=jnp.zeros(size, jnp.uint16),
        score=jnp.asarray(score),
        luminance=zeros,
        depth=zeros,
    )
    out, overflow = segmentation.apply_budget(wanted, jnp.int32(allowed))
    got, hold = segmentation.unpack_mask(out.mask)
    keeps = oracle.budget(method, score, allowed)
    np.testing.assert_array_equal(np.asarray(got) == types.METHOD_ATAA, keeps)
    loses = (method == types.METHOD_ATAA) & ~keeps
    np.testing.assert_array_equal(np.asarray(out.why) == types.WHY_OVER_BUDGET, loses)
    assert np.all(np.asarray(got)[loses] == types.METHOD_TAA)
    assert np.all(np.asarray(hold) == 3)
    assert int(overflow) == loses.sum()


@settings(max_examples=30)
@given(
    size=st.sampled_from([(1, 1), (7, 9), (4, 16), (33, 31)]),
    density=st.sampled_from([0.0, 0.1, 0.9, 1.0]),
    seed=st.integers(0, 100),
)
def test_compaction_lists_the_pixels_in_row_major_order(size, density, seed):
    mask = np.random.default_rng(seed).random(size) < density
    indices, count = compact.compact(jnp.asarray(mask))
    expected = np.flatnonzero(mask)
    assert int(count) == len(expected)
    np.testing.assert_array_equal(indices[: len(expected)], expected)
    assert np.all(np.asarray(indices)[len(expected) :] == mask.size)


@settings(max_examples=20)
@given(
    count=st.sampled_from([1, 31, 64, 1000]),
    width=st.sampled_from([1, 4, 8, 100]),
    chunk=st.sampled_from([1, 40, 5000]),
    density=st.sampled_from([0.0, 0.1, 1.0]),
)
def test_mapping_by_chunks_equals_mapping_all(count, width, chunk, density):
    tile = (count // width, width) if count % width == 0 else None
    rng = np.random.default_rng(count)
    needed, values = rng.random(count) < density, rng.integers(1, 99, (count, 2))

    def work(rows, used):
        doubled = {"one": 2 * rows[:, 0], "both": -rows}
        return doubled, jnp.sum(jnp.where(used, rows[:, 0], 0))

    rows = jnp.asarray(values, jnp.int32)
    found, total = compact.map_chunks(jnp.asarray(needed), chunk, work, rows, tile)
    np.testing.assert_array_equal(found["one"], 2 * values[:, 0] * needed)
    np.testing.assert_array_equal(found["both"], -values * needed[:, None])
    assert int(total) == values[needed, 0].sum()


@given(st.integers(0, 2), st.integers(0, 1 << 20))
def test_the_mask_is_unpacked_as_packed_and_saturates(method, history):
    mask = segmentation.pack_mask(
        jnp.full((1, 1), method, jnp.uint32), jnp.full((1, 1), history, jnp.uint32)
    )
    got = segmentation.unpack_mask(mask)
    assert int(got[0][0, 0]) == method
    assert int(got[1][0, 0]) == min(history, 65535)
