"""One frame of Adaptive Temporal Antialiasing, and a sequence (paper, Figure 2).

    raster → taa → segmentation → raytrace → resolve → fxaa → display

`frame` is the whole; `antialias` is everything after raster and takes colour and
G-buffer from whoever made them. Both are pure functions over `types.State`.
"""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import color as colors
from ataa_jax import (
    embree,
    fxaa,
    raster,
    raytrace,
    resolve,
    sampling,
    segmentation,
    taa,
)
from ataa_jax.errors import InputError
from ataa_jax.formats import Format
from ataa_jax.presets import (
    BUDGET,
    PRESETS,
    Config,
    Params,
    Preset,
    max_pixels,
    preset,
    raster_config,
    with_budget,
    with_criteria,
    with_size,
    with_taa,
    with_threshold,
)
from ataa_jax.raster import RasterOutput
from ataa_jax.raytrace import RaytraceOutput
from ataa_jax.types import (
    METHOD_ATAA,
    METHOD_FXAA,
    Classification,
    FrameInputs,
    GBuffer,
    History,
    Rays,
    Scene,
    Segmentation,
    State,
)
from ataa_jax.world import Sequence

__all__ = [
    "BUDGET",
    "PRESETS",
    "Config",
    "FrameOutput",
    "Observe",
    "Params",
    "Preset",
    "Statistics",
    "Trace",
    "antialias",
    "frame",
    "init",
    "max_pixels",
    "preset",
    "raster_config",
    "sequence",
    "stages",
    "to_numpy",
    "warm",
    "with_budget",
    "with_criteria",
    "with_cut",
    "with_size",
    "with_taa",
    "with_threshold",
]

_Buffer = TypeVar("_Buffer")


class Statistics(eqx.Module):
    """What one frame did, as counts of pixels and rays."""

    fxaa_pixels: Int[Array, ""]
    ataa_pixels: Int[Array, ""]
    overflow_pixels: Int[Array, ""]  # asked for rays beyond the budget
    primary_rays: Int[Array, ""]  # sparse ones, of the raytrace stage
    rays: Rays  # of the raytrace stage
    raster_rays: Rays


class FrameOutput(eqx.Module):
    """Every buffer of the paper's Figure 2, by name."""

    image: Float[Array, "h w 3"]  # display-referred sRGB
    raw: Float[Array, "h w 3"]  # raster colour, linear
    gbuffer: GBuffer
    taa: Float[Array, "h w 3"]  # linear
    reprojected: Float[Array, "h w 3"]  # history before rectification, linear
    segmentation: Segmentation
    traced: Float[Array, "h w 3"]  # linear, 0 where not traced
    composite: Float[Array, "h w 3"]  # linear; the history stores it, with feedback
    statistics: Statistics


def init(size: tuple[int, int], history: Format = "float32") -> State:
    """Returns the state before the first frame: no history at all.

    Args:
        size: image (height, width).
        history: the format that `resolve.Config.history` keeps it in.
    """
    return State(
        history=History(
            color=_filled((*size, 3), 0.0, history),
            depth=_filled(size, np.inf, history),
            motion=_filled((*size, 2), 0.0, history),
            count=_filled(size, 0.0, history),
            valid=jnp.asarray(False),
        ),
        classification=Classification(mask=_filled(size, 0.0, "uint32")),
    )


def _filled(shape: tuple[int, ...], value: float, dtype: str) -> jax.Array:
    """Does as `jnp.full`, which compiles a program for every shape."""
    return jax.device_put(np.full(shape, value, jnp.dtype(dtype)))


@jax.jit
def _uncut(valid: Bool[Array, ""], cut: Bool[Array, ""]) -> Bool[Array, ""]:
    """Returns whether there is a history to read."""
    return valid & ~cut


def _pass(name: str, buffer: _Buffer) -> _Buffer:
    return buffer


Observe = Callable[[str, Any], Any]
# Takes the pixels that get rays; what stands in for the raytrace stage.
Trace = Callable[[Bool[Array, "h w"]], RaytraceOutput]


