"""The sailing boat at the jetty: a lofted hull, spars, furled sails and rigging.

The boat's own space: +z is forward, +y up, y = 0 the water line; `parts` turns and
moves it to its berth. The rigging is 6 to 10 mm thick: thinner than a pixel from
anywhere but the jetty.
"""

import numpy as np

from ataa_jax.builtin import shapes
from ataa_jax.builtin.shapes import Part, Point, Shape, box, line, merge, sagging, tube

_LENGTH = 7.4
_MAST_Z = 0.75
_MAST_TOP = 7.9
_BOOM_END = (0.0, 1.62, -2.75)


def parts(berth: Point, heading: float, bollards: list[Point]) -> list[Part]:
    """Returns the boat at its berth.

    Args:
        berth: where the middle of the water line lies.
        heading: degrees, counter-clockwise from above, of the bow from +z.
        bollards: world positions of the stern's, the middle's and the bow's lines.
    """
    placed = [
        part._replace(shape=part.shape.turned(heading).moved(berth))
        for part in (*_hull(), *_deck(), *_spars(), *_sails(), *_rigging())
    ]
    matrix = shapes.rotation_y(np.radians(heading))
    ropes = []
    for cleat, post in zip(
        ((-0.85, 0.95, -3.4), (-1.1, 0.85, 0.2), (-0.45, 1.1, 3.0)),
        bollards,
        strict=True,
    ):
        start = matrix @ np.array(cleat) + berth
        ropes.append(tube(sagging(tuple(start), post, 0.12, 12), 0.009, 5))
    return [*placed, Part("rope moorings", merge(ropes), "rope")]


def _half_beam(s: np.ndarray) -> np.ndarray:
    """Returns half of the width at s, 0 at the stern and 1 at the bow."""
    return 0.02 + 1.18 * np.clip(1.0 - ((s - 0.42) / 0.585) ** 2, 0.0, 1.0) ** 0.625


def _sheer(s: np.ndarray) -> np.ndarray:
    """Returns the height of the hull's upper edge."""
    return 0.78 + 0.55 * (s - 0.32) ** 2 + 0.28 * s**3


def _keel(s: np.ndarray) -> np.ndarray:
    """Returns the height of the hull's lowest line, which rises to the bow."""
    belly = np.sin(np.pi * np.clip(0.12 + 0.86 * s, 0.0, 1.0)) ** 0.7
    return 0.1 - 0.62 * belly + 0.30 * s**6


def _along(s: np.ndarray) -> np.ndarray:
    return (s - 0.5) * _LENGTH


