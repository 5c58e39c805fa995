"""Resolve pixel by pixel."""

import numpy as np


def resolve(
    method, raw, blended, traced, blended_count, traced_count,
    *, samples=None, feedback=True,
):  # fmt: skip
    """Returns (composite, count of the history, colour of the history).

    With `samples` rays a pixel the traced colour joins TAA's, else it replaces it.
    """
    composite, stored = np.zeros(raw.shape), np.zeros(raw.shape)
    count = np.zeros(method.shape)
    for pixel in np.ndindex(method.shape):
        shown_traced = [sane(value) for value in traced[pixel]]
        if samples is not None:
            shown_traced = join(
                [sane(value) for value in blended[pixel]], float(blended_count[pixel]),
                shown_traced, samples,
            )  # fmt: skip
        sources = {
            0: (raw[pixel], 1.0),
            1: (blended[pixel], blended_count[pixel]),
            2: (shown_traced, traced_count),
        }
        shown = kept = int(method[pixel])
        if shown == 2 and not feedback:
            kept = 1
        count[pixel] = sources[kept][1]
        for image, source in ((composite, shown), (stored, kept)):
            for channel, value in enumerate(sources[source][0]):
                image[(*pixel, channel)] = sane(value)
    return composite, count, stored


def sane(value):
    """Returns radiance in [0, 65504]; NaN counts as 0."""
    return min(float(value), 65504.0) if value > 0 else 0.0


def join(old, frames, new, rays):
    """Returns the mean of a colour of some frames and one of some rays.

    It is taken of c / (1 + max(c)), and taken back.
    """
    mapped = [[c / (1.0 + max(color)) for c in color] for color in (old, new)]
    mean = [
        (frames * a + rays * b) / (frames + rays) for a, b in zip(*mapped, strict=True)
    ]
    return [c / (1.0 - max(mean)) for c in mean]
