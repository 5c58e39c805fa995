"""Poles with overhead wires, and the garden's lamps on their string.

The wires are 12 mm thick: a quarter of a pixel at 640×360 from across the garden.
"""

from itertools import pairwise

import numpy as np

from ataa_jax.builtin import shapes
from ataa_jax.builtin.garden import WIND_WHEEL, ground
from ataa_jax.builtin.house import HOOK
from ataa_jax.builtin.shapes import Part, Point, Shape, box, line, merge, tube

_HEIGHT = 8.6
# x and z of the poles; the third stands behind the house, the last two to its sides.
_POLES = [(-34.0, -17.0), (-15.5, -15.0), (3.3, -13.5), (21.5, -20.0), (44.0, -34.0)]
_BRANCHES = [(-14.5, 3.0), (21.0, 4.0)]


def parts() -> list[Part]:
    """Returns poles, wires and lamps."""
    return [*_overhead(), *_string(), *_bollard_lamps()]


def _ends(x: float, z: float) -> list[Point]:
    """Returns where a pole at (x, z) holds its three wires."""
    low, high = _HEIGHT - 0.18, _HEIGHT + 0.15
    return [(x, low, z - 0.85), (x, high, z), (x, low, z + 0.85)]


def _overhead() -> list[Part]:
    poles, insulators = [], []
    profile = [(0.0, -0.15), (0.02, -0.15), (0.05, -0.11), (0.03, -0.08)]
    profile += [(0.055, -0.05), (0.03, 0.0), (0.0, 0.01)]
    knob = shapes.lathe(profile, 10)
    for x, z in _POLES + _BRANCHES:
        path = np.array([(x, -0.5, z), (x, 4.0, z), (x, _HEIGHT, z)])
        poles.append(tube(path, np.array([0.14, 0.12, 0.1]), 10))
        y = _HEIGHT - 0.45
        poles.append(box((x - 0.05, y, z - 0.95), (x + 0.05, y + 0.12, z + 0.95)))
        insulators += [knob.moved(end) for end in _ends(x, z)]
    home = _POLES[2]
    spans = [*pairwise(_POLES), *((home, branch) for branch in _BRANCHES)]
    wires = [
        _wire(a, b, 0.022 * float(np.linalg.norm(np.subtract(b, a))))
        for left, right in spans
        for a, b in zip(_ends(*left), _ends(*right), strict=True)
    ]
    drops = [
        _wire(end, (HOOK[0], HOOK[1] - 0.15 * k, HOOK[2]), 0.25)
        for k, end in enumerate(_ends(*home))
    ]
    return [
        Part("poles", merge(poles), "pole"),
        Part("insulators", merge(insulators), "gelcoat"),
        Part("wire overhead", merge(wires), "cable"),
        Part("wire to the house", merge(drops), "cable"),
    ]


def _wire(start: Point, end: Point, sag: float) -> Shape:
    return tube(shapes.sagging(start, end, sag, 28), 0.006, 5)


def _string() -> list[Part]:
    """Returns a string of lamps from the balcony over a post to the wind wheel."""
    post = (5.0, 3.1, 3.4)
    ends: list[Point] = [(2.2, 3.0, -2.15), post, (WIND_WHEEL[0], 3.0, WIND_WHEEL[2])]
    profile = [(0.0, -0.1), (0.03, -0.075), (0.035, -0.045), (0.014, 0.0), (0.0, 0.0)]
    bulb = shapes.lathe(profile, 10)
    string, bulbs = [], []
    for a, b in pairwise(ends):
        path = shapes.sagging(a, b, 0.45, 25)
        string.append(tube(path, 0.004, 5))
        bulbs += [bulb.moved(tuple(p)) for p in path[2:-1:3]]
    return [
        Part("wire of lamps", merge(string), "cable"),
        Part("lamp bulbs", merge(bulbs), "lamp"),
        Part("lamp post", line((post[0], 0.0, post[2]), post, 0.03, 8), "frame"),
    ]


def _disc(radius: float, low: float, high: float) -> Shape:
    r = radius
    return shapes.lathe(
        [(0.0, low), (r, low), (r, low), (r, high), (r, high), (0.0, high)], 14
    )


def _bollard_lamps() -> list[Part]:
    bodies, glows = [], []
    for x, z in ((0.75, 3.6), (3.3, 7.0), (-2.9, 2.3)):
        place = (x, float(ground(x, z)), z)
        bodies.append(_disc(0.05, 0.0, 0.5).moved(place))
        bodies.append(_disc(0.06, 0.58, 0.62).moved(place))
        glows.append(_disc(0.042, 0.5, 0.58).moved(place))
    return [
        Part("lamp bollards", merge(bodies), "frame"),
        Part("lamp bollard glow", merge(glows), "lamp"),
    ]
