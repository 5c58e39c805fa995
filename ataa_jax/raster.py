"""Raster stage: one jittered sample a pixel, colour and G-buffer (paper, Figure 2).

Visibility comes from Embree, a ray through each pixel's jittered sample in place of a
rasterizer; everything else is as a rasterizer leaves it, mip levels included. The
colour comes from `shading.radiance`, the code that ray hits run too.

Symbols: a *sample position* is the pixel's centre plus the jitter; a motion vector is
previous − current position of the sampled point in px, so the jitter cancels.
"""

from dataclasses import dataclass, field
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import camera as cameras
from ataa_jax import embree, shading
from ataa_jax.surface import Surface, previous_position
from ataa_jax.types import FrameInputs, GBuffer, Hits, Scene


@dataclass(frozen=True)
class Config:
    """Choices that change the program."""

    size: tuple[int, int] = (360, 640)  # rows, columns
    mip_maps: bool = True  # False: level 0 everywhere, as the reference and SSAA read
    shading: shading.Config = field(default_factory=shading.Config)


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    mip_bias: Float[Array, ""]


def default_params(mip_bias: float = 0.0) -> Params:
    """Returns the parameters with the hardware's own level of detail (bias 0)."""
    return Params(mip_bias=jnp.asarray(mip_bias, jnp.float32))


class RasterOutput(eqx.Module):
    """The raster stage's buffers and its rays."""

    color: Float[Array, "h w 3"]  # linear radiance
    gbuffer: GBuffer
    primary_rays: Int[Array, ""]
    shadow_rays: Int[Array, ""]


@partial(jax.jit, static_argnames=("tracer", "config"))
def raster(
    scene: Scene,
    inputs: FrameInputs,
    params: Params,
    *,
    tracer: embree.Tracer,
    config: Config,
) -> RasterOutput:
    """Draws one frame at one sample a pixel.

    Args:
        scene: what to draw.
        inputs: cameras, rigid groups' transforms and the jitter, for this frame and
            the previous one.
        params: the mip bias.
        tracer: visibility and shadow rays.
        config: size and effects.

    Returns:
        Colour and G-buffer of the frame.
    """
    size = config.size
    centre_px = cameras.pixel_centres(size)
    direction = cameras.directions(
        inputs.camera, size, centre_px + inputs.jitter[None, :]
    )
    eye = cameras.position(inputs.camera)
    hits = embree.intersect(
        tracer,
        inputs.world_from_group,
        jnp.broadcast_to(eye[None, :], direction.shape),
        direction,
        tile=size,
    )
    steps = cameras.direction_steps(inputs.camera, size[0]) if config.mip_maps else None
    shaded = shading.radiance(
        scene,
        tracer,
        inputs.world_from_group,
        direction,
        hits,
        steps,
        params.mip_bias,
        config=config.shading,
    )
    motion, motion_valid = _motion(scene, inputs, direction, centre_px, hits, shaded, size)
    surface = shaded.surface
    depth = jnp.where(surface.hit, hits.distance, jnp.inf)
    gbuffer = GBuffer(
        depth=depth.reshape(size),
        motion=motion.reshape(*size, 2),
        motion_valid=motion_valid.reshape(size),
        normal=jnp.where(surface.hit, surface.normal, 0.0).T.reshape(*size, 3),
        object=jnp.where(surface.hit, surface.object, -1).reshape(size),
        material=jnp.where(surface.hit, surface.material, -1).reshape(size),
    )
    return RasterOutput(
        color=shaded.color.reshape(*size, 3),
        gbuffer=gbuffer,
        primary_rays=jnp.asarray(size[0] * size[1], jnp.int32),
        shadow_rays=shaded.shadow_rays,
    )


def _motion(
    scene: Scene,
    inputs: FrameInputs,
    direction: Float[Array, "n 3"],
    centre_px: Float[Array, "n 2"],
    hits: Hits,
    shaded: shading.Shaded,
    size: tuple[int, int],
) -> tuple[Float[Array, "n 2"], Bool[Array, " n"]]:
    """Returns motion vectors and whether the point was in front of and inside the view.

    Sky lies at infinity: its direction, not a point, is projected.
    """
    surface = shaded.surface
    previous = previous_position(
        scene.geometry, inputs.previous_world_from_group, hits, surface
    )
    offset_now = _relative(surface, surface.position, inputs.camera, direction)
    offset_then = _relative(surface, previous, inputs.previous_camera, direction)
    now_px, _ = cameras.project(inputs.camera, size, offset_now)
    then_px, in_front = cameras.project(inputs.previous_camera, size, offset_then)
    moved = _moved(scene, inputs, surface)
    # Exactly zero where nothing moved: rounding must not make the history's filter
    # blur a still image, and the disocclusion test must not see a ghost of motion.
    motion = jnp.where((moved & in_front)[:, None], then_px - now_px, 0.0)
    # Far outside, the vector's length says nothing more; bounded, it stays finite.
    bound = 4.0 * max(size)
    motion = jnp.clip(motion, -bound, bound)
    target = centre_px + motion
    extent = jnp.array([size[1], size[0]], jnp.float32)
    inside = jnp.all((target >= 0.0) & (target <= extent[None, :]), axis=-1)
    return motion, in_front & inside


def _relative(
    surface: Surface,
    position: Float[Array, "3 n"],
    camera: cameras.Camera,
    direction: Float[Array, "n 3"],
) -> Float[Array, "n 3"]:
    eye = cameras.position(camera)
    return jnp.where(surface.hit, position - eye[:, None], direction.T).T


def _moved(scene: Scene, inputs: FrameInputs, surface: Surface) -> Bool[Array, " n"]:
    """Returns where the camera or the point's own rigid group moved."""
    camera_moved = ~_equal(inputs.camera, inputs.previous_camera)
    groups = jnp.any(
        inputs.world_from_group != inputs.previous_world_from_group, axis=(1, 2)
    )
    if groups.shape[0] == 1:
        return jnp.broadcast_to(camera_moved | groups[0], surface.hit.shape)
    own = groups[scene.geometry.group[surface.triangle]] & surface.hit
    return camera_moved | own


def _equal(a: cameras.Camera, b: cameras.Camera) -> Bool[Array, ""]:
    return jnp.all(a.world_from_view == b.world_from_view) & (
        a.tan_half_fov_y == b.tan_half_fov_y
    )
