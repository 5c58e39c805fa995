"""Whole frames of any small scene by one compiled program.

Every scene has arrays of the same shapes, so none compiles anew.
"""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np

from ataa_jax import camera as cameras
from ataa_jax import effects, embree, fxaa, pipeline, types
from tests import furnished, tiny

SIZE = (16, 24)
FXAA = fxaa.Config(preset=12)  # the fewest steps: it compiles soonest


@cache
def yard() -> furnished.Shot:
    """The scene whose shapes all others have: 106 triangles, 2 groups, 3 lights."""
    return furnished.yard()


@cache
def _program(full: bool) -> tuple[pipeline.Config, pipeline.Params]:
    """The preset; full: all maps, mirrors and 8 rays too."""
    scene = yard().scene
    shading = replace(
        effects.required(scene),
        emission=True,
        emissive_textures=full,
        reflections=full,
        # Every map is one more trilinear lookup in each of the two copies of shading.
        metallic_roughness_textures=full,
        normal_maps=full,
    )
    config, params = pipeline.preset(
        "tuned", scene, SIZE, samples=8 if full else 2, budget=np.inf,
        selection=effects.Selection(shading),
    )  # fmt: skip
    return replace(config, fxaa=FXAA), params


def params() -> pipeline.Params:
    """The default preset's numbers, without a ray budget."""
    return _program(False)[1]


def frame(
    state: types.State,
    scene: types.Scene,
    inputs: types.FrameInputs,
    *,
    backend: str = "auto",
    full: bool = False,
) -> tuple[pipeline.FrameOutput, types.State]:
    """Renders one frame of a scene that has the yard's shapes."""
    config, numbers = _program(full)
    tracer = embree.build(scene, backend=backend)
    assert tracer.clear is None
    output, after = pipeline.frame(
        state, inputs, numbers, scene=scene, tracer=tracer, config=config
    )
    # The callbacks are done when the result is: only then may the scene go.
    output.image.block_until_ready()
    return output, after


def run(
    scene: types.Scene, inputs: list[types.FrameInputs], **options
) -> list[pipeline.FrameOutput]:
    """Renders frames one after the other, from no history on."""
    state, outputs = pipeline.init(SIZE), []
    for each in inputs:
        output, state = frame(state, scene, each, **options)
        outputs.append(output)
    return outputs


def methods(output: pipeline.FrameOutput) -> np.ndarray:
    """The mask's methods."""
    return np.asarray(output.segmentation.mask) & 0xFFFF


def walk(frames: int = 4, motion: float = 0.06) -> list[types.FrameInputs]:
    """The yard seen on a walk; its crate turns."""
    shots = []
    for index in range(frames):
        poses, groups = [], []
        for k in (index, index - 1):
            eye = np.array([0.6 + motion * k, 1.9, 4.4 - motion * k])
            pose = cameras.look_at(eye, np.array([0.1, 0.9, 0.0]))
            poses.append(cameras.make(pose, 0.9))
            crate = tiny.moved((0.3, 0.0, 0.2 + 0.02 * k), turn=0.5 + 0.05 * k)
            groups.append(jnp.asarray(np.stack([tiny.still()[0], crate])))
        jitter = jnp.asarray([0.25 * (-1) ** index, 0.125 * index - 0.2], jnp.float32)
        shots.append(
            types.FrameInputs(
                camera=poses[0], previous_camera=poses[1],
                world_from_group=groups[0], previous_world_from_group=groups[1],
                jitter=jitter, cut=jnp.asarray(False),
            )
        )  # fmt: skip
    return shots


def apart(a: pipeline.FrameOutput, b: pipeline.FrameOutput) -> np.ndarray:
    """The largest difference shown of any channel."""
    return np.abs(np.asarray(a.image) - np.asarray(b.image)).max(axis=-1)


def scaled(scene: types.Scene, factor: float, shift: np.ndarray) -> types.Scene:
    """The scene `factor` times as large, then moved; lights look the same."""
    geometry, lights = scene.geometry, scene.lights
    size, place = np.float32(factor), np.asarray(shift, np.float32)
    # A moving group's own space is scaled, and its matrix moves it.
    still = np.asarray(geometry.group == 0)[:, None, None]
    position = np.asarray(geometry.position) * size
    intensity = np.asarray(lights.intensity)
    near = np.asarray(lights.kind != types.LIGHT_DIRECTIONAL)[:, None]
    return replace(
        scene,
        geometry=replace(
            geometry, position=jnp.asarray(np.where(still, position + place, position))
        ),
        lights=replace(
            lights,
            position=jnp.asarray(np.asarray(lights.position) * size + place),
            range=lights.range * size,
            intensity=jnp.asarray(np.where(near, intensity * size * size, intensity)),
        ),
    )


def scaled_inputs(
    inputs: types.FrameInputs, factor: float, shift: np.ndarray
) -> types.FrameInputs:
    """The frame's cameras and groups, in the scaled and moved scene."""

    def moved(matrix):
        matrix = np.array(matrix, np.float64)
        matrix[..., :3, 3] = matrix[..., :3, 3] * factor + shift
        return matrix

    def camera(eye):
        return replace(
            eye, world_from_view=jnp.asarray(moved(eye.world_from_view), jnp.float32)
        )

    def groups(matrices):
        placed = moved(matrices)
        placed[0] = np.eye(3, 4)
        return jnp.asarray(placed, jnp.float32)

    return replace(
        inputs,
        camera=camera(inputs.camera),
        previous_camera=camera(inputs.previous_camera),
        world_from_group=groups(inputs.world_from_group),
        previous_world_from_group=groups(inputs.previous_world_from_group),
    )
