"""Inputs of frames for tests: a camera, where it was, and the groups' transforms."""

import jax.numpy as jnp
import numpy as np

from ataa_jax import camera, types
from tests import tiny


def inputs(
    eye: tuple[float, float, float] = (0.0, 1.0, 5.0),
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    previous_eye: tuple[float, float, float] | None = None,
    previous_target: tuple[float, float, float] | None = None,
    groups: np.ndarray | None = None,
    previous_groups: np.ndarray | None = None,
    jitter: tuple[float, float] = (0.0, 0.0),
    cut: bool = False,
    fov_y: float = 0.9,
) -> types.FrameInputs:
    now = camera.look_at(np.array(eye), np.array(target))
    then = camera.look_at(
        np.array(previous_eye or eye), np.array(previous_target or target)
    )
    groups = tiny.still() if groups is None else groups
    previous_groups = groups if previous_groups is None else previous_groups
    return types.FrameInputs(
        camera=camera.make(now, fov_y),
        previous_camera=camera.make(then, fov_y),
        world_from_group=jnp.asarray(groups),
        previous_world_from_group=jnp.asarray(previous_groups),
        jitter=jnp.asarray(jitter, jnp.float32),
        cut=jnp.asarray(cut),
    )
