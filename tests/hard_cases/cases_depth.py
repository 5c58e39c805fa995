"""Depth edges: sky beside geometry, wild ratios, planes at grazing angles, z-fighting.

The depth term is |Sobel(1/z)| / (8 · max 1/z) over the 3×3.
"""

import jax.numpy as jnp
import numpy as np

from ataa_jax import embree, segmentation, terms
from tests import tiny
from tests.hard_cases.case import Topic

TOPIC = Topic("depth")

SIZE = (48, 64)
# Degrees between the middle of the view and a plane: 90 faces it.
TILTS = (90.0, 60.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.0)


def _sobel(depth: np.ndarray) -> np.ndarray:
    """The term by its definition, in float64."""
    inverse = np.where(depth > 0, 1.0 / np.where(depth > 0, depth, 1.0), 0.0)
    padded = np.pad(inverse, 1, mode="edge")
    h, w = depth.shape
    n = [[padded[r : r + h, c : c + w] for c in range(3)] for r in range(3)]
    top = np.max(n, axis=(0, 1))
    dx = n[0][2] + 2 * n[1][2] + n[2][2] - n[0][0] - 2 * n[1][0] - n[2][0]
    dy = n[2][0] + 2 * n[2][1] + n[2][2] - n[0][0] - 2 * n[0][1] - n[0][2]
    return np.hypot(dx, dy) / (8.0 * np.where(top > 0, top, 1.0))


def _term(depth: np.ndarray) -> np.ndarray:
    return np.asarray(terms.depth_edge(jnp.asarray(depth, jnp.float32)), np.float64)


@TOPIC.case(
    "depths of 1e-3 to 1e6 and sky in one frame give the term by its definition",
    danger="1/z² leaves float32; inf − inf beside the sky",
    quantity="largest difference from float64; inf if any term is not finite",
    bound=5e-7,
    reason="nine terms of at most 1 and a quotient: eight roundings of 2⁻²⁴",
)
def wild_ratios() -> float:
    rng = np.random.default_rng(0)
    depth = 10.0 ** rng.uniform(-3, 6, SIZE)
    depth[rng.random(SIZE) < 0.3] = np.inf
    depth[:8, :8] = np.inf
    depth = depth.astype(np.float32)
    difference = np.abs(_term(depth) - _sobel(depth.astype(np.float64)))
    return float(np.where(np.isfinite(difference), difference, np.inf).max())


@TOPIC.case(
    "depths that are no depths count as sky",
    danger="NaN, 0, −1, 1e-45 and 3e38 in one 3×3",
    quantity="terms that are not in [0, 1]",
    bound=0,
    reason="the term is a share by construction",
)
def no_depths() -> float:
    values = (np.nan, 0.0, -1.0, 1e-45, 1e-30, 2e-30, 3e38, -np.inf, 1.0)
    rng = np.random.default_rng(1)
    wrong = 0
    for chosen in (values, (-1.0, 1.0), (np.nan, 1.0)):
        term = _term(rng.choice(np.float32(chosen), SIZE))
        wrong += int(np.sum(~((term >= 0.0) & (term <= 1.0 + 1e-6))))
    return float(wrong)


@TOPIC.case(
    "a wall that faces the camera is no edge at any distance",
    danger="the rounding of z is taken for a slope",
    quantity="largest term of walls at 1e-3 to 1e6",
    bound=0,
    reason="all nine depths are the same float",
)
def facing_wall() -> float:
    return max(_term(np.full(SIZE, 10.0**e)).max() for e in range(-3, 7))


def _plane(tilt: float, roll: float) -> tuple[np.ndarray, np.ndarray]:
    """1/z of a plane at distance 1, and its step by a pixel (x, y), float64."""
    pixel = 2.0 * np.tan(0.5) / SIZE[0]
    angle, turn = np.radians(tilt), np.radians(roll)
    # A unit normal at `tilt` from the view's own plane: 1/z = normal · (x, y, −1).
    normal = np.array(
        [np.cos(angle) * np.sin(turn), -np.cos(angle) * np.cos(turn), -np.sin(angle)]
    )
    y, x = np.indices(SIZE)
    x = (x + 0.5 - SIZE[1] / 2) * pixel
    y = -(y + 0.5 - SIZE[0] / 2) * pixel
    inverse = normal[0] * x + normal[1] * y - normal[2]
    return inverse, np.array([normal[0], -normal[1]]) * pixel


def _planes():
    """Yields the paper's and the term's view of planes: (term, px to the horizon)."""
    for tilt in TILTS:
        for roll in (0.0, 20.0, 45.0):
            inverse, step = _plane(tilt, roll)
            depth = np.where(inverse > 0, 1.0 / np.where(inverse > 0, inverse, 1), 0)
            seen = np.where(inverse > 0, depth, np.inf).astype(np.float32)
            length = np.hypot(*step)
            far = np.where(length > 1e-12, inverse / max(length, 1e-12), np.inf)
            # Only where all of the 3×3 is plane; the image's border repeats pixels.
            whole = far > 2.0
            whole[[0, -1]] = whole[:, [0, -1]] = False
            yield _term(seen)[whole], far[whole]


