"""Checks of colour and jitter against the reference."""

from dataclasses import replace
from typing import get_args

import jax.numpy as jnp
import numpy as np
from scipy.ndimage import uniform_filter

from ataa_jax import color as colors
from ataa_jax.capture import evidence
from ataa_jax.capture.conventions import Encoding, Frame
from ataa_jax.capture.evidence import Stills
from ataa_jax.capture.findings import ERROR, NOTE, WARNING, Finding
from ataa_jax.capture.readings import encoded_color, linear_color

_EDGE = 0.1  # range of tone-mapped luma in the 3×3 that makes an edge
# our choice: chance alone exceeds it once in a thousand captures, after the standard
# error is doubled for neighbours that are not independent.
_SIGMAS = 4.0
# our choice: mip levels and noise leave flat areas alike to a few parts in a thousand.
_FLAT = 0.03
# our choice: samples of the 3×3 vary more than those of a pixel, which predicts too
# much bending. On six camera paths the true encoding showed 0.5 to 0.7 of it, linear
# colour up to 0.2, for mip levels bend a little too.
_BENT, _TRULY_BENT = 0.35, 0.6
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
    bends = {e: _bend(stills, declared, e) for e in get_args(Encoding) if e != declared}
    likely = {e: v for e, v in bends.items() if v[0] > _BENT and v[1] > _SIGMAS}
    if likely:
        best = min(likely, key=lambda e: abs(np.log(likely[e][0] / _TRULY_BENT)))
        return [_encoded(declared, best, *likely[best])]
    return _unknown_encoding(declared, top) if declared == "linear" else []


def _encoded(declared: str, seen: str, share: float, sigmas: float) -> Finding:
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
        f"and at edges the reference departs from the mean of the samples by "
        f"{share:.2f} of what that encoding would do ({sigmas:.0f} standard errors)",
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


def _bend(stills: Stills, declared: Encoding, seen: Encoding) -> tuple[float, float]:
    """Returns how far the reference is bent as another encoding would bend it.

    Let A lead to the averaging space. The reference is the mean of the samples there,
    and there alone: values that are encoded otherwise are bent, and so is their mean,
    by Jensen's inequality. How much, the samples of the 3×3 predict: the prediction p
    for the difference A(sample) − A(reference), d, is fitted by d = k p.

    Returns:
        k, and k in standard errors (doubled for neighbours that are not independent).
    """
    average = stills.capture.conventions.average
    top = bottom = rest = 0.0
    count = 0
    for still in stills.frames:
        assert still.reference is not None
        if still.reference.shape != still.color.shape:
            return 0.0, 0.0

        def averaged(stored: np.ndarray, encoding: Encoding) -> np.ndarray:
            linear = jnp.asarray(linear_color(stored, encoding))
            return np.asarray(colors.to_average(linear, average))

        own = averaged(still.color, declared)
        d = _luma(own) - _luma(averaged(still.reference, declared))
        true = _mean3x3(averaged(still.color, seen))
        linear = np.asarray(colors.from_average(jnp.asarray(true), average))
        bent = averaged(encoded_color(linear, seen), declared)
        p = _luma(_mean3x3(own)) - _luma(bent)
        use = np.isfinite(d) & np.isfinite(p)
        top += float(np.sum(d[use] * p[use]))
        bottom += float(np.sum(p[use] ** 2))
        # The error of a fit whose pixels differ in spread (White 1980).
        rest += float(np.sum((d[use] * p[use]) ** 2))
        count += int(use.sum())
    if count < 64 or bottom <= 0.0 or rest <= 0.0:
        return 0.0, 0.0
    return top / bottom, 0.5 * top / np.sqrt(rest)


def _luma(image: np.ndarray) -> np.ndarray:
    return image @ np.array(colors.LUMA_WEIGHTS, np.float32)


def _mean3x3(image: np.ndarray) -> np.ndarray:
    return uniform_filter(image, 3, mode="nearest", axes=(0, 1))


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
    # More than any jitter: the frame is not the one that its reference shows.
    near = np.linalg.norm(shifts, axis=1) < 1.0
    if near.sum() < 2:
        return [float("nan"), float("nan")]
    shifts, given = np.array(shifts)[near], given[near]
    found = shifts - np.mean(shifts, axis=0)
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
