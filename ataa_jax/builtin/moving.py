"""What moves: the boat rocks, a pinwheel turns, a toy car circles, a ball rolls.

Every motion is a whole number of cycles in `DURATION`, so the animation loops.
"""

import numpy as np

from ataa_jax.builtin.boat import BOAT_AT, BOAT_HEADING
from ataa_jax.builtin.landscape import ground
from ataa_jax.builtin.parts import GROUPS, Parts
from ataa_jax.builtin.shapes import (
    Shape,
    box,
    lathe,
    line,
    merge,
    rotation_about,
    rotation_y,
    sheet,
    tube,
)

DURATION = 8.0

_PINWHEEL = np.array([-0.55, 2.35, 4.6])
_PINWHEEL_TURN = np.radians(20.0)  # the axle's direction, from +z
_CAR = np.array([1.35, 5.15])  # centre of its round, x and z
_CAR_RADIUS = np.array([0.72, 1.35])
_BALL, _BALL_RADIUS, _BALL_REACH = np.array([3.1, 5.2]), 0.16, 0.7


def add(parts: Parts) -> None:
    """Adds the moving things, each in the space of its group."""
    _pinwheel(parts)
    _car(parts)
    _ball(parts)


def transforms(time: float) -> np.ndarray:
    """Returns float32 (groups, 3, 4) world_from_group at a time in seconds."""
    cycle = 2.0 * np.pi * (time % DURATION) / DURATION
    still = np.eye(3, 4)
    by_name = {
        "static": still,
        "boat": _boat_pose(cycle),
        "pinwheel": _pinwheel_pose(cycle),
        "car": _car_pose(cycle),
        "ball": _ball_pose(cycle),
    }
    return np.stack([by_name[name] for name in GROUPS]).astype(np.float32)


def _pose(rotation: np.ndarray, at: np.ndarray) -> np.ndarray:
    return np.concatenate([rotation, np.asarray(at, float)[:, None]], axis=1)


def _boat_pose(cycle: float) -> np.ndarray:
    heading = rotation_y(np.radians(BOAT_HEADING))
    roll = rotation_about(np.array([1.0, 0, 0]), np.radians(1.3) * np.sin(2 * cycle))
    pitch = rotation_about(np.array([0.0, 0, 1]), np.radians(0.5) * np.sin(cycle + 1.0))
    heave = np.array([0.0, 0.02 * np.sin(2 * cycle + 0.6), 0.0])
    return _pose(heading @ roll @ pitch, np.array(BOAT_AT) + heave)


def _pinwheel_pose(cycle: float) -> np.ndarray:
    spin = rotation_about(np.array([0.0, 0.0, 1.0]), cycle)
    return _pose(rotation_y(_PINWHEEL_TURN) @ spin, _PINWHEEL)


def _car_pose(cycle: float) -> np.ndarray:
    x, z = _CAR + _CAR_RADIUS * np.array([np.cos(cycle), np.sin(cycle)])
    dx, dz = _CAR_RADIUS * np.array([-np.sin(cycle), np.cos(cycle)])
    y = float(ground(x, z)) + 0.04
    return _pose(rotation_y(np.arctan2(-dz, dx)), np.array([x, y, z]))


def _ball_pose(cycle: float) -> np.ndarray:
    travel = _BALL_REACH * np.sin(cycle)
    x, z = _BALL + np.array([travel, 0.0])
    roll = rotation_about(np.array([0.0, 0.0, -1.0]), travel / _BALL_RADIUS)
    y = float(ground(x, z)) + _BALL_RADIUS
    return _pose(roll, np.array([x, y, z]))


def _pinwheel(parts: Parts) -> None:
    """Adds eight curved vanes in the plane z = 0, and a still post behind them."""
    for k in range(8):
        turn = rotation_about(np.array([0.0, 0, 1]), 2.0 * np.pi * k / 8)
        r = np.linspace(0.06, 0.62, 9)[:, None]
        w = np.linspace(-0.5, 0.5, 6)[None]
        width = 0.05 + 0.30 * r
        y = w * width + 0.08 * np.sin(np.pi * r)
        z = 0.07 * np.sin(np.pi * (w + 0.5)) * (r / 0.6) + 0.1 * w * width
        vane = np.stack(np.broadcast_arrays(r, y, z), axis=-1) @ turn.T
        material = ("red", "yellow", "gelcoat", "glazed blue")[k % 4]
        parts.add(f"pinwheel vanes {material}", material, sheet(vane), group="pinwheel")
    hub = lathe([(0, -0.06), (0.07, -0.06), (0.07, 0.04), (0.03, 0.09), (0, 0.1)], 20)
    tip = rotation_about(np.array([1.0, 0, 0]), np.pi / 2)
    hub = hub._replace(position=hub.position @ tip.T, normal=hub.normal @ tip.T)
    parts.add("pinwheel hub", "steel", hub, group="pinwheel")
    x, y, z = _PINWHEEL + 0.12 * np.array(
        [-np.sin(_PINWHEEL_TURN), 0, -np.cos(_PINWHEEL_TURN)]
    )
    axle = line((x, y, z), tuple(_PINWHEEL), 0.02, 8)
    parts.add(
        "pinwheel post", "slats", line((x, -0.3, z), (x, y + 0.04, z), 0.028, 10), axle
    )


