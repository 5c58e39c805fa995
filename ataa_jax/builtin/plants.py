"""Trees, hedges, pots and grasses: modelled wood, and leaves on alpha-cut cards."""

from typing import NamedTuple

import numpy as np

from ataa_jax.builtin import shapes
from ataa_jax.builtin.shapes import Part, Point, Shape, merge, tube, unit


class Tree(NamedTuple):
    """A tree's wood and its leaves."""

    wood: Shape
    leaves: Shape


class Species(NamedTuple):
    """How a tree grows."""

    boughs: int  # that leave the trunk
    sprays: int  # leaf cards a twig
    card: float = 0.42  # half the side of a leaf card, metres
    bare: float = 0.3  # share of the trunk below the crown
    twigs: bool = True  # model the twigs' wood


def tree(
    foot: Point, height: float, spread: float, seed: int, species: Species
) -> Tree:
    """Grows a tree: a trunk, boughs, twigs, and sprays of leaves along the twigs.

    Args:
        foot: where it stands.
        height: of the crown's top, metres.
        spread: radius of the crown, metres.
        seed: of its growth.
        species: how it grows.
    """
    boughs, sprays, card, bare, _ = species
    random = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, 10)
    lean = random.normal(0, 0.05, 2) * height
    trunk = np.stack(
        [
            lean[0] * s**2 + 0.02 * height * np.sin(s * 5 + seed),
            height * 0.92 * s,
            lean[1] * s**2 + 0.02 * height * np.cos(s * 4 + seed) - 0.02 * height,
        ],
        axis=-1,
    )
    thick = 0.024 * height * (1.0 - 0.88 * s) * (1.0 + 0.5 * np.exp(-12 * s))
    wood = [tube(trunk, thick, 9)]
    twigs = []
    for k in range(boughs):
        up = bare + (0.97 - bare) * (k + random.random()) / boughs
        start = np.array([np.interp(up, s, trunk[:, i]) for i in range(3)])
        turn = 2.4 * k + random.normal(0, 0.3)
        # An egg-shaped crown: widest at a third of its height.
        share = (up - bare) / (1.0 - bare)
        reach = spread * np.sqrt(np.clip(1.0 - ((share - 0.3) / 0.75) ** 2, 0.06, 1.0))
        rise = 0.25 + 0.75 * share
        way = unit(np.array([np.cos(turn), rise, np.sin(turn)]))
        q = np.linspace(0.0, 1.0, 6)[:, None]
        bough = start + way * reach * q + np.array([0, 0.15 * reach, 0]) * q**2
        width = float(np.interp(up, s, thick))
        wood.append(tube(bough, 0.55 * width * (1.0 - 0.8 * q[:, 0]), 6))
        for m in range(4):
            at = 0.35 + 0.65 * (m + 0.5) / 4
            origin = start + (bough[-1] - start) * at
            heading = unit(way + 0.8 * random.normal(0, 1, 3) + np.array([0, 0.2, 0]))
            tip = origin + heading * reach * random.uniform(0.25, 0.5)
            twigs.append((origin, tip))
    if species.twigs:
        wood += [tube(np.stack(twig), np.array([0.012, 0.004]), 4) for twig in twigs]
    ends = np.array(twigs)
    along = random.uniform(0.0, 1.0, (len(twigs), sprays, 1))
    centre = ends[:, None, 0] + (ends[:, None, 1] - ends[:, None, 0]) * along
    centre = (centre + random.uniform(-card, card, centre.shape)).reshape(-1, 3)
    middle = np.array([0.0, height * (bare + 1.0) / 2.0, 0.0])
    outward = unit((centre - middle) / np.array([spread, height * 0.5, spread]))
    leaves = scattered(centre, outward, card, random)
    return Tree(merge(wood).moved(foot), leaves.moved(foot))


def scattered(
    centre: np.ndarray, outward: np.ndarray, half: float, random: np.random.Generator
) -> Shape:
    """Places leaf cards whose faces lean outward, with soft outward normals."""
    n = len(centre)
    face = unit(outward + 0.75 * random.normal(0, 1, (n, 3)))
    up = random.normal(0, 1, (n, 3)) + np.array([0.0, 0.6, 0.0])
    up = unit(up - face * np.sum(up * face, axis=1, keepdims=True))
    size = half * random.uniform(0.75, 1.25, (n, 1))
    across = np.cross(up, face)
    soft = unit(outward + (0.0, 0.35, 0.0) + 0.25 * random.normal(0, 1, (n, 3)))
    return shapes.cards(centre, across * size, up * size, soft)


