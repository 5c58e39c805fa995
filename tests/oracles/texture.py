"""Texture lookup one element at a time in float64, from the OpenGL definitions."""

import math
from collections.abc import Iterator

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
    total = np.zeros(3)
    for weight, texel in _four(image, u, v, wrap):
        total += weight * np.array([decode(c, srgb) for c in texel[:3]])
    return total


def alpha(image: np.ndarray, u: float, v: float, wrap: tuple[int, int]) -> float:
    """Samples the alpha of uint8 (h, w, 4) at (u, v), in [0, 1]."""
    return sum(weight * texel[3] / 255.0 for weight, texel in _four(image, u, v, wrap))


def trilinear(
    levels: list[np.ndarray],
    u: float,
    v: float,
    wrap: tuple[int, int],
    srgb: bool,
    detail: float,
) -> np.ndarray:
    """Samples a pyramid, largest level first, between the levels around `detail`."""
    detail = min(max(detail, 0.0), len(levels) - 1.0)
    low = math.floor(detail)
    color = bilinear(levels[low], u, v, wrap, srgb)
    if detail > low:
        far = bilinear(levels[low + 1], u, v, wrap, srgb)
        color = (1 - (detail - low)) * color + (detail - low) * far
    return color


def level_of_detail(
    size: tuple[int, int], uv_dx: np.ndarray, uv_dy: np.ndarray
) -> float:
    """Returns log2 of the longer side of a pixel's footprint, in texels of level 0."""
    height, width = size
    longer = max(
        math.hypot(uv_dx[0] * width, uv_dx[1] * height),
        math.hypot(uv_dy[0] * width, uv_dy[1] * height),
    )
    return math.log2(longer) if longer > 0 else -math.inf


def unpack(textures: types.Textures, texture: int) -> list[np.ndarray]:
    """Returns one texture's levels, uint8 (h, w, 4), largest first."""
    levels = []
    for level in range(int(textures.level_count[texture])):
        first = int(textures.level_offset[texture, level])
        height = int(textures.level_height[texture, level])
        width = int(textures.level_width[texture, level])
        packed = np.asarray(textures.texels)[first : first + height * width]
        channels = [packed >> shift & 255 for shift in (0, 8, 16, 24)]
        levels.append(np.stack(channels, -1).reshape(height, width, 4).astype(np.uint8))
    return levels


def _four(
    image: np.ndarray, u: float, v: float, wrap: tuple[int, int]
) -> Iterator[tuple[float, np.ndarray]]:
    """Yields the four texels around (u, v) with their weights."""
    height, width = image.shape[:2]
    if wrap[0] == types.WRAP_CLAMP:
        u = min(max(u, 0.0), 1.0)
    if wrap[1] == types.WRAP_CLAMP:
        v = min(max(v, 0.0), 1.0)
    x, y = u * width - 0.5, v * height - 0.5
    for yi in (math.floor(y), math.floor(y) + 1):
        for xi in (math.floor(x), math.floor(x) + 1):
            weight = (1 - abs(x - xi)) * (1 - abs(y - yi))
            row, column = (
                wrap_index(yi, height, wrap[1]),
                wrap_index(xi, width, wrap[0]),
            )
            yield weight, image[row, column]
