"""What stands about: table, chairs and lounger on the terrace, a bicycle beside it."""

import numpy as np

from ataa_jax.builtin import shapes
from ataa_jax.builtin.house import FLOOR
from ataa_jax.builtin.shapes import Part, Shape, beam, box, line, merge, tube


def parts() -> list[Part]:
    """Returns the furniture and the bicycle."""
    return [*_terrace(), *_bicycle()]


def _chair(x: float, z: float, degrees: float) -> tuple[Shape, Shape]:
    """Returns the wire frame and the slatted seat of a garden chair."""
    legs = []
    for side in (-0.24, 0.24):
        path = [
            (side, 0, 0.26),
            (side, 0.44, 0.22),
            (side, 0.42, -0.2),
            (side, 0.86, -0.34),
        ]
        legs.append(tube(np.array(path), 0.011, 6))
        legs.append(line((side, 0.0, -0.3), (side, 0.43, -0.12), 0.011))
    seat = [
        box((-0.25, 0.435, z0), (0.25, 0.455, z0 + 0.05))
        for z0 in np.arange(-0.2, 0.2, 0.068)
    ]
    for k in range(6):
        y, back = 0.5 + 0.062 * k, -0.215 - 0.021 * k
        seat.append(beam((-0.25, y, back), (0.25, y, back), 0.015, 0.045))
    place = (x, FLOOR, z)
    return merge(legs).turned(degrees).moved(place), merge(seat).turned(degrees).moved(
        place
    )


def _terrace() -> list[Part]:
    x, z = -7.6, -0.9
    chairs = [
        _chair(x - 0.95, z + 0.1, 95.0),
        _chair(x + 0.95, z - 0.05, -80.0),
        _chair(x + 0.1, z - 0.85, 8.0),
    ]
    top = shapes.lathe(
        [
            (0.0, 0.0),
            (0.56, 0.0),
            (0.56, 0.0),
            (0.58, 0.02),
            (0.56, 0.04),
            (0.56, 0.04),
            (0.0, 0.04),
        ],
        32,
    ).moved((x, FLOOR + 0.71, z))
    feet = []
    for angle in np.arange(3) * 2.1:
        dx, dz = np.cos(angle), np.sin(angle)
        start = (x + 0.4 * dx, FLOOR, z + 0.4 * dz)
        feet.append(line(start, (x - 0.1 * dx, FLOOR + 0.72, z - 0.1 * dz), 0.012))
    glassware = shapes.lathe(
        [(0.0, 0.0), (0.06, 0.0), (0.075, 0.1), (0.03, 0.2), (0.04, 0.26), (0.0, 0.26)]
    )
    bowl = shapes.lathe(
        [(0.0, 0.0), (0.1, 0.0), (0.2, 0.09), (0.19, 0.095), (0.0, 0.03)]
    )
    lounger = [
        box((-0.3, 0.26, z0), (0.3, 0.285, z0 + 0.055))
        for z0 in np.arange(-0.6, 0.72, 0.075)
    ]
    for k in range(9):
        s = 0.07 * k
        lounger.append(
            beam(
                (-0.3, 0.3 + 0.62 * s, -0.66 - 0.78 * s),
                (0.3, 0.3 + 0.62 * s, -0.66 - 0.78 * s),
                0.05,
                0.02,
            )
        )
    rails = []
    for side in (-0.31, 0.31):
        rails.append(beam((side, 0.25, -0.65), (side, 0.25, 0.75), 0.03, 0.05))
        rails.append(beam((side, 0.25, -0.62), (side, 0.68, -1.17), 0.03, 0.04))
        rails += [
            box((side - 0.02, 0.0, z0), (side + 0.02, 0.24, z0 + 0.05))
            for z0 in (-0.6, 0.65)
        ]
    place = (-4.4, FLOOR, -0.35)
    lounge = merge(lounger + rails).turned(35.0).moved(place)
    return [
        Part("chair frames", merge([c[0] for c in chairs]), "frame"),
        Part("slat chairs", merge([c[1] for c in chairs]).tiled(0.6), "varnish"),
        Part("table", top, "fascia"),
        Part("table feet", merge(feet), "frame"),
        Part("vase", glassware.moved((x - 0.1, FLOOR + 0.75, z + 0.1)), "glazed blue"),
        Part("bowl", bowl.moved((x + 0.2, FLOOR + 0.75, z - 0.1)), "terracotta"),
        Part("slat lounger", lounge, "varnish"),
    ]


def _bicycle() -> list[Part]:
    """Returns a bicycle, side on to the path; its spokes are 3 mm thick."""
    radius = 0.33
    rear, front = np.array([0.0, radius, 0.0]), np.array([1.04, radius, 0.0])
    crank = (0.44, 0.28, 0.0)
    saddle, stem, fork = (0.27, 0.86, 0.0), (0.84, 0.92, 0.0), (0.87, 0.78, 0.0)
    frame = [
        line(tuple(rear), crank, 0.012),
        line(tuple(rear), (0.31, 0.74, 0.0), 0.011),
        line(crank, saddle, 0.016),
        line((0.31, 0.72, 0.0), fork, 0.016),
        line(crank, fork, 0.018),
        line(tuple(front), fork, 0.014),
        line(fork, stem, 0.016),
    ]
    bar = [(0.72, 0.98, -0.26), (0.88, 0.97, -0.16), (0.84, 0.93, 0.0)]
    bar += [(x, y, -z) for x, y, z in bar[1::-1]]
    trim = [
        tube(np.array(bar), 0.012, 8),
        line((0.44, 0.28, -0.03), (0.52, 0.13, -0.03), 0.01),
        line((0.44, 0.28, 0.03), (0.36, 0.43, 0.03), 0.01),
        line((0.44, 0.28, -0.012), (0.44, 0.28, 0.012), 0.08, 18),
    ]
    seat = shapes.lathe(
        [(0.0, 0.0), (0.08, 0.0), (0.09, 0.03), (0.05, 0.06), (0.0, 0.06)]
    )
    turn = np.linspace(0.0, 2.0 * np.pi, 41)
    ring = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
    tyres, spokes = [], []
    for hub in (rear, front):
        tyres.append(tube(hub + radius * ring, 0.017, 8))
        spokes.append(tube(hub + (radius - 0.025) * ring, 0.008, 5))
        for k in range(28):
            a = 2.0 * np.pi * k / 28
            rim = hub + (radius - 0.025) * np.array([np.cos(a), np.sin(a), 0.0])
            side = 0.03 if k % 2 else -0.03
            spokes.append(line((hub[0], hub[1], side), tuple(rim), 0.0015, 4))
    place, degrees = (2.75, 0.0, -1.9), 12.0
    parts = (
        ("bicycle frame", frame, "glazed blue"),
        ("bicycle trim", [*trim, seat.moved((0.25, 0.86, 0.0))], "frame"),
        ("bicycle tyres", tyres, "rubber"),
        ("wire bicycle spokes", spokes, "steel"),
    )
    return [
        Part(name, merge(shape).turned(degrees).moved(place), material)
        for name, shape, material in parts
    ]
