"""Trees, hedge, tufts and potted plants; leaves are cut out by alpha."""

import numpy as np

from ataa_jax.builtin.landscape import WATER, ground, shore
from ataa_jax.builtin.parts import Parts
from ataa_jax.builtin.shapes import Point, Shape, cards, lathe, merge, sheet, tube, unit


def add(parts: Parts) -> None:
    """Adds everything that grows."""
    _tree(parts, (-8.9, 0.0, 2.4), 6.6, 2.7, "leaf tree", seed=70)
    _tree(parts, (3.6, -0.1, -15.0), 7.5, 2.4, "leaf birch", seed=71)
    for k, (x, z, h, r) in enumerate(
        [
            (-13.5, -13.0, 9.5, 3.6),
            (-6.0, -15.0, 8.6, 3.2),
            (-1.6, -17.5, 8.0, 2.8),
            (-21.0, -6.0, 9, 3.8),
        ]
    ):
        _tree(parts, (x, 0.0, z), h, r, "leaf tree", seed=72 + k)
    _hedge(parts)
    _tufts(parts)
    _bushes(parts)
    _pots(parts)


def _tree(
    parts: Parts, foot: Point, height: float, radius: float, leaf: str, seed: int
) -> None:
    random = np.random.default_rng(seed)
    base = np.array(foot)
    fork = base + np.array(
        [random.normal(0, 0.15), height * 0.42, random.normal(0, 0.15)]
    )
    crown = base + np.array([0.0, height - radius * 0.95, 0.0])
    trunk = 0.03 * height
    s = np.linspace(0.0, 1.0, 8)[:, None]
    bend = np.sin(np.pi * s) * random.normal(0, 0.12, 3) * (1, 0, 1)
    stem = base + (fork - base) * s + bend
    flare = trunk * (0.75 + 0.6 * np.exp(-6.0 * s[:, 0]))
    branches = [tube(stem, flare, 10)]
    tips = []
    for k in range(9):
        angle = 2.0 * np.pi * (k + random.uniform(-0.25, 0.25)) / 9 * 2.4
        rise = random.uniform(-0.15, 0.95)
        out = (
            np.array([np.cos(angle), 0, np.sin(angle)])
            * radius
            * np.sqrt(1 - min(rise, 0.9) ** 2)
        )
        tip = crown + 0.72 * (out + np.array([0.0, rise * radius, 0.0]))
        middle = (
            (fork + tip) / 2
            + np.array([0.0, -0.12 * radius, 0.0])
            + random.normal(0, 0.1, 3)
        )
        t = np.linspace(0.0, 1.0, 7)[:, None]
        path = (1 - t) ** 2 * fork + 2 * t * (1 - t) * middle + t**2 * tip
        branches.append(tube(path, trunk * 0.62 * (1.0 - 0.85 * t[:, 0]), 6))
        tips += [tip, path[4]]
    parts.add("tree wood", "bark", *branches)
    # Clumps of cards about the branch tips, their normals out of the crown.
    count = int(190 * radius)
    centre = np.array(tips)[random.integers(0, len(tips), count)]
    offset = unit(random.normal(size=(count, 3))) * (
        0.42 * radius * random.random((count, 1)) ** 0.5
    )
    centre = centre + offset * (1.0, 0.75, 1.0)
    outward = unit(centre - crown + np.array([0.0, 0.35 * radius, 0.0]))
    up = unit(0.8 * outward + random.normal(0, 0.55, (count, 3)))
    across = unit(np.cross(up, random.normal(size=(count, 3))))
    size = random.uniform(0.3, 0.5, (count, 1))
    parts.add(leaf, leaf, cards(centre, across * size, up * size, outward))


