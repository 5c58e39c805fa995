"""Configuration and parameters of a whole frame, and the named presets.

`Config` and `Params` nest what the stages own; `preset` fills both by name.
"""

from dataclasses import dataclass, field, replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ataa_jax import effects, fxaa, raster, raytrace, resolve, segmentation, taa
from ataa_jax.errors import InputError
from ataa_jax.fxaa import Config as FxaaConfig
from ataa_jax.raster import Config as RasterConfig
from ataa_jax.raytrace import Config as RaytraceConfig
from ataa_jax.resolve import Config as ResolveConfig
from ataa_jax.segmentation import Config as SegmentationConfig
from ataa_jax.taa import Config as TaaConfig
from ataa_jax.types import Scene


@dataclass(frozen=True)
class Config:
    """Nests the stages' own choices."""

    # False: TAA alone, as engines run it: no mask, no rays, no FXAA, and the raw colour
    # where there is no history.
    adaptive: bool = True
    raster: RasterConfig = field(default_factory=RasterConfig)
    taa: TaaConfig = field(default_factory=lambda: taa.PRESETS["tuned"][0])
    segmentation: SegmentationConfig = field(default_factory=SegmentationConfig)
    raytrace: RaytraceConfig = field(default_factory=RaytraceConfig)
    resolve: ResolveConfig = field(default_factory=ResolveConfig)
    fxaa: FxaaConfig = field(default_factory=FxaaConfig)


class Params(eqx.Module):
    """Nests the stages' own numbers."""

    raster: raster.Params
    taa: taa.Params
    segmentation: segmentation.Params
    resolve: resolve.Params
    fxaa: fxaa.Params
    budget: Float[Array, ""]  # sparse primary rays a pixel of the frame; inf: no cap


@dataclass(frozen=True)
class Preset:
    """What goes together: TAA's constants, the criteria, and what a ray reads."""

    taa: str  # of `taa.PRESETS`
    mip_bias: float  # of the raster stage's textures
    segmentation: str  # of `segmentation.PRESETS`
    footprint: raytrace.Footprint
    traced: resolve.Traced  # what traced colours do to the TAA result


PRESETS: dict[str, Preset] = {
    # TAA by `experiments/tune_taa.py`, weights by `experiments/fit_thresholds.py`, the
    # rays' textures by `experiments/grey_halo.py`, what becomes of their colours by
    # `experiments/sparse_jitter.py`.
    "tuned": Preset("tuned", -2.0, "fitted", "sample", "join"),
    # The same TAA; the two criteria "weighted equally", and rays that read mip level 0
    # and replace the TAA result (section 3).
    "paper": Preset("tuned", -2.0, "paper", "level0", "replace"),
    # The literature throughout: UE4's TAA leaves the textures' level of detail alone.
    "ue4": Preset("ue4", 0.0, "paper", "level0", "replace"),
}


# Paper, section 3: "8x ray traced supersampling for 6% of the scene at a cost of fewer
# than 0.5 rays per pixel".
BUDGET = 0.48


def preset(
    name: str,
    scene: Scene | None,
    size: tuple[int, int],
    *,
    samples: int = 8,
    budget: float = BUDGET,
    selection: effects.Selection | None = None,
) -> tuple[Config, Params]:
    """Returns configuration and parameters for a scene.

    Args:
        name: of `PRESETS`: "tuned", "paper" or "ue4".
        scene: decides the effects that are compiled in; None: nothing will be drawn.
        size: image (height, width).
        samples: rays a traced pixel: 2, 4 or 8.
        budget: sparse primary rays a pixel of the frame, averaged over it. inf:
            no cap.
        selection: effects to compile for, such as `Sequence.effects`; by default what
            the scene calls for, in any motion.

    Raises:
        InputError: unknown preset, or values out of range.
    """
    if name not in PRESETS:
        raise InputError(f"unknown preset '{name}'; known are {', '.join(PRESETS)}")
    if samples not in (2, 4, 8):
        raise InputError(f"ATAA traces 2, 4 or 8 rays a pixel, not {samples}")
    if not budget >= 0.0:
        raise InputError(f"a ray budget must be at least 0 rays a pixel, not {budget}")
    chosen = PRESETS[name]
    taa_config, taa_params = taa.PRESETS[chosen.taa]
    criteria, weights = segmentation.PRESETS[chosen.segmentation]
    if selection is None:
        given = RasterConfig().shading if scene is None else effects.required(scene)
        selection = effects.Selection(given)
    config = Config(
        raster=raster.Config(
            size=size,
            shading=selection.shading,
            camera_motion=selection.camera_motion,
            object_motion=selection.object_motion,
        ),
        taa=taa_config,
        segmentation=criteria,
        raytrace=raytrace.Config(
            samples=samples, footprint=chosen.footprint, shading=selection.shading
        ),
        resolve=resolve.Config(traced=chosen.traced),
    )
    params = Params(
        raster=raster.default_params(chosen.mip_bias),
        taa=taa_params,
        segmentation=weights,
        resolve=resolve.default_params(),
        fxaa=fxaa.default_params(),
        budget=jnp.asarray(budget, jnp.float32),
    )
    return config, params


def with_budget(params: Params, budget: float) -> Params:
    """Returns the parameters under another ray budget, rays a pixel of the frame."""
    return eqx.tree_at(
        lambda p: p.budget, params, jnp.asarray(budget, params.budget.dtype)
    )


def with_criteria(
    config: Config, params: Params, criteria: str
) -> tuple[Config, Params]:
    """Returns both with one of `segmentation.PRESETS` in place of their own."""
    choices, weights = segmentation.PRESETS[criteria]
    return (
        replace(config, segmentation=choices),
        eqx.tree_at(lambda p: p.segmentation, params, weights),
    )


def with_threshold(params: Params, threshold: float) -> Params:
    """Returns the parameters under another segmentation threshold."""
    return eqx.tree_at(
        lambda p: p.segmentation.threshold,
        params,
        jnp.asarray(threshold, params.segmentation.threshold.dtype),
    )


def with_taa(params: Params, numbers: taa.Params) -> Params:
    """Returns the parameters with other numbers for the TAA stage."""
    return eqx.tree_at(lambda p: p.taa, params, numbers)


def with_size(config: Config, size: tuple[int, int]) -> Config:
    """Returns the configuration for another image size."""
    return replace(config, raster=replace(config.raster, size=size))


def raster_config(config: Config) -> RasterConfig:
    """Returns the raster stage's choices, with what the criteria ask of it as well."""
    asked = config.adaptive and config.segmentation.use_layers
    return replace(config.raster, second_motion=config.raster.second_motion or asked)


@partial(jax.jit, static_argnames="config")
def max_pixels(budget: Float[Array, ""], config: Config) -> Int[Array, ""]:
    """Returns how many pixels of a frame a ray budget pays for."""
    pixels = config.raster.size[0] * config.raster.size[1]
    affordable = jnp.floor(budget * (pixels / config.raytrace.samples))
    return jnp.clip(affordable, 0.0, float(pixels)).astype(jnp.int32)
