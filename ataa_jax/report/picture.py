"""Masks over pictures, and the few drawing helpers that the figures share."""

from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ataa_jax import types
from ataa_jax.report.palette import (
    MASK_ALPHA,
    MASK_COLORS,
    REASONS,
    Rgb,
)

INK: Rgb = (28, 31, 35)
SOFT: Rgb = (104, 111, 120)
PAPER: Rgb = (255, 255, 255)
RULE: Rgb = (214, 217, 221)

Number = int | float
Anchor = Literal["la", "ma", "ra", "lm", "mm", "rm", "ls", "ms", "rs"]


def greyscale(image: np.ndarray) -> np.ndarray:
    """Returns the luma (Rec. 709, of sRGB values) in three channels, uint8."""
    luma = image.astype(np.float64) @ np.array([0.2126, 0.7152, 0.0722])
    return np.repeat(np.round(luma).astype(np.uint8)[..., None], 3, axis=-1)


def mask_overlay(image: np.ndarray, method: np.ndarray) -> np.ndarray:
    """Lays the mask over the greyscale image: red FXAA, blue TAA, yellow ATAA.

    Args:
        image: uint8 (h, w, 3), sRGB.
        method: (h, w), METHOD_* of each pixel.

    Returns:
        uint8 (h, w, 3).
    """
    color = np.zeros((*method.shape, 3))
    alpha = np.zeros((*method.shape, 1))
    for value, rgb in MASK_COLORS.items():
        color[method == value] = rgb
        alpha[method == value] = MASK_ALPHA[value]
    return _blend(image, color, alpha)


def why_overlay(image: np.ndarray, why: np.ndarray) -> np.ndarray:
    """Lays the reasons over the greyscale image; a pixel shows its first of REASONS.

    Args:
        image: uint8 (h, w, 3), sRGB.
        why: uint16 (h, w), WHY_* bits; pixels without any stay grey.
    """
    why = why.astype(np.uint16)  # masks of eight bits hold the first eight reasons
    color = np.zeros((*why.shape, 3))
    alpha = np.zeros((*why.shape, 1))
    for reason in reversed(REASONS):
        here = (why & reason.bits) == reason.bits
        color[here] = reason.color
        alpha[here] = reason.alpha
    return _blend(image, color, alpha)


def traced_cutout(image: np.ndarray, method: np.ndarray) -> np.ndarray:
    """Shows the picture left of a diagonal, and right of it only what was traced.

    Args:
        image: uint8 (h, w, 3), sRGB.
        method: (h, w), METHOD_*; where it is not ATAA the right side is dark.
    """
    height, width = method.shape
    row, column = np.mgrid[:height, :width] + 0.5
    # From 60 % of the width at the top to 40 % at the bottom.
    edge = width * (0.6 - 0.2 * row / height)
    out = image.copy()
    out[(column > edge) & (method != types.METHOD_ATAA)] = (22, 24, 28)
    out[np.abs(column - edge) < max(width / 640.0, 0.5)] = PAPER
    return out


def _blend(image: np.ndarray, color: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    mixed = greyscale(image) * (1.0 - alpha) + color * alpha
    return np.round(mixed).astype(np.uint8)


def enlarge(image: np.ndarray, zoom: int) -> Image.Image:
    """Returns the image enlarged by a whole number, each pixel a square."""
    return Image.fromarray(np.repeat(np.repeat(image, zoom, axis=0), zoom, axis=1))


def fit(image: np.ndarray, width: int) -> Image.Image:
    """Returns the image at a width: whole enlargements as squares, others filtered."""
    if width % image.shape[1] == 0:
        return enlarge(image, width // image.shape[1])
    height = max(round(image.shape[0] * width / image.shape[1]), 1)
    return Image.fromarray(image).resize((width, height), Image.Resampling.LANCZOS)


@cache
def font(size: Number, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Returns DejaVu Sans, which comes with Matplotlib: the same on every machine."""
    import matplotlib as mpl  # here, for only writing asks for it

    folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(
        str(folder / name), size, layout_engine=ImageFont.Layout.BASIC
    )


class Sheet:
    """A white page to paste pictures on and write beside them."""

    def __init__(self, width: int, height: int) -> None:
        self.image = Image.new("RGB", (width, height), PAPER)
        self.draw = ImageDraw.Draw(self.image)

    def paste(self, picture: Image.Image, x: int, y: int) -> None:
        """Places a picture with its top left corner at (x, y)."""
        self.image.paste(picture, (x, y))

    def text(
        self,
        x: Number,
        y: Number,
        text: str,
        *,
        size: Number = 12,
        bold: bool = False,
        color: Rgb = INK,
        anchor: Anchor = "la",
    ) -> float:
        """Writes a line, and returns its width."""
        face = font(size, bold)
        self.draw.text((x, y), text, fill=color, font=face, anchor=anchor)
        return face.getlength(text)

    def rule(self, x: Number, y: Number, width: Number) -> None:
        """Draws a hairline."""
        self.draw.line([(x, y), (x + width - 1, y)], fill=RULE)

    def frame(self, box: tuple[Number, Number, Number, Number], letter: str) -> None:
        """Frames a part of a picture, white within a dark line, with its letter."""
        x0, y0, x1, y1 = (round(v) for v in box)
        self.draw.rectangle((x0 - 1, y0 - 1, x1 + 1, y1 + 1), outline=(20, 20, 20))
        self.draw.rectangle((x0, y0, x1, y1), outline=PAPER, width=1)
        if letter:
            self.tag(x0, y0, letter)

    def tag(self, x: Number, y: Number, letter: str) -> None:
        """Writes a letter in a small white square whose top left corner is (x, y)."""
        self.draw.rectangle((x, y, x + 14, y + 15), fill=PAPER)
        self.text(x + 7.5, y + 8, letter, size=11, bold=True, anchor="mm")

    def legend(
        self, x: Number, y: Number, entries: list[tuple[str, Rgb]], *, size: Number = 11
    ) -> Number:
        """Writes colour keys in a row, and returns where it ends."""
        for name, color in entries:
            self.draw.rectangle((x, y + 2, x + 10, y + 12), fill=color, outline=SOFT)
            x += 16 + self.text(x + 16, y, name, size=size, color=INK) + 16
        return x
