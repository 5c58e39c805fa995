"""Scale and place: scenes a thousand times as large, or far from the origin.

The yard of `studio` on a walk, rendered anew each time; see `studio.scaled`.
"""

from functools import cache

import numpy as np

from ataa_jax import pipeline
from tests.hard_cases import studio
from tests.hard_cases.case import Topic
from tests.hard_cases.studio import apart, walk

TOPIC = Topic("scale and place")


@cache
def _at(factor: float, far: float = 0.0) -> list[pipeline.FrameOutput]:
    """The walk in a yard of another scale and place."""
    shift = np.array([far, -0.5 * far, 0.25 * far])
    return studio.run(
        studio.scaled(studio.yard().scene, factor, shift),
        [studio.scaled_inputs(each, factor, shift) for each in walk()],
    )


@TOPIC.case(
    "a scene scaled by 2^±10 has the same mask, bit by bit",
    danger="an offset, floor or threshold in scene units",
    quantity="masks and why-bits of 4 frames that differ",
    bound=0,
    reason="scaling by a power of two changes no significand",
)
def powers_of_two() -> float:
    wrong = 0
    for factor in (2.0**10, 2.0**-10):
        for base, other in zip(_at(1.0), _at(factor), strict=True):
            for part in ("mask", "why"):
                a, b = (getattr(o.segmentation, part) for o in (base, other))
                wrong += int(np.sum(np.asarray(a != b)))
    return float(wrong)


def _share_alike(base, other) -> float:
    return min(
        float(np.mean(studio.methods(a) == studio.methods(b)))
        for a, b in zip(base, other, strict=True)
    )


@TOPIC.case(
    "a scene scaled by 1e±3 has the same mask away from the threshold",
    danger="an offset, floor or threshold in scene units",
    quantity="pixels of the second frame that differ, their score over 1e-3 from the "
    "threshold and no sample on another object within 2 px",
    bound=0,
    # Coordinates round anew, by 6e-8: scores follow, but where a sample falls on the
    # other side of an edge the colour is another one.
    reason="scores move by rounding alone, 1e-4 at most",
)
def powers_of_ten() -> float:
    threshold = float(studio.params().segmentation.threshold)
    wrong = 0
    for factor in (1e3, 1e-3):
        a, b = _at(1.0)[1], _at(factor)[1]
        near = np.zeros(studio.SIZE, bool)
        for output in (a, b):
            score = np.asarray(output.segmentation.score)
            near |= np.abs(score - threshold) < 1e-3 * threshold
        for other, base in zip(_at(factor)[:2], _at(1.0)[:2], strict=True):
            edge = np.asarray(other.gbuffer.object != base.gbuffer.object)
            spread = np.pad(edge, 2)
            for r in range(5):
                for c in range(5):
                    near |= spread[r : r + edge.shape[0], c : c + edge.shape[1]]
        wrong += int(np.sum((studio.methods(a) != studio.methods(b)) & ~near))
    return float(wrong)


@TOPIC.case(
    "motion vectors 1e4 units from the origin are nearly the same",
    danger="coordinates lose their last bits: 1e4 has steps of 2⁻¹⁰",
    quantity="largest change where the same object is seen, px, 4 frames",
    # Half a step is 2^-11 units, at depth 2 with 16.6 px a unit and depth 0.004 px;
    # eye and corner are rounded, now and before, in two axes.
    bound=8 * 2.0**-11 * 8.3,
    reason="eight roundings of 2⁻¹¹ units, 8.3 px a unit at the nearest depth, 2",
)
def translated_motion() -> float:
    return _motion_error(1e4)


def _motion_error(far: float) -> float:
    worst = 0.0
    for a, b in zip(_at(1.0), _at(1.0, far), strict=True):
        same = np.asarray(a.gbuffer.object == b.gbuffer.object)
        error = np.abs(np.asarray(a.gbuffer.motion) - np.asarray(b.gbuffer.motion))
        worst = max(worst, float(error.max(axis=-1)[same].max()))
    return worst


@TOPIC.case(
    "a scene 1e4 units from the origin has nearly the same mask",
    danger="coordinates lose their last bits: 1e4 has steps of 2⁻¹⁰",
    quantity="share of pixels with the same method, worst of 4 frames",
    bound=0.95,
    # Half a step, 2^-11, is 1/60 of a pixel at depth 4: samples within that of an edge
    # change sides, one in thirty of those at edges, and each pixel's 3×3 with them.
    reason="corners move by 1/60 px; one edge sample in 30 changes sides, with its 3×3",
    at_least=True,
)
def translated() -> float:
    return _share_alike(_at(1.0), _at(1.0, 1e4))


@TOPIC.case(
    "float32 gives way gradually with the distance from the origin",
    danger="float32 has no place left between the pixels",
    quantity="furthest power of 10 with motion within 0.1 px and 9 pixels of 10 shown "
    "within 4/255, yard of 12 units",
    bound=1e4,
    reason="at 1e5 a step is 2⁻⁷ units: eight of its halves are 0.26 px",
    at_least=True,
)
def gives_up() -> float:
    fine = 0.0
    for far in (1e2, 1e3, 1e4, 1e5, 1e6):
        shown = min(
            float(np.mean(apart(a, b) <= 4.0 / 255.0))
            for a, b in zip(_at(1.0), _at(1.0, far), strict=True)
        )
        if _motion_error(far) > 0.1 or shown < 0.9:
            break
        fine = far
    return fine
