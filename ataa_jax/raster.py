"""Raster stage: one jittered sample a pixel, colour and G-buffer (paper, Figure 2).

Visibility comes from Embree, a ray through each pixel's jittered sample in place of a
rasterizer; everything else is as a rasterizer leaves it, mip levels included. The
colour comes from `transport.trace`, the code that the tracer runs too.

Symbols: a *sample position* is the pixel's centre plus the jitter; a motion vector is
previous − current position of the sampled point in px, so the jitter cancels.
"""

from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import camera as cameras
from ataa_jax import compact, embree, exported, transport, vector
from ataa_jax.shading import Config as ShadingConfig
from ataa_jax.shading import clear_of
from ataa_jax.surface import Surface, interpolate, previous_position
from ataa_jax.types import Camera, FrameInputs, GBuffer, Hits, Rays, Scene
from ataa_jax.vector import Vec3

# our choice: an image is drawn in bands of rows, so that what the rays met, some 100
# bytes a pixel, stays small whatever the size. What is shaded comes in smaller chunks.
_BAND_PIXELS = 1 << 17


@dataclass(frozen=True)
class Config:
    """Choices that change the program."""

    size: tuple[int, int] = (360, 640)  # rows, columns
    camera_motion: bool = True  # False: the camera stands still; see `effects`
    object_motion: bool = True  # False: no rigid group moves
    mip_maps: bool = True  # False: level 0 everywhere, as the reference and SSAA read
    second_motion: bool = False  # True: of what is seen through layers too
    shading: ShadingConfig = field(default_factory=ShadingConfig)


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
    rays: Rays

    @property
    def shadow_rays(self) -> Int[Array, ""]:
        """Shadow rays to all lights."""
        return jnp.sum(self.rays.shadow, dtype=jnp.int32)


