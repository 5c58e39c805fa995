"""The failures of section 2, each alone: what the mask finds, and what it leaves."""

from dataclasses import replace
from functools import cache

import numpy as np

from ataa_jax import color as colors
from ataa_jax import pipeline, reference, sampling, segmentation, types
from ataa_jax import world as worlds
from ataa_jax.builtin import failures

SIZE = (90, 160)
# The largest channel's difference that is seen; see experiments/failure_suite.py.
VISIBLE = 8.0 / 255.0


@cache
def shot(letter):
    case = failures.case(letter)
    return worlds.sequence(worlds.prepare(case.build()), case.path, SIZE)


def jitter(frame):
    return sampling.halton_jitter(16)[(frame + failures.LEAD_IN) % 16]


@cache
def frames(letter, *, adaptive=True, optional=""):
    """Outputs by frame index, of ATAA 8x without a budget or of TAA alone."""
    case, seen = failures.case(letter), shot(letter)
    config, params = pipeline.preset(
        "paper", seen.world.scene, SIZE, budget=float("inf")
    )
    config = replace(config, adaptive=adaptive)
    if optional:
        switched = replace(config.segmentation, **{f"use_{optional}": True})
        config = replace(config, segmentation=switched)
        # As in the experiment: the other two terms count as before.
        params = pipeline.with_threshold(params, 0.04)
    state, found = pipeline.init(SIZE), {}
    for index in range(-failures.LEAD_IN, max(case.frames) + 1):
        inputs = seen.inputs(index, jitter(index))
        output, state = pipeline.stages(
            state,
            pipeline.with_cut(inputs, index in (-failures.LEAD_IN, case.cut)),
            params,
            scene=seen.world.scene,
            tracer=seen.world.tracer,
            config=config,
        )
        found[index] = output
    return found


def masks(letter, frame, **choices):
    """Returns (method, why) of a frame."""
    found = frames(letter, **choices)[frame].segmentation
    method, _ = segmentation.unpack_mask(found.mask)
    return np.asarray(method), np.asarray(found.why)


@cache
def truth(letter, frame):
    return reference.reference(shot(letter), frame, 64, use_cache=False)


def wrong(letter, frame):
    """Where TAA alone is visibly wrong."""
    exact = np.asarray(colors.display(truth(letter, frame).color))
    image = np.asarray(frames(letter, adaptive=False)[frame].image)
    return np.abs(image - exact).max(axis=-1) > VISIBLE


def rectangle(low, high, z):
    """Pixels whose whole square shows the rectangle from `low` to `high` at depth z."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    step = 2.0 * np.tan(np.radians(22.5)) / SIZE[0] * z
    x, y = (x - SIZE[1] / 2) * step, 1.5 - (y - SIZE[0] / 2) * step
    return (
        (x > low[0] + step)
        & (x < high[0] - step)
        & (y > low[1] + step)
        & (y < high[1] - step)
    )


def was_outside(letter, frame, previous_from_current):
    """Pixels that lay outside the previous view, and those too near its rim to say.

    The map takes view-space points (..., 3) of this frame to the previous one's.
    """
    height, width = SIZE
    y, x = np.mgrid[:height, :width] + 0.5
    step = 2.0 * np.tan(np.radians(22.5)) / height
    z = np.asarray(frames(letter)[frame].gbuffer.depth, np.float64)
    offset = jitter(frame)
    x_now, y_now = x + offset[0], y + offset[1]
    point = np.stack(
        [(x_now - width / 2) * step * z, (height / 2 - y_now) * step * z, -z], axis=-1
    )
    then = previous_from_current(point)
    x_then = width / 2 + then[..., 0] / (-then[..., 2] * step)
    y_then = height / 2 - then[..., 1] / (-then[..., 2] * step)
    at_x, at_y = x + x_then - x_now, y + y_then - y_now
    margin = np.minimum(np.minimum(at_x, width - at_x), np.minimum(at_y, height - at_y))
    # float32 positions of a few metres, seen 160 px wide, are good to 1e-3 px.
    return margin < 0.0, np.abs(margin) < 1e-2


def test_every_failure_of_the_paper_has_a_case_that_shows_surfaces():
    assert [case.letter for case in failures.CASES] == list("abcdefghi")
    for case in failures.CASES:
        source = case.build()
        assert source.cameras
        assert source.lights
        assert case.cut is None or case.cut in case.frames


def test_what_a_moving_object_reveals_is_fxaas_and_nothing_else_is():
    for frame in (3, 6):
        method, why = masks("a", frame)
        now, before = (
            np.asarray(frames("a")[index].gbuffer.object)
            for index in (frame, frame - 1)
        )
        revealed = (now == 0) & (before == 1)
        # The rim's neighbours were wall before: held against those, it is no news.
        inner = revealed.copy()
        padded = np.pad(before == 1, 1, mode="edge")
        for row in range(3):
            for column in range(3):
                inner &= padded[row : row + SIZE[0], column : column + SIZE[1]]
        assert inner.sum() > 80
        assert np.all(method[inner] == types.METHOD_FXAA)
        assert np.all(why[inner] == types.WHY_DISOCCLUDED)
        assert not np.any((method == types.METHOD_FXAA) & ~revealed)
        assert not np.any(method[revealed] == types.METHOD_TAA)


def test_a_turning_camera_leaves_fxaa_the_strip_that_comes_into_view():
    case = failures.case("b")
    aspect = SIZE[1] / SIZE[0]
    angle = np.arctan(2.0 * np.tan(np.radians(22.5)) * aspect * case.path.motion)
    c, s = np.cos(angle), np.sin(angle)
    # The camera turns right; a point ahead was to the right before.
    turn = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
    for frame in (2, 5):
        method, _ = masks("b", frame)
        outside, unsure = was_outside("b", frame, lambda p: p @ turn.T)
        assert 0.03 < outside.mean() < 0.1
        np.testing.assert_array_equal(
            (method == types.METHOD_FXAA)[~unsure], outside[~unsure]
        )


def test_stepping_back_leaves_fxaa_the_rim_that_comes_into_view():
    case, seen = failures.case("c"), shot("c")
    step = -2.0 * case.path.motion * seen.focus
    for frame in (2, 5):
        method, _ = masks("c", frame)
        outside, unsure = was_outside(
            "c", frame, lambda p: p + np.array([0.0, 0.0, step])
        )
        for rim in (outside[0], outside[-1], outside[:, 0], outside[:, -1]):
            assert np.all(rim)
        np.testing.assert_array_equal(
            (method == types.METHOD_FXAA)[~unsure], outside[~unsure]
        )


def test_wires_that_taa_loses_are_traced():
    lost, traced = 0, 0
    for frame in (1, 4, 7):
        method, _ = masks("d", frame)
        missing = (np.asarray(truth("d", frame).thin) > 0.0) & wrong("d", frame)
        lost += missing.sum()
        traced += (missing & (method == types.METHOD_ATAA)).sum()
    assert lost > 500
    assert traced >= 0.9 * lost


def test_detail_finer_than_pixels_needs_the_spread_criterion():
    for frame in (1, 4, 7):
        failed = wrong("e", frame)
        assert failed.mean() > 0.1
        two, _ = masks("e", frame)
        more, why = masks("e", frame, optional="spread")
        missed, left = (
            np.mean(method[failed] == types.METHOD_TAA) for method in (two, more)
        )
        # The paper's two criteria miss more than a third, spread finds a third of that.
        assert missed > 0.33
        assert left < 0.75 * missed
        assert np.any(why & types.WHY_SPREAD)


def caught_by_luminance(letter, frame, where):
    """Shares of TAA's visible errors that are traced, and that luminance began."""
    method, why = masks(letter, frame)
    failed = wrong(letter, frame) & where
    assert failed.sum() > 50
    why = why[failed]
    began = (why & (types.WHY_LUMINANCE | types.WHY_HELD)) != 0
    return np.mean(method[failed] == types.METHOD_ATAA), np.mean(began)


