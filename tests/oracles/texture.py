"""Texture lookup one element at a time in float64, from the OpenGL definitions."""

import math

import numpy as np

from ataa_jax import types


def decode(code: float, srgb: bool) -> float:
    c = code / 255.0
    if not srgb:
        return c
    return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4


def wrap_index(i: int, extent: int, mode: int) -> int:
    if mode == types.WRAP_REPEAT:
        return i % extent
    if mode == types.WRAP_CLAMP:
        return min(max(i, 0), extent - 1)
    i = i % (2 * extent)
    return i if i < extent else 2 * extent - 1 - i


def bilinear(
    image: np.ndarray, u: float, v: float, wrap: tuple[int, int], srgb: bool
) -> np.ndarray:
    """Samples uint8 (h, w, 4) at (u, v); returns linear RGB."""
    height, width = image.shape[:2]
    modes = wrap
    if modes[0] == types.WRAP_CLAMP:
        u = min(max(u, 0.0), 1.0)
    if modes[1] == types.WRAP_CLAMP:
        v = min(max(v, 0.0), 1.0)
    x, y = u * width - 0.5, v * height - 0.5
    total = np.zeros(3)
    for dy in (0, 1):
        for dx in (0, 1):
            xi, yi = math.floor(x) + dx, math.floor(y) + dy
            weight = (1 - abs(x - xi)) * (1 - abs(y - yi))
            texel = image[
                wrap_index(yi, height, modes[1]), wrap_index(xi, width, modes[0])
            ]
            total += weight * np.array([decode(c, srgb) for c in texel[:3]])
    return total
