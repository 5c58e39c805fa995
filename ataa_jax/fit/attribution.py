"""What rays bought: error removed, failures missed, rays wasted.

A pixel's *gain* is the squared sRGB error that tracing removes from TAA's result there.
*Missed failures*: of the pixels of highest gain, as many as were traced, the share that
was not traced. *Wasted rays*: of the traced pixels, the share without any gain.
"""

from dataclasses import dataclass

import numpy as np

from ataa_jax import pipeline
from ataa_jax.fit import relaxed
from ataa_jax.fit.replay import Take
from ataa_jax.types import METHOD_ATAA, METHOD_FXAA


@dataclass(frozen=True)
class Bought:
    """Of the scored frames together."""

    removed_per_ray: float  # squared sRGB error, summed over the channels
    missed: float  # in [0, 1]
    wasted: float  # in [0, 1]
    rays: float  # a pixel


# Colours of `picture`: traced with a gain, wasted, missed.
USEFUL, WASTED, MISSED = (70, 200, 90), (225, 60, 50), (60, 120, 245)


def bought(take: Take, params: pipeline.Params, terms: tuple[str, ...]) -> Bought:
    """Returns what the rays of a closed loop bought.

    Args:
        take: the sequence, its configuration with the terms switched on.
        params: numbers, threshold and all.
        terms: the terms that are on.
    """
    gains, traced, best = _masks(take, params, terms)
    count = max(int(traced.sum()), 1)
    return Bought(
        removed_per_ray=float(gains[traced].sum()) / (count * take.samples),
        missed=float((best & ~traced).sum()) / max(int(best.sum()), 1),
        wasted=float((gains[traced] <= 0.0).sum()) / count,
        rays=count * take.samples / traced.size,
    )


def picture(
    take: Take, params: pipeline.Params, terms: tuple[str, ...], frame: int
) -> np.ndarray:
    """Returns a scored frame in grey, its traced and missed pixels coloured, uint8."""
    gains, traced, best = _masks(take, params, terms)
    truth = np.asarray(take.frames.truth)[take.lead_in + frame]
    grey = np.repeat(truth.mean(-1, keepdims=True), 3, axis=-1)
    shown = np.round(255.0 * (0.25 + 0.5 * grey)).astype(np.uint8)
    shown[best[frame] & ~traced[frame]] = MISSED
    shown[traced[frame] & (gains[frame] > 0.0)] = USEFUL
    shown[traced[frame] & (gains[frame] <= 0.0)] = WASTED
    return shown


def _masks(
    take: Take, params: pipeline.Params, terms: tuple[str, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns (gain, traced, best), (frames, h, w); best: as many a frame as traced."""
    shown = relaxed.look(take.frames, params, config=take.config, names=terms)
    blended, colors, method = (
        np.asarray(leaf)[take.lead_in :]
        for leaf in (shown.blended, shown.traced, shown.method)
    )
    truth = np.asarray(take.frames.truth)[take.lead_in :]
    errors = [((image - truth) ** 2).sum(-1) for image in (blended, colors)]
    gains = np.where(method == METHOD_FXAA, -np.inf, errors[0] - errors[1])
    traced = method == METHOD_ATAA
    best = np.zeros_like(traced)
    for gain, mask, out in zip(gains, traced, best, strict=True):
        order = np.argsort(-gain, axis=None, kind="stable")[: int(mask.sum())]
        out.reshape(-1)[order] = True
    return gains, traced, best
