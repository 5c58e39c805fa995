"""What moves: a toy car, a drone and a wind wheel, each a rigid group, in a loop."""

from collections.abc import Callable

import numpy as np

from ataa_jax.builtin import garden, shapes
from ataa_jax.builtin.shapes import Part, Shape, box, line, merge

DURATION = 8.0  # seconds; every motion below repeats after it
GROUPS = ["static", "toy car", "drone", "wind wheel"]

_CAR_CENTRE, _CAR_RADII = np.array([0.5, 5.3]), np.array([2.7, 1.5])
_DRONE_CENTRE, _DRONE_RADII = np.array([3.4, 4.3, -0.5]), np.array([2.0, 0.35, 1.3])


def parts() -> list[Part]:
    """Returns the moving things, in the spaces of their groups."""
    return [*_car(), *_drone(), *_wheel()]


def transforms() -> Callable[[float], np.ndarray]:
    """Returns seconds -> world_from_group, float32 (4, 3, 4), with period DURATION."""

    def at(time: float) -> np.ndarray:
        turn = 2.0 * np.pi * ((time / DURATION) % 1.0)
        matrices = [np.eye(3, 4), _car_at(turn), _drone_at(turn), _wheel_at(turn)]
        return np.stack(matrices).astype(np.float32)

    return at


def _placed(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    return np.concatenate([rotation, position[:, None]], axis=1)


def _car_at(turn: float) -> np.ndarray:
    """Drives an ellipse over path and lawn, nose first, on the ground."""
    x, z = _CAR_CENTRE + _CAR_RADII * (np.cos(turn), np.sin(turn))
    dx, dz = _CAR_RADII * (-np.sin(turn), np.cos(turn))
    y = float(garden.ground(x, z)) + 0.045
    heading = shapes.rotation_y(float(np.arctan2(dx, dz)))
    return _placed(heading, np.array([x, y, z]))


def _drone_at(turn: float) -> np.ndarray:
    """Flies an ellipse, rising and falling twice a round, and leans into its turn."""
    offset = np.array([np.cos(-turn), np.sin(2.0 * turn), np.sin(-turn)])
    lean = shapes.rotation_about(np.array([0.0, 0.0, 1.0]), 0.22)
    return _placed(
        shapes.rotation_y(turn) @ lean, _DRONE_CENTRE + _DRONE_RADII * offset
    )


def _wheel_at(turn: float) -> np.ndarray:
    axis = np.array([0.0, 0.0, 1.0])
    hub = np.array(garden.WIND_WHEEL) + np.array([0.0, 0.0, 0.12])
    return _placed(shapes.rotation_about(axis, -turn), hub)


def _car() -> list[Part]:
    """A toy racer, half a metre long, nose along +z."""
    s = np.linspace(0.0, 1.0, 15)[:, None]
    t = np.linspace(0.0, 2.0 * np.pi, 21)[None, :]
    half = 0.13 * np.sin(np.pi * (0.06 + 0.9 * s)) ** 0.4
    tall = 0.075 * np.sin(np.pi * (0.05 + 0.9 * s)) ** 0.5 * (1.15 - 0.45 * s)
    grid = np.stack(
        [half * np.cos(t), 0.12 + tall * np.sin(t), (s - 0.5) * 0.56 + 0 * t], -1
    )
    body = shapes.outward(shapes.sheet(grid, closed=True))
    wheels, hubs = [], []
    for x in (-0.15, 0.15):
        for z in (-0.17, 0.18):
            wheels.append(line((x - 0.035, 0.06, z), (x + 0.035, 0.06, z), 0.075, 18))
            hubs.append(line((x - 0.038, 0.06, z), (x + 0.038, 0.06, z), 0.035, 12))
    seat = shapes.lathe(
        [(0.0, 0.0), (0.055, 0.01), (0.06, 0.05), (0.035, 0.09), (0.0, 0.1)]
    )
    wing = [
        box((-0.16, 0.24, -0.29), (0.16, 0.25, -0.22)),
        box((-0.01, 0.12, -0.27), (0.01, 0.24, -0.24)),
    ]
    aerial = line((0.08, 0.15, -0.18), (0.08, 0.52, -0.24), 0.003)
    stripe = box((-0.03, 0.185, -0.2), (0.03, 0.197, -0.05))
    return [
        Part("car body", merge([body, *wing]), "red", "toy car"),
        Part("car wheels", merge(wheels), "rubber", "toy car"),
        Part(
            "car trim",
            merge([*hubs, stripe, seat.moved((0, 0.16, -0.02))]),
            "gelcoat",
            "toy car",
        ),
        Part("wire car aerial", aerial, "cable", "toy car"),
    ]


def _drone() -> list[Part]:
    body = shapes.lathe(
        [(0.0, -0.05), (0.09, -0.04), (0.12, 0.0), (0.08, 0.05), (0.0, 0.06)], 20
    )
    arms, discs = [], []
    for sx in (-0.26, 0.26):
        for sz in (-0.26, 0.26):
            arms.append(line((0.0, 0.0, 0.0), (sx, 0.03, sz), 0.012))
            arms.append(line((sx, 0.0, sz), (sx, 0.075, sz), 0.018, 8))
            blade = box((-0.15, 0.075, -0.011), (0.15, 0.08, 0.011))
            discs.append(blade.turned(400 * (sx + 2 * sz)).moved((sx, 0.0, sz)))
    for side in (-0.1, 0.1):
        arms.append(line((side, -0.14, -0.1), (side, -0.14, 0.1), 0.006))
        arms.append(line((side, -0.14, 0.0), (side * 0.6, -0.03, 0.0), 0.006))
    return [
        Part("drone body", body, "gelcoat", "drone"),
        Part("drone arms", merge(arms), "frame", "drone"),
        Part("drone blades", merge(discs), "frame", "drone"),
    ]


def _wheel() -> list[Part]:
    """Eight twisted blades about +z, as on a garden wind wheel."""
    blades: list[list[Shape]] = [[], []]
    r = np.linspace(0.16, 1.15, 9)[:, None]
    c = np.linspace(-1.0, 1.0, 5)[None, :]
    half = 0.05 + 0.16 * (r - 0.16)
    pitch = 0.95 - 0.5 * (r - 0.16)
    grid = np.stack(
        [half * c * np.cos(pitch), r + 0 * c, half * c * np.sin(pitch)], axis=-1
    )
    front = shapes.sheet(grid)
    for k in range(8):
        spin = shapes.rotation_about(np.array([0.0, 0.0, 1.0]), k * np.pi / 4.0)
        blades[k % 2].append(
            front._replace(
                position=front.position @ spin.T, normal=front.normal @ spin.T
            )
        )
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    rim = np.stack([0.8 * np.cos(angle), 0.8 * np.sin(angle), 0 * angle], axis=-1)
    hub = line((0, 0, -0.06), (0, 0, 0.1), 0.09, 16)
    return [
        Part("wind wheel blades", merge(blades[0]), "wheel yellow", "wind wheel"),
        Part("wind wheel white blades", merge(blades[1]), "wheel white", "wind wheel"),
        Part("wire wind wheel rim", shapes.tube(rim, 0.008, 5), "steel", "wind wheel"),
        Part("wind wheel hub", hub, "red", "wind wheel"),
    ]
