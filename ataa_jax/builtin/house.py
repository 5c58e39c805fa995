"""The house: brick and timber below, a white upper floor with a balcony, a terrace.

It faces +z. Lengths are metres; the garden's ground lies at y = 0.
"""

from itertools import pairwise

import numpy as np

from ataa_jax.builtin import shapes
from ataa_jax.builtin.shapes import Part, Shape, beam, box, line, merge, quad, tube

FLOOR = 0.36  # floor of the house and of the terrace
_HEAD = 2.75  # top of doors and windows
_CEILING = 3.05
_FRONT = -3.0  # outer face of the ground floor
_UPPER_FLOOR = 3.35
_UPPER_FRONT = -3.7
_UPPER_TOP = 6.1
HOOK = (-0.1, 6.9, -7.2)  # where the overhead wires meet the house


def parts() -> list[Part]:
    """Returns everything that stands on the house's plot."""
    return [
        *_ground_floor(),
        *_upper_floor(),
        *_roofs(),
        *_openings(),
        *_room(),
        *_terrace(),
        *_railing(),
        *_awning(),
        *_fittings(),
    ]


def _ground_floor() -> list[Part]:
    front, back, base = _FRONT, -9.0, -0.3
    brick = [
        shapes.pierced_wall(
            (-9.6, base, front - 0.3),
            (-6.2, _CEILING, front),
            [(-8.3, -7.6, 0.9, _HEAD)],
        ),
        box((-9.6, base, back), (-9.3, _CEILING, front - 0.3)),
        box((-9.3, base, back), (1.7, _CEILING, back + 0.3)),
        # The side toward the water: a wall along x, turned by a quarter.
        shapes.pierced_wall(
            (-front, base, -0.3), (-back, _CEILING, 0.0), [(4.2, 7.6, 0.9, _HEAD)]
        )
        .turned(90.0)
        .moved((1.7, 0.0, 0.0)),
    ]
    clad = shapes.pierced_wall(
        (-0.7, base, front - 0.25),
        (1.42, _CEILING, front),
        [(0.15, 1.15, FLOOR, _HEAD)],
    )
    piers = [
        box((-6.2, base, front - 0.3), (-5.95, _CEILING, front)),
        box((-0.95, base, front - 0.3), (-0.7, _CEILING, front + 0.02)),
        box((-5.95, _HEAD, front - 0.3), (-0.95, _CEILING, front)),
        box((-5.95, base, front - 0.3), (-0.95, FLOOR, front)),
    ]
    return [
        Part("brick walls", merge(brick).tiled(0.96), "brick"),
        Part("cladding at the door", clad.tiled(0.96, 2.4), "cladding"),
        Part("render below", merge(piers).tiled(2.0), "render"),
    ]


def _upper_floor() -> list[Part]:
    left, right, back = -7.8, -0.7, -8.7
    y0, y1, z = _UPPER_FLOOR, _UPPER_TOP, _UPPER_FRONT
    white = [
        shapes.pierced_wall(
            (left, y0, z - 0.3),
            (-2.6, y1, z),
            [(-7.2, -4.5, 3.75, 5.7), (-3.7, -3.2, 3.75, 5.7)],
        ),
        box((left, y0, back), (left + 0.3, y1, z - 0.3)),
        box((left + 0.3, y0, back), (right, y1, back + 0.3)),
        shapes.pierced_wall(
            (-z + 0.3, y0, -0.3), (-back, y1, 0.0), [(4.6, 7.0, y0, 5.7)]
        )
        .turned(90.0)
        .moved((right, 0.0, 0.0)),
    ]
    clad = shapes.pierced_wall(
        (-2.6, y0, z - 0.3), (right, y1, z + 0.03), [(-2.2, -1.15, y0 + 0.02, 5.7)]
    )
    return [
        Part("white walls above", merge(white).tiled(2.0), "render"),
        Part("cladding above", clad.tiled(0.96, 2.4), "cladding"),
    ]