def upright(
    foot: np.ndarray,
    height: np.ndarray,
    random: np.random.Generator,
    lean: float = 0.15,
) -> Shape:
    """Places two crossed upright cards at each foot (n, 3), heights (n,) in metres."""
    n = len(foot)
    turn = random.uniform(0, np.pi, n)
    parts = []
    for quarter in (0.0, np.pi / 2):
        across = np.stack(
            [np.cos(turn + quarter), np.zeros(n), np.sin(turn + quarter)], axis=-1
        )
        up = unit(np.array([0, 1.0, 0]) + lean * random.normal(0, 1, (n, 3)))
        half = (height / 2.0)[:, None]
        soft = unit(np.array([0.2, 1.0, 0.35]) + 0.2 * random.normal(0, 1, (n, 3)))
        parts.append(
            shapes.cards(foot + up * half * 0.97, across * half, up * half, soft)
        )
    return merge(parts)


def hedge(low: Point, high: Point, count: int, seed: int) -> Shape:
    """Returns a clipped hedge: leaf cards on and just under the faces of a box."""
    random = np.random.default_rng(seed)
    lo, hi = np.array(low, float), np.array(high, float)
    p = random.uniform(lo, hi, (count, 3))
    size = hi - lo
    weights = np.array([size[1] * size[2], size[0] * size[2] * 0.5, size[0] * size[1]])
    axis = random.choice(3, count, p=weights / weights.sum())
    side = np.where(axis == 1, 1, random.integers(0, 2, count))
    rows = np.arange(count)
    p[rows, axis] = np.where(side == 1, hi[axis], lo[axis])
    outward = np.zeros((count, 3))
    outward[rows, axis] = 2.0 * side - 1.0
    p += random.normal(0, 0.05, p.shape) - 0.04 * outward
    return scattered(p, outward, 0.19, random)


def pot(radius: float, height: float) -> Shape:
    """Turns a pot with a rim and a hollow mouth."""
    r, h = radius, height
    profile = [
        (0.0, 0.0), (0.66 * r, 0.0), (0.66 * r, 0.0), (0.72 * r, 0.03 * h),
        (0.86 * r, 0.4 * h), (0.95 * r, 0.82 * h), (0.95 * r, 0.82 * h),
        (1.05 * r, 0.84 * h), (1.07 * r, 0.92 * h), (1.05 * r, h), (1.05 * r, h),
        (0.93 * r, h), (0.93 * r, h), (0.88 * r, 0.86 * h), (0.0, 0.86 * h),
    ]  # fmt: skip
    return shapes.lathe(profile, 32)


def rosette(foot: Point, length: float, count: int, seed: int) -> Shape:
    """Returns arching strap leaves that rise from one foot, on alpha-cut strips."""
    random = np.random.default_rng(seed)
    q = np.linspace(0.0, 1.0, 9)
    strips = []
    for k in range(count):
        turn = 2.39996 * k + random.normal(0, 0.1)
        tilt = 0.25 + 0.95 * k / count + random.normal(0, 0.06)
        reach = length * random.uniform(0.75, 1.1) * (0.8 + 0.2 * k / count)
        # The leaf bends down along its length: its angle from upright grows with q.
        angle = tilt + 1.1 * tilt * q**1.7
        step = reach / (len(q) - 1)
        out = np.concatenate([[0.0], np.cumsum(np.sin(angle[:-1]) * step)])
        up = np.concatenate([[0.0], np.cumsum(np.cos(angle[:-1]) * step)])
        way = np.array([np.cos(turn), 0.0, np.sin(turn)])
        side = np.array([-np.sin(turn), 0.0, np.cos(turn)])
        spine = out[:, None] * way + np.stack([0 * up, up, 0 * up], axis=-1)
        half = 0.085 * length
        fold = 0.03 * length * np.array([0.0, 1.0, 0.0])
        grid = np.stack([spine - half * side + fold, spine, spine + half * side + fold])
        uv = np.stack(
            np.broadcast_arrays(np.array([0.0, 0.5, 1.0])[:, None], (1.0 - q)[None]), -1
        )
        strips.append(shapes.facing(shapes.sheet(grid, uv), (0, 1, 0)))
    return merge(strips).moved(foot)


def bush(foot: Point, radius: float, count: int, card: float, seed: int) -> Shape:
    """Returns a ball of leaf cards whose lowest point is the foot."""
    random = np.random.default_rng(seed)
    outward = unit(random.normal(0, 1, (count, 3)))
    depth = random.uniform(0.75, 1.0, (count, 1))
    centre = outward * radius * depth + (0.0, radius * 0.9, 0.0)
    return scattered(centre, outward, card, random).moved(foot)


