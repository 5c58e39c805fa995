"""Mip pyramids of encoded images: decoded and filtered once, then found in the cache.

A pyramid is kept by the bytes of the file's image, its encoding, this code and Pillow's
version, and is believed only if its checksum and size are right.
"""

import hashlib
import io
import sys
from dataclasses import dataclass

import numpy as np
import PIL
from PIL import Image

from ataa_jax import cache, mipmap

FOLDER = "pyramids"

_LEAST_BYTES = 1 << 16  # our choice: 128×96 texels are made as fast as they are read
_LIMIT_BYTES = 1 << 30  # our choice: five scenes like Sponza


@dataclass(frozen=True)
class Pyramid:
    """All levels of an image, and a digest of what decides them."""

    levels: list[np.ndarray]  # as `mipmap.pyramid` returns them
    digest: bytes

    @property
    def texels(self) -> np.ndarray:
        """The image itself, uint8 (h, w, 4)."""
        codes = self.levels[0].astype("<u4", copy=False)
        return codes.view(np.uint8).reshape(*codes.shape, 4)


def open_image(data: bytes) -> Image.Image:
    """Reads the head of a PNG or JPEG; raises whatever Pillow does."""
    return Image.open(io.BytesIO(data), formats=("PNG", "JPEG"))


def load(data: bytes, srgb: bool) -> Pyramid:
    """Reads the pyramid of an encoded image, or makes it; raises whatever Pillow does.

    Args:
        data: a PNG or JPEG.
        srgb: as in `mipmap.pyramid`.
    """
    image = open_image(data)
    width, height = image.size
    shapes = mipmap.level_shapes(height, width)
    sizes = [rows * columns for rows, columns in shapes]
    code = cache.code_hash(*(sys.modules[__name__], mipmap))
    choices = f"{code} {PIL.__version__} {srgb} {hashlib.sha256(data).hexdigest()}"
    digest = hashlib.blake2b(choices.encode(), digest_size=20)
    file = cache.folder() / FOLDER / f"{digest.hexdigest()}.npz"
    kept = 4 * sum(sizes) >= _LEAST_BYTES
    like = np.broadcast_to(np.uint32(0), (sum(sizes),))
    flat = cache.read(file, like) if kept else None
    if flat is None:
        made = mipmap.pyramid(_rgba(image), srgb)
        if kept:
            flat = np.concatenate([level.reshape(-1) for level in made])
            cache.write(file, flat, _LIMIT_BYTES)
        return Pyramid(made, digest.digest())
    parts = np.split(flat, np.cumsum(sizes)[:-1])
    levels = [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
    return Pyramid(levels, digest.digest())


def _rgba(image: Image.Image) -> np.ndarray:
    """Returns uint8 (height, width, 4); 16-bit grey rounds to 8 bits."""
    if image.mode.startswith("I"):
        grey = np.asarray(image).astype(np.int64)
        grey = ((np.clip(grey, 0, 65535) + 128) // 257).astype(np.uint8)
        opaque = np.full_like(grey, 255)
        return np.stack([grey, grey, grey, opaque], axis=-1)
    return np.array(image.convert("RGBA"))