@exported.jit("config")
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
    height, width = config.size
    rows = min(height, max(1, _BAND_PIXELS // width))
    bands = -(-height // rows)
    rows = -(-height // bands)  # as equal as they can be
    if bands > 1:  # of whole blocks of rays
        rows = -(-rows // compact.BLOCK) * compact.BLOCK
        bands = -(-height // rows)

    def band(first_row: Int[Array, ""]) -> tuple[Float[Array, "r w 3"], GBuffer, Rays]:
        return _band(
            scene, inputs, params, first_row, rows, tracer=tracer, config=config
        )

    if bands == 1:
        color, gbuffer, rays = band(jnp.zeros((), jnp.int32))
    else:
        first_rows = jnp.arange(bands, dtype=jnp.int32) * rows
        color, gbuffer, rays = jax.lax.map(band, first_rows)
        color, gbuffer = jax.tree.map(
            lambda x: x.reshape(bands * rows, *x.shape[2:])[:height], (color, gbuffer)
        )
        rays = jax.tree.map(lambda x: jnp.sum(x, axis=0, dtype=jnp.int32), rays)
    return RasterOutput(
        color=color,
        gbuffer=gbuffer,
        primary_rays=jnp.asarray(height * width, jnp.int32),
        rays=rays,
    )


def _band(
    scene: Scene,
    inputs: FrameInputs,
    params: Params,
    first_row: Int[Array, ""],
    rows: int,
    *,
    tracer: embree.Tracer,
    config: Config,
) -> tuple[Float[Array, "r w 3"], GBuffer, Rays]:
    """Draws some rows of the image; those below its last are sky, and cost nothing."""
    size = config.size
    tile = (rows, size[1])
    x_px, y_px = cameras.pixel_centres(tile)
    y_px = y_px + first_row.astype(jnp.float32)
    direction = cameras.directions(
        inputs.camera, size, x_px + inputs.jitter[0], y_px + inputs.jitter[1]
    )
    if size[0] % rows:
        direction = vector.select(y_px < size[0], direction, jnp.nan)
    direction = vector.materialize(direction)
    steps = cameras.direction_steps(inputs.camera, size[0]) if config.mip_maps else None
    traced = transport.trace(
        scene,
        tracer,
        inputs.world_from_group,
        cameras.position(inputs.camera),
        direction,
        steps,
        params.mip_bias,
        config=config.shading,
        tile=tile,
        second=config.second_motion,
    )
    hits, surface = traced.shown, traced.surface
    if clear_of(tracer, config.shading) is not None:
        surface = interpolate(
            scene.geometry, inputs.world_from_group, hits, direction, None
        )

    def motion_of(
        hits: Hits, surface: Surface
    ) -> tuple[Float[Array, "n 2"], Bool[Array, " n"]]:
        if not (config.camera_motion or config.object_motion):
            still = jnp.zeros((*x_px.shape, 2), jnp.float32)
            return still, jnp.ones(x_px.shape, jnp.bool_)
        x, y, valid = _motion(
            scene, inputs, direction, (x_px, y_px), hits, surface, size
        )
        return jnp.stack([x, y], axis=-1), valid

    motion, motion_valid = motion_of(hits, surface)
    second_motion = second_share = None
    if traced.second is not None:
        beside = traced.second.hits
        surface_beside = interpolate(
            scene.geometry, inputs.world_from_group, beside, direction, None
        )
        second_motion = motion_of(beside, surface_beside)[0].reshape(*tile, 2)
        second_share = traced.second.share.reshape(tile)
    elif config.second_motion:  # without layers nothing is seen beside
        second_motion = jnp.zeros((*tile, 2), jnp.float32)
        second_share = jnp.zeros(tile, jnp.float32)
    normal = vector.stack(vector.select(surface.hit, surface.normal, 0.0))
    depth = jnp.where(surface.hit, hits.distance, jnp.inf)
    gbuffer = GBuffer(
        depth=depth.reshape(tile),
        motion=motion.reshape(*tile, 2),
        motion_valid=motion_valid.reshape(tile),
        normal=normal.reshape(*tile, 3),
        object=jnp.where(surface.hit, surface.object, -1).reshape(tile),
        material=jnp.where(surface.hit, surface.material, -1).reshape(tile),
        second_motion=second_motion,
        second_share=second_share,
    )
    return vector.stack(traced.color).reshape(*tile, 3), gbuffer, traced.rays


def _motion(
    scene: Scene,
    inputs: FrameInputs,
    direction: Vec3,
    centre_px: tuple[Float[Array, " n"], Float[Array, " n"]],
    hits: Hits,
    surface: Surface,
    size: tuple[int, int],
) -> tuple[Float[Array, " n"], Float[Array, " n"], Bool[Array, " n"]]:
    """Returns motion vectors and whether the point was in front of and inside the view.

    Sky lies at infinity: its direction, not a point, is projected.
    """
    previous = previous_position(
        scene.geometry, inputs.previous_world_from_group, hits, surface
    )

    def offset(position: Vec3, camera: Camera) -> Vec3:
        return vector.select(
            surface.hit, position - cameras.position(camera), direction
        )

    now_x, now_y, _ = cameras.project(
        inputs.camera, size, offset(surface.position, inputs.camera)
    )
    then_x, then_y, in_front = cameras.project(
        inputs.previous_camera, size, offset(previous, inputs.previous_camera)
    )
    # Exactly zero where nothing moved: rounding must not make the history's filter
    # blur a still image, and the disocclusion test must not see a ghost of motion.
    moved = _moved(scene, inputs, surface) & in_front
    # Far outside, the vector's length says nothing more; bounded, it stays finite.
    bound = 4.0 * max(size)
    x = jnp.where(moved, jnp.clip(then_x - now_x, -bound, bound), 0.0)
    y = jnp.where(moved, jnp.clip(then_y - now_y, -bound, bound), 0.0)
    target_x, target_y = centre_px[0] + x, centre_px[1] + y
    inside = (target_x >= 0.0) & (target_x <= size[1])
    inside = inside & (target_y >= 0.0) & (target_y <= size[0])
    return x, y, in_front & inside


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


def _equal(a: Camera, b: Camera) -> Bool[Array, ""]:
    return jnp.all(a.world_from_view == b.world_from_view) & (
        a.tan_half_fov_y == b.tan_half_fov_y
    )
