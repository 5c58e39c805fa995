"""The garden: ground, water, path, fences, jetty, what grows, and the distance."""

import numpy as np

from ataa_jax.builtin import plants, shapes
from ataa_jax.builtin.shapes import Part, Point, Shape, box, line, merge, tube

_WATER = -0.4
WIND_WHEEL = (7.4, 3.9, 5.4)  # hub of the turning wheel


def bank(z: np.ndarray | float) -> np.ndarray:
    """Returns x of the water's near edge at z."""
    z = np.asarray(z, float)
    bend = 0.004 * np.clip(-z - 10.0, 0.0, None) ** 2
    opening = 0.5 * np.clip(z - 2.0, 0.0, None)
    return np.asarray(5.3 + 0.5 * np.sin(0.22 * z + 0.6) + opening + bend)


def ground(x: np.ndarray | float, z: np.ndarray | float) -> np.ndarray:
    """Returns the height of the ground: a lawn, and a channel for the water."""
    x, z = np.asarray(x, float), np.asarray(z, float)
    swell = 0.05 * np.sin(0.45 * x + 0.3) * np.cos(0.38 * z)
    near = bank(z)
    inside = np.minimum(x - near, near + 11.5 + 0.4 * np.sin(0.3 * z) - x)
    s = np.clip((inside + 0.7) / 1.5, 0.0, 1.0)
    return np.asarray(swell - 1.5 * s * s * (3.0 - 2.0 * s))


def _spaced(low: float, high: float, far: float, step: float) -> np.ndarray:
    """Returns grid lines: even steps inside [low, high], then growing ones to ±far."""
    inner = np.arange(low, high + step, step)
    grow = step * 1.25 ** np.arange(1, 30)
    up = inner[-1] + np.cumsum(grow)
    down = inner[0] - np.cumsum(grow)
    return np.concatenate([down[down > -far][::-1], inner, up[up < far]])


def parts() -> list[Part]:
    """Returns the garden and everything around it."""
    return [
        *_land(),
        *_paths(),
        *_shore(),
        *_fences(),
        *_jetty(),
        *_wind_wheel_mast(),
        *_growth(),
        *_distance(),
        *plants.potted(),
        *plants.woodland(),
    ]


def _land() -> list[Part]:
    x, z = _spaced(-15.0, 21.0, 260.0, 0.45), _spaced(-22.0, 20.0, 260.0, 0.45)
    gx, gz = np.meshgrid(x, z)
    grid = np.stack([gx, ground(gx, gz), gz], axis=-1)
    lawn = shapes.sheet(grid, np.stack([gx, gz], axis=-1) / 1.4)
    wx, wz = np.meshgrid(np.linspace(0, 150, 11), np.linspace(-220, 60, 15))
    grid = np.stack([wx, np.full_like(wx, _WATER), wz], axis=-1)
    water = shapes.sheet(grid, np.stack([wx, wz], axis=-1) / 3.5)
    return [Part("lawn", lawn, "lawn"), Part("water", water, "water")]


def _path() -> np.ndarray:
    """Returns x and z (70, 2) of the gravel path's middle, a cubic Bézier curve."""
    a, b, c, d = np.array([(3.4, 24.0), (2.4, 12.0), (2.2, 8.0), (-0.8, 1.8)])
    t = np.linspace(0.0, 1.0, 70)[:, None]
    s = 1.0 - t
    return a * s**3 + 3.0 * b * t * s**2 + 3.0 * c * t**2 * s + d * t**3


