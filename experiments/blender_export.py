"""Writes a scene of the package for `blender_capture.py`: geometry, light, camera path.

    python experiments/blender_export.py builtin walk scene.npz --frames 6 --size 160x90

Run it in the package's environment; the file holds arrays alone, so that Blender's own
Python can read it. Lights and sky come multiplied by the world's exposure.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from ataa_jax import scene, world

# Blender's world has z up: (x, y, z) becomes (x, −z, y).
BLENDER_FROM_WORLD = np.array(
    [[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]]
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene")
    parser.add_argument("path")
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--size", default="160x90")
    parser.add_argument("--motion", default="typical")
    given = parser.parse_args()
    width, height = (int(part) for part in given.size.split("x"))
    source = world.read(given.scene)  # a prepared world keeps no textures of its own
    loaded = world.prepare(source)
    shot = world.shot(loaded, given.path, (height, width), motion=given.motion)
    arrays: dict[str, Any] = {
        **_meshes(loaded),
        **_materials(source, loaded.exposure),
        **_light(loaded),
        **_motion(shot, given.frames),
    }
    np.savez_compressed(given.out, **arrays)


def _meshes(loaded: world.World) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    for k, mesh in enumerate(loaded.source.meshes):
        arrays[f"mesh{k}_position"] = mesh.position
        arrays[f"mesh{k}_triangles"] = mesh.triangles
        arrays[f"mesh{k}_head"] = np.array([mesh.material, mesh.group])
        if mesh.normal is not None:
            arrays[f"mesh{k}_normal"] = mesh.normal
        if mesh.uv is not None:
            arrays[f"mesh{k}_uv"] = mesh.uv
    return arrays


def _materials(source: scene.SceneSource, exposure: float) -> dict[str, np.ndarray]:
    rows = [
        [
            *m.base_color[:3],
            m.metallic,
            m.roughness,
            *(exposure * e for e in m.emissive),
            m.alpha_cutoff if m.alpha_mode != "OPAQUE" else -1.0,
            m.base_color_texture,
            m.normal_texture,
            m.normal_scale,
        ]
        for m in source.materials
    ]
    arrays = {"materials": np.array(rows, np.float64)}
    for k, texture in enumerate(source.textures):
        arrays[f"texture{k}"] = texture.texels
        arrays[f"texture{k}_srgb"] = np.array(texture.srgb)
    return arrays


def _light(loaded: world.World) -> dict[str, np.ndarray]:
    lights = [
        [*light.direction, *(loaded.exposure * i for i in light.intensity)]
        for light in loaded.lights
        if light.kind == 0
    ]
    sky = loaded.scene.sky
    rows = [sky.zenith, sky.horizon, sky.ground, sky.bounce]
    return {
        "suns": np.array(lights, np.float64).reshape(-1, 6),
        "sky": np.array(rows, np.float64),
        "sky_visibility": np.array(float(sky.visibility)),
    }


def _motion(shot: world.Sequence, frames: int) -> dict[str, np.ndarray]:
    """Returns camera and groups of frames −1 … frames, for Blender's axes."""
    cameras, groups = [], []
    for frame in range(-1, frames + 1):
        pose = shot.pose(frame)
        cameras.append(BLENDER_FROM_WORLD @ pose.world_from_view)
        whole = np.tile(np.eye(4), (len(shot.world.source.group_names), 1, 1))
        whole[:, :3] = shot.world.source.transforms(pose.time)
        groups.append(BLENDER_FROM_WORLD @ whole @ BLENDER_FROM_WORLD.T)
    return {
        "cameras": np.array(cameras),
        "groups": np.array(groups),
        "fov_y": np.array(shot.pose(0).fov_y),
        "size": np.array(shot.size),
        "fps": np.array(shot.path.fps),
    }


if __name__ == "__main__":
    main()