def test_a_moving_shadow_is_caught_by_the_luminance_criterion():
    output = frames("g")[4]
    floor = np.asarray(output.gbuffer.object) == 0
    # Motion vectors say nothing: the floor stands still.
    assert not np.any(np.asarray(output.gbuffer.motion)[floor])
    traced, began = caught_by_luminance("g", 4, floor)
    assert traced > 0.95
    assert began > 0.95
    _, why = masks("g", 4)
    assert not np.any(why & (types.WHY_DISOCCLUDED | types.WHY_OFF_SCREEN))


def changes(letter, where):
    """The largest change that half a second brings to a region, by equal jitter."""
    world = shot(letter).world
    config, params = pipeline.preset("paper", world.scene, SIZE)
    seen = [
        np.asarray(
            pipeline.raster.raster(
                world.scene,
                shot(letter).inputs(frame),
                params.raster,
                tracer=world.tracer,
                config=config.raster,
            ).color
        )
        for frame in (0, 5)
    ]
    return np.abs(seen[1] - seen[0])[where].max()


def test_what_moves_behind_a_pane_is_caught_by_the_luminance_criterion():
    pane = rectangle((-1.45, 0.45), (1.45, 2.55), 4.0)
    assert changes("f", pane) > 0.0
    # The paper's criteria miss part of it (`failure_suite.csv`): behind a pane the
    # contrast falls, and a pale stripe's step stays under the threshold.
    traced, began = caught_by_luminance("f", 4, pane)
    assert traced > 0.6
    assert began > 0.6


def test_what_moves_behind_a_pane_is_found_by_the_layers_criterion():
    left, missed, failures_seen = 0, 0, 0
    for frame in (1, 4, 7):
        failed = wrong("f", frame)
        two, _ = masks("f", frame)
        more, why = masks("f", frame, optional="layers")
        failures_seen += failed.sum()
        missed += np.sum(failed & (two == types.METHOD_TAA))
        left += np.sum(failed & (more == types.METHOD_TAA))
        pane = rectangle((-1.45, 0.45), (1.45, 2.55), 4.0)
        asked = (why & types.WHY_LAYERS) != 0
        assert np.all(asked[pane])
        assert not np.any(asked & (np.asarray(layered("f", frame)) == 0.0))
    # The paper's two criteria leave more than a tenth of it, this one less.
    assert missed > 0.1 * failures_seen
    assert left < 0.1 * failures_seen


def layered(letter, frame):
    return frames(letter, optional="layers")[frame].gbuffer.second_share


def test_a_moving_reflection_is_caught_by_the_luminance_criterion():
    mirror = rectangle((-2.6, 0.5), (2.6, 2.7), 6.0)
    assert changes("h", mirror) > 0.0
    assert not np.any(np.asarray(frames("h")[4].gbuffer.motion)[mirror])
    traced, began = caught_by_luminance("h", 4, mirror)
    assert traced > 0.9
    assert began > 0.9


def test_after_a_cut_the_whole_frame_is_fxaas():
    cut = failures.case("i").cut
    method, why = masks("i", cut)
    assert np.all(method == types.METHOD_FXAA)
    assert np.all(why == types.WHY_OFF_SCREEN)
    before, _ = masks("i", cut - 1)
    assert not np.any(before == types.METHOD_FXAA)