def _alone(name: str) -> float:
    """The depth term over which a preset fires while all others are 0."""
    config, params = segmentation.PRESETS[name]
    names = [n for n in ("luminance", "depth", "response") if vars(config)[f"use_{n}"]]
    total = sum(float(getattr(params, f"{n}_weight")) for n in names)
    return float(params.threshold) * total / float(params.depth_weight)


@TOPIC.case(
    "a plane is an edge near its horizon only, paper's criteria",
    danger="grazing planes fire all over: 1/z falls fast against itself",
    quantity="px from the horizon at which a plane still fires, 9 tilts × 3 rolls",
    # The term of a plane at d px is 1/(d + 1) if the horizon lies along the rows,
    # less on the diagonal; it exceeds 0.12, 0.06 on the mean of two, while d < 7.33.
    bound=1.0 / 0.12 - 1.0 + 1e-3,
    reason="1/(d + 1) > 0.12 ⇔ d < 7.33 px: the Sobel's own answer, not rounding",
)
def planes_by_paper() -> float:
    limit = _alone("paper")
    worst = [far[term > limit].max(initial=0.0) for term, far in _planes()]
    return float(max(worst))


@TOPIC.case(
    "a plane 10° from the line of sight or steeper is no edge, paper's criteria",
    danger="floors and walls seen at everyday angles are traced all over",
    quantity="share of the plane's pixels that fire on depth alone, up to 16 px from "
    "its horizon",
    bound=0,
    reason="the term is under 1/17 there, half of what fires",
)
def plain_planes() -> float:
    limit = _alone("paper")
    shares = [np.mean(term[far > 16.0] > limit) for term, far in _planes() if
              (far > 16.0).any()]  # fmt: skip
    return float(max(shares))


@TOPIC.case(
    "a plane is never an edge by itself, default",
    danger="grazing planes spend the ray budget",
    quantity="pixels of planes that fire on depth alone, 9 tilts × 3 rolls",
    bound=0,
    reason="the fitted weight of depth is so small that 1 itself does not fire",
)
def planes_by_default() -> float:
    limit = _alone("fitted")
    return float(sum(int(np.sum(term > limit)) for term, _ in _planes()))


def _fight(gap: float) -> int:
    """Of rays at two parallel squares, `gap` apart at distance 4: wrong picks."""
    near = tiny.quad(4.0, (0.0, 0.0, gap))
    far = tiny.quad(4.0, (0.0, 0.0, 0.0))
    turn = tiny.moved(turn=0.7)[:, :3]  # no axis is special
    parts = [tiny.Part((p.position @ turn.T).astype(np.float32)) for p in (far, near)]
    tracer = embree.build(tiny.scene(parts))
    rng = np.random.default_rng(0)
    target = rng.uniform(-1.5, 1.5, (20_000, 3)) * (1, 1, 0)
    origin = np.broadcast_to(np.array([0.5, 0.3, 4.0]), target.shape)
    rotated = ((part @ turn.T).astype(np.float32) for part in (origin, target - origin))
    hits = tracer.intersect_numpy(tiny.still(), *rotated)
    return int(np.sum(hits.triangle < 2))


@TOPIC.case(
    "of near-coplanar surfaces the nearer one is seen",
    danger="z-fighting: neighbouring pixels pick different surfaces",
    quantity="smallest gap, a power of 4 over the distance, with no wrong pick",
    bound=2.0**-20,
    # Corners are rounded to 2^-24 of coordinates up to 2, rays likewise, and Embree's
    # distance is a quotient of sums of such products: sixteen steps of the distance.
    reason="sixteen float32 steps: corners, ray and quotient are rounded",
)
def z_fighting() -> float:
    clean = [2.0**-k for k in range(14, 25, 2) if _fight(4.0 * 2.0**-k) == 0]
    return min(clean, default=np.inf)


@TOPIC.case(
    "coplanar surfaces are picked alike every time",
    danger="a still view flickers, for threads and packets race",
    quantity="rays that pick another triangle in a second trace of gap 0",
    bound=0,
    reason="same input, same bits",
)
def coplanar_is_repeatable() -> float:
    parts = [tiny.quad(4.0), tiny.quad(4.0)]
    tracer = embree.build(tiny.scene(parts))
    rng = np.random.default_rng(0)
    target = rng.uniform(-1.5, 1.5, (20_000, 3)) * (1, 1, 0)
    origin = np.broadcast_to(np.array([0.5, 0.3, 4.0]), target.shape)
    rays = [part.astype(np.float32) for part in (origin, target - origin)]
    first, second = (
        tracer.intersect_numpy(tiny.still(), *rays).triangle for _ in range(2)
    )
    return float(np.sum(first != second))


TOPIC.covered(
    "a plane's depth term is its constant gradient",
    danger="a slope counts as a curve",
    test="test_terms.py::test_a_planes_depth_term_is_its_constant_gradient",
    bound="atol 3e-7, rtol 1e-7",
    reason="1/z near 1 is rounded to 6e-8; its differences are summed",
)
TOPIC.covered(
    "terms lie in [0, 1], and depths scaled by 2^±20 give the same mask",
    danger="a threshold that depends on the scene's unit",
    test="test_segmentation.py::"
    "test_terms_lie_in_the_unit_interval_and_scaling_the_scene_changes_nothing",
    bound="terms and score in [0, 1]; masks bit-equal at scales 2⁻²⁰, 1/2 and 2²⁰",
    reason="the term is a ratio, and powers of two scale without rounding",
)