def _roofs() -> list[Part]:
    slabs = [
        box((-10.1, _CEILING, -9.4), (2.3, _UPPER_FLOOR, -2.1)),
        box((-8.5, _UPPER_TOP, -9.3), (0.0, _UPPER_TOP + 0.24, -2.9)),
    ]
    tops = [
        box((-10.05, _UPPER_FLOOR, -9.35), (2.25, _UPPER_FLOOR + 0.03, -2.15)),
        box((-8.45, _UPPER_TOP + 0.24, -9.25), (-0.05, _UPPER_TOP + 0.27, -2.95)),
    ]
    trims = []
    for (x0, x1, z0, z1), y in (
        ((-10.1, 2.3, -9.4, -2.1), _UPPER_FLOOR),
        ((-8.5, 0.0, -9.3, -2.9), _UPPER_TOP + 0.24),
    ):
        corners = [(x0, z0), (x1, z0), (x1, z1), (x0, z1), (x0, z0)]
        for (ax, az), (bx, bz) in pairwise(corners):
            trims.append(beam((ax, y + 0.02, az), (bx, y + 0.02, bz), 0.06, 0.09))
    soffit = box((-8.3, _UPPER_TOP - 0.02, -3.68), (-0.15, _UPPER_TOP, -3.05))
    chimney = [box((-6.9, 6.3, -8.0), (-6.0, 7.25, -7.3))]
    cap = [box((-7.0, 7.25, -8.1), (-5.9, 7.33, -7.2))]
    return [
        Part("roof slabs", merge(slabs), "fascia"),
        Part("roof felt", merge(tops), "roof"),
        Part("roof edges", merge(trims + cap), "frame"),
        Part("soffit", soffit.tiled(0.96, 2.4), "cladding"),
        Part("chimney", merge(chimney).tiled(0.96), "brick"),
    ]


def _window(
    x0: float, x1: float, y0: float, y1: float, z: float, mullions: list[float]
) -> tuple[list[Shape], Shape, Shape]:
    """Returns the frame, the pane and the sill of a window that looks along +z."""
    w, depth = 0.055, 0.07
    bars = [
        box((x0, y0, z - depth), (x0 + w, y1, z)),
        box((x1 - w, y0, z - depth), (x1, y1, z)),
        box((x0 + w, y0, z - depth), (x1 - w, y0 + w, z)),
        box((x0 + w, y1 - w, z - depth), (x1 - w, y1, z)),
    ]
    bars += [
        box((x - 0.015, y0 + w, z - 0.055), (x + 0.015, y1 - w, z - 0.01))
        for x in mullions
    ]
    pane = quad((x0, y0, z - 0.04), (x1 - x0, 0.0, 0.0), (0.0, y1 - y0, 0.0))
    sill = box((x0 - 0.06, y0 - 0.04, z - 0.05), (x1 + 0.06, y0, z + 0.2))
    return bars, pane.tiled(5.0, y1 - y0), sill


def _openings() -> list[Part]:
    frames, panes, sills = [], [], []
    front, upper = _FRONT - 0.14, _UPPER_FRONT - 0.14
    for x0, x1, y0, y1, z, mullions in (
        (-8.3, -7.6, 0.9, _HEAD, front, []),
        (-7.2, -4.5, 3.75, 5.7, upper, [-6.3, -5.4]),
        (-3.7, -3.2, 3.75, 5.7, upper, []),
        (-2.2, -1.15, 3.37, 5.7, upper + 0.03, []),
    ):
        bars, pane, sill = _window(x0, x1, y0, y1, z, mullions)
        frames += bars
        panes.append(pane)
        sills.append(sill)
    for u0, u1, y0, y1, x, mullions in (
        (4.2, 7.6, 0.9, _HEAD, 1.7, [5.05, 5.9, 6.75]),
        (4.6, 7.0, 3.37, 5.7, -0.7, [5.8]),
    ):
        bars, pane, sill = _window(u0, u1, y0, y1, -0.14, mullions)
        frames += [b.turned(90.0).moved((x, 0, 0)) for b in bars]
        panes.append(pane.turned(90.0).moved((x, 0, 0)))
        sills.append(sill.turned(90.0).moved((x, 0, 0)))
    # Four sliding panes; the middle two stand open, behind the outer ones.
    for k, x in enumerate((-5.95, -5.88, -2.27, -2.20)):
        z = _FRONT - (0.08, 0.17, 0.17, 0.08)[k]
        bars, pane, _ = _window(x, x + 1.25, FLOOR, _HEAD, z, [])
        frames += bars
        panes.append(pane)
    frames.append(box((-5.95, FLOOR, _FRONT - 0.28), (-0.95, FLOOR + 0.03, _FRONT)))
    door = box((0.15, FLOOR, _FRONT - 0.15), (1.15, _HEAD, _FRONT - 0.08))
    handle = line((0.3, 1.0, _FRONT - 0.02), (0.3, 2.0, _FRONT - 0.02), 0.016, 8)
    return [
        Part("window frames", merge(frames), "frame"),
        Part("window panes", merge(panes), "glass"),
        Part("window sills", merge(sills), "stone"),
        Part("front door", door, "yellow"),
        Part("door handle", handle, "steel"),
    ]


