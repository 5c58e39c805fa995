"""Segmentation and sparse stage: counts at the capacity, counters, packing, ties."""

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import compact, segmentation, types
from ataa_jax.mask import HOLD_MAX
from tests.hard_cases import buffers
from tests.hard_cases.case import Topic

TOPIC = Topic("segmentation and sparse rays")

PIXELS, CHUNK = 40, 8


@TOPIC.case(
    "every pixel asked for is worked on once: none, all, the capacity, one more",
    danger="a last chunk that is skipped, done twice, or reads past the list",
    quantity="pixels worked on another number of times than once, 41 counts × 2 orders",
    bound=0,
    reason="a pixel left out stays black, one done twice is counted twice",
)
def capacity() -> float:
    @jax.jit
    def worked_on(needed):
        def work(index, used, seen):
            return seen.at[index].add(used.astype(jnp.int32), mode="drop")

        return compact.for_each_chunk(needed, CHUNK, work, jnp.zeros(PIXELS, jnp.int32))

    wrong = 0
    for count in range(PIXELS + 1):  # 8, 16, … are whole chunks
        first = np.arange(PIXELS) < count
        for needed in (first, np.random.default_rng(count).permutation(first)):
            wrong += int(np.sum(np.asarray(worked_on(jnp.asarray(needed))) != needed))
    return float(wrong)


def _wanting(count: int, score) -> types.Segmentation:
    """A mask in which the first `count` pixels of 80 ask for rays."""
    method = np.where(np.arange(80) < count, types.METHOD_ATAA, types.METHOD_TAA)
    nothing = jnp.zeros(buffers.SIZE, jnp.float32)
    return types.Segmentation(
        mask=jnp.asarray(method.reshape(buffers.SIZE), jnp.uint32),
        why=jnp.zeros(buffers.SIZE, jnp.uint16),
        score=jnp.asarray(
            np.broadcast_to(score, 80).reshape(buffers.SIZE), jnp.float32
        ),
        luminance=nothing,
        depth=nothing,
    )


def _kept(wanted: types.Segmentation, allowed: int) -> tuple[np.ndarray, int]:
    out, overflow = segmentation.apply_budget(wanted, jnp.int32(allowed))
    method, _ = segmentation.unpack_mask(out.mask)
    return np.asarray(method).reshape(-1) == types.METHOD_ATAA, int(overflow)


@TOPIC.case(
    "a budget of exactly what is asked for loses nothing, one less loses one",
    danger="off by one at the cut",
    quantity="pixels kept or overflows that differ, 0 to 80 asked, budgets ±1",
    bound=0,
    reason="the budget is a count",
)
def budget_edge() -> float:
    wrong = 0
    for asked in (0, 1, 31, 32, 33, 79, 80):
        for spare in (-1, 0, 1):
            allowed = max(asked + spare, 0)
            kept, overflow = _kept(_wanting(asked, 0.5), allowed)
            wrong += int(kept.sum() != min(asked, allowed))
            wrong += int(overflow != max(asked - allowed, 0))
    return float(wrong)


@TOPIC.case(
    "scores of NaN, inf, −0 and equal ones keep the budget, the first in order win",
    danger="NaN has no place in an order: the cut is not found",
    quantity="frames over budget, or ties that went to later pixels",
    bound=0,
    reason="rays beyond the budget cost time; ties by order give the same bits",
)
def odd_scores() -> float:
    rng = np.random.default_rng(0)
    values = np.float32([np.nan, -np.nan, np.inf, -np.inf, -0.0, 0.0, 1e-45, 0.5, 1])
    wrong = 0
    for allowed in (0, 1, 7, 40, 79):
        for _ in range(20):
            kept, _ = _kept(_wanting(80, rng.choice(values, 80)), allowed)
            wrong += int(kept.sum() != allowed)
        for score in (0.0, -0.0, 0.5, np.inf):
            kept, _ = _kept(_wanting(80, score), allowed)
            wrong += int(not np.array_equal(np.flatnonzero(kept), np.arange(allowed)))
    return float(wrong)


