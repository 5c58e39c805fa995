"""Resolve pixel by pixel."""

import numpy as np


def resolve(method, raw, blended, traced, blended_count, traced_count):
    """Returns (composite, count)."""
    composite, count = np.zeros(raw.shape), np.zeros(method.shape)
    for pixel in np.ndindex(method.shape):
        sources = {
            0: (raw[pixel], 1.0),
            1: (blended[pixel], blended_count[pixel]),
            2: (traced[pixel], traced_count),
        }
        color, count[pixel] = sources[int(method[pixel])]
        for channel, value in enumerate(color):
            good = value > 0  # false for NaN
            composite[(*pixel, channel)] = min(value, 65504.0) if good else 0.0
    return composite, count
