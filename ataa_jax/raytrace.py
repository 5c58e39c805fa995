"""Sparse ray tracing of the pixels that the mask asks for (paper, section 3).

At each of them 2, 4 or 8 rays in the Direct3D n-rooks pattern, shaded by the same code
as the raster stage. The paper's rays read textures at mip level 0 and are not jittered;
here a ray reads half of its share of the pixel, and both are choices.

The number of traced pixels changes every frame. Pixels are taken in chunks of a fixed
capacity inside a `while_loop`: the program is compiled once, and a frame costs as many
chunks as it has pixels.
"""

from dataclasses import dataclass, field
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import camera as cameras
from ataa_jax import color as colors
from ataa_jax import compact, embree, exported, sampling, shading, transport, vector
from ataa_jax.shading import Config as ShadingConfig
from ataa_jax.types import FrameInputs, Lights, Rays, Scene

# What of a texture a ray reads. level0: mip level 0 (paper, section 3). pixel: what a
# rasterizer reads, by the whole pixel's derivatives on the hit triangle's plane
# (Igehy 1999) without a mip bias. sample: the ray's share of the pixel, derivatives
# over √samples times `Config.footprint_scale`.
Footprint = Literal["level0", "pixel", "sample"]


@dataclass(frozen=True)
class Config:
    """Choices that change the program."""

    samples: int = 8  # rays a traced pixel: 2, 4 or 8 (paper, section 3)
    # Traced pixels at a time, at most; see `_chunk`. our choice: as many rays as the
    # raster stage's bands have pixels.
    chunk: int = 1 << 14
    average: colors.Average = "tonemap"
    # our choice: nearer to the reference than mip level 0 in all of twelve settings
    # (experiments/grey_halo.py).
    footprint: Footprint = "sample"
    # our choice: a trilinear lookup weighs two texels of its level each way, twice the
    # width that the level stands for; half of the share makes it as wide as the share.
    # Of 1/8, 1/4, 1/2 and 1 the best on four scenes of six, and above mip level 0 on
    # four (experiments/ray_footprint.py).
    footprint_scale: float = 0.5
    # True: the pattern moves with the frame's jitter, so that frames differ in their
    # samples; round the pixel's edges, so that it still covers this pixel evenly.
    jitter: bool = False
    shading: ShadingConfig = field(default_factory=ShadingConfig)


class RaytraceOutput(eqx.Module):
    """Traced colours, and the rays they took."""

    color: Float[Array, "h w 3"]  # linear radiance; 0 where not traced
    primary_rays: Int[Array, ""]
    rays: Rays

    @property
    def shadow_rays(self) -> Int[Array, ""]:
        """Shadow rays to all lights."""
        return jnp.sum(self.rays.shadow, dtype=jnp.int32)


def nothing(size: tuple[int, int], lights: Lights | None) -> RaytraceOutput:
    """Returns what the stage gives where no pixel is traced; None: no lights."""
    return RaytraceOutput(
        color=jnp.zeros((*size, 3), jnp.float32),
        primary_rays=jnp.zeros((), jnp.int32),
        rays=shading.no_rays(lights),
    )


@exported.jit("config")
def raytrace(
    scene: Scene,
    inputs: FrameInputs,
    traced: Bool[Array, "h w"],
    *,
    tracer: embree.Tracer,
    config: Config,
) -> RaytraceOutput:
    """Traces the pixels where `traced` is True.

    Args:
        scene: what to draw.
        inputs: camera and transforms of this frame; the jitter is used where the
            configuration asks for it.
        traced: the pixels that get rays.
        tracer: primary and shadow rays.
        config: rays a pixel, capacity of a chunk, effects.

    Returns:
        The pixels' colour, averaged over their rays in the averaging space.
    """
    size = (traced.shape[0], traced.shape[1])
    pixels = size[0] * size[1]
    offsets = jnp.asarray(sampling.pattern(config.samples))
    if config.jitter:
        moved = offsets + inputs.jitter[None, :] + 0.5
        offsets = moved - jnp.floor(moved) - 0.5
    steps = _steps(inputs, size[0], config)

    def work(
        index: Int[Array, " n"], used: Bool[Array, " n"], carry: tuple[Array, Rays]
    ) -> tuple[Array, Rays]:
        image, rays = carry
        color, cast = _trace_chunk(
            scene, inputs, index, used, offsets, steps, size,
            tracer=tracer, config=config,
        )  # fmt: skip
        image = image.at[index].set(color, mode="drop")
        return image, jax.tree.map(jnp.add, rays, cast)

    start = jnp.zeros((pixels, 3), jnp.float32), shading.no_rays(scene.lights)
    chunk = _chunk(pixels, config)
    image, rays = compact.for_each_chunk(traced, chunk, work, start)
    return RaytraceOutput(
        color=image.reshape(*size, 3),
        primary_rays=jnp.sum(traced, dtype=jnp.int32) * config.samples,
        rays=rays,
    )


def _chunk(pixels: int, config: Config) -> int:
    """Returns how many traced pixels make a chunk.

    our choice: a sixteenth of the image, a little more than the paper's 6 %, in equal
    parts where that is too many. What a chunk has to spare costs little where only hits
    are shaded, but not in small images: at 160×90 the stage took twice as long with
    chunks of 2^14; at 640×360, 3 to 5 % longer.
    """
    share = -(-pixels // 16)
    parts = -(-share // config.chunk)
    return -(-share // parts)


def _steps(
    inputs: FrameInputs, height: int, config: Config
) -> tuple[vector.Vec3, vector.Vec3] | None:
    """Returns the change of a ray's direction over its footprint; None: level 0."""
    if config.footprint == "level0":
        return None
    right, down = cameras.direction_steps(inputs.camera, height)
    if config.footprint == "pixel":
        return right, down
    share = config.samples**-0.5 * config.footprint_scale
    return right * share, down * share


def _trace_chunk(
    scene: Scene,
    inputs: FrameInputs,
    index: Int[Array, " n"],
    used: Bool[Array, " n"],
    offsets: Float[Array, "s 2"],
    steps: tuple[vector.Vec3, vector.Vec3] | None,
    size: tuple[int, int],
    *,
    tracer: embree.Tracer,
    config: Config,
) -> tuple[Float[Array, "n 3"], Rays]:
    """Traces all samples of one chunk of pixels, a pixel's rays side by side."""
    width = size[1]
    row = (index // width).astype(jnp.float32)
    column = (index % width).astype(jnp.float32)
    x_px = (column[:, None] + 0.5 + offsets[None, :, 0]).reshape(-1)
    y_px = (row[:, None] + 0.5 + offsets[None, :, 1]).reshape(-1)
    direction = cameras.directions(inputs.camera, size, x_px, y_px)
    # A direction of NaN hits nothing and costs nothing: the chunk's unused tail.
    active = jnp.repeat(used, config.samples)
    direction = vector.materialize(vector.select(active, direction, jnp.nan))
    seen = transport.trace(
        scene,
        tracer,
        inputs.world_from_group,
        cameras.position(inputs.camera),
        direction,
        steps,
        0.0,
        config=config.shading,
    )
    samples = colors.to_average(vector.stack(seen.color), config.average)
    samples = samples.reshape(index.shape[0], config.samples, 3)
    mean = jnp.sum(samples, axis=1) * (1.0 / config.samples)
    return colors.from_average(mean, config.average), seen.rays
