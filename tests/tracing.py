"""What the tests of tracing share: rays, scenes to trace, poses of their groups."""

import numpy as np

from ataa_jax import embree
from tests import tiny

BACKENDS = ("packet", "run")
EPS = np.finfo(np.float32).eps
INF = np.float32(np.inf)
# A packet that lands on an instance carries its ray into the group's space and back
# in float32: a few roundings of coordinates about as large as the distance.
MOVED = 16 * EPS


def rays(count, spread=3.0, seed=0):
    rng = np.random.default_rng(seed)
    origin = rng.normal(size=(count, 3)) * spread
    direction = rng.normal(size=(count, 3)) * rng.uniform(0.1, 10, size=(count, 1))
    return origin.astype(np.float32), direction.astype(np.float32)


def down(x, z, height=1.0):
    """Rays straight down from `height` above the points (x, z)."""
    x, z = (np.asarray(v, np.float32).reshape(-1) for v in (x, z))
    origin = np.stack([x, np.full_like(x, height), z], axis=-1)
    return origin, np.tile(np.float32([0, -1, 0]), (x.size, 1))


def everything(count):
    return np.ones(count, bool)


def soup(count=150, seed=3):
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-3, 3, size=(count, 1, 3))
    position = centre + rng.normal(size=(count, 3, 3))
    return tiny.scene([tiny.Part(position.astype(np.float32))])


def garden(groups=1):
    """Opaque and masked parts; parts 2 and 3 move if there are groups for them."""
    leaf = tiny.quad(3.0, (0.0, 0.0, 1.0))
    leaf.material = 1
    lattice = tiny.quad(2.0, (0.5, 0.2, -1.5))
    lattice.material = 1
    ball = tiny.sphere()
    box = tiny.cube(1.5, (2.0, 0.0, 0.0))
    if groups > 1:
        ball.group, lattice.group = 1, groups - 1
    return tiny.scene(
        [tiny.floor(20, -1.5), box, ball, lattice, leaf],
        [tiny.Material(), tiny.Material(alpha_masked=True, texture=0)],
        [tiny.checker()],
    )


_shared = []


def shared_tracer():
    if not _shared:
        _shared.append(embree.build(garden()))
    return _shared[0]


def pose(seed, groups=3):
    rng = np.random.default_rng(seed)
    matrices = tiny.still(groups)
    for group in range(1, groups):
        matrices[group] = tiny.moved(
            tuple(rng.normal(size=3)), rng.uniform(-3, 3), tuple(rng.uniform(0.5, 2, 3))
        )
    return matrices