def _paths() -> list[Part]:
    curve = _path()
    ahead = np.gradient(curve, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    offsets = np.linspace(-0.95, 0.95, 7)
    flat = curve[:, None] + side[:, None] * offsets[None, :, None]
    x, z = flat[..., 0], flat[..., 1]
    crown = 0.03 + 0.012 * (1.0 - (offsets / 0.95) ** 2)
    strip = shapes.sheet(
        np.stack([x, ground(x, z) + crown, z], axis=-1), np.stack([x, z], -1) / 1.1
    )
    strip = shapes.facing(strip, (0, 1, 0))
    edges = []
    for column in (0, -1):
        edge = np.stack(
            [x[:, column], ground(x[:, column], z[:, column]) + 0.02, z[:, column]], -1
        )
        edges.append(tube(edge, 0.03, 6))
    slabs = []
    random = np.random.default_rng(21)
    for t in np.linspace(0.06, 0.96, 9):
        px, pz = np.array([0.7, 3.1]) * (1 - t) + np.array([4.9, -1.9]) * t
        pz += 0.25 * np.sin(5 * t)
        slab = box((-0.36, -0.08, -0.26), (0.36, 0.035, 0.26))
        slab = slab.turned(-36.0 + random.normal(0.0, 6.0))
        slabs.append(slab.moved((px, float(ground(px, pz)), pz)))
    return [
        Part("gravel path", strip, "gravel"),
        Part("path edges", merge(edges), "frame"),
        Part("stepping stones", merge(slabs).tiled(1.8), "paving"),
    ]


def _pebble(random: np.random.Generator) -> Shape:
    """Returns one rounded stone of about a metre, lying on its widest side."""
    polar, turn = np.linspace(0.0, np.pi, 8), np.linspace(0.0, 2 * np.pi, 11)
    p, t = np.meshgrid(polar, turn, indexing="ij")
    ball = np.stack([np.sin(p) * np.cos(t), np.cos(p), np.sin(p) * np.sin(t)], axis=-1)
    knobs = random.normal(0, 1, (4, 3))
    swell = np.sin(1.7 * (ball @ knobs.T) + random.uniform(0, 6, 4)).sum(axis=-1)
    half = random.uniform((0.4, 0.22, 0.35), (0.55, 0.36, 0.5))
    ball = ball * (1.0 + 0.12 * swell)[..., None] * half
    ball[:, -1] = ball[:, 0]
    return shapes.outward(shapes.sheet(ball, closed=True))


def _shore() -> list[Part]:
    random = np.random.default_rng(22)
    stones = []
    for z in np.arange(-16.0, 16.0, 0.3):
        z0 = z + random.normal(0, 0.08)
        x = float(bank(z0)) - 0.12 + random.normal(0, 0.12)
        size = random.uniform(0.35, 0.9)
        stone = _pebble(random)
        stone = stone._replace(position=stone.position * size).turned(
            random.uniform(0, 360)
        )
        stones.append(stone.moved((x, float(ground(x, z0)) + 0.03, z0)))
    pads = []
    disc = shapes.lathe(
        [(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (0.96, 0.03), (0.0, 0.02)], 16
    )
    for _ in range(70):
        z0 = random.choice((-9.0, 4.2, 9.0)) + random.normal(0.0, 1.1)
        x = float(bank(z0)) + 1.0 + abs(random.normal(0.0, 0.9))
        pad = disc._replace(
            position=disc.position * (1.0, 0.4, 1.0) * random.uniform(0.1, 0.24)
        )
        pads.append(pad.moved((x, _WATER - 0.002, z0)))
    return [
        Part("shore stones", merge(stones), "stone"),
        Part("water lilies", merge(pads), "lily"),
    ]


def _fence(
    start: Point, end: Point, height: float, width: float, gap: float
) -> tuple[Shape, Shape]:
    """Returns vertical slats, and the posts and bars that hold them."""
    a, b = np.array(start, float), np.array(end, float)
    length = float(np.linalg.norm(b - a))
    degrees = -np.degrees(np.arctan2(b[2] - a[2], b[0] - a[0]))
    slats = [
        box((x, 0.08, 0.0), (x + width, height, 0.018))
        for x in np.arange(0.03, length - width, width + gap)
    ]
    holders = [
        box((0.0, y, -0.04), (length, y + 0.06, 0.0)) for y in (0.25, height - 0.3)
    ]
    holders += [
        box((x, -0.2, -0.11), (x + 0.07, height + 0.04, -0.04))
        for x in np.linspace(0.0, length - 0.07, max(round(length / 2.2), 1) + 1)
    ]
    return (
        merge(slats).turned(degrees).moved(start),
        merge(holders).turned(degrees).moved(start),
    )


def _fences() -> list[Part]:
    west, west_posts = _fence((-10.6, 0.0, 11.0), (-10.6, 0.0, -3.0), 1.45, 0.045, 0.04)
    east, east_posts = _fence((1.8, 0.0, -5.2), (5.0, 0.0, -5.2), 1.75, 0.032, 0.032)
    return [
        Part("slat fence west", west, "slats"),
        Part("slat fence east", east, "varnish"),
        Part("fence posts west", west_posts, "slats"),
        Part("fence posts east", east_posts, "varnish"),
    ]


JETTY_END = 8.0
_JETTY_NEAR, _JETTY_FAR = -1.35, -2.9  # z of its long sides
_JETTY_TOP = 0.2


def bollards() -> list[Point]:
    """Returns the tops of the jetty's posts that the boat is tied to."""
    return [(JETTY_END - 0.1, _JETTY_TOP + 0.3, z) for z in (-1.4, -2.85, -2.95)]


def _jetty() -> list[Part]:
    boards, x = [], 4.5
    while x < JETTY_END:
        boards.append(
            box(
                (x, _JETTY_TOP - 0.035, _JETTY_FAR), (x + 0.14, _JETTY_TOP, _JETTY_NEAR)
            )
        )
        x += 0.152
    frame = [
        box((4.5, _JETTY_TOP - 0.16, z), (JETTY_END, _JETTY_TOP - 0.04, z + 0.08))
        for z in (_JETTY_FAR + 0.1, _JETTY_NEAR - 0.18)
    ]
    posts = [
        line((px, -1.8, pz), (px, _JETTY_TOP + 0.42, pz), 0.07, 10)
        for px in (5.4, 6.7, JETTY_END - 0.1)
        for pz in (_JETTY_NEAR + 0.05, _JETTY_FAR - 0.05)
    ]
    bow_posts = [line((7.5, -1.8, -7.5), (7.5, 0.7, -7.5), 0.09, 10)]
    return [
        Part("jetty boards", merge(boards).tiled(8 * 0.152, 2.4), "deck"),
        Part("jetty frame", merge(frame), "pole"),
        Part("jetty posts", merge(posts + bow_posts), "pole"),
    ]


def _wind_wheel_mast() -> list[Part]:
    x, y, z = WIND_WHEEL
    mast = tube(np.array([(x, -0.3, z), (x, y, z)]), np.array([0.055, 0.04]), 10)
    axle = line((x, y, z - 0.35), (x, y, z + 0.08), 0.04, 8)
    tail = box((x - 0.01, y - 0.22, z - 1.15), (x + 0.01, y + 0.22, z - 0.6))
    boom = line((x, y, z - 0.3), (x, y, z - 0.7), 0.018)
    return [
        Part("wind wheel mast", merge([mast, axle, boom]), "frame"),
        Part("wind wheel tail", tail, "red"),
    ]


def _growth() -> list[Part]:
    """Returns grasses, reeds and flowers that stand in the ground."""
    random = np.random.default_rng(23)
    z = random.uniform(-30.0, 13.0, 420)
    x = bank(z) + random.normal(-0.1, 0.3, 420)
    keep = (z < -6.0) | (z > 6.6)
    reed = np.stack([x, ground(x, z) - 0.05, z], axis=-1)[
        keep & (random.random(420) < 0.75)
    ]
    zf = random.uniform(-60.0, 12.0, 500)
    xf = bank(zf) + 11.5 + random.normal(0.2, 0.5, 500)
    far = np.stack([xf, ground(xf, zf) - 0.05, zf], axis=-1)
    reeds = merge(
        [
            plants.upright(reed, random.uniform(0.5, 1.25, len(reed)), random),
            plants.upright(far, random.uniform(1.0, 2.0, len(far)), random),
        ]
    )
    spots = [
        _strewn(random, (-10.5, -10.1), (-2.8, 11.0), 90),  # along the west fence
        _strewn(random, (1.8, 5.0), (-5.1, -4.6), 40),  # and the east fence
        _strewn(random, (2.4, 2.8), (-4.5, 0.6), 30),  # beside the terrace
        _strewn(random, (-10.0, 7.0), (2.2, 12.0), 60),  # anywhere
    ]
    foot = np.concatenate(spots)
    foot = foot[(foot[:, 0] < bank(foot[:, 2]) - 0.3) & ~_on_path(foot)]
    tufts = plants.upright(foot, random.uniform(0.16, 0.42, len(foot)), random)
    bed = _strewn(random, (-9.5, -2.7), (1.15, 1.75), 190)
    flowers = plants.upright(bed[:110], random.uniform(0.35, 0.6, 110), random)
    between = plants.upright(bed[110:], random.uniform(0.35, 0.7, 80), random)
    soil = box((-9.6, -0.2, 1.02), (-2.6, 0.06, 1.85))
    return [
        Part("leaf reeds", reeds, "leaf reed"),
        Part("leaf tufts", merge([tufts, between]), "leaf tuft"),
        Part("leaf bed flowers", flowers, "leaf lavender"),
        Part("flower bed", soil, "soil"),
    ]


def _strewn(
    random: np.random.Generator,
    x: tuple[float, float],
    z: tuple[float, float],
    count: int,
) -> np.ndarray:
    """Returns points (count, 3) just under the ground of a rectangle."""
    px, pz = random.uniform(*x, count), random.uniform(*z, count)
    return np.stack([px, ground(px, pz) - 0.03, pz], axis=-1)


def _on_path(foot: np.ndarray) -> np.ndarray:
    """Returns which of the points lie on the gravel path or its edge."""
    curve = _path()
    gap = np.linalg.norm(foot[:, None, [0, 2]] - curve[None], axis=-1).min(axis=1)
    return gap < 1.15


def _distance() -> list[Part]:
    """Returns what hides the horizon: a line of trees, and two rows of hills."""
    turn = np.linspace(0.0, 2.0 * np.pi, 97)
    ring = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=-1)
    trees = []
    for radius, height, share in ((105.0, 8.0, 0.0), (140.0, 12.0, 0.37)):
        wave = radius * (1.0 + 0.07 * np.sin(5 * turn + share * 9))
        low = ring * wave[:, None] - np.array([0.0, 1.0, 0.0])
        rows = np.stack([low + np.array([0.0, height, 0.0]), low])
        u = turn / (2 * np.pi) * round(2 * np.pi * radius / (4 * height)) + share
        uv = np.stack(np.broadcast_arrays(u[None], np.array([0.04, 0.98])[:, None]), -1)
        trees.append(shapes.sheet(rows, uv))
    hills = []
    for name, radius, height, seed in (
        ("hill near", 190.0, 16.0, 31),
        ("hill far", 250.0, 44.0, 32),
    ):
        random = np.random.default_rng(seed)
        ridge = sum(
            np.sin(k * turn + random.uniform(0, 6)) * random.uniform(0.5, 1.0) / k
            for k in range(2, 9)
        )
        top = height * np.clip(0.55 + 0.4 * np.asarray(ridge), 0.15, None)
        share = np.linspace(0.0, 1.0, 6)[:, None]
        profile = np.sin(share * np.pi / 2)
        grid = ring[None] * (radius + 60.0 * share)[..., None]
        grid[..., 1] = -1.0 + top[None] * profile
        sheet = shapes.sheet(grid, closed=True)
        hills.append(Part(name, shapes.facing(sheet, (0, 1, 0)), name))
    return [Part("leaf far line", merge(trees), "leaf far trees"), *hills]
