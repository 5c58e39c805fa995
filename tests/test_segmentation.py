"""Segmentation: the paper's order of tests, the hold counter, further criteria."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ataa_jax import segmentation, types
from ataa_jax.errors import InputError
from tests.oracles import segmentation as oracle

CONFIG = segmentation.Config()
LOW = 0xFFFF


def frame(size, *, motion=None, depth=None, seed=0):
    """State, colour, G-buffer and reprojected history of a still, flat grey view."""
    grey = jnp.full((*size, 3), 0.5, jnp.float32)
    still = np.zeros((*size, 2), np.float32) if motion is None else motion
    depth = np.ones(size, np.float32) if depth is None else depth
    gbuffer = types.GBuffer(
        depth=jnp.asarray(depth, jnp.float32),
        motion=jnp.asarray(still, jnp.float32),
        motion_valid=jnp.ones(size, bool),
        normal=jnp.zeros((*size, 3), jnp.float32),
        object=jnp.zeros(size, jnp.int32),
        material=jnp.zeros(size, jnp.int32),
    )
    past = types.History(
        color=grey,
        depth=gbuffer.depth,
        motion=gbuffer.motion,
        count=jnp.ones(size, jnp.float32),
        valid=jnp.asarray(True),
    )
    mask = types.Classification(mask=jnp.zeros(size, jnp.uint32))
    return types.State(history=past, classification=mask), grey, gbuffer, grey


def random_frame(size, seed):
    rng = np.random.default_rng(seed)
    motion = rng.uniform(-2.0, 2.0, (*size, 2)).astype(np.float32)
    depth = rng.uniform(1.0, 4.0, size)
    depth[rng.random(size) < 0.4] = np.inf
    state, _, gbuffer, _ = frame(size, motion=motion, depth=depth)
    color = rng.uniform(0.0, 2.0, (*size, 3)) * (rng.random(size) < 0.6)[..., None]
    then = motion + rng.choice([0.0, 0.3, 0.9, 3.0], (*size, 1))
    held = rng.integers(0, 4, size) * (rng.random(size) < 0.5)
    state = eqx.tree_at(
        lambda s: (s.history.motion, s.history.depth, s.classification.mask),
        state,
        (
            jnp.asarray(then, jnp.float32),
            jnp.asarray(rng.uniform(1.0, 4.0, size), jnp.float32),
            jnp.asarray((held << 16) | 1, jnp.uint32),
        ),
    )
    gbuffer = eqx.tree_at(
        lambda g: g.motion_valid, gbuffer, jnp.asarray(rng.random(size) < 0.9)
    )
    normal = rng.normal(size=(*size, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    # Few normals and ids, so that some neighbourhoods hold one alone; sky has none.
    kind = np.repeat(rng.integers(0, 3, size[0])[:, None], size[1], axis=1)
    normal = np.where((kind > 0)[..., None], normal[0, 0], normal)
    normal[np.isinf(depth)] = 0.0
    ids = np.where(np.isinf(depth), -1, kind)
    gbuffer = eqx.tree_at(
        lambda g: (g.normal, g.object, g.material),
        gbuffer,
        (
            jnp.asarray(normal, jnp.float32),
            jnp.asarray(ids, jnp.int32),
            jnp.asarray(np.minimum(ids, 1), jnp.int32),
        ),
    )
    reprojected = color * rng.uniform(0.5, 1.5, (*size, 1))
    return (
        state,
        jnp.asarray(color, jnp.float32),
        gbuffer,
        jnp.asarray(reprojected, jnp.float32),
    )


def run(inputs, config=CONFIG, **params):
    params = segmentation.default_params(**params)
    out = segmentation.segmentation(*inputs, params, config=config)
    method, hold = segmentation.unpack_mask(out.mask)
    return np.asarray(method), np.asarray(hold), out


CONFIGS = {
    "paper": CONFIG,
    "either": segmentation.Config(reading="either"),
    "pixel": segmentation.Config(disocclusion="pixel"),
    "depth test": segmentation.Config(depth_disocclusion=True),
    "no motion test": segmentation.Config(use_disocclusion=False),
    "no history": segmentation.Config(use_history=False, use_luminance=False),
    "no depth": segmentation.Config(use_depth=False),
    "normals": segmentation.Config(use_normal=True),
    "objects": segmentation.Config(use_object=True),
    "materials": segmentation.Config(use_material=True, use_depth=False),
    "spread": segmentation.Config(use_spread=True),
    "all, either": segmentation.Config(
        reading="either",
        use_normal=True,
        use_object=True,
        use_material=True,
        use_spread=True,
    ),
    "nothing": segmentation.Config(use_luminance=False, use_depth=False),
}


@pytest.mark.parametrize("size", [(9, 11), (1, 1), (2, 5)])
@pytest.mark.parametrize("name", CONFIGS)
def test_every_choice_agrees_with_the_oracle(name, size):
    params = segmentation.default_params(
        threshold=0.12,
        disocclusion_px=0.5,
        reset_px=0.7,
        hold=5,
        depth_weight=2.0,
        normal_weight=0.7,
        object_weight=0.4,
        material_weight=0.3,
        spread_weight=3.0,
        normal_threshold=0.2,
    )
    inputs = random_frame(size, seed=len(name))
    out = segmentation.segmentation(*inputs, params, config=CONFIGS[name])
    arrays = jax.tree.map(np.asarray, inputs)
    expected = oracle.segmentation(
        *arrays, jax.tree.map(np.asarray, params), CONFIGS[name]
    )
    method, hold = segmentation.unpack_mask(out.mask)
    for got, want in zip((method, hold, out.why), expected, strict=False):
        np.testing.assert_array_equal(got, want)
    # The largest error of a quotient of nine-term sums in float32.
    np.testing.assert_allclose(out.score, expected[3], atol=2e-6)


def test_five_pixels_by_hand():
    state, color, gbuffer, _ = frame((1, 5))
    gbuffer = eqx.tree_at(
        lambda g: (g.motion_valid, g.motion),
        gbuffer,
        (
            gbuffer.motion_valid.at[0, 0].set(False),  # nothing known of the past
            gbuffer.motion.at[0, 1].set(jnp.asarray([2.0, 0.0])),  # was still before
        ),
    )
    held = np.array([[7, 7, 3, 1, 0]])
    state = eqx.tree_at(
        lambda s: s.classification.mask, state, jnp.asarray(held << 16, jnp.uint32)
    )
    config = segmentation.Config(disocclusion="pixel")
    method, hold, out = run((state, color, gbuffer, color), config, threshold=0.1)
    np.testing.assert_array_equal(method, [[0, 0, 2, 2, 1]])
    np.testing.assert_array_equal(hold, [[0, 0, 2, 0, 0]])
    np.testing.assert_array_equal(out.why, [[1, 2, 4, 4, 0]])
    np.testing.assert_allclose(out.score, [[0, 0, 0.1, 0.1, 0]])


@pytest.mark.parametrize("config", CONFIGS.values(), ids=list(CONFIGS))
def test_a_still_flat_view_is_all_taa(config):
    method, hold, out = run(frame((7, 9)), config)
    assert np.all(method == types.METHOD_TAA)
    assert not np.any(hold)
    assert not np.any(out.why)
    assert not np.any(out.score)


@pytest.mark.parametrize("size", [(7, 9), (1, 1)])
def test_the_first_frame_is_all_fxaa_and_says_why(size):
    state, *rest = random_frame(size, seed=1)
    state = eqx.tree_at(lambda s: s.history.valid, state, jnp.asarray(False))
    method, hold, out = run((state, *rest))
    assert np.all(method == types.METHOD_FXAA)
    assert not np.any(hold)
    assert np.all(np.asarray(out.why) == types.WHY_OFF_SCREEN)


def test_motion_that_leads_off_screen_or_is_no_number_is_fxaas():
    for bad in (1e9, np.nan, np.inf):
        motion = np.full((4, 5, 2), bad, np.float32)
        method, _, out = run(frame((4, 5), motion=motion))
        assert np.all(method == types.METHOD_FXAA)
        assert np.all(np.isfinite(out.score))


def test_what_a_moving_object_uncovers_is_disoccluded():
    # The object covered columns 2 to 5 and moved right by four; the background stands.
    state, color, gbuffer, _ = frame((3, 12))
    then = np.zeros((3, 12, 2), np.float32)
    then[:, 2:6, 0] = -4.0
    now = np.zeros((3, 12, 2), np.float32)
    now[:, 6:10, 0] = -4.0
    near = state.history.depth.at[:, 2:6].multiply(0.5)
    state = eqx.tree_at(
        lambda s: (s.history.motion, s.history.depth), state, (jnp.asarray(then), near)
    )
    gbuffer = eqx.tree_at(lambda g: g.motion, gbuffer, jnp.asarray(now))
    for choice, expected in (
        ("pixel", [0, 0, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0]),
        # The band's own rim has a neighbour that stood still before.
        ("neighbourhood", [0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0]),
    ):
        config = segmentation.Config(disocclusion=choice)
        method, _, _ = run((state, color, gbuffer, color), config)
        np.testing.assert_array_equal(method[1] == types.METHOD_FXAA, expected)


def test_the_depth_test_sees_only_what_was_hidden():
    config = segmentation.Config(depth_disocclusion=True)
    now = np.float32([[4.0, 4.0, np.inf, np.inf, 2.0]])
    then = np.float32([[2.0, 3.9, 3.0, np.inf, 9.0]])
    state, color, gbuffer, _ = frame((1, 5), depth=now)
    state = eqx.tree_at(lambda s: s.history.depth, state, jnp.asarray(then))
    _, _, out = run((state, color, gbuffer, color), config)
    np.testing.assert_array_equal(np.asarray(out.why) & 2, [[2, 0, 2, 0, 0]])


def test_a_pixel_that_fires_once_is_traced_for_hold_frames_more():
    state, grey, gbuffer, _ = frame((5, 5))
    methods = []
    for index in range(8):
        then = grey * (0.25 if index == 0 else 1.0)
        method, _, out = run((state, grey, gbuffer, then), hold=4)
        methods.append(method[2, 2])
        state = eqx.tree_at(lambda s: s.classification.mask, state, out.mask)
        if index == 1:
            assert out.why[2, 2] == types.WHY_HELD
    assert methods == [2, 2, 2, 2, 2, 1, 1, 1]


def test_a_significant_change_of_motion_resets_the_counter():
    config = segmentation.Config(use_disocclusion=False)
    state, grey, gbuffer, _ = frame((3, 3))
    state = eqx.tree_at(
        lambda s: (s.classification.mask, s.history.motion),
        state,
        (jnp.full((3, 3), 4 << 16, jnp.uint32), jnp.full((3, 3, 2), 5.0, jnp.float32)),
    )
    method, hold, out = run((state, grey, gbuffer, grey), config)
    assert np.all(method == types.METHOD_TAA)
    assert not np.any(hold)
    assert np.all(np.asarray(out.why) == types.WHY_RESET)


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), scale=st.sampled_from([2.0**-20, 0.5, 2.0**20]))
def test_terms_lie_in_the_unit_interval_and_scaling_the_scene_changes_nothing(
    seed, scale
):
    state, color, gbuffer, then = random_frame((9, 11), seed)
    _, _, out = run((state, color, gbuffer, then))
    for term in (out.luminance, out.depth, out.score):
        assert np.all((np.asarray(term) >= 0.0) & (np.asarray(term) <= 1.0))
    gbuffer = eqx.tree_at(lambda g: g.depth, gbuffer, gbuffer.depth * scale)
    past = state.history.depth * scale
    state = eqx.tree_at(lambda s: s.history.depth, state, past)
    _, _, scaled = run((state, color, gbuffer, then))
    np.testing.assert_array_equal(scaled.mask, out.mask)


def test_optional_criteria_by_hand():
    # Two walls that meet at a right angle between columns 3 and 4, one depth, one grey.
    state, grey, gbuffer, _ = frame((3, 8))
    right = np.arange(8) >= 4
    normal = np.where(right[:, None], (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    gbuffer = eqx.tree_at(
        lambda g: (g.normal, g.object, g.material),
        gbuffer,
        (
            jnp.asarray(np.broadcast_to(normal, (3, 8, 3)), jnp.float32),
            jnp.asarray(np.broadcast_to(right, (3, 8)), jnp.int32),
            jnp.asarray(np.broadcast_to(np.arange(8) >= 6, (3, 8)), jnp.int32),
        ),
    )
    # This frame's samples alternate about the history's grey: the 3×3 means agree to a
    # ninth of the difference, which alone stays under the threshold.
    sign = (-1.0) ** np.add.outer(np.arange(3), np.arange(8))
    noisy = grey * jnp.asarray(1.0 + 0.2 * sign[..., None], jnp.float32)
    edge = [0, 0, 0, 1, 1, 0, 0, 0]
    for name, bit, color, expected in (
        ("normal", types.WHY_NORMAL, grey, edge),
        ("object", types.WHY_OBJECT, grey, edge),
        ("material", types.WHY_MATERIAL, grey, [0, 0, 0, 0, 0, 1, 1, 0]),
        ("spread", types.WHY_SPREAD, noisy, [1] * 8),
    ):
        inputs = (state, color, gbuffer, grey)
        method, _, _ = run(inputs, threshold=0.03)
        assert np.all(method == types.METHOD_TAA)
        # Weighted so heavily that the other terms do not thin it out.
        config = replace(CONFIG, **{f"use_{name}": True})
        weight = {f"{name}_weight": 100.0}
        method, _, out = run(inputs, config, threshold=0.03, **weight)
        np.testing.assert_array_equal(method[1] == types.METHOD_ATAA, expected)
        np.testing.assert_array_equal(out.why[1], np.multiply(expected, bit))


def test_criteria_that_are_off_are_not_in_the_program():
    inputs = random_frame((5, 6), seed=3)
    params = segmentation.default_params()

    def program(config):
        def stage(state, color, gbuffer, then):
            return segmentation.segmentation(
                state, color, gbuffer, then, params, config=config
            )

        return str(jax.make_jaxpr(stage)(*inputs))

    # Of all terms only that of normals takes an arc sine.
    assert "asin" not in program(CONFIG)
    assert "asin" in program(replace(CONFIG, use_normal=True))
    results = []
    for ids in (0, 7):
        state, color, gbuffer, then = inputs
        gbuffer = eqx.tree_at(
            lambda g: (g.normal, g.object, g.material),
            gbuffer,
            (gbuffer.normal * ids, gbuffer.object * ids, gbuffer.material * ids),
        )
        results.append(
            segmentation.segmentation(
                state, color, gbuffer, then, params, config=CONFIG
            )
        )
    jax.tree.map(np.testing.assert_array_equal, *results)


def test_bad_radiance_and_depth_leave_the_score_finite():
    state, color, gbuffer, then = frame((4, 5))
    color = color.at[1, 1].set(jnp.nan).at[2, 2].set(jnp.inf).at[3, 3].set(-1.0)
    depth = gbuffer.depth.at[0, 0].set(jnp.nan).at[1, 0].set(0.0).at[2, 0].set(-1.0)
    gbuffer = eqx.tree_at(lambda g: g.depth, gbuffer, depth)
    for config in (CONFIG, CONFIGS["all, either"]):
        _, _, out = run((state, color, gbuffer, then), config)
        assert np.all(np.isfinite(out.score))


def test_jit_equals_eager():
    inputs = random_frame((5, 6), seed=2)
    params = segmentation.default_params()
    jitted = segmentation.segment(*inputs, params, jnp.int32(5), config=CONFIG)
    with jax.disable_jit():
        eager = segmentation.segment(*inputs, params, jnp.int32(5), config=CONFIG)
    # Compiled code contracts a·b + c to one rounding where eager takes two.
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), jitted, eager
    )


def test_parameters_do_not_compile_anew():
    inputs = random_frame((5, 6), seed=2)
    run(inputs)
    before = segmentation.segmentation._cache_size()
    run(inputs, threshold=0.7, hold=9)
    assert segmentation.segmentation._cache_size() == before
    run(inputs, replace(CONFIG, use_depth=False))
    assert segmentation.segmentation._cache_size() == before + 1


def test_the_response_fires_where_the_taa_result_left_its_history():
    state, color, gbuffer, then = frame((3, 8))
    blended = then.at[:, 4].set(0.9)
    config = replace(CONFIG, use_response=True)
    params = segmentation.default_params(threshold=0.03, response_weight=100.0)
    out = segmentation.segmentation(
        state, color, gbuffer, then, params, config=config, blended=blended
    )
    method, _ = segmentation.unpack_mask(out.mask)
    expected = np.arange(8) == 4
    np.testing.assert_array_equal(np.asarray(method[1]) == types.METHOD_ATAA, expected)
    np.testing.assert_array_equal(out.why[1], expected * types.WHY_RESPONSE)


def test_what_moves_otherwise_behind_a_layer_fires():
    state, color, gbuffer, then = frame((3, 4))
    share = jnp.asarray([[0.0, 0.1, 0.3, 0.5]] * 3, jnp.float32)
    other = gbuffer.motion + jnp.asarray([[[3.0, 0.0]]], jnp.float32)
    config = replace(CONFIG, use_layers=True)
    buffers = replace(gbuffer, second_motion=other, second_share=share)
    # The mean of three terms, of which two are 0 here; 3 px count for 3/4.
    params = segmentation.default_params(threshold=0.05)
    with pytest.raises(InputError, match="second_motion=True"):
        segmentation.segmentation(state, color, gbuffer, then, params, config=config)
    out = segmentation.segmentation(state, color, buffers, then, params, config=config)
    fires = np.array([False, False, True, True])
    np.testing.assert_array_equal(out.why[1], fires * types.WHY_LAYERS)


def test_the_response_without_a_taa_result_is_refused():
    config = replace(CONFIG, use_response=True)
    with pytest.raises(ValueError, match="asks for the TAA result"):
        run(frame((3, 4)), config)