def _hedge(parts: Parts) -> None:
    """Adds a clipped hedge at the back and the left of the garden."""
    random = np.random.default_rng(80)
    line = np.array(
        [(-26.0, 6.5), (-14.5, 1.5), (-13.5, -9.5), (0.2, -10.5), (2.4, -12.5)]
    )
    length = np.concatenate(
        [[0], np.linalg.norm(np.diff(line, axis=0), axis=1)]
    ).cumsum()
    s = np.linspace(0, length[-1], 40)
    foot = np.stack([np.interp(s, length, line[:, k]) for k in (0, 1)], axis=-1)
    side = np.gradient(foot, axis=0)
    side = np.stack([-side[:, 1], side[:, 0]], axis=-1)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    section = np.array(
        [
            (0.42, -0.1),
            (0.45, 1.4),
            (0.3, 1.62),
            (-0.3, 1.62),
            (-0.45, 1.4),
            (-0.42, -0.1),
        ]
    )
    flat = foot[:, None] + side[:, None] * section[None, :, :1]
    y = np.broadcast_to(section[None, :, 1], flat.shape[:2])
    points = np.stack([flat[..., 0], y, flat[..., 1]], axis=-1)
    core = sheet(points)
    if core.normal[len(section) // 2, 1] < 0:
        core = sheet(points[:, ::-1])
    parts.add("hedge core", "hill near", core)
    count = 2200
    i, j = random.integers(0, 39, count), random.integers(0, 5, count)
    a, b = random.random((2, count, 1))
    p = points[i, j] * (1 - a) * (1 - b) + points[i + 1, j] * a * (1 - b)
    p = p + points[i, j + 1] * (1 - a) * b + points[i + 1, j + 1] * a * b
    e1, e2 = points[i + 1, j] - points[i, j], points[i, j + 1] - points[i, j]
    outward = unit(np.cross(e1, e2))
    outward *= np.sign(np.sum(outward * (p - _axis(points, i)), axis=1, keepdims=True))
    up = unit(outward * 0.7 + random.normal(0, 0.5, (count, 3)) + np.array([0, 0.4, 0]))
    across = unit(np.cross(up, random.normal(size=(count, 3))))
    size = random.uniform(0.14, 0.26, (count, 1))
    parts.add(
        "leaf hedge",
        "leaf hedge",
        cards(p + up * size * 0.4, across * size, up * size, outward),
    )


def _axis(points: np.ndarray, i: np.ndarray) -> np.ndarray:
    return points[i].mean(axis=1)


def _upright(foot: np.ndarray, size: np.ndarray, random: np.random.Generator) -> Shape:
    """Makes two crossed cards on each foot point."""
    turn = random.uniform(0, np.pi, len(foot))
    turn = np.concatenate([turn, turn + np.pi / 2])
    half = np.concatenate([size, size])[:, None]
    across = np.stack([np.cos(turn), np.zeros_like(turn), np.sin(turn)], axis=1) * half
    up = np.tile([[0.0, 1.0, 0.0]], (len(turn), 1)) * half
    centre = np.concatenate([foot, foot]) + up * 0.94
    soft = np.tile([[0.0, 1.0, 0.25]], (len(turn), 1))
    return cards(centre, across, up, unit(soft))


def _tufts(parts: Parts) -> None:
    random = np.random.default_rng(81)
    # Reeds in the shallow water.
    z = np.concatenate([random.uniform(-23, -9.5, 150), random.uniform(-4.2, 9.0, 130)])
    x = shore(z) + random.normal(0.15, 0.35, len(z))
    foot = np.stack([x, np.maximum(ground(x, z), WATER - 0.1) - 0.05, z], axis=1)
    size = random.uniform(0.28, 0.62, len(z)) * np.where(z > 0, 0.75, 1.0)
    parts.add("leaf reeds", "leaf reed", _upright(foot, size, random))
    # Grass left standing along fence, deck and path.
    runs = [
        ((-10.6, 0.9), (-3.3, 6.4), 90),
        ((-7.6, 1.62), (-1.1, 1.62), 60),
        ((4.5, -7.6), (2.6, -13.0), 50),
    ]
    feet = []
    for (x0, z0), (x1, z1), count in runs:
        s = random.random(count)
        feet.append(np.stack([x0 + (x1 - x0) * s, z0 + (z1 - z0) * s], axis=1))
    lawn = np.stack([random.uniform(-9, 6, 260), random.uniform(-8, 9, 260)], axis=1)
    open_lawn = (lawn[:, 0] < shore(lawn[:, 1]) - 0.6) & (
        (lawn[:, 1] > 2.4) | (lawn[:, 0] > 4.9)
    )
    open_lawn &= np.abs(lawn[:, 0] - 1.8) > 1.9
    feet.append(lawn[open_lawn])
    flat = np.concatenate(feet) + random.normal(0, 0.08, (sum(map(len, feet)), 2))
    foot = np.stack([flat[:, 0], ground(flat[:, 0], flat[:, 1]), flat[:, 1]], axis=1)
    size = random.uniform(0.07, 0.17, len(foot))
    parts.add("leaf grass", "leaf tuft", _upright(foot, size, random))


def _bush(
    parts: Parts, at: Point, radius: float, leaf: str, count: int, seed: int
) -> None:
    random = np.random.default_rng(seed)
    direction = unit(random.normal(size=(count, 3)) + np.array([0.0, 0.6, 0.0]))
    centre = np.array(at) + direction * radius * random.uniform(0.5, 0.95, (count, 1))
    up = unit(direction + random.normal(0, 0.4, (count, 3)))
    across = unit(np.cross(up, random.normal(size=(count, 3))))
    size = random.uniform(0.28, 0.45, (count, 1)) * radius
    parts.add(leaf, leaf, cards(centre, across * size, up * size, direction))


def _bushes(parts: Parts) -> None:
    spots = [
        (-7.0, 1.95, 0.42),
        (-5.9, 2.0, 0.36),
        (-4.7, 1.95, 0.45),
        (-3.4, 2.0, 0.38),
        (2.6, 1.9, 0.4),
        (3.7, 0.9, 0.45),
    ]
    for k, (x, z, r) in enumerate(spots):
        leaf = "leaf flower" if k in (1, 3, 4) else "leaf hedge"
        _bush(parts, (x, 0.12, z), r, leaf, 90, 90 + k)


def _pot(radius: float, height: float) -> Shape:
    r, h = radius, height
    return lathe(
        [
            (0.0, 0.0), (0.62 * r, 0.0), (0.62 * r, 0.0), (0.8 * r, 0.35 * h),
            (0.93 * r, 0.8 * h), (0.94 * r, 0.84 * h), (0.94 * r, 0.84 * h),
            (1.06 * r, 0.85 * h), (1.09 * r, 0.9 * h), (1.07 * r, 0.98 * h), (1.02 * r, h),
            (0.94 * r, 0.99 * h), (0.9 * r, 0.9 * h), (0.9 * r, 0.9 * h), (0.0, 0.9 * h),
        ],
        40,
    )  # fmt: skip


def _blades(at: Point, count: int, reach: float, seed: int) -> Shape:
    """Makes arching leaves, each a bent strip that shows the whole texture."""
    random = np.random.default_rng(seed)
    leaves = []
    s = np.linspace(0.0, 1.0, 9)
    for _ in range(count):
        angle, lean = random.uniform(0, 2 * np.pi), random.uniform(0.15, 0.95)
        length = reach * random.uniform(0.65, 1.0)
        out = length * lean * s**1.25
        y = length * (1.15 - 0.35 * lean) * s - length * 0.75 * lean * s**2.4
        heading = np.array([np.cos(angle), np.sin(angle)])
        spine = np.stack([out * heading[0], y, out * heading[1]], axis=1) + at
        side = np.array([-heading[1], 0.0, heading[0]]) * 0.055 * reach
        points = np.stack([spine - side, spine + side], axis=1)
        points[:, :, 1] += 0.25 * 0.055 * reach
        uv = np.stack(
            np.broadcast_arrays(np.array([0.0, 1.0])[None], (0.99 - 0.98 * s)[:, None]),
            axis=-1,
        )
        leaves.append(sheet(points, uv))
    return merge(leaves)


def _pots(parts: Parts) -> None:
    pots = [
        (0.72, 0.07, 8.55, 0.30, 0.52, "terracotta", "blades", 1.15),
        (4.75, 0.0, 8.1, 0.27, 0.40, "glazed blue", "leaf flower", 0.42),
        (2.75, 0.28, 0.9, 0.26, 0.48, "terracotta", "leaf hedge", 0.4),
        (-0.75, 0.28, -0.95, 0.22, 0.42, "glazed blue", "blades", 0.85),
        (-2.6, 0.28, 1.1, 0.2, 0.34, "terracotta", "leaf flower", 0.3),
        (-7.1, 0.28, -0.9, 0.28, 0.5, "terracotta", "blades", 1.05),
    ]
    for k, (x, y, z, r, h, material, plant, reach) in enumerate(pots):
        parts.add(f"pot {material}", material, _pot(r, h).moved((x, y, z)))
        soil = lathe([(0.0, 0.905 * h), (0.9 * r, 0.905 * h), (0.0, 0.91 * h)], 20)
        parts.add("pot soil", "soil", soil.moved((x, y, z)))
        if plant == "blades":
            parts.add(
                "leaf blades",
                "leaf blade",
                _blades((x, y + 0.88 * h, z), 34, reach, 100 + k),
            )
        else:
            _bush(parts, (x, y + h + 0.35 * reach, z), reach, plant, 120, 100 + k)
