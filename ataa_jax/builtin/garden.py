"""Fences, poles and wires: what is thinner than a pixel."""

import numpy as np

from ataa_jax.builtin.landscape import ground
from ataa_jax.builtin.parts import Parts
from ataa_jax.builtin.shapes import Point, beam, box, lathe, line, sagging, tube

_POLE = (3.3, 7.6, -12.2)  # top of the pole behind the house
_POLE_LEFT = (-24.0, 8.4, -15.0)
_POLE_RIGHT = (46.0, 8.2, -62.0)
_POLE_FRONT = (17.5, 8.8, 16.0)  # out of the main view


def add(parts: Parts) -> None:
    """Adds fences, poles and wires."""
    _fence(parts, (-10.8, 0.7), (-3.3, 6.6), 1.15)
    _fence(parts, (4.55, -7.7), (3.4, -11.6), 0.95)
    _fence(parts, (4.75, -5.5), (4.95, 0.4), 0.95)
    _wires(parts)
    _lights(parts)


def _fence(
    parts: Parts, start: tuple[float, float], end: tuple[float, float], height: float
) -> None:
    """Adds thin upright slats on two rails between posts."""
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))

    def at(s: float) -> tuple[float, float, float]:
        x, z = a + (b - a) * s
        return float(x), float(ground(x, z)), float(z)

    turn = float(np.degrees(np.arctan2(-(b - a)[1], (b - a)[0])))
    slats, posts = [], []
    count = int(length / 0.075)
    for k in range(count):
        x, y, z = at((k + 0.5) / count)
        slat = box((-0.016, 0.06, -0.008), (0.016, height, 0.008))
        slats.append(slat.turned(turn).moved((x, y, z)))
    spans = max(1, round(length / 1.6))
    for k in range(spans + 1):
        x, y, z = at(k / spans)
        post = box((-0.04, -0.3, -0.085), (0.04, height + 0.06, -0.01))
        posts.append(post.turned(turn).moved((x, y, z)))
    for share in (0.22, 0.85):
        (x0, y0, z0), (x1, y1, z1) = at(0.0), at(1.0)
        h = height * share
        posts.append(beam((x0, y0 + h, z0), (x1, y1 + h, z1), 0.022, 0.06))
    parts.add("slat fence", "slats", *slats)
    parts.add("fence posts", "slats", *posts)


def _pole(parts: Parts, top: Point) -> None:
    x, y, z = top
    mast = lathe([(0, -1.5), (0.13, -1.5), (0.085, y), (0, y + 0.01)], 12)
    parts.add("pole masts", "pole", mast.moved((x, 0.0, z)))
    parts.add(
        "pole arms",
        "pole",
        beam((x - 0.85, y - 0.35, z), (x + 0.85, y - 0.35, z), 0.09, 0.09),
    )
    bell = lathe(
        [(0, 0), (0.03, 0), (0.05, 0.05), (0.03, 0.1), (0.035, 0.13), (0, 0.15)], 10
    )
    for dx in (-0.75, 0.0, 0.75):
        parts.add(
            "pole insulators",
            "gelcoat",
            bell.moved((x + dx, y - 0.3 + (0.3 if dx == 0 else 0), z)),
        )


def _ends(top: Point) -> list[Point]:
    x, y, z = top
    return [(x - 0.75, y - 0.16, z), (x, y + 0.12, z), (x + 0.75, y - 0.16, z)]


def _wires(parts: Parts) -> None:
    for top in (_POLE, _POLE_LEFT, _POLE_RIGHT, _POLE_FRONT):
        _pole(parts, top)
    for other, sag in ((_POLE_LEFT, 0.8), (_POLE_RIGHT, 1.7), (_POLE_FRONT, 0.9)):
        for a, b in zip(_ends(_POLE), _ends(other), strict=True):
            parts.add("wire overhead", "cable", tube(sagging(a, b, sag, 40), 0.010, 5))
    for dz in (-0.12, 0.12):
        drop = sagging((3.3, 7.0, -12.2), (0.45, 6.75, -5.0 + dz), 0.35)
        parts.add("wire to house", "cable", tube(drop, 0.009, 5))
    guy = line((3.3, 6.6, -12.2), (1.6, 0.0, -13.6), 0.008, 5)
    parts.add("wire guy", "cable", guy)
    # A line of washing would hide the house; a bare line between two trees does not.
    string = sagging((-8.1, 2.75, 0.1), (2.35, 2.75, 0.1), 0.35, 40)
    parts.add("wire lights", "cable", tube(string, 0.005, 5))
    bulb = lathe(
        [(0, -0.05), (0.02, -0.035), (0.026, -0.01), (0.015, 0.03), (0, 0.04)], 8
    )
    bulbs = [bulb.moved(tuple(p - (0, 0.05, 0))) for p in string[2:-2:3]]
    parts.add("lamp string", "lamp", *bulbs)


def _lights(parts: Parts) -> None:
    """Adds low path lamps."""
    for x, z in ((1.15, 6.6), (3.55, 7.2), (0.0, 2.9), (3.9, 1.0)):
        y = float(ground(np.array(x), np.array(z)))
        post = lathe([(0, 0), (0.03, 0), (0.03, 0.5), (0, 0.5)], 10)
        glow = lathe(
            [
                (0, 0.5),
                (0.045, 0.5),
                (0.045, 0.5),
                (0.045, 0.6),
                (0.045, 0.6),
                (0, 0.6),
            ],
            12,
        )
        cap = lathe([(0, 0.6), (0.1, 0.6), (0.1, 0.61), (0.02, 0.65), (0, 0.65)], 16)
        parts.add("path lamps", "frame", post.moved((x, y, z)), cap.moved((x, y, z)))
        parts.add("lamp path", "lamp", glow.moved((x, y, z)))
