"""Resolve pixel by pixel."""

import numpy as np


def resolve(
    method, raw, blended, traced, blended_count, traced_count, *, feedback=True
):
    """Returns (composite, count of the history, colour of the history)."""
    composite, stored = np.zeros(raw.shape), np.zeros(raw.shape)
    count = np.zeros(method.shape)
    for pixel in np.ndindex(method.shape):
        sources = {
            0: (raw[pixel], 1.0),
            1: (blended[pixel], blended_count[pixel]),
            2: (traced[pixel], traced_count),
        }
        shown = kept = int(method[pixel])
        if shown == 2 and not feedback:
            kept = 1
        count[pixel] = sources[kept][1]
        for image, source in ((composite, shown), (stored, kept)):
            for channel, value in enumerate(sources[source][0]):
                good = value > 0  # false for NaN
                image[(*pixel, channel)] = min(value, 65504.0) if good else 0.0
    return composite, count, stored