def _car(parts: Parts) -> None:
    """Adds a toy car of 0.6 m: a lofted body, a cabin and wheels."""
    body = _loft(
        [
            (-0.30, 0.10, 0.19, 0.11), (-0.285, 0.07, 0.235, 0.13), (-0.15, 0.06, 0.245, 0.14),
            (0.1, 0.06, 0.235, 0.14), (0.25, 0.07, 0.20, 0.125), (0.30, 0.10, 0.165, 0.10),
        ]
    )  # fmt: skip
    cabin = _loft(
        [
            (-0.22, 0.22, 0.235, 0.10),
            (-0.17, 0.2, 0.335, 0.105),
            (0.0, 0.2, 0.345, 0.105),
            (0.1, 0.2, 0.24, 0.10),
        ]
    )
    parts.add("car body", "red", body, group="car")
    parts.add("car cabin", "gelcoat", cabin, group="car")
    windows = [
        box((-0.15, 0.25, s * 0.097 - 0.008), (-0.01, 0.31, s * 0.097 + 0.008))
        for s in (-1, 1)
    ]
    parts.add("car windows", "frame", *windows, group="car")
    tilt = rotation_about(np.array([1.0, 0, 0]), np.pi / 2)
    wheels, hubs = [], []
    for x in (-0.18, 0.19):
        for z in (-0.14, 0.14):
            for radius, width, into in ((0.075, 0.025, wheels), (0.04, 0.03, hubs)):
                disc = lathe(
                    [
                        (0, -width),
                        (radius * 0.85, -width),
                        (radius, -width * 0.5),
                        (radius, width * 0.5),
                        (radius * 0.85, width),
                        (0, width),
                    ],
                    20,
                )
                into.append(
                    disc._replace(
                        position=disc.position @ tilt.T, normal=disc.normal @ tilt.T
                    ).moved((x, 0.075, z))
                )
    parts.add("car wheels", "rubber", *wheels, group="car")
    parts.add("car hubs", "steel", *hubs, group="car")
    bumper = [
        tube(
            np.array([[x, 0.1, -0.11], [x * 1.05, 0.1, 0.0], [x, 0.1, 0.11]]), 0.014, 8
        )
        for x in (-0.3, 0.3)
    ]
    parts.add("car bumpers", "steel", *bumper, group="car")


def _loft(sections: list[tuple[float, float, float, float]]) -> Shape:
    """Makes a rounded body along x from (x, bottom, top, half width) sections."""
    angle = np.linspace(0.0, 2.0 * np.pi, 25)
    c, s = np.cos(angle), np.sin(angle)
    ring_z = np.sign(c) * np.abs(c) ** 0.45
    ring_y = np.sign(s) * np.abs(s) ** 0.45
    rings = []
    for x, bottom, top, half in sections:
        y = (bottom + top) / 2 + (top - bottom) / 2 * ring_y
        rings.append(np.stack([np.full(25, x), y, half * ring_z], axis=1))
    first = np.broadcast_to(rings[0].mean(axis=0), (25, 3))
    last = np.broadcast_to(rings[-1].mean(axis=0), (25, 3))
    points = np.stack([first, *rings, last])
    points[:, -1] = points[:, 0]
    return sheet(points[::-1], closed=True)


def _ball(parts: Parts) -> None:
    """Adds a beach ball: segments in turn red, white, yellow, white."""
    polar = np.linspace(0.0, np.pi, 17)[:, None]
    segments = 8
    for k in range(segments):
        angle = np.linspace(k, k + 1, 7)[None] * 2.0 * np.pi / segments
        n = np.stack(
            np.broadcast_arrays(
                np.sin(polar) * np.sin(angle),
                np.cos(polar),
                np.sin(polar) * np.cos(angle),
            ),
            axis=-1,
        )
        slice_ = sheet(n * _BALL_RADIUS)
        slice_ = slice_._replace(normal=n.reshape(-1, 3))
        material = ("red", "gelcoat", "yellow", "gelcoat")[k % 4]
        parts.add(f"ball {material}", material, merge([slice_]), group="ball")
