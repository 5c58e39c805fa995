"""Buffers to start a stage from, and everything after raster as one program."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import fxaa, pipeline, raster, raytrace, shading, types
from tests import frames

SIZE = (8, 10)
STILL = jnp.zeros(2, jnp.float32)


def gbuffer(size=SIZE, *, motion=0.0, valid=True, depth=1.0) -> types.GBuffer:
    """A G-buffer of one object; every field may be an array or one value."""
    return types.GBuffer(
        depth=_full(depth, size),
        motion=_full(motion, (*size, 2)),
        motion_valid=jnp.asarray(np.broadcast_to(valid, size)),
        normal=jnp.zeros((*size, 3), jnp.float32),
        object=jnp.zeros(size, jnp.int32),
        material=jnp.zeros(size, jnp.int32),
    )


def history(color, *, count=1.0, depth=1.0, motion=0.0, valid=True) -> types.History:
    """A history of a colour image."""
    size = np.shape(color)[:2]
    return types.History(
        color=jnp.asarray(color, jnp.float32),
        depth=_full(depth, size),
        motion=_full(motion, (*size, 2)),
        count=_full(count, size),
        valid=jnp.asarray(valid),
    )


def state(past: types.History) -> types.State:
    """A state whose last mask was all TAA."""
    mask = jnp.full(past.depth.shape, types.METHOD_TAA, jnp.uint32)
    return types.State(history=past, classification=types.Classification(mask=mask))


def noise(count, size=SIZE, *, low=0.2, high=0.9, seed=0):
    """Images of uniform noise, (count, h, w, 3)."""
    rng = np.random.default_rng(seed)
    return jnp.asarray(rng.uniform(low, high, (count, *size, 3)), jnp.float32)


def preset(name="tuned", size=SIZE, **options):
    """Returns a preset's configuration and parameters, without a ray budget."""
    config, params = pipeline.preset(name, None, size, budget=np.inf, **options)
    # The fewest steps: it compiles soonest.
    return replace(config, fxaa=fxaa.Config(preset=12)), params


@partial(jax.jit, static_argnames="config")
def after_raster(current, color, buffers, traced, params, *, config):
    """One frame from its colour and G-buffer on; `traced` stands in for the rays."""
    rays = shading.no_rays(None)
    none = jnp.zeros((), jnp.int32)
    drawn = raster.RasterOutput(
        color=color, gbuffer=buffers, primary_rays=none, rays=rays
    )

    def trace(wanted):
        return raytrace.RaytraceOutput(
            color=jnp.where(wanted[..., None], traced, 0.0),
            primary_rays=none,
            rays=rays,
        )

    return pipeline.antialias(
        current, drawn, frames.inputs(), params, config=config, trace=trace
    )


def with_leaf(tree, where, value):
    """Returns a pytree with one leaf replaced."""
    return eqx.tree_at(where, tree, value)


def _full(value, shape):
    return jnp.asarray(np.broadcast_to(value, shape), jnp.float32)
