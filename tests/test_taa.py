"""TAA: convergence, exact reads, hulls, bad values, and the oracle."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ataa_jax import taa, types
from tests.oracles import taa as oracle

STILL = jnp.zeros(2, jnp.float32)
JITTER = jnp.asarray([0.3, -0.2], jnp.float32)
PLAIN = taa.Config(rectify="none", motion="pixel")


def gbuffer(size, *, motion=None, valid=None, depth=None):
    full = np.zeros((*size, 2), np.float32)
    return types.GBuffer(
        depth=jnp.asarray(np.ones(size) if depth is None else depth, jnp.float32),
        motion=jnp.asarray(full if motion is None else motion, jnp.float32),
        motion_valid=jnp.asarray(np.ones(size, bool) if valid is None else valid),
        normal=jnp.zeros((*size, 3), jnp.float32),
        object=jnp.zeros(size, jnp.int32),
        material=jnp.zeros(size, jnp.int32),
    )


def history(color, *, count=1.0, valid=True):
    size = color.shape[:2]
    return types.History(
        color=jnp.asarray(color, jnp.float32),
        depth=jnp.ones(size, jnp.float32),
        motion=jnp.zeros((*size, 2), jnp.float32),
        count=jnp.asarray(np.broadcast_to(count, size), jnp.float32),
        valid=jnp.asarray(valid),
    )


def image(size, seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    return jnp.asarray(scale * rng.random((*size, 3)), jnp.float32)


def random_frame(size, seed):
    """A frame with everything in it: motion, borders, invalid pixels, sky."""
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1.0, 9.0, size)
    depth[rng.random(size) < 0.2] = np.inf
    buffers = gbuffer(
        size,
        motion=rng.uniform(-3.0, 3.0, (*size, 2)),
        valid=rng.random(size) < 0.8,
        depth=depth,
    )
    past = history(image(size, seed + 1, 3.0), count=rng.integers(1, 9, size))
    return past, image(size, seed + 2, 3.0), buffers


CONFIGS = {
    **{name: config for name, (config, _) in taa.PRESETS.items()},
    "plain": taa.Config(
        history_filter="bilinear", rectify="none", motion="pixel", weighting="linear"
    ),
    "clip in a rounded box": taa.Config(
        rectify="clip", neighbourhood="rounded", space="rgb", blend="accumulate"
    ),
    "variance of the plus": taa.Config(
        neighbourhood="plus", clamp_current=True, current_filter="gaussian"
    ),
    "variance of the rounded box": taa.Config(neighbourhood="rounded"),
    "clamp in rgb": taa.Config(rectify="clamp", space="rgb", weighting="linear"),
}


@pytest.mark.parametrize("size", [(7, 9), (1, 1)])
@pytest.mark.parametrize("name", CONFIGS)
def test_every_choice_agrees_with_the_oracle(name, size):
    config, params = CONFIGS[name], taa.default_params(0.1, 0.3, 4.0, 0.9)
    past, color, buffers = random_frame(size, seed=len(name))
    out = taa.taa(past, color, buffers, JITTER, params, config=config)
    arrays = jax.tree.map(np.asarray, (past, color, buffers))
    expected = oracle.taa(*arrays, np.asarray(JITTER), params, config)
    for got, want in zip(
        (out.color, out.reprojected, out.count, out.valid), expected, strict=True
    ):
        # float32 against float64: a few roundings, amplified by the clip's division
        # and by 1 + max(x) ≤ 4 in leaving the tone map.
        np.testing.assert_allclose(got, want, atol=2e-5, rtol=2e-5)


def test_four_pixels_by_hand():
    # Linear space, a = 1/4, no rectifier. The history is 0, 4, 8, 12 in a row; the
    # current frame 1 everywhere.
    config = replace(PLAIN, history_filter="bilinear", weighting="linear")
    then = np.broadcast_to(np.float32([0, 4, 8, 12])[None, :, None], (1, 4, 3))
    motion = np.float32([[[1.0, 0.0], [0.5, 0.0], [1.0, 0.0], [2.0, 0.0]]])
    out = taa.taa(
        history(then),
        jnp.ones((1, 4, 3), jnp.float32),
        gbuffer((1, 4), motion=motion),
        STILL,
        taa.default_params(0.25),
        config=config,
    )
    # Read: texel 1; between 1 and 2; texel 3; outside the view, so the current frame.
    np.testing.assert_array_equal(out.reprojected[0, :, 0], [4.0, 6.0, 12.0, 1.0])
    np.testing.assert_array_equal(out.color[0, :, 0], [3.25, 4.75, 9.25, 1.0])
    np.testing.assert_array_equal(out.count[0], [2.0, 2.0, 2.0, 1.0])
    np.testing.assert_array_equal(out.valid[0], [True, True, True, False])
    np.testing.assert_array_equal(out.previous_px[0, :, 1], [1.5, 2.0, 3.5, 5.5])


@pytest.mark.parametrize("filter_", ["bilinear", "catmull_rom"])
@pytest.mark.parametrize("weighting", ["tonemap", "luma", "linear"])
def test_a_motion_of_whole_pixels_reads_the_history_bit_by_bit(filter_, weighting):
    config = replace(PLAIN, history_filter=filter_, weighting=weighting)
    then = np.asarray(image((6, 8), seed=1, scale=100.0))
    for dy, dx in [(0, 0), (2, -3), (-1, 1)]:
        motion = np.broadcast_to(np.float32([dx, dy]), (6, 8, 2))
        out = taa.taa(
            history(then), image((6, 8)), gbuffer((6, 8), motion=motion),
            STILL, taa.default_params(), config=config,
        )  # fmt: skip
        rows, columns = np.nonzero(np.asarray(out.valid))
        assert len(rows) == (6 - abs(dy)) * (8 - abs(dx))
        np.testing.assert_array_equal(
            np.asarray(out.reprojected)[rows, columns], then[rows + dy, columns + dx]
        )


def test_a_still_scene_converges_to_the_mean_of_its_jittered_samples():
    config = replace(PLAIN, history_filter="bilinear", blend="accumulate")
    frames = [np.asarray(image((5, 6), seed=k)) for k in range(16)]
    past = history(np.zeros((5, 6, 3)), valid=False)
    for frame in frames:
        out = taa.taa(
            past, jnp.asarray(frame), gbuffer((5, 6)), JITTER,
            taa.default_params(), config=config,
        )  # fmt: skip
        past = history(np.asarray(out.color), count=np.asarray(out.count))
    mapped = [f / (1 + f.max(axis=-1, keepdims=True)) for f in frames]
    result = np.asarray(past.color)
    result = result / (1 + result.max(axis=-1, keepdims=True))
    # Sixteen round trips through float32.
    np.testing.assert_allclose(result, np.mean(mapped, axis=0), atol=1e-5)
    np.testing.assert_array_equal(past.count, 16.0)


@pytest.mark.parametrize("name", CONFIGS)
def test_a_constant_image_passes_unchanged(name):
    flat = jnp.broadcast_to(jnp.float32([0.2, 3.0, 0.7]), (7, 9, 3))
    _, _, buffers = random_frame((7, 9), seed=3)
    out = taa.taa(
        history(np.asarray(flat)), flat, buffers, JITTER,
        taa.default_params(), config=CONFIGS[name],
    )  # fmt: skip
    # Weights that sum to 1 up to rounding, then the way out of the tone map.
    np.testing.assert_allclose(out.color, flat, rtol=4e-6)
    np.testing.assert_allclose(out.reprojected, flat, rtol=4e-6)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=list(CONFIGS))
def test_the_first_frame_is_the_current_frame(config):
    config = replace(config, current_filter="none", clamp_current=False)
    color = image((5, 7), scale=10.0)
    past = history(np.full((5, 7, 3), np.nan), valid=False)
    out = taa.taa(
        past, color, gbuffer((5, 7)), JITTER, taa.default_params(), config=config
    )
    np.testing.assert_array_equal(out.color, color)
    np.testing.assert_array_equal(out.reprojected, color)
    np.testing.assert_array_equal(out.count, 1.0)
    assert not np.any(out.valid)


def test_nothing_is_valid_where_all_motion_leads_off_screen():
    motion = np.full((4, 5, 2), 1e6, np.float32)
    motion[0] = np.nan
    out = taa.taa(
        history(np.ones((4, 5, 3))), image((4, 5)), gbuffer((4, 5), motion=motion),
        STILL, taa.default_params(), config=taa.Config(),
    )  # fmt: skip
    assert not np.any(out.valid)
    assert np.all(np.isfinite(out.color))
    np.testing.assert_array_equal(out.color, image((4, 5)))


def test_a_view_of_sky_only_is_averaged_like_any_other():
    def averaged(depth):
        return taa.taa(
            history(np.ones((4, 5, 3))), image((4, 5)),
            gbuffer((4, 5), depth=np.full((4, 5), depth)),
            STILL, taa.default_params(), config=taa.Config(),
        )  # fmt: skip

    out, of_a_wall = averaged(np.inf), averaged(2.0)
    assert np.all(out.valid)
    np.testing.assert_array_equal(out.color, of_a_wall.color)


@settings(max_examples=20)
@given(
    name=st.sampled_from(list(CONFIGS)),
    seed=st.integers(0, 1000),
    bad=st.sampled_from([np.nan, np.inf, -np.inf, -3.0, 1e38]),
)
def test_bad_values_are_gone_within_the_frame(name, seed, bad):
    config = CONFIGS[name]
    past, color, buffers = random_frame((7, 9), seed)
    color = color.at[3, 4].set(bad)
    past = eqx.tree_at(
        lambda h: (h.color, h.count),
        past,
        (past.color.at[2, 6].set(bad), past.count.at[1, 1].set(bad)),
    )
    out = taa.taa(past, color, buffers, JITTER, taa.default_params(), config=config)
    for value in (out.color, out.reprojected, out.count):
        assert np.all(np.isfinite(value))
        assert np.all(np.asarray(value) >= 0.0)


@settings(max_examples=20)
@given(
    rectify=st.sampled_from(["none", "clamp", "clip", "variance_clip"]),
    dering=st.booleans(),
    seed=st.integers(0, 1000),
)
def test_the_result_lies_in_the_hull_of_its_inputs(rectify, dering, seed):
    config = taa.Config(
        history_filter="catmull_rom" if dering else "bilinear",
        dering=dering,
        rectify=rectify,
        space="rgb",
        weighting="linear",
    )
    past, color, buffers = random_frame((7, 9), seed)
    out = taa.taa(past, color, buffers, JITTER, taa.default_params(), config=config)
    inputs = np.stack([past.color, color])
    # A rounding beyond the extremes, which are at most 3.
    assert np.all(np.asarray(out.color) >= inputs.min(axis=(0, 1, 2)) - 1e-6)
    assert np.all(np.asarray(out.color) <= inputs.max(axis=(0, 1, 2)) + 1e-6)


def test_an_objects_edge_moves_with_the_object():
    # A near object in column 2 moves by one pixel; its neighbours follow its motion.
    depth = np.full((3, 5), 9.0, np.float32)
    depth[:, 2] = 1.0
    motion = np.zeros((3, 5, 2), np.float32)
    motion[:, 2, 0] = -1.0
    out = taa.taa(
        history(np.ones((3, 5, 3))), image((3, 5)),
        gbuffer((3, 5), motion=motion, depth=depth),
        STILL, taa.default_params(), config=taa.Config(motion="nearest_depth"),
    )  # fmt: skip
    np.testing.assert_array_equal(out.previous_px[1, :, 1], [0.5, 0.5, 1.5, 2.5, 4.5])


def test_jit_equals_eager():
    past, color, buffers = random_frame((5, 6), seed=8)
    config, params = taa.PRESETS["tuned"]
    jitted = taa.taa(past, color, buffers, JITTER, params, config=config)
    with jax.disable_jit():
        eager = taa.taa(past, color, buffers, JITTER, params, config=config)
    # Compiled code contracts a·b + c to one rounding where eager takes two.
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-6),
        jitted,
        eager,
    )


def test_parameters_do_not_compile_anew():
    past, color, buffers = random_frame((5, 6), seed=8)
    config, _ = taa.PRESETS["tuned"]
    for weight in (0.1, 0.2):
        taa.taa(past, color, buffers, JITTER, taa.default_params(weight), config=config)
    before = taa.taa._cache_size()
    taa.taa(past, color, buffers, JITTER, taa.default_params(0.3), config=config)
    assert taa.taa._cache_size() == before
