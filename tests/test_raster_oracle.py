"""Raster and raytrace stages against the brute-force oracle."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import effects, embree, raster
from tests import furnished
from tests.oracles import raster as oracle


@functools.cache
def both(build):
    shot = build()
    config = raster.Config(size=shot.size, shading=effects.required(shot.scene))
    found = raster.raster(
        shot.scene,
        shot.inputs,
        raster.default_params(shot.mip_bias),
        tracer=embree.build(shot.scene),
        config=config,
    )
    found = jax.tree.map(np.asarray, found)
    return found, oracle.draw(shot.scene, shot.inputs, shot.size, shot.mip_bias)
