"""Segmentation weights and thresholds fitted by optimistix against SSAA references.

`record` renders a sequence once; `fit` closes the loop over it as often as it takes;
`write` keeps what was found, with its evidence; `export` hands it to an engine.
"""

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
    "checkpoints_of",
    "export",
    "fit",
    "record",
    "write",
]
