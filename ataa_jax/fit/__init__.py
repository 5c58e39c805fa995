"""Segmentation weights and thresholds fitted by optimistix against SSAA references.

`record` renders a sequence once, `record_capture` takes an engine's frames in its
place; `fit` closes the loop over them as often as it takes; `write` keeps what was
found, with its evidence; `export` hands it to an engine.
"""

from ataa_jax.fit.captured import check_terms, rays_of, record_capture
from ataa_jax.fit.fitting import (
    Fitted,
    Options,
    Standing,
    check,
    check_options,
    check_size,
    checkpoints_of,
    fit,
)
from ataa_jax.fit.recording import Recording, record
from ataa_jax.fit.replay import Take
from ataa_jax.fit.result import export, write
from ataa_jax.fit.score import check_budget

__all__ = [
    "Fitted",
    "Options",
    "Recording",
    "Standing",
    "Take",
    "check",
    "check_budget",
    "check_options",
    "check_size",
    "check_terms",
    "checkpoints_of",
    "export",
    "fit",
    "rays_of",
    "record",
    "record_capture",
    "write",
]
