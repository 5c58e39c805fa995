"""Adaptive Temporal Antialiasing (Marrs et al., HPG 2018): a functional reference.

The public face. Names are imported on first use, so that ``import ataa_jax`` and the
command line's ``--help`` answer at once.

    load, shot              a scene file or the built-in scene; a camera path through it
    preset, init            configuration and parameters; the state before frame 0
    frame, sequence         one frame; a fold over a path
    stages, antialias       the same, open to an observer; everything after raster
    raster … fxaa           the stages' modules, each usable alone
    reference, metrics      supersampled ground truth; SSIM, PSNR, FLIP, flicker
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ataa_jax import (
        capture,
        color,
        embree,
        fxaa,
        metrics,
        paths,
        pipeline,
        raster,
        raytrace,
        reference,
        resolve,
        segmentation,
        taa,
        types,
        world,
    )
    from ataa_jax.errors import InputError
    from ataa_jax.pipeline import (
        antialias,
        frame,
        init,
        preset,
        sequence,
        stages,
    )
    from ataa_jax.types import METHOD_ATAA, METHOD_FXAA, METHOD_TAA
    from ataa_jax.world import load, shot

_MODULES = (
    *("capture", "color", "embree", "fxaa", "metrics", "paths", "pipeline", "raster"),
    *("raytrace", "reference", "resolve", "segmentation", "taa", "types", "world"),
)
_HOMES = {
    "InputError": "errors",
    **dict.fromkeys(
        ("antialias", "frame", "init", "preset", "sequence", "stages"), "pipeline"
    ),
    **dict.fromkeys(("METHOD_ATAA", "METHOD_FXAA", "METHOD_TAA"), "types"),
    **dict.fromkeys(("load", "shot"), "world"),
}

__all__ = [
    "METHOD_ATAA",
    "METHOD_FXAA",
    "METHOD_TAA",
    "InputError",
    "antialias",
    "capture",
    "color",
    "embree",
    "frame",
    "fxaa",
    "init",
    "load",
    "metrics",
    "paths",
    "pipeline",
    "preset",
    "raster",
    "raytrace",
    "reference",
    "resolve",
    "segmentation",
    "sequence",
    "shot",
    "stages",
    "taa",
    "types",
    "world",
]


def __getattr__(name: str) -> object:
    """Imports a public name's module when it is first asked for."""
    if name in _MODULES:
        return importlib.import_module(f"ataa_jax.{name}")
    if name in _HOMES:
        module = importlib.import_module(f"ataa_jax.{_HOMES[name]}")
        return getattr(module, name)
    raise AttributeError(f"module 'ataa_jax' has no attribute '{name}'")
