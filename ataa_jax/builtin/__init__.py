"""A scene that needs no file: a house in a garden by the water.

It is generated, always the same, and calls for every failure of temporal antialiasing:
wires and ropes thinner than a pixel, slats, railings, alpha-cut leaves, fine textures,
glossy water, things that move and shadows that move with them.
"""

import numpy as np

from ataa_jax import camera
from ataa_jax.builtin import (
    boat,
    garden,
    house,
    landscape,
    materials,
    moving,
    parts,
    plants,
)
from ataa_jax.scene import CameraSource, LightSource, SceneSource, SkySource
from ataa_jax.types import LIGHT_DIRECTIONAL

# name: eye, target, vertical field of view in degrees
_CAMERAS = {
    "main": ((3.2, 1.7, 11.5), (1.5, 2.15, -2.0), 50.0),
    "boat": ((5.3, 1.6, -2.2), (9.2, 2.6, -9.2), 52.0),
    "fence": ((-2.0, 1.25, 7.9), (-8.2, 1.1, 0.2), 50.0),
    "walk_start": ((2.9, 1.65, 13.5), (0.6, 1.9, 0.0), 50.0),
}


def garden_house() -> SceneSource:
    """Generates the built-in scene."""
    palette = materials.build()
    collected = parts.Parts(palette)
    for module in (landscape, house, garden, boat, plants, moving):
        module.add(collected)
    direction = np.array([0.62, -0.60, -0.50])
    direction = direction / np.linalg.norm(direction)
    sun = LightSource(
        kind=LIGHT_DIRECTIONAL,
        intensity=(4.0, 3.7, 3.2),
        direction=(float(direction[0]), float(direction[1]), float(direction[2])),
        name="sun",
    )
    cameras = [
        CameraSource(
            name,
            camera.look_at(np.array(eye), np.array(target)),
            float(np.radians(fov)),
        )
        for name, (eye, target, fov) in _CAMERAS.items()
    ]
    return SceneSource(
        name="garden house",
        meshes=collected.meshes(),
        materials=palette.materials,
        textures=palette.textures,
        lights=[sun],
        cameras=cameras,
        sky=SkySource(
            zenith=(0.16, 0.27, 0.52),
            horizon=(0.55, 0.63, 0.72),
            ground=(0.12, 0.11, 0.10),
        ),
        group_names=list(parts.GROUPS),
        transforms=moving.transforms,
        duration=moving.DURATION,
    )