def _room() -> list[Part]:
    """Returns what one sees through the open doors."""
    x0, x1, back = -5.95, -0.95, -7.4
    walls = [
        box((x0 - 0.1, FLOOR, back - 0.1), (x1 + 0.1, _CEILING, back)),
        box((x0 - 0.1, FLOOR, back), (x0, _CEILING, _FRONT - 0.3)),
        box((x1, FLOOR, back), (x1 + 0.1, _CEILING, _FRONT - 0.3)),
    ]
    floor = box((x0, FLOOR - 0.1, back), (x1, FLOOR, _FRONT - 0.3))
    s = FLOOR
    sofa = [
        box((-4.9, s + 0.12, -6.9), (-2.6, s + 0.45, -5.95)),
        box((-4.9, s + 0.45, -6.9), (-2.6, s + 0.85, -6.65)),
        box((-5.05, s + 0.12, -6.9), (-4.9, s + 0.65, -5.95)),
        box((-2.6, s + 0.12, -6.9), (-2.45, s + 0.65, -5.95)),
    ]
    cushions = [
        box((-4.7, s + 0.5, -6.66), (-4.25, s + 0.9, -6.5)),
        box((-3.3, s + 0.5, -6.66), (-2.85, s + 0.9, -6.5)),
    ]
    picture = quad((-4.3, 1.55, back + 0.02), (1.5, 0, 0), (0, 0.95, 0)).tiled(
        1.5, 0.95
    )
    shade = shapes.lathe(
        [(0.0, 0.0), (0.28, 0.0), (0.28, 0.0), (0.1, 0.25), (0.0, 0.27)]
    )
    folds = np.linspace(0.0, 1.0, 41)
    curtain = []
    for x in (-4.9, -2.35):
        row = np.stack(
            [x + 0.5 * folds, 0 * folds, -3.5 + 0.05 * np.sin(folds * 44.0)], axis=-1
        )
        grid = np.stack([row + np.array([0.0, y, 0.0]) for y in (2.85, FLOOR + 0.03)])
        curtain.append(shapes.sheet(grid))
    return [
        Part("room walls", merge(walls), "interior"),
        Part("room floor", floor.tiled(1.2, 2.4), "cladding"),
        Part("sofa", merge(sofa), "linen"),
        Part("cushions", merge(cushions), "yellow"),
        Part("picture", picture, "glass"),
        Part("pendant lamp", shade.moved((-3.4, 1.95, -5.6)), "lamp"),
        Part(
            "wire of the pendant",
            line((-3.4, 2.2, -5.6), (-3.4, 3.05, -5.6), 0.006),
            "cable",
        ),
        Part("curtains", merge(curtain), "linen"),
    ]


def _terrace() -> list[Part]:
    boards = []
    pitch = 0.15
    for k in range(80):
        x = -9.6 + pitch * k
        boards.append(box((x, FLOOR - 0.03, _FRONT), (x + 0.143, FLOOR, 1.0)))
    joists = [
        box((-9.6, 0.02, 0.9), (2.4, FLOOR - 0.03, 0.96)),
        box((-9.58, 0.0, _FRONT), (-9.5, FLOOR - 0.03, 0.9)),
        box((2.3, 0.0, _FRONT), (2.38, FLOOR - 0.03, 0.9)),
    ]
    steps = [
        box((-2.3, -0.1, 1.0), (0.7, FLOOR - 0.13, 1.42)),
        box((-2.5, -0.1, 1.42), (0.9, FLOOR - 0.25, 1.84)),
    ]
    columns = [
        line((x, FLOOR, -2.25), (x, _CEILING, -2.25), 0.045, 10)
        for x in (-9.7, -6.2, -0.75, 2.1)
    ]
    return [
        Part("terrace boards", merge(boards).tiled(8 * pitch, 2.4), "deck"),
        Part("terrace frame", merge(joists).tiled(1.2), "deck"),
        Part("steps", merge(steps).tiled(1.8), "paving"),
        Part("columns", merge(columns), "frame"),
    ]