@TOPIC.case(
    "packing gives back every method and every counter",
    danger="a shift or a mask too short",
    quantity="of all 3 × 65,536 pairs, those that differ",
    bound=0,
    reason="the mask is the state: one lost bit is another frame",
)
def packing() -> float:
    method, counter = (
        part.reshape(3, -1) for part in np.meshgrid(np.arange(3), np.arange(65_536))
    )
    mask = segmentation.pack_mask(
        jnp.asarray(method, jnp.uint32), jnp.asarray(counter, jnp.uint32)
    )
    got = segmentation.unpack_mask(mask)
    found_method, found_counter = (np.asarray(part) for part in got)
    return float(np.sum((found_method != method) | (found_counter != counter)))


@TOPIC.case(
    "the hold counter saturates, counts down, and never wraps",
    danger="65,536 wraps to 0 or spills into the method; 0 − 1 is 65,535",
    quantity="frames in which counter or method is not the expected one",
    bound=0,
    reason="a wrapped counter holds a pixel for 18 minutes at 60 frames a second",
)
def counter() -> float:
    wrong = 0
    grey = jnp.full((*buffers.SIZE, 3), 0.5)
    for hold in (-5, 0, 1, 3, 65_534, 65_535, 65_536, 2**31 - 1):
        current = buffers.state(buffers.history(grey))
        params = segmentation.default_params(hold=hold)
        expected = min(max(hold, 0), HOLD_MAX)
        for index in range(6):
            then = grey * (0.25 if index == 0 else 1.0)  # it fires once
            out = segmentation.segmentation(
                current, grey, buffers.gbuffer(), then, params,
                config=segmentation.Config(),
            )  # fmt: skip
            method, left = segmentation.unpack_mask(out.mask)
            if index:
                traced, expected = expected > 0, max(expected - 1, 0)
            else:
                traced = True
            name = types.METHOD_ATAA if traced else types.METHOD_TAA
            wrong += int(not np.all(np.asarray(left) == expected))
            wrong += int(not np.all(np.asarray(method) == name))
            current = buffers.with_leaf(
                current, lambda s: s.classification.mask, out.mask
            )
    return float(wrong)


TOPIC.covered(
    "no pixel traced costs no ray, one pixel changes one",
    danger="an empty chunk traces its fill",
    test="test_raytrace.py::test_pixels_not_asked_for_stay_black_and_cost_nothing",
    bound="0 rays and colour 0; asked for one pixel, colour 0 at all others",
    reason="rays are spent, and colours written, only where asked for",
)
TOPIC.covered(
    "every pixel traced equals supersampling",
    danger="the last chunk",
    test="test_raytrace.py::test_every_pixel_traced_equals_supersampling",
    bound="> 0.995 of pixels within rtol 1e-4, atol 1e-5; every ray counted",
    reason="another order of summation; rays differ in the last bit of their "
    "directions",
)
TOPIC.covered(
    "the capacity of a chunk changes nothing",
    danger="pixels at a chunk's border",
    test="test_raytrace.py::test_the_capacity_changes_nothing",
    bound="rtol 1e-5, atol 1e-6; counts of rays equal",
    reason="a pixel's packet neighbours change with the chunk, its rays do not",
)
TOPIC.covered(
    "the budget goes to the highest scores, then to the first pixels",
    danger="ties that depend on threads",
    test="test_mask.py::"
    "test_the_budget_goes_to_the_highest_scores_then_to_the_first_pixels",
    bound="0 pixels differ from a stable sort; overflow equal",
    reason="ties go by pixel order, so that one answer is right",
)
TOPIC.covered(
    "bad radiance and depth leave the score finite",
    danger="NaN scores",
    test="test_segmentation.py::test_bad_radiance_and_depth_leave_the_score_finite",
    bound="every score finite",
    reason="NaN compares false: such a pixel would never be traced",
)