def _section(t: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Returns hull points; t runs from −1 (starboard sheer) over the keel to 1."""
    a = np.abs(t)
    width = np.sin(0.5 * np.pi * a) ** 0.72
    rise = a**2.6
    half, top, keel = _half_beam(s), _sheer(s), _keel(s)
    x = np.sign(t) * half * width
    y = keel + (top - keel) * rise
    rake = 0.42 * s**4 * rise - 0.28 * (1.0 - s) ** 6 * rise
    return np.stack([x, y, _along(s) + rake], axis=-1)


def _hull() -> list[Part]:
    s = np.linspace(0.0, 1.0, 41)
    bands = {"hull": (0.72, 1.0), "gelcoat": (0.66, 0.72), "boot top": (0.0, 0.66)}
    found = []
    for material, (inner, outer) in bands.items():
        sides = []
        for sign in (-1.0, 1.0):
            t = sign * np.linspace(inner, outer, 11)
            side = shapes.sheet(_section(*np.broadcast_arrays(t[None, :], s[:, None])))
            sides.append(shapes.facing(side, (sign, 0, 0)))
        found.append(Part(f"boat {material}", merge(sides), material))
    edge = _section(np.linspace(-1.0, 1.0, 33), np.zeros(33))
    centre = (edge[0] + edge[-1]) / 2.0
    fan = np.stack([np.broadcast_to(centre, edge.shape), edge])
    transom = shapes.facing(shapes.sheet(fan), (0, 0, -1))
    found.append(Part("boat transom", transom, "varnish"))
    rails = []
    for sign in (-1.0, 1.0):
        sheer = _section(np.full(41, sign), s)
        rails.append(tube(sheer, 0.035, 8))
        stripe = _section(np.full(41, sign * 0.93), s) + np.array([sign * 0.012, 0, 0])
        rails.append(tube(stripe, 0.012, 5))
    rails.append(
        tube(_section(np.linspace(-1, 1, 17), np.zeros(17))[[0, 16]], 0.035, 8)
    )
    found.append(Part("boat rubbing strake", merge(rails), "varnish"))
    rudder = box((-0.03, -0.5, -4.15), (0.03, 0.75, -3.72))
    tiller = tube(
        np.array([(0, 0.85, -3.95), (0, 1.05, -3.4), (0, 1.08, -2.7)]), 0.025, 8
    )
    found.append(Part("boat rudder", merge([rudder, tiller]), "varnish"))
    return found


def _deck() -> list[Part]:
    s, across = np.linspace(0.0, 1.0, 41), np.linspace(-1.0, 1.0, 9)
    edge = _section(np.ones_like(s), s)
    x = across[None, :] * (edge[:, None, 0] - 0.02)
    y = edge[:, None, 1] - 0.06 + 0.07 * (1.0 - across[None, :] ** 2)
    z = edge[:, None, 2] + 0 * x
    deck = shapes.facing(shapes.sheet(np.stack([x, y, z], axis=-1)), (0, 1, 0))
    # The cabin: a rounded box, lofted from the cockpit forward.
    along = np.linspace(-0.6, 2.1, 15)
    t = np.linspace(0.0, np.pi, 17)
    width = 0.72 * np.clip((2.35 - along) / 2.0, 0.0, 1.0) ** 0.45
    tall = 0.46 * np.clip((2.3 - along) / 0.9, 0.0, 1.0) ** 0.6
    ring_x = np.sign(np.cos(t)) * np.abs(np.cos(t)) ** 0.45
    ring_y = np.sin(t) ** 0.5
    cabin = np.stack(
        [
            width[:, None] * ring_x,
            0.82 + tall[:, None] * ring_y,
            along[:, None] + 0 * ring_x,
        ],
        axis=-1,
    )
    roof = shapes.facing(shapes.sheet(cabin), (0, 1, 0))
    rear = np.stack([np.broadcast_to(cabin[0].mean(0), cabin[0].shape), cabin[0]])
    bulkhead = shapes.facing(shapes.sheet(rear), (0, 0, -1))
    ports = [_port(side, z) for side in (-1.0, 1.0) for z in (-0.1, 0.5, 1.1)]
    coaming = [
        box((side - 0.025, 0.75, -2.9), (side + 0.025, 1.02, -0.6))
        for side in (-0.66, 0.66)
    ]
    coaming.append(box((-0.685, 0.75, -2.95), (0.685, 1.02, -2.9)))
    hatch = box((-0.27, 0.84, -0.64), (0.27, 1.22, -0.6))
    seats = box((-0.63, 0.8, -2.9), (0.63, 0.89, -0.64))
    return [
        Part("boat deck", deck.tiled(1.0, 2.4), "deck"),
        Part("boat cabin", merge([roof, bulkhead]), "gelcoat"),
        Part("boat ports", merge(ports), "frame"),
        Part("boat cockpit", merge([*coaming, hatch]), "varnish"),
        Part("boat seats", seats.tiled(1.2, 2.4), "deck"),
    ]


def _port(side: float, z: float) -> Shape:
    disc = shapes.lathe(
        [(0.0, 0.0), (0.11, 0.0), (0.11, 0.0), (0.09, 0.025), (0.0, 0.025)], 16
    )
    turn = shapes.rotation_about(np.array([0.0, 0.0, 1.0]), -side * np.pi / 2.0)
    disc = disc._replace(position=disc.position @ turn.T, normal=disc.normal @ turn.T)
    width = 0.72 * ((2.35 - z) / 2.0) ** 0.45
    return disc.moved((side * (width - 0.01), 1.03, z))


def _spars() -> list[Part]:
    mast = np.array([(0.0, y, _MAST_Z) for y in np.linspace(0.8, _MAST_TOP, 12)])
    thick = np.linspace(0.062, 0.035, 12)
    spreaders = [line((x, 5.1, 0.72), (0.0, 5.15, 0.75), 0.018) for x in (-0.72, 0.72)]
    boom = line((0.0, 1.7, 0.66), _BOOM_END, 0.045, 10)
    bowsprit = line((0.0, 1.22, 3.4), (0.0, 1.36, 4.9), 0.04, 10)
    gear = [
        line((0.0, _MAST_TOP, 0.75), (0.0, _MAST_TOP + 0.5, 0.75), 0.006),
        line((-0.14, _MAST_TOP + 0.5, 0.75), (0.14, _MAST_TOP + 0.5, 0.75), 0.006),
    ]
    posts = [
        line(tuple(foot), (foot[0], foot[1] + 0.55, foot[2]), 0.012)
        for side in (-1.0, 1.0)
        for foot in _stanchion_feet(side)
    ]
    return [
        Part(
            "boat spars",
            merge([tube(mast, thick, 12), *spreaders, boom, bowsprit]),
            "varnish",
        ),
        Part("rail stanchions", merge([*posts, *gear]), "steel"),
    ]


def _stanchion_feet(side: float) -> np.ndarray:
    """Returns where the lifeline's five posts stand on one side's gunwale."""
    s = np.array([0.06, 0.3, 0.55, 0.78, 0.96])
    return _section(np.full(5, side), s) * np.array([0.97, 1.0, 1.0])


def _sails() -> list[Part]:
    s = np.linspace(0.0, 1.0, 40)
    path = sagging((0.0, 1.80, 0.6), (0.0, 1.70, -2.6), 0.0, 40)
    path[:, 1] += 0.02 * np.sin(s * 40.0)
    bulk = (0.135 - 0.06 * s) * np.minimum(1.0, 0.25 + 12.0 * np.minimum(s, 1.0 - s))
    bulk = bulk * (1.0 + 0.05 * np.sin(s * 57.0) + 0.05 * np.sin(s * 23.0))
    furled = tube(path, bulk, 12)
    stay = np.linspace(0.0, 1.0, 30)
    roll = sagging((0.0, 1.55, 4.75), (0.0, 7.35, 0.92), 0.0, 30)
    jib = tube(roll, 0.015 + 0.045 * np.sin(np.pi * (0.25 + 0.72 * stay)), 10)
    ties = []
    for k in range(7):
        i = 3 + 5 * k
        ring = path[i] + (bulk[i] + 0.006) * np.stack(
            [np.cos(s * 2 * np.pi), np.sin(s * 2 * np.pi), 0 * s], axis=-1
        )
        ties.append(tube(ring[::4], 0.006, 4))
    pennant_s = np.linspace(0.0, 1.0, 16)
    wave = 0.05 * np.sin(pennant_s * 9.0) * pennant_s
    rows = []
    for edge in (1.0, -1.0):
        half = 0.13 * (1.0 - 0.85 * pennant_s)
        rows.append(
            np.stack(
                [-0.02 - 0.75 * pennant_s, _MAST_TOP + 0.3 + edge * half, 0.75 + wave],
                -1,
            )
        )
    return [
        Part("boat furled sails", merge([furled, jib]).tiled(0.6), "sail"),
        Part("rope sail ties", merge(ties), "rope"),
        Part("boat pennant", shapes.sheet(np.stack(rows)), "pennant"),
    ]


def _rigging() -> list[Part]:
    top, hounds = (0.0, _MAST_TOP - 0.15, 0.75), (0.0, 5.0, 0.75)
    stays: list[Shape] = []
    running: list[Shape] = []
    ratlines: list[Shape] = []

    def rope(
        into: list[Shape],
        start: Point,
        end: Point,
        radius: float = 0.004,
        sag: float = 0.0,
    ) -> None:
        into.append(tube(sagging(start, end, sag, 2 if sag == 0.0 else 10), radius, 5))

    rope(stays, top, (0.0, 1.4, 4.85))  # forestay
    rope(stays, (0.0, 5.8, 0.78), (0.0, 1.2, 3.5))  # inner forestay
    for side in (-1.0, 1.0):
        rope(stays, top, (side * 0.7, 0.95, -3.5))  # backstays
        rope(stays, top, (side * 0.72, 5.1, 0.72))  # cap shrouds over the spreaders
        rope(stays, (side * 0.72, 5.1, 0.72), (side * 1.12, 0.85, 0.7))
        fore, aft = (side * 1.1, 0.86, 1.15), (side * 1.14, 0.85, 0.2)
        rope(stays, hounds, fore)
        rope(stays, hounds, aft)
        for h in np.linspace(0.1, 0.78, 11):
            a = tuple(np.array(fore) + (np.array(hounds) - fore) * h)
            b = tuple(np.array(aft) + (np.array(hounds) - aft) * h)
            rope(ratlines, a, b, 0.003, 0.012)
        # lazy jacks hold the furled sail
        for z in (-0.6, -1.7):
            rope(running, (side * 0.03, 4.6, 0.7), (side * 0.14, 1.62, z), 0.003)
        rails = _stanchion_feet(side)  # lifelines between the stanchions
        running += [
            tube(rails + np.array([0.0, up, 0.0]), 0.003, 4) for up in (0.3, 0.53)
        ]
    rope(running, top, _BOOM_END, 0.004, 0.15)  # topping lift
    rope(running, (0.05, 7.7, 0.72), (0.12, 1.0, 0.6), 0.0035, 0.05)  # main halyard
    rope(running, (-0.05, 7.3, 0.78), (-0.15, 1.0, 0.7), 0.0035, 0.08)  # jib halyard
    # flag halyard
    rope(running, (0.58, 5.1, 0.72), (0.95, 1.0, 0.45), 0.003, 0.04)
    for x in (-0.05, 0.05):  # main sheet
        rope(running, (x, 1.6, -2.6), (x * 4, 1.1, -2.92), 0.005)
    return [
        Part("rope standing rigging", merge(stays), "cable"),
        Part("rope running rigging", merge(running), "rope"),
        Part("rope ratlines", merge(ratlines), "rope"),
    ]


def far_sail(water: Point) -> list[Part]:
    """Returns a small boat under sail, far away."""
    s, t = np.linspace(0.0, 1.0, 9)[:, None], np.linspace(0.0, 1.0, 9)[None, :]
    sails = []
    for luff, leech, height in ((0.0, -2.6, 6.2), (1.9, 0.3, 4.9)):
        z = (luff + (leech - luff) * t) * (1.0 - s)
        belly = 0.45 * np.sin(np.pi * t) * np.sqrt(1.0 - s)
        y = np.broadcast_to(0.9 + height * s, z.shape)
        sails.append(shapes.sheet(np.stack([belly, y, z], axis=-1)))
    angle = np.linspace(-np.pi, np.pi, 25)[None, :]
    rise = np.linspace(0.0, 1.0, 4)[:, None]
    x = (0.55 + 0.25 * rise) * np.sin(angle)
    y, z = np.broadcast_arrays(0.55 * rise - 0.05, 2.3 * np.cos(angle))
    hull = shapes.sheet(np.stack([x, y, z], axis=-1), closed=True)
    if np.sum(hull.normal[:, 0] * hull.position[:, 0]) < 0.0:
        hull = shapes.flipped(hull)
    parts = (
        ("far sails", merge(sails), "sail"),
        ("far hull", hull, "gelcoat"),
        ("rope far mast", line((0.0, 0.3, 0.0), (0.0, 7.2, 0.0), 0.05, 8), "varnish"),
    )
    return [
        Part(name, shape.turned(-50.0).moved(water), material)
        for name, shape, material in parts
    ]
