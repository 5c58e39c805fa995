"""Which parts of a frame a figure shows enlarged: where TAA is most wrong."""

from dataclasses import dataclass

import numpy as np

from ataa_jax import metrics
from ataa_jax.compare import REFERENCE, Comparison


@dataclass(frozen=True)
class Crop:
    """A window of the image, in pixels."""

    name: str  # A, B, C, …
    row: int
    column: int
    height: int
    width: int

    def of(self, image: np.ndarray) -> np.ndarray:
        """Returns the window's part of an image."""
        return image[
            self.row : self.row + self.height, self.column : self.column + self.width
        ]


def choose(
    comparison: Comparison,
    frame: int,
    *,
    count: int = 4,
    size: tuple[int, int] = (36, 64),
    method: str | None = None,
) -> list[Crop]:
    """Returns windows that do not overlap, where a method's squared error is greatest.

    In images of many windows they also keep a window's distance from each other. They
    are chosen by the error of `method` alone, never by what ATAA gains there, so that
    its failures are shown as well. Of equal windows the first in reading order is
    taken.

    Args:
        comparison: images of the method and the reference.
        frame: index of the frame.
        count: how many at most; fewer where no more fit.
        size: (height, width) of a window; cut to the image's.
        method: whose error; `worst_case` by default.
    """
    method = worst_case(comparison) if method is None else method
    image, truth = (
        comparison.images[name][frame].astype(np.float64)
        for name in (method, REFERENCE)
    )
    height, width = min(size[0], image.shape[0]), min(size[1], image.shape[1])
    # Else all would lie side by side on the one worst object.
    spread = 2 if image.shape[0] >= 8 * height and image.shape[1] >= 8 * width else 1
    error = _box_sums(np.mean((image - truth) ** 2, axis=-1), height, width)
    crops = []
    while len(crops) < count and np.isfinite(error).any():
        row, column = np.unravel_index(int(np.argmax(error)), error.shape)
        row, column = int(row), int(column)
        crops.append(Crop("ABCDEFGH"[len(crops)], row, column, height, width))
        error[
            max(row - spread * height + 1, 0) : row + spread * height,
            max(column - spread * width + 1, 0) : column + spread * width,
        ] = -np.inf
    # In reading order, left to right, the letters are easier to find in the picture.
    crops.sort(key=lambda crop: (crop.column, crop.row))
    return [
        Crop("ABCDEFGH"[i], crop.row, crop.column, crop.height, crop.width)
        for i, crop in enumerate(crops)
    ]


def worst_case(comparison: Comparison) -> str:
    """Returns whose error chooses the windows: TAA, or what comes closest to it."""
    for name in ("taa", "taa_ue4", "none", "fxaa"):
        if name in comparison.images:
            return name
    return next(name for name in comparison.images if name != REFERENCE)


def score(image: np.ndarray, truth: np.ndarray) -> tuple[str, float]:
    """Returns a window's measure and its value: SSIM, or MSE where it is too small.

    Args:
        image: uint8 (h, w, 3).
        truth: the same shape.
    """
    a, b = (part.astype(np.float32) / np.float32(255.0) for part in (image, truth))
    if min(image.shape[:2]) >= metrics.SSIM_MIN_SIZE:
        return "SSIM", metrics.ssim(a, b)
    return "MSE", metrics.mean_squared_error(a, b)


def _box_sums(values: np.ndarray, height: int, width: int) -> np.ndarray:
    """Returns the sum over every whole window, indexed by its first row and column."""
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    total[1:, 1:] = values.cumsum(0).cumsum(1)
    return (
        total[height:, width:]
        - total[:-height, width:]
        - total[height:, :-width]
        + total[:-height, :-width]
    )
