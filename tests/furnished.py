"""Small scenes with everything that the raster stage draws, each with its frame.

Textures are noise, so that a wrong level, texel or derivative shows.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from ataa_jax import scene as scenes
from ataa_jax import types
from tests import frames, tiny


@dataclass
class Shot:
    """A scene, one frame of it, and the image to draw."""

    scene: types.Scene
    inputs: types.FrameInputs
    size: tuple[int, int]
    mip_bias: float


def yard() -> Shot:
    """Everything moves: the camera, a turning crate; fence, ball, all three lights."""
    rng = np.random.default_rng(0)
    textures = [
        scenes.TextureSource(noise(rng, 16, 16), srgb=True),
        scenes.TextureSource(normals(rng, 12, 10), srgb=False),
        scenes.TextureSource(noise(rng, 9, 14), srgb=False),
        scenes.TextureSource(noise(rng, 7, 5, holes=True), srgb=True),
    ]
    materials = [
        scenes.MaterialSource(
            base_color_texture=0, normal_texture=1, metallic=0.0, normal_scale=0.7
        ),
        scenes.MaterialSource(base_color_texture=0, metallic_roughness_texture=2),
        scenes.MaterialSource(
            base_color=(0.9, 0.7, 0.5, 1.0), metallic=0.6, roughness=0.4,
            metallic_roughness_texture=2,
        ),
        scenes.MaterialSource(
            base_color_texture=3, alpha_mode="MASK", metallic=0.0, alpha_cutoff=0.4
        ),
    ]  # fmt: skip
    crate = tiny.cube(1.2, (0.0, 0.6, 0.0))
    fence = tiny.quad(2.0, (-1.4, 0.9, 1.2))
    ball = tiny.sphere(6, 9, 0.7)
    meshes = [
        mesh(tiny.floor(12.0), 0, repeat=6.0),
        mesh(crate, 1, group=1, repeat=1.5),
        mesh(ball, 2, at=(1.5, 0.8, -0.8), smooth=True),
        mesh(fence, 3, repeat=1.4),
    ]
    lights = [
        scenes.LightSource(
            types.LIGHT_DIRECTIONAL, (2.0, 1.9, 1.5), direction=(-0.6, -0.7, -0.4)
        ),
        scenes.LightSource(
            types.LIGHT_POINT, (3.0, 6.0, 4.0), position=(-0.5, 2.5, 2.0), range=7.0
        ),
        scenes.LightSource(
            types.LIGHT_SPOT, (30.0, 12.0, 9.0), position=(2.5, 3.5, 2.5),
            direction=(-0.5, -0.8, -0.6), inner_cone_angle=0.3, outer_cone_angle=0.7,
        ),
    ]  # fmt: skip
    now = [tiny.still()[0], tiny.moved((0.3, 0.0, 0.2), turn=0.5)]
    then = [tiny.still()[0], tiny.moved((0.1, 0.05, 0.3), turn=0.35)]
    inputs = frames.inputs(
        (0.6, 1.9, 4.4), (0.1, 0.9, 0.0),
        previous_eye=(0.4, 2.0, 4.6), previous_target=(0.3, 0.85, 0.0),
        groups=np.stack(now), previous_groups=np.stack(then), jitter=(0.3125, -0.4375),
    )  # fmt: skip
    return Shot(
        packed(meshes, materials, textures, lights, 0.8), inputs, (16, 24), -0.5
    )


def workshop() -> Shot:
    """The camera rests; a mirrored and stretched sign and ball swing past a lamp."""
    rng = np.random.default_rng(1)
    mirror = {"wrap_u": types.WRAP_MIRROR, "wrap_v": types.WRAP_CLAMP}
    textures = [
        scenes.TextureSource(noise(rng, 11, 8, holes=True), srgb=True, **mirror),
        scenes.TextureSource(normals(rng, 6, 6), srgb=False, **mirror),
        scenes.TextureSource(noise(rng, 8, 32), srgb=True),
    ]
    materials = [
        scenes.MaterialSource(base_color=(0.6, 0.5, 0.4, 1.0), roughness=0.5),
        scenes.MaterialSource(
            base_color=(1.0, 0.9, 0.8, 0.9), base_color_texture=0, normal_texture=1,
            alpha_mode="MASK", alpha_cutoff=0.3, metallic=0.2, roughness=0.6,
        ),
        scenes.MaterialSource(
            emissive=(0.5, 0.8, 0.2), emissive_texture=2, metallic=0.0,
        ),
    ]  # fmt: skip
    meshes = [
        mesh(tiny.floor(8.0, -0.5), 0),
        mesh(tiny.quad(1.6), 1, group=1, repeat=2.3),
        mesh(tiny.cube(0.8), 2, group=2),
        mesh(tiny.sphere(5, 8, 0.5), 0, group=1, at=(0.9, 0.1, -0.4), smooth=True),
    ]
    lights = [
        scenes.LightSource(
            types.LIGHT_SPOT, (25.0, 25.0, 20.0), position=(0.4, 2.6, 2.2),
            direction=(-0.1, -0.8, -0.6), inner_cone_angle=0.2, outer_cone_angle=0.8,
        )
    ]  # fmt: skip
    lamp = tiny.moved((-0.9, -0.1, -0.6), 0.3, 1.1)
    now = [tiny.still()[0], tiny.moved((0.4, 0.3, 0.2), 0.6, (-1.0, 0.7, 1.3)), lamp]
    then = [tiny.still()[0], tiny.moved((0.3, 0.35, 0.2), 0.8, (-1.0, 0.7, 1.3)), lamp]
    inputs = frames.inputs(
        (-0.4, 1.1, 2.9), (0.0, 0.1, 0.0), jitter=(-0.25, 0.375), fov_y=0.8,
        groups=np.stack(now), previous_groups=np.stack(then),
    )  # fmt: skip
    return Shot(packed(meshes, materials, textures, lights, 0.5), inputs, (13, 19), 0.0)


def corridor() -> Shot:
    """One rigid group; the camera turned and stepped back, so much has no past."""
    rng = np.random.default_rng(2)
    clamp = {"wrap_u": types.WRAP_CLAMP, "wrap_v": types.WRAP_CLAMP}
    textures = [
        scenes.TextureSource(noise(rng, 24, 24), srgb=True, **clamp),
        scenes.TextureSource(normals(rng, 8, 4), srgb=False),
    ]
    materials = [
        scenes.MaterialSource(base_color_texture=0, metallic=0.0, roughness=0.7),
        scenes.MaterialSource(normal_texture=1, metallic=0.5, roughness=0.55),
    ]
    wall = tiny.quad(6.0)
    left = replace(wall, position=wall.position[..., [2, 1, 0]] - (1.5, 0.0, 0.0))
    meshes = [
        mesh(tiny.floor(6.0, -1.0), 1, repeat=3.0),
        mesh(left, 0, repeat=1.25),
        mesh(tiny.cube(0.7, (0.8, -0.6, -1.0)), 1),
    ]
    lights = [
        scenes.LightSource(
            types.LIGHT_POINT, (4.0, 4.0, 5.0), position=(1.4, 1.2, 0.7)
        ),
        scenes.LightSource(types.LIGHT_DIRECTIONAL, direction=(-0.3, -0.8, 0.1),
                           intensity=(1.0, 0.8, 0.6)),
    ]  # fmt: skip
    inputs = frames.inputs(
        (0.5, 0.2, 2.8), (-0.3, -0.3, -1.0), jitter=(0.125, 0.25), fov_y=1.3,
        previous_eye=(0.3, 0.1, 0.4), previous_target=(0.9, -0.2, -1.0),
    )  # fmt: skip
    return Shot(packed(meshes, materials, textures, lights, 1.0), inputs, (13, 9), 0.5)


SHOTS = (yard, workshop, corridor)


def mesh(
    part: tiny.Part,
    material: int,
    *,
    group: int = 0,
    repeat: float = 1.0,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    smooth: bool = False,
) -> scenes.MeshSource:
    """Makes a mesh of a part; smooth: normals point away from the part's origin."""
    corners = part.position.reshape(-1, 3).astype(np.float32)
    # Shifted, so that seams of the texture lie inside triangles too.
    uv = None if part.uv is None else part.uv.reshape(-1, 2) * repeat - 0.3
    length = np.linalg.norm(corners, axis=1, keepdims=True)
    return scenes.MeshSource(
        name="",
        position=(corners + at).astype(np.float32),
        triangles=np.arange(len(corners)).reshape(-1, 3).astype(np.int32),
        material=material,
        normal=corners / length if smooth else None,
        uv=None if uv is None else uv.astype(np.float32),
        group=group,
    )


