"""Mip pyramids of 8-bit RGBA images, filtered in linear light.

Each level is the box filter of the one above: every texel is the mean of the area that
it covers, also for odd sizes, where a texel covers two and a fraction. Colour is
weighted by alpha, so that the colour behind a hole does not bleed into its rim.
"""

from typing import no_type_check

import numpy as np

from ataa_jax import loops

_CODES = np.arange(256, dtype=np.float32) / np.float32(255.0)


def decode_srgb(x: np.ndarray) -> np.ndarray:
    """Decodes sRGB values in [0, 1] (IEC 61966-2-1)."""
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def encode_srgb(x: np.ndarray) -> np.ndarray:
    """Encodes linear values in [0, 1] as sRGB."""
    safe = np.maximum(x, 0.0031308)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * safe ** (1 / 2.4) - 0.055)


_DECODE = decode_srgb(_CODES).astype(np.float32)

# Linear value → sRGB code, finely enough that the code is right to half a step except
# in the darkest few, where 65,536 entries leave an error of at most one code.
_ENCODE = np.round(encode_srgb(np.linspace(0.0, 1.0, 65536)) * 255.0).astype(np.uint8)

_LINEAR = np.arange(256, dtype=np.uint8)  # the same where the code is the value


def pyramid(texels: np.ndarray, srgb: bool) -> list[np.ndarray]:
    """Builds all levels down to 1×1.

    Args:
        texels: uint8 (h, w, 4).
        srgb: RGB is sRGB-encoded; alpha never is.

    Returns:
        Packed levels, uint32 (h_k, w_k), r | g << 8 | b << 16 | a << 24; the first is
        exactly the image.
    """
    levels = [_pack(texels)]
    if max(texels.shape[:2]) == 1:
        return levels
    color = np.empty((*texels.shape[:2], 3), np.float32)
    _look_up(_DECODE if srgb else _CODES, texels, color)
    # Only base colours hold alpha: glTF's other textures ignore the channel.
    opaque = not srgb or bool(np.all(texels[..., 3] == 255))
    image: np.ndarray = color
    if not opaque:
        alpha = _CODES[texels[..., 3:]]
        image = np.concatenate([color * alpha, alpha], axis=-1)
    # Where all is transparent there is no weight: keep the plain mean of the colour.
    plain = None if opaque else color
    while opaque and image.shape[0] % 2 == image.shape[1] % 2 == 0:
        height, width = image.shape[0] // 2, image.shape[1] // 2
        smaller = np.empty((height, width, 3), np.float32)
        codes = np.empty((height, width), np.uint32)
        _quarter(image, _ENCODE if srgb else _LINEAR, smaller, codes)
        image = smaller
        levels.append(codes)
    while max(image.shape[:2]) > 1:
        image = _halve(_halve(image, 0), 1)
        if opaque:
            color, alpha = image, np.ones((*image.shape[:2], 1), np.float32)
        else:
            assert plain is not None
            plain = _halve(_halve(plain, 0), 1)
            alpha = image[..., 3:]
            solid = alpha > 1e-4
            color = np.where(solid, image[..., :3] / np.where(solid, alpha, 1.0), plain)
        levels.append(_pack(_to_codes(color, alpha, srgb)))
    return levels


@loops.compiled
@no_type_check
def _look_up(table, codes, values):  # noqa: ANN001, ANN202
    for y in range(values.shape[0]):
        for x in range(values.shape[1]):
            for k in range(3):
                values[y, x, k] = table[codes[y, x, k]]


@loops.compiled
@no_type_check
def _quarter(image, encode, smaller, codes):  # noqa: ANN001, ANN202 (as the caller's)
    """Does as `_halve` along both axes, of even size, and `_to_codes`, in one pass."""
    half, steps = np.float32(0.5), np.float32(len(encode) - 1)
    for y in range(codes.shape[0]):
        for x in range(codes.shape[1]):
            packed = np.uint32(0xFF000000)
            for k in range(3):
                left = (image[2 * y, 2 * x, k] + image[2 * y + 1, 2 * x, k]) * half
                right = image[2 * y, 2 * x + 1, k] + image[2 * y + 1, 2 * x + 1, k]
                mean = (left + right * half) * half
                smaller[y, x, k] = mean
                code = encode[np.int32(mean * steps + half)]
                packed |= np.uint32(code) << np.uint32(8 * k)
            codes[y, x] = packed


def level_shapes(height: int, width: int) -> list[tuple[int, int]]:
    """Returns (height, width) of every level of a pyramid, the image's first."""
    shapes = [(height, width)]
    while max(shapes[-1]) > 1:
        shapes.append((max(shapes[-1][0] // 2, 1), max(shapes[-1][1] // 2, 1)))
    return shapes


def _halve(image: np.ndarray, axis: int) -> np.ndarray:
    """Box-filters one axis to floor(n / 2) texels (at least 1)."""
    extent = image.shape[axis]
    if extent == 1:
        return image
    x = np.moveaxis(image, axis, 0)
    half = extent // 2
    if extent % 2 == 0:
        mean = (x[0::2] + x[1::2]) * np.float32(0.5)
    else:
        # Texel k of n covers [k, k+1)·extent/n: weights shift along the row
        # (Guthe and Heckbert, "Non-power-of-two mipmaps", 2005).
        k = np.arange(half, dtype=np.float32).reshape(-1, *(1,) * (x.ndim - 1))
        n = np.float32(half)
        mean = (
            x[0:-1:2][:half] * ((n - k) / extent)
            + x[1::2][:half] * (n / extent)
            + x[2::2][:half] * ((k + 1) / extent)
        )
    return np.ascontiguousarray(np.moveaxis(mean, 0, axis), np.float32)


def _to_codes(color: np.ndarray, alpha: np.ndarray, srgb: bool) -> np.ndarray:
    color = np.clip(color, 0.0, 1.0)
    if srgb:
        rgb = _ENCODE[(color * np.float32(65535.0) + np.float32(0.5)).astype(np.int32)]
    else:
        rgb = (color * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
    alpha = np.clip(alpha, 0.0, 1.0) * np.float32(255.0) + np.float32(0.5)
    return np.concatenate([rgb, alpha.astype(np.uint8)], axis=-1)


def _pack(texels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(texels, np.uint8).view("<u4")[..., 0].astype(np.uint32)
