"""Checks of colour and jitter against the reference."""

from dataclasses import replace
from typing import get_args

import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax.capture import evidence
from ataa_jax.capture.conventions import Encoding, Frame
from ataa_jax.capture.evidence import Stills
from ataa_jax.capture.findings import ERROR, NOTE, WARNING, Finding
from ataa_jax.capture.readings import linear_color

_EDGE = 0.1  # range of tone-mapped luma in the 3×3 that makes an edge
# our choice: chance alone exceeds it once in a thousand captures, after the standard
# error is doubled for neighbours that are not independent.
_SIGMAS = 4.0
# our choice: mip levels and noise leave flat areas alike to a few parts in a thousand.
_FLAT = 0.03
# our choice: aliasing weakens what is measured to about 0.8 of the jitter.
_FOLLOWS = 0.35


def check(stills: Stills) -> list[Finding]:
    """Returns what contradicts the metadata."""
    return [
        *_encoding(stills),
        *_jitter(stills),
    ]


def _encoding(stills: Stills) -> list[Finding]:
    """Compares colour with the reference, and both with what linear radiance allows."""
    declared = stills.capture.conventions.color
    top = max(float(np.nanmax(np.abs(s.color), initial=0.0)) for s in stills.frames)
    if declared != "linear" and top > 1.01:
        text = f"colour was promised '{declared}', but reaches {top:.3g}"
        remedy = 'write color = "linear"'
        return [Finding(ERROR, "linear colour", "", text, remedy)]
    if any(still.reference is None for still in stills.frames):
        return _unknown_encoding(declared, top)
    if found := _reference_apart(stills, declared):
        return found
    if top > 1.01:
        return []
    own, sigma = _gap(stills, declared)
    if abs(own) > _SIGMAS * sigma:
        gaps = {e: abs(_gap(stills, e)[0]) for e in get_args(Encoding)}
        best = min(gaps, key=lambda e: gaps[e])
        if best != declared and gaps[best] < 0.5 * abs(own):
            return [_encoded(declared, best, own, gaps[best], sigma)]
    return _unknown_encoding(declared, top) if declared == "linear" else []


def _encoded(
    declared: str, seen: str, own: float, rest: float, sigma: float
) -> Finding:
    words = {
        "srgb": "sRGB-encoded",
        "display": "tone-mapped and sRGB-encoded",
        "tonemapped": "tone-mapped",
        "linear": "linear",
    }
    return Finding(
        ERROR,
        "encoded colour",
        "",
        f"colour was promised {declared}, but is {words[seen]}: no value exceeds 1, "
        f"and at edges the reference is the mean of the samples to {rest:.4f} when "
        f"decoded, {abs(own):.4f} as stored ({abs(own) / sigma:.0f} standard errors)",
        f'capture before tone map and encoding, or write color = "{seen}"',
    )


def _unknown_encoding(declared: str, top: float) -> list[Finding]:
    if declared != "linear" or top > 1.0 or top == 0.0:
        return []
    return [
        Finding(
            NOTE,
            "dim or encoded colour",
            "",
            f"no value of the colour exceeds {top:.3g}; nothing tells a dim scene from "
            "a tone-mapped or encoded one",
            "make sure that it was captured before the tone map",
        )
    ]


def _gap(stills: Stills, encoding: Encoding) -> tuple[float, float]:
    """Returns the mean of A(sample) − A(reference) at edges, and its standard error.

    A leads to the averaging space: there, and only there, the reference is the mean of
    the samples. Encoded values are bent, and so is their mean, by Jensen's inequality.
    """
    average = stills.capture.conventions.average
    values = []
    for still in stills.frames:
        assert still.reference is not None
        pair = []
        for image in (still.color, still.reference):
            linear = jnp.asarray(linear_color(image, encoding))
            mapped = colors.to_average(linear, average)
            pair.append(np.asarray(colors.luma(mapped), np.float64))
        if pair[0].shape != pair[1].shape:
            return 0.0, 1.0
        edge = _range3x3(still.luma) > _EDGE
        values.append((pair[0] - pair[1])[edge])
    joined = np.concatenate(values)
    if joined.size < 64:
        return 0.0, 1.0
    return float(joined.mean()), 2.0 * float(joined.std()) / np.sqrt(joined.size)


def _range3x3(plane: np.ndarray) -> np.ndarray:
    """Returns the largest minus the smallest of the 3×3; border: clamp to edge."""
    high = low = np.pad(plane, 1, mode="edge")
    high = np.maximum(np.maximum(high[:-2], high[1:-1]), high[2:])
    low = np.minimum(np.minimum(low[:-2], low[1:-1]), low[2:])
    high = np.maximum(np.maximum(high[:, :-2], high[:, 1:-1]), high[:, 2:])
    low = np.minimum(np.minimum(low[:, :-2], low[:, 1:-1]), low[:, 2:])
    return high - low


