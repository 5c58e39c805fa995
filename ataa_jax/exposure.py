"""How bright a scene is: what its surroundings send back, and the exposure it gets.

Both are measured on a small view, which is drawn by the raster stage and remembered in
the cache folder. The stage's program belongs to one image size; so that a command need
not compile a second one, the view is drawn in the program of the size that will be
rendered, tile by tile, with camera and jitter set so that the rays are the view's own.
"""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ataa_jax import (
    cache,
    camera,
    color,
    compact,
    effects,
    embree,
    layers,
    material,
    raster,
    sampling,
    shading,
    surface,
    texture,
    transport,
    types,
    vector,
)

# Height and width of the view.
PREVIEW = (90, 160)

# our choice: surfaces' largest channel, tone-mapped, has the mean 0.3, which sRGB shows
# as 0.58. Unlike a mean of logarithms it is not led astray by black corners.
_KEY = 0.3

# our choice: an image so small that the view takes more tiles draws it in a program of
# its own, which by then costs less than the tiles.
_MAX_TILES = 36


class Brightness(eqx.Module):
    """What a view of a scene measures."""

    bounce: Float[Array, "3"]  # mean radiance that what hides the sky sends
    exposure: Float[Array, ""]  # what everything that emits is multiplied by
    rays: types.Rays  # secondary rays of the view and what was drawn beside it


def measure(
    scene: types.Scene,
    tracer: embree.Tracer,
    world_from_group: np.ndarray,
    eye: types.Camera,
    sky_visibility: float,
    *,
    size: tuple[int, int] | None = None,
    object_motion: bool = True,
) -> Brightness:
    """Measures the surroundings' mean radiance, then the exposure under it.

    Args:
        scene: lit, without bounce.
        tracer: of this scene.
        world_from_group: where the rigid groups stand, float32 (groups, 3, 4).
        eye: the camera of the view.
        sky_visibility: the share of the sky that visible surfaces see; what hides the
            rest is taken to look like what the view shows.
        size: image (height, width) that will be rendered; None: none will be.
        object_motion: as `raster.Config` will have it then.

    Returns:
        From the cache folder, where it is known there.
    """
    if size is None or np.prod(_tiles(size)) > _MAX_TILES:
        size = PREVIEW
    config = raster.Config(
        size=size, object_motion=object_motion, shading=effects.required(scene)
    )
    key = _key(scene, tracer, world_from_group, eye, sky_visibility, config)
    file = cache.folder() / "exposure" / f"{key}.npz"
    none = shading.no_rays(scene.lights)
    like = Brightness(jnp.zeros(3), jnp.zeros(()), none)
    if (found := cache.read(file, like)) is not None:
        return found

    def draw(lit: types.Scene) -> tuple[np.ndarray, bool, types.Rays]:
        return _draw(lit, tracer, world_from_group, eye, config)

    color, surfaces, _ = draw(scene)
    share = 1.0 - sky_visibility if surfaces else 0.0
    bounce = jnp.asarray(share * color.mean(axis=0), jnp.float32)
    color, _, rays = draw(eqx.tree_at(lambda s: s.sky.bounce, scene, bounce))
    exposure = jnp.asarray(automatic(color.max(axis=1)), jnp.float32)
    result = Brightness(bounce, exposure, rays)
    cache.write(file, result)
    return result


def automatic(peak: np.ndarray) -> float:
    """Exposes so that surfaces' tone-mapped brightness has the mean of the key.

    Args:
        peak: largest channel of every surface pixel, linear.
    """
    peak = peak[np.isfinite(peak) & (peak > 0.0)]
    if peak.size == 0:
        return 1.0
    low, high = -60.0, 60.0  # log2 of the exposure; the mean grows with it
    for _ in range(60):
        middle = 0.5 * (low + high)
        exposed = peak * 2.0**middle
        bright = float(np.mean(exposed / (1.0 + exposed))) > _KEY
        low, high = (low, middle) if bright else (middle, high)
    return float(2.0 ** (0.5 * (low + high)))


def code_hash() -> str:
    """Hashes the sources that decide the colour of a ray, and names what runs them."""
    sources = cache.code_hash(
        *(camera, color, compact, embree, layers, material, raster, sampling, shading),
        *(surface, texture, transport, vector),
    )
    return f"{sources} {cache.computer()} "


def _key(
    scene: types.Scene,
    tracer: embree.Tracer,
    world_from_group: np.ndarray,
    eye: types.Camera,
    sky_visibility: float,
    config: raster.Config,
) -> str:
    made_by = code_hash() + cache.code_hash(sys.modules[__name__])
    choices = f"{made_by} {tracer.backend} {config} {sky_visibility}"
    text = np.frombuffer(choices.encode(), np.uint8)
    return cache.content_hash((scene, world_from_group, eye, text))


def _draw(
    scene: types.Scene,
    tracer: embree.Tracer,
    world_from_group: np.ndarray,
    eye: types.Camera,
    config: raster.Config,
) -> tuple[np.ndarray, bool, types.Rays]:
    """Draws the view in tiles of the program's size.

    A tile's field of view is wider by the ratio of heights, which gives its pixels the
    view's size; a jitter of many pixels puts them in their place.

    Returns:
        Linear colours of the pixels that show a surface, or else of all, float64
        (n, 3); whether any does; and the rays.
    """
    height, width = config.size
    rows, columns = _tiles(config.size)
    wider = eye.tan_half_fov_y * (height / PREVIEW[0])
    eye = eqx.tree_at(lambda c: c.tan_half_fov_y, eye, wider)
    groups = jnp.asarray(world_from_group, jnp.float32)
    colors, hits, rays = [], [], shading.no_rays(scene.lights)
    for top in range(0, rows * height, height):
        for left in range(0, columns * width, width):
            middle = left + (width - PREVIEW[1]) / 2, top + (height - PREVIEW[0]) / 2
            inputs = types.FrameInputs(
                camera=eye,
                previous_camera=eye,
                world_from_group=groups,
                previous_world_from_group=groups,
                jitter=jnp.asarray(middle, jnp.float32),
                cut=jnp.asarray(True),
            )
            drawn = raster.raster(
                scene, inputs, raster.default_params(), tracer=tracer, config=config
            )
            part = slice(0, PREVIEW[0] - top), slice(0, PREVIEW[1] - left)
            colors.append(np.asarray(drawn.color, np.float64)[part].reshape(-1, 3))
            hits.append(np.isfinite(np.asarray(drawn.gbuffer.depth)[part]).reshape(-1))
            rays = jax.tree.map(jnp.add, rays, drawn.rays)
    color, hit = np.concatenate(colors), np.concatenate(hits)
    return (color[hit] if hit.any() else color), bool(hit.any()), rays


def _tiles(size: tuple[int, int]) -> tuple[int, int]:
    """Returns how many tiles of this size cover the view, down and across."""
    return -(-PREVIEW[0] // size[0]), -(-PREVIEW[1] // size[1])
