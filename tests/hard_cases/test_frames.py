"""Hard cases: see `cases_place` and `cases_frames`, which share one compiled program.

And hypothesis looks for scenes that break a promise of a frame.
"""

import hypothesis
import pytest
from hypothesis import strategies as st

from tests.hard_cases import cases_frames, cases_place, random_scenes
from tests.hard_cases.checks import check, parameters

KNOBS = st.builds(
    random_scenes.Knobs,
    seed=st.integers(0, 2**16),
    shape=st.sampled_from(random_scenes.SHAPES),
    scale=st.sampled_from([1e-4, 1e-2, 1.0, 1e2, 1e5]),
    uv=st.sampled_from([0.0, 1.0, 1e3, 1e6]),
    spoiled=st.booleans(),
    intensity=st.sampled_from([0.0, 1e-3, 3.0, 1e6]),
    emission=st.sampled_from([0.0, 1.0, 1e5]),
    fov_y=st.sampled_from([0.01, 0.9, 2.9]),
    motion=st.sampled_from([0.0, 0.01, 0.3, 100.0]),
    inside=st.booleans(),
)


@pytest.mark.parametrize(
    "case", [*parameters(cases_place.TOPIC), *parameters(cases_frames.TOPIC)]
)
def test_the_measured_value_keeps_its_bound(case):
    check(case)


@hypothesis.settings(max_examples=20)
@hypothesis.given(KNOBS)
def test_any_small_scene_keeps_every_promise_of_a_frame(knobs):
    assert cases_frames.broken(knobs) == {}


@pytest.mark.hard
@hypothesis.settings(max_examples=200)
@hypothesis.given(KNOBS)
def test_any_small_scene_keeps_every_promise_with_all_effects_compiled(knobs):
    assert cases_frames.broken(knobs, full=True) == {}