def _reference_apart(stills: Stills, declared: Encoding) -> list[Finding]:
    """Says when colour and reference differ where there is nothing to antialias."""
    if not abs(np.log(_flat_ratio(stills, declared))) > _FLAT:
        return []
    ratio = {e: _flat_ratio(stills, e) for e in get_args(Encoding)}
    off = {encoding: abs(np.log(value)) for encoding, value in ratio.items()}
    best = min(off, key=lambda e: off[e])
    text = (
        f"in flat areas the reference is {ratio[declared]:.3f} times as bright as the "
        "colour, tone-mapped"
    )
    if best != declared and off[best] < off[declared] / 3.0:
        text += f"; read as '{best}' it is {ratio[best]:.3f} times"
        remedy = "store the reference as the colour is stored"
        return [Finding(ERROR, "encoded reference", "", text, remedy)]
    remedy = "capture both with one exposure, before any post-processing"
    return [Finding(WARNING, "reference differs", "", text, remedy)]


def _flat_ratio(stills: Stills, encoding: Encoding) -> float:
    """Returns the median of reference over colour, away from edges and black."""
    ratios = []
    for still in stills.frames:
        if still.reference is None or still.reference.shape != still.color.shape:
            continue
        exposure = np.float32(still.meta.exposure)
        truth = evidence.tonemapped_luma(
            linear_color(still.reference, encoding) * exposure
        )
        spread = _range3x3(still.color_luma)
        flat = (spread < 0.1 * still.color_luma) & (still.color_luma > 1e-3)
        ratios.append(truth[flat] / still.color_luma[flat])
    joined = np.concatenate(ratios) if ratios else np.zeros(0)
    return float(np.median(joined)) if joined.size >= 64 else 1.0


def _jitter(stills: Stills) -> list[Finding]:
    """Compares the recorded jitter with where the images lie."""
    jitters = [still.meta.jitter for still in stills.frames]
    if all(jitter is None for jitter in jitters):
        return [
            Finding(
                ERROR,
                "missing jitter",
                "",
                "no frame's metadata hold a jitter",
                "write each frame's subpixel offset, px from the pixel centre, x right "
                "and y down; [0, 0] where the samples lie at the centre",
            )
        ]
    given = np.array([jitter or (0.0, 0.0) for jitter in jitters])
    if np.all(given == 0.0):
        return [
            Finding(
                WARNING,
                "no jitter",
                "",
                "every frame's jitter is 0",
                "TAA gains no samples from still pixels; turn the jitter on",
            )
        ]
    if np.abs(given).max() > 1.0:
        return [
            Finding(
                ERROR,
                "jitter unit",
                "",
                f"the jitter reaches {np.abs(given).max():.3g} px",
                "write it in pixels from the pixel centre, −0.5 to 0.5",
            )
        ]
    if any(still.reference is None for still in stills.frames):
        return []
    return _measured_jitter(stills, given)


def _follows(stills: Stills, given: np.ndarray) -> list[float]:
    """Returns by which factor the images move with the recorded jitter, x and y."""
    shifts = [
        evidence.shift(still.luma, still.color_luma, stills.x, stills.y)
        for still in stills.frames
    ]
    # A constant shift is the pixel grid's, not the jitter's.
    found = np.array(shifts) - np.mean(shifts, axis=0)
    centred = given - given.mean(axis=0)
    return [evidence.slope([found[:, k]], [centred[:, k]]) for k in (0, 1)]


def settle_jitter(stills: Stills) -> tuple[Stills, list[tuple[str, str]]]:
    """Turns the jitter as the images have it, where the layout states no signs."""
    jitters = [still.meta.jitter for still in stills.frames]
    measurable = all(still.reference is not None for still in stills.frames)
    capture = stills.capture
    if capture.conventions.jitter_stated or None in jitters or not measurable:
        return stills, []
    k = _follows(stills, np.array(jitters))
    signs = np.where(np.array(k) < -_FOLLOWS, -1.0, 1.0)

    def turned(frame: Frame) -> Frame:
        if frame.jitter is None:
            return frame
        x, y = np.asarray(frame.jitter) * signs
        return replace(frame, jitter=(float(x), float(y)))

    frames = tuple(turned(frame) for frame in capture.frames)
    settled = replace(capture, frames=frames)
    held = [replace(s, meta=f) for s, f in zip(stills.frames, frames, strict=False)]
    words = ["right" if signs[0] > 0 else "left", "down" if signs[1] > 0 else "up"]
    fact = f"x {words[0]}, y {words[1]} (the images move by {k[0]:.2f}, {k[1]:.2f})"
    return replace(stills, capture=settled, frames=held), [("jitter, inferred", fact)]


def _measured_jitter(stills: Stills, given: np.ndarray) -> list[Finding]:
    k = _follows(stills, given)
    numbers = f"the images move by {k[0]:.2f} of it in x and {k[1]:.2f} in y"
    if all(abs(v) < _FOLLOWS or np.isnan(v) for v in k):
        return [
            Finding(
                ERROR,
                "missing jitter",
                "",
                f"the metadata hold a jitter, the colour does not show it: {numbers}",
                "capture the jittered frames, or write [0, 0]",
            )
        ]
    axes = [name for name, v in zip("xy", k, strict=True) if v < -_FOLLOWS]
    if axes:
        signs = "opposite sign in " + " and ".join(axes)
        return [
            Finding(
                ERROR,
                "jitter sign",
                "",
                f"the recorded jitter has the {signs}: {numbers}",
                "write the sample's offset from the pixel centre, x right and y down",
            )
        ]
    return []