def packed(
    meshes: list[scenes.MeshSource],
    materials: list[scenes.MaterialSource],
    textures: list[scenes.TextureSource],
    lights: list[scenes.LightSource],
    visibility: float,
) -> types.Scene:
    groups = max(m.group for m in meshes) + 1
    sky = scenes.SkySource((0.2, 0.3, 0.7), (0.7, 0.6, 0.5), (0.15, 0.1, 0.05))
    scene, _ = scenes.pack(
        scenes.SceneSource(
            "", meshes, materials, textures, lights, sky=sky,
            group_names=["static", "moving", "resting"][:groups],
        )
    )  # fmt: skip
    packed_sky = scenes.pack_sky(sky, visibility)
    bounce = jnp.asarray(np.array([0.06, 0.05, 0.04]) * (1 - visibility), jnp.float32)
    return replace(scene, sky=replace(packed_sky, bounce=bounce))


def noise(
    rng: np.random.Generator, height: int, width: int, *, holes: bool = False
) -> np.ndarray:
    """Random colours; with holes, random alpha too."""
    image = rng.integers(0, 256, (height, width, 4), np.uint8)
    if not holes:
        image[..., 3] = 255
    return image


def normals(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Random tangent-space normals within about 45° of the surface's own."""
    image = rng.integers(64, 192, (height, width, 4), np.uint8)
    image[..., 2:] = 255
    return image
