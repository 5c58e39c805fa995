"""Reprojection: points at and behind the camera's plane, borders, long motion."""

import jax.numpy as jnp
import numpy as np

from ataa_jax import camera as cameras
from ataa_jax import window
from ataa_jax.vector import Vec3
from tests.hard_cases import buffers
from tests.hard_cases.case import Topic

TOPIC = Topic("reprojection")

WIDE = 8192


@TOPIC.case(
    "points behind the camera and at w ≈ 0 are flagged, and finite",
    danger="division by w = 0; points behind the eye mirrored into the view",
    quantity="positions that are not finite, or behind the camera and not flagged",
    bound=0,
    reason="one infinite position would make a NaN of the history's weights",
)
def behind_the_camera() -> float:
    depth = np.array(
        [0.0, -0.0, *(s * 10.0**e for e in range(-45, 39) for s in (1, -1))]
    )
    across = np.array([0.0, 1e-38, 1e-20, 1e-3, 1.0, 1e20, 1e30])
    z, x, y = (part.reshape(-1) for part in np.meshgrid(depth, across, across))
    offset = Vec3(*(jnp.asarray(part, jnp.float32) for part in (x, -y, -z)))
    eye = cameras.make(np.eye(4), 0.9)
    found = cameras.project(eye, buffers.SIZE, offset)
    x_px, y_px, in_front = (np.asarray(part) for part in found)
    infinite = ~(np.isfinite(x_px) & np.isfinite(y_px))
    return float(np.sum(infinite | (in_front & (z <= 0.0))))


@TOPIC.case(
    "positions on a border between pixels and on the image's edge are decided",
    danger="floor and rounding disagree; the last half pixel counts as outside",
    quantity="positions read wrongly, of 48",
    bound=0,
    reason="a table by the stated rule: the right or lower pixel, edges included",
)
def borders() -> float:
    height, width = 4, 6
    steps = np.array([-1.0, -0.5 - 2**-22, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0])
    wrong = 0
    for dx in steps:
        motion = jnp.full((height, width), dx, jnp.float32)
        row, column = window.history_position(motion, motion * 0.0)
        inside = np.asarray(window.inside(row, column))[0]
        index = np.asarray(window.nearest_index(row, column))[0]
        exact = np.float32(dx) + np.arange(width, dtype=np.float32)
        want_inside = (exact >= -0.5) & (exact <= width - 0.5)
        want = np.clip(np.floor(exact.astype(np.float64) + 0.5), 0, width - 1)
        wrong += int(np.sum((inside != want_inside) | (index != want)))
    return float(wrong)


@TOPIC.case(
    "motion of thousands of pixels reads where it leads",
    danger="pixel + motion loses its fraction in float32",
    quantity="largest error of the position in an image 8192 wide, px",
    bound=2.0**-11,
    reason="half a step of float32 between 4096 and 8192; 1/2048 of a bilinear weight",
)
def long_motion() -> float:
    rng = np.random.default_rng(0)
    target = rng.uniform(-0.5, WIDE - 0.5, (2, WIDE))
    motion = (target - np.arange(WIDE)).astype(np.float32)
    _, column = window.history_position(jnp.asarray(motion), jnp.zeros((2, WIDE)))
    exact = motion.astype(np.float64) + np.arange(WIDE)
    return float(np.abs(np.asarray(column, np.float64) - exact).max())


@TOPIC.case(
    "motion beyond the image is outside, whatever its length",
    danger="an integer overflows and lands inside the image",
    quantity="motions of 10 to 1e38 px, NaN and inf that count as inside",
    bound=0,
    reason="nothing is known of the past there: FXAA's case",
)
def endless_motion() -> float:
    lengths = [s * 10.0**e for e in range(1, 39) for s in (1, -1)]
    wrong = 0
    for length in (*lengths, np.nan, np.inf, -np.inf):
        motion = jnp.full(buffers.SIZE, length, jnp.float32)
        row, column = window.history_position(motion, motion)
        index = np.asarray(window.nearest_index(row, column))
        outside = (index < 0) | (index >= buffers.SIZE[0] * buffers.SIZE[1])
        wrong += int(np.sum(np.asarray(window.inside(row, column)) | outside))
    return float(wrong)


TOPIC.covered(
    "no motion reads the history bit by bit, with every filter and averaging space",
    danger="filters blur a still image a little every frame",
    test="test_taa.py::test_a_motion_of_whole_pixels_reads_the_history_bit_by_bit",
    bound="bit-equal at motions of (0, 0), (2, −3) and (−1, 1) px",
    reason="at whole pixels the texel itself is handed on, unfiltered",
)
TOPIC.covered(
    "where nothing moved motion vectors are exactly zero",
    danger="rounding of two projections makes ghosts of motion",
    test="test_raster_oracle.py::test_motion_is_exactly_zero_where_nothing_moved",
    bound="motion = 0 where still, ≠ 0 where not, pixels near an edge left out",
    reason="equal poses must cancel, not nearly cancel",
)
TOPIC.covered(
    "a cut forgets everything",
    danger="the frame before the cut shines through",
    test="test_pipeline.py::test_a_cut_forgets_everything",
    bound="image and state bit-equal to those of a first frame, every pixel FXAA's",
    reason="what is forgotten cannot show",
)
TOPIC.covered(
    "a view of sky only is averaged like any other",
    danger="infinite depth in the search for the nearest surface",
    test="test_taa.py::test_a_view_of_sky_only_is_averaged_like_any_other",
    bound="colour bit-equal to a wall's, every pixel valid",
    reason="depth picks the motion that is read, and enters no sum",
)
