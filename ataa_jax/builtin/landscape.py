"""The ground, the water and what hides the horizon."""

import numpy as np

from ataa_jax.builtin.images import noise
from ataa_jax.builtin.parts import Parts
from ataa_jax.builtin.shapes import Shape, quad, sheet

WATER = -0.45  # y of the water

# The shore, x by z, from the viewer's side to where the water closes off the garden.
_SHORE_Z = np.array([-45.0, -36.0, -30.0, -24.0, -16.0, -8.0, 0.0, 8.0, 16.0, 30.0])
_SHORE_X = np.array([-80.0, -40.0, -12.0, 0.5, 4.2, 5.2, 6.0, 7.6, 9.5, 13.0])


def shore(z: np.ndarray) -> np.ndarray:
    """Returns x of the water's edge."""
    return np.interp(z, _SHORE_Z, _SHORE_X)


def ground(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Returns the height of the garden's ground."""
    inland = shore(z) - x
    bank = -1.1 * np.exp(-np.maximum(inland, -0.5) / 0.55)
    swell = 0.05 * np.sin(0.7 * x + 0.4) * np.sin(0.5 * z) * np.clip(inland / 3, 0, 1)
    return bank + np.minimum(swell, 0.03)


def add(parts: Parts) -> None:
    """Adds lawn, path, water, hills and the far tree line."""
    _lawn(parts)
    _paths(parts)
    water = quad((-300.0, WATER, 60.0), (600.0, 0, 0), (0, 0, -460.0))
    parts.add("water", "water", water.tiled(5.0))
    _hills(parts)
    _far_trees(parts)


def _lawn(parts: Parts) -> None:
    z = np.concatenate(
        [np.linspace(30, 12, 13), np.linspace(11.4, -24, 60), np.linspace(-25, -44, 10)]
    )
    s = np.linspace(0.0, 1.0, 56) ** 2.4  # 0 at the water, dense there
    x = shore(z)[:, None] + 0.5 - (shore(z)[:, None] + 80.0) * s[None]
    zz = np.broadcast_to(z[:, None], x.shape)
    points = np.stack([x, ground(x, zz), zz], axis=-1)[::-1]
    uv = np.stack([points[..., 0], points[..., 2]], axis=-1) / 2.4
    parts.add("lawn", "lawn", sheet(points[:, ::-1], uv[:, ::-1]))


def ribbon(line: np.ndarray, width: np.ndarray, lift: float) -> Shape:
    """Makes a strip that lies on the ground along a line of (x, z)."""
    tangent = np.gradient(line, axis=0)
    side = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    across = np.linspace(-0.5, 0.5, 9)
    flat = line[:, None] + side[:, None] * (across[None, :] * width[:, None])[..., None]
    crown = lift - 0.05 * np.clip(np.abs(across) * 2.0 - 0.8, 0.0, 1.0) / 0.2
    height = ground(flat[..., 0], flat[..., 1]) + crown
    points = np.stack([flat[..., 0], height, flat[..., 1]], axis=-1)
    strip = sheet(points, flat)
    if strip.normal[:, 1].mean() < 0:
        strip = sheet(points[:, ::-1], flat[:, ::-1])
    return strip


def smooth(points: list[tuple[float, float]], count: int = 60) -> np.ndarray:
    """Returns a Catmull-Rom curve through points (n, 2)."""
    p = np.array(points, float)
    p = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    t = np.linspace(0.0, len(points) - 1 - 1e-9, count)
    i, f = t.astype(int), (t % 1.0)[:, None]
    a, b, c, d = (p[i + k] for k in range(4))
    return 0.5 * (
        2 * b + (c - a) * f + (2 * a - 5 * b + 4 * c - d) * f**2
        + (3 * b - a - 3 * c + d) * f**3
    )  # fmt: skip


def _paths(parts: Parts) -> None:
    main = smooth([(3.2, 16.0), (2.9, 10.0), (2.2, 6.5), (1.0, 4.2), (0.5, 1.6)])
    width = np.interp(np.linspace(0, 1, 60), [0, 0.5, 0.75, 1], [2.0, 1.9, 2.3, 2.8])
    parts.add("path", "gravel", ribbon(main, width, 0.035).tiled(1.25))
    side = smooth([(1.6, 4.4), (3.0, 1.6), (4.0, -2.6), (4.6, -6.4)])
    parts.add("path", "gravel", ribbon(side, np.full(60, 1.15), 0.03).tiled(1.25))
    court = np.array([[0.3, 9.9], [0.3, 7.2]])
    slabs = ribbon(np.linspace(court[0], court[1], 9), np.full(9, 4.2), 0.06)
    parts.add("terrace front", "paving", slabs.tiled(1.5))


def _hills(parts: Parts) -> None:
    random_near, random_far = noise(256, 6, seed=60), noise(256, 4, seed=61)
    for name, material, radius, height, rough in (
        ("hills far", "hill far", 330.0, 30.0, random_far),
        ("hills near", "hill near", 170.0, 9.0, random_near),
    ):
        angle = np.linspace(-1.75, 1.75, 160)
        rows = np.linspace(0.0, 1.0, 10)
        i = np.linspace(0, 255, 160).astype(int)
        j = (rows * 40).astype(int)
        bump = rough[j][:, i]
        r = radius * (1.0 + 0.45 * rows)[:, None]
        y = height * np.sin(rows * np.pi / 2)[:, None] * (0.25 + 1.2 * bump)
        points = np.stack(
            [r * np.sin(angle), y + WATER - 0.2, -r * np.cos(angle)], axis=-1
        )
        parts.add(name, material, sheet(points[:, ::-1]))


def _far_trees(parts: Parts) -> None:
    """Adds rings of alpha-cut tree tops on the far bank."""
    for radius, height, arc, phase in ((95.0, 6.5, 2.6, 0.0), (150.0, 13.0, 3.0, 0.37)):
        angle = np.linspace(-arc / 2 - 0.1, arc / 2 + 0.2, 90)
        r = radius * (1.0 + 0.05 * np.sin(7 * angle + phase))
        foot = np.stack(
            [r * np.sin(angle), np.full(90, WATER - 0.3), -r * np.cos(angle)], axis=-1
        )
        top = foot + np.array([0.0, height, 0.0])
        length = radius * (angle - angle[0])
        uv = np.stack(
            [
                np.stack([length / (height * 4) + phase, np.full(90, v)], axis=-1)
                for v in (0.02, 0.98)
            ]
        )
        wall = sheet(np.stack([top, foot]), uv)
        lit = np.tile(np.array([-0.45, 0.6, 0.66]), (len(wall.normal), 1))
        parts.add(
            "leaf far trees",
            "leaf far trees",
            wall._replace(normal=lit / np.linalg.norm(lit[0])),
        )