def _railing() -> list[Part]:
    """Returns the balcony's railing; its bars are 12 mm thick, 11 cm apart."""
    y0, y1 = _UPPER_FLOOR + 0.05, _UPPER_FLOOR + 1.0
    corners = [(-7.8, -3.7), (-7.8, -2.25), (2.15, -2.25), (2.15, -8.9)]
    bars, posts, handrails = [], [], []
    for (ax, az), (bx, bz) in pairwise(corners):
        length = float(np.hypot(bx - ax, bz - az))
        for s in np.linspace(0.0, 1.0, round(length / 0.11) + 1)[1:-1]:
            x, z = ax + (bx - ax) * s, az + (bz - az) * s
            bars.append(line((x, y0 + 0.08, z), (x, y1 - 0.03, z), 0.006, 5))
        for s in np.linspace(0.0, 1.0, max(round(length / 1.4), 1) + 1):
            x, z = ax + (bx - ax) * s, az + (bz - az) * s
            posts.append(line((x, y0, z), (x, y1, z), 0.02, 8))
        handrails.append(beam((ax, y1, az), (bx, y1, bz), 0.05, 0.035))
        handrails.append(beam((ax, y0 + 0.09, az), (bx, y0 + 0.09, bz), 0.02, 0.02))
    return [
        Part("rail bars", merge(bars), "frame"),
        Part("rail posts", merge(posts), "frame"),
        Part("rail hand", merge(handrails), "frame"),
    ]


def _awning() -> list[Part]:
    """Returns striped cloth under the balcony, with a scalloped valance."""
    x = np.linspace(-6.1, -2.9, 129)
    sag = np.array([0.0, -0.05, -0.05, 0.0])
    z, y = np.linspace(-2.1, -0.25, 4), np.linspace(3.02, 2.5, 4) + sag
    rows = [
        np.stack([x, np.full_like(x, b), np.full_like(x, a)], -1)
        for a, b in zip(z, y, strict=True)
    ]
    scallop = 0.16 + 0.07 * np.abs(np.sin((x - x[0]) * np.pi / 0.32))
    valance = np.stack([rows[-1], rows[-1] - np.stack([0 * x, scallop, 0 * x], -1)])
    cloth = merge([shapes.sheet(np.stack(rows)), shapes.sheet(valance)])
    arms = [
        line((x, 2.98, -2.1), (x, 2.52, -0.28), 0.014) for x in (-6.08, -4.5, -2.92)
    ]
    arms.append(line((-6.12, 2.5, -0.25), (-2.88, 2.5, -0.25), 0.02))
    return [
        Part("awning", cloth.tiled(0.96, 1.0), "awning"),
        Part("awning arms", merge(arms), "steel"),
    ]


def _fittings() -> list[Part]:
    """Returns lamps, the rain pipe and the aerial."""
    lamp_body = box((-0.38, 1.95, _FRONT), (-0.22, 2.35, _FRONT + 0.1))
    glow = box((-0.36, 2.0, _FRONT + 0.1), (-0.24, 2.3, _FRONT + 0.13))
    strips = [box((-4.2, 6.075, -3.4), (-1.0, 6.085, -3.34))]
    bends = [(-9.75, 3.05, -2.5), (-9.75, 2.9, -2.6), (-9.7, 2.7, -2.94)]
    pipe = tube(np.array([*bends, (-9.7, 0.0, -2.94)]), 0.04, 10)
    mast = (-1.6, 6.3, -7.6)
    rods = [line(mast, (mast[0], 8.5, mast[2]), 0.016)]
    for k in range(7):
        x, half = mast[0] - 0.7 + 0.22 * k, 0.24 + 0.035 * k
        rods.append(line((x, 8.32, mast[2] - half), (x, 8.32, mast[2] + half), 0.005))
    rods.append(
        line((mast[0] - 0.75, 8.32, mast[2]), (mast[0] + 0.7, 8.32, mast[2]), 0.009)
    )
    hook = line((-0.75, 6.0, -7.2), HOOK, 0.02)
    return [
        Part("wall lamp", lamp_body, "frame"),
        Part("lamp glow", merge([glow, *strips]), "lamp"),
        Part("rain pipe", pipe, "frame"),
        Part("wire aerial", merge(rods), "steel"),
        Part("wire hook", hook, "frame"),
    ]