def potted() -> list[Part]:
    """Returns the pots by the path and on the terrace, with what grows in them."""
    deck = 0.36
    big, low = (0.05, 0.02, 8.55), (-0.95, 0.0, 8.1)
    door, corner, table = (1.75, deck, -2.45), (-9.1, deck, 0.4), (-5.6, deck, 0.55)
    terracotta = [
        pot(0.3, 0.5).moved(low),
        pot(0.26, 0.44).moved(table),
        pot(0.2, 0.34).moved((-6.15, deck, 0.5)),
    ]
    glazed = [pot(0.36, 0.62).moved(big), pot(0.32, 0.62).moved(door)]
    pale = [pot(0.4, 0.7).moved(corner)]
    soil = [
        shapes.lathe([(0.0, -0.05), (r, -0.05), (r, 0.0), (0.0, 0.02)], 20).moved(
            (x, y + h, z)
        )
        for (x, y, z), r, h in (
            (big, 0.33, 0.55),
            (low, 0.27, 0.44),
            (door, 0.29, 0.55),
        )
    ]
    straps = [
        rosette((big[0], 0.55, big[2]), 0.95, 34, 61),
        rosette((corner[0], deck + 0.6, corner[2]), 1.15, 36, 62),
    ]
    balls = [
        bush((door[0], deck + 0.62, door[2]), 0.34, 260, 0.1, 63),
        bush((-6.15, deck + 0.3, 0.5), 0.2, 110, 0.07, 64),
    ]
    flowers = [
        bush((low[0], 0.38, low[2]), 0.36, 210, 0.13, 65),
        bush((table[0], deck + 0.36, table[2]), 0.3, 150, 0.12, 66),
    ]
    return [
        Part("pots terracotta", merge(terracotta), "terracotta"),
        Part("pots glazed", merge(glazed), "glazed blue"),
        Part("pots pale", merge(pale), "fascia"),
        Part("pot soil", merge(soil), "soil"),
        Part("leaf straps", merge(straps), "leaf blade"),
        Part("leaf box balls", merge(balls), "leaf hedge"),
        Part("leaf pot flowers", merge(flowers), "leaf flower"),
    ]


def _trees(
    name: str,
    leaf: str,
    places: list[tuple[float, float, float, float]],
    seed: int,
    species: Species,
) -> list[Part]:
    """Returns one mesh of wood and one of leaves for (x, z, height, spread) places."""
    grown = [
        tree((x, -0.1, z), height, spread, seed + k, species)
        for k, (x, z, height, spread) in enumerate(places)
    ]
    return [
        Part(f"wood {name}", merge([t.wood for t in grown]).tiled(0.5), "bark"),
        Part(f"leaf {name}", merge([t.leaves for t in grown]), leaf),
    ]


def woodland() -> list[Part]:
    """Returns the garden's trees, and those beyond it."""
    shade = [(-13.2, -4.5, 8.5, 3.4), (8.4, 15.4, 6.6, 2.3)]
    slim = [(4.0, -10.5, 7.4, 1.9), (-12.2, 4.6, 5.6, 1.8)]
    far = [
        (-21.0, -24.0, 11.0, 4.5), (-9.0, -27.0, 10.0, 4.2), (1.5, -30.0, 12.0, 4.6),
        (21.0, -8.0, 8.5, 3.6), (24.5, -19.0, 10.0, 4.2), (20.5, -30.0, 9.0, 3.8),
        (33.0, -26.0, 11.0, 4.6), (26.0, 2.0, 8.0, 3.4), (-26.0, -10.0, 10.0, 4.2),
        (36.0, -8.0, 10.5, 4.4), (32.0, -48.0, 12.0, 5.0), (10.0, -44.0, 11.0, 4.6),
    ]  # fmt: skip
    oak = Species(boughs=22, sprays=12)
    birch = Species(boughs=20, sprays=8, card=0.32)
    young = Species(boughs=14, sprays=7, card=0.24)
    distant = Species(boughs=16, sprays=5, card=0.95, bare=0.2, twigs=False)
    clipped = hedge((-12.0, 0.0, -3.0), (-11.2, 1.9, 11.0), 2600, 95)
    return [
        *_trees("shade trees", "leaf tree", shade, 70, oak),
        *_trees("birches", "leaf birch", slim, 80, birch),
        *_trees("young tree", "leaf birch", [(-6.3, 4.4, 3.0, 1.15)], 90, young),
        *_trees("far trees", "leaf tree", far, 100, distant),
        Part("leaf hedge", clipped, "leaf hedge"),
    ]