def antialias(
    state: State,
    drawn: RasterOutput,
    inputs: FrameInputs,
    params: Params,
    *,
    scene: Scene | None = None,
    tracer: embree.Tracer | None = None,
    config: Config,
    observe: Observe = _pass,
    trace: Trace | None = None,
) -> tuple[FrameOutput, State]:
    """Everything after raster; not jitted as a whole, each stage is.

    Args:
        state: what the frame before left.
        drawn: this frame's colour and G-buffer.
        inputs: cameras, jitter, and whether the camera was cut.
        params: numbers.
        scene: what the sparse rays shade.
        tracer: casts them.
        config: choices.
        observe: sees every stage's output under its name (to time it, say) and
            returns it.
        trace: gives the traced colours in the place of scene and tracer.

    Returns:
        All buffers, and the state for the next frame.
    """
    color, gbuffer = drawn.color, drawn.gbuffer
    size = config.raster.size
    state = eqx.tree_at(
        lambda s: s.history.valid, state, _uncut(state.history.valid, inputs.cut)
    )
    with jax.named_scope("taa"):
        blended = observe(
            "taa",
            taa.taa(
                state.history, color, gbuffer, inputs.jitter, params.taa,
                config=config.taa,
            ),
        )  # fmt: skip
    if config.adaptive:
        with jax.named_scope("segmentation"):
            segmented, overflow = observe(
                "segmentation",
                segmentation.segment(
                    state, color, gbuffer, blended.reprojected, params.segmentation,
                    max_pixels(params.budget, config),
                    config=config.segmentation, blended=blended.color,
                ),
            )  # fmt: skip
        method, _ = segmentation.unpack_mask(segmented.mask)
        with jax.named_scope("raytrace"):
            traced = observe(
                "raytrace",
                _trace(trace, scene, tracer, inputs, config)(method == METHOD_ATAA),
            )
    else:
        segmented, overflow = segmentation.all_taa(size), jnp.zeros((), jnp.int32)
        method, _ = segmentation.unpack_mask(segmented.mask)
        traced = raytrace.nothing(size, None if scene is None else scene.lights)
    with jax.named_scope("resolve"):
        resolved = observe(
            "resolve",
            resolve.resolve(
                segmented, color, gbuffer, blended, traced.color, params.resolve,
                samples=config.raytrace.samples, average=config.raytrace.average,
                config=config.resolve,
            ),
        )  # fmt: skip
    image = colors.display(resolved.composite)
    if config.adaptive:
        with jax.named_scope("fxaa"):
            image = observe(
                "fxaa",
                fxaa.fxaa_sparse(
                    image, method == METHOD_FXAA, params.fxaa, config=config.fxaa
                ),
            )
    output = FrameOutput(
        image=image,
        raw=color,
        gbuffer=gbuffer,
        taa=blended.color,
        reprojected=blended.reprojected,
        segmentation=segmented,
        traced=traced.color,
        composite=resolved.composite,
        statistics=Statistics(
            fxaa_pixels=jnp.sum(method == METHOD_FXAA, dtype=jnp.int32),
            ataa_pixels=jnp.sum(method == METHOD_ATAA, dtype=jnp.int32),
            overflow_pixels=overflow,
            primary_rays=traced.primary_rays,
            rays=traced.rays,
            raster_rays=drawn.rays,
        ),
    )
    return output, State(
        history=resolved.history, classification=resolved.classification
    )


def _trace(
    trace: Trace | None,
    scene: Scene | None,
    tracer: embree.Tracer | None,
    inputs: FrameInputs,
    config: Config,
) -> Trace:
    """Returns what gives the traced colours: the raytrace stage, or its stand-in."""
    if trace is not None:
        return trace
    if scene is None or tracer is None:
        raise InputError("without `trace`, antialias needs a scene and its tracer")
    return lambda wanted: raytrace.raytrace(
        scene, inputs, wanted, tracer=tracer, config=config.raytrace
    )


def warm(
    inputs: FrameInputs, *, scene: Scene, tracer: embree.Tracer, config: Config
) -> None:
    """Compiles the raytrace stage, by a frame that traces nothing.

    XLA takes half a gigabyte to compile it. At 1920×1080 the peak of `stages` is lower
    by a fifth of one where that is over before a frame's buffers are there.
    """
    raytrace.raytrace(
        scene,
        with_cut(inputs, False),
        jnp.zeros(config.raster.size, jnp.bool_),
        tracer=tracer,
        config=config.raytrace,
    )


def stages(
    state: State,
    inputs: FrameInputs,
    params: Params,
    *,
    scene: Scene,
    tracer: embree.Tracer,
    config: Config,
    observe: Observe = _pass,
) -> tuple[FrameOutput, State]:
    """One frame, stage by stage: the same as `frame`, open to an observer."""
    with jax.named_scope("raster"):
        drawn = observe(
            "raster",
            raster.raster(
                scene,
                inputs,
                params.raster,
                tracer=tracer,
                config=raster_config(config),
            ),
        )
    return antialias(
        state, drawn, inputs, params,
        scene=scene, tracer=tracer, config=config, observe=observe,
    )  # fmt: skip


@partial(jax.jit, static_argnames="config")
def frame(
    state: State,
    inputs: FrameInputs,
    params: Params,
    *,
    scene: Scene,
    tracer: embree.Tracer,
    config: Config,
) -> tuple[FrameOutput, State]:
    """Renders one frame: scene and camera in, antialiased image and all buffers out.

    Args:
        state: what the frame before left; `init(size)` before the first.
        inputs: cameras, transforms and jitter.
        params: numbers; changing them does not compile anew.
        scene: geometry, materials, lights.
        tracer: Embree's copy of the scene.
        config: choices that change the program.

    Returns:
        All buffers, and the state for the next frame.
    """
    return stages(state, inputs, params, scene=scene, tracer=tracer, config=config)


def sequence(
    shot: Sequence,
    params: Params,
    *,
    config: Config,
    frames: int,
    state: State | None = None,
) -> Iterator[tuple[FrameOutput, State]]:
    """Folds `frame` over a camera path.

    Args:
        shot: the world along a path.
        params: numbers.
        config: choices; its size must be the shot's.
        frames: how many.
        state: to go on from; None starts anew.

    Yields:
        Output and state of each frame.
    """
    world = shot.world
    if state is None:
        state = init(config.raster.size, config.resolve.history)
    current = state
    jitter = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    for index in range(frames):
        output, current = frame(
            current,
            shot.inputs(index, jitter[index % len(jitter)]),
            params,
            scene=world.scene,
            tracer=world.tracer,
            config=config,
        )
        yield output, current
        del output  # before the next one needs the memory


def with_cut(inputs: FrameInputs, cut: bool) -> FrameInputs:
    """Returns the inputs with the camera-cut flag set or cleared."""
    return eqx.tree_at(lambda i: i.cut, inputs, jnp.asarray(cut))


def to_numpy(tree: Any) -> Any:
    """Copies a pytree of arrays to NumPy."""
    return jax.tree.map(np.asarray, tree)
