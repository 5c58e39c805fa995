"""Supersampled images: SSAA baselines and the N-sample ground truth, cached on disk.

Every pixel is the box-filtered mean of N samples at mip level 0, averaged in the
averaging space that all methods share. The reference's samples are one fixed
low-discrepancy set (`sampling.reference_pattern`).
"""

import hashlib
import re
import sys
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ataa_jax import cache, embree, exported, exposure, raster, sampling
from ataa_jax import color as colors
from ataa_jax.scene import SceneSource
from ataa_jax.types import FrameInputs, Scene
from ataa_jax.world import Sequence, World

# our choice: about 1,500 reference frames of 640×360; the oldest go first.
CACHE_LIMIT_BYTES = 4 << 30

_THIN = re.compile(
    r"wire|rope|cable|rigging|slat|fence|rail|leaf|leaves|plant|bamboo|blind|orchid"
    r"|ivy|chain|grass|foliage|antenna",
    re.IGNORECASE,
)


class Supersampled(eqx.Module):
    """The mean of a pixel's samples, and the share of them that met thin features."""

    color: Float[Array, "h w 3"]  # linear radiance
    thin: Float[Array, "h w"]  # in [0, 1]


def thin_objects(source: SceneSource) -> np.ndarray:
    """Returns which objects are wires, ropes, slats, rails or leaves, bool (objects,).

    Told from names of meshes and materials, and from alpha masks (leaves, chains).
    """

    def thin(name: str, material: int) -> bool:
        m = source.materials[material]
        return m.alpha_mode == "MASK" or bool(_THIN.search(f"{name} {m.name}"))

    return np.array([thin(mesh.name, mesh.material) for mesh in source.meshes], bool)


def supersample(
    world: World,
    inputs: FrameInputs,
    offsets_px: np.ndarray,
    size: tuple[int, int],
    *,
    average: colors.Average = "tonemap",
    progress: Callable[[], None] = lambda: None,
) -> Supersampled:
    """Renders one frame with several samples a pixel, one full-screen pass each.

    Args:
        world: the scene.
        inputs: camera and transforms; the jitter is not used.
        offsets_px: float32 (samples, 2), px from the pixel centre.
        size: image (height, width).
        average: the space in which samples are averaged.
        progress: called after every pass.

    Returns:
        Colour and thin coverage.
    """
    config = raster.Config(size=size, mip_maps=False, shading=world.shading)
    thin = jnp.asarray(thin_objects(world.source))
    total = jnp.zeros((*size, 3), jnp.float32), jnp.zeros(size, jnp.float32)
    for offset in offsets_px:
        total = _add_sample(
            world.scene,
            eqx.tree_at(lambda i: i.jitter, inputs, jnp.asarray(offset)),
            thin,
            total,
            tracer=world.tracer,
            config=config,
            average=average,
        )
        progress()
    scale = 1.0 / len(offsets_px)
    color = colors.from_average(total[0] * scale, average)
    return Supersampled(color=color, thin=total[1] * scale)


@exported.jit("config", "average", donate=("total",))
def _add_sample(
    scene: Scene,
    inputs: FrameInputs,
    thin: Bool[Array, " objects"],
    total: tuple[Float[Array, "h w 3"], Float[Array, "h w"]],
    *,
    tracer: embree.Tracer,
    config: raster.Config,
    average: colors.Average,
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w"]]:
    drawn = raster.raster(
        scene, inputs, raster.default_params(), tracer=tracer, config=config
    )
    ids = drawn.gbuffer.object
    crossed = (ids >= 0) & thin[jnp.maximum(ids, 0)]
    color = total[0] + colors.to_average(drawn.color, average)
    return color, total[1] + crossed.astype(jnp.float32)


def reference(
    shot: Sequence,
    frame: int,
    samples: int,
    *,
    average: colors.Average = "tonemap",
    progress: Callable[[], None] = lambda: None,
    use_cache: bool = True,
) -> Supersampled:
    """Returns the ground truth of one frame, from the cache where it has it.

    Args:
        shot: the world along a path.
        frame: index of the frame.
        samples: N; 64 for fitting and tests, 256 for published tables.
        average: the space in which samples are averaged.
        progress: called `samples` times.
        use_cache: read and write the cache folder.
    """
    file = cache_file(shot, frame, samples, average)
    if use_cache and (found := cache.read(file, _like(shot.size))) is not None:
        for _ in range(samples):
            progress()
        return jax.tree.map(jnp.asarray, found)
    result = supersample(
        shot.world,
        shot.inputs(frame),
        sampling.reference_pattern(samples),
        shot.size,
        average=average,
        progress=progress,
    )
    if use_cache:
        cache.write(file, result, CACHE_LIMIT_BYTES)
    return result


def cache_file(
    shot: Sequence, frame: int, samples: int, average: colors.Average = "tonemap"
) -> Path:
    """Returns where the cache keeps the `reference` of these arguments, if it does."""
    key = _content_key(shot.world, shot.inputs(frame), shot.size, samples, average)
    return cache.folder() / "reference" / f"{key}.npz"


def _like(size: tuple[int, int]) -> Supersampled:
    """Returns the shapes and types of a result."""
    return jax.eval_shape(
        lambda: Supersampled(color=jnp.zeros((*size, 3)), thin=jnp.zeros(size))
    )


def code_hash() -> str:
    """Hashes the sources that decide an image, and names what runs them."""
    return exposure.code_hash() + cache.code_hash(sys.modules[__name__])


def _content_key(
    world: World,
    inputs: FrameInputs,
    size: tuple[int, int],
    samples: int,
    average: str,
) -> str:
    digest = hashlib.blake2b(digest_size=20)
    choices = f"{code_hash()} {size} {samples} {average} {world.shading}"
    digest.update(choices.encode())
    digest.update(world.content_hash.encode())
    digest.update(thin_objects(world.source).tobytes())  # told from names
    for array in jax.tree.leaves((inputs.camera, inputs.world_from_group)):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
