"""Image quality against a reference, on display-referred sRGB images in [0, 1].

SSIM is scikit-image's with the settings of Wang et al. (2004). Its mean leaves out a
border of five pixels, just where screen-edge disocclusion lives: `border_error` is
given beside it.
"""

import importlib.util
from typing import cast

import numpy as np

SSIM_MIN_SIZE = 11  # the Gaussian window of σ = 1.5, truncated at 3.5 σ
BORDER = 5


def ssim(image: np.ndarray, reference: np.ndarray) -> float:
    """Returns the mean structural similarity, NaN under 11 pixels a side.

    Args:
        image: (h, w, 3) sRGB in [0, 1].
        reference: the same shape.
    """
    from skimage.metrics import structural_similarity  # here: it imports slowly

    if min(image.shape[:2]) < SSIM_MIN_SIZE:
        return float("nan")
    return float(
        cast(
            float,
            structural_similarity(
                image,
                reference,
                gaussian_weights=True,
                sigma=1.5,
                use_sample_covariance=False,
                data_range=1.0,
                channel_axis=-1,
            ),
        )
    )


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Returns the peak signal-to-noise ratio in dB, inf for equal images."""
    error = mean_squared_error(image, reference)
    return float("inf") if error == 0.0 else float(-10.0 * np.log10(error))


def mean_squared_error(
    image: np.ndarray, reference: np.ndarray, where: np.ndarray | None = None
) -> float:
    """Returns the mean squared error, over the pixels of `where`; NaN if empty."""
    squared = np.mean(
        (image.astype(np.float64) - reference.astype(np.float64)) ** 2, axis=-1
    )
    if where is None:
        return float(squared.mean())
    return float(squared[where].mean()) if where.any() else float("nan")


def border_error(image: np.ndarray, reference: np.ndarray) -> float:
    """Returns the mean squared error in the outer five pixels that SSIM leaves out."""
    inner = np.ones(image.shape[:2], bool)
    inner[BORDER:-BORDER, BORDER:-BORDER] = False
    return mean_squared_error(image, reference, inner)


def flicker(
    image: np.ndarray,
    previous: np.ndarray,
    motion: np.ndarray,
    motion_valid: np.ndarray,
) -> float:
    """Returns the mean absolute change of a point's colour from frame to frame.

    Args:
        image: (h, w, 3) sRGB of this frame.
        previous: the same of the frame before.
        motion: (h, w, 2) previous − current position in px.
        motion_valid: (h, w); pixels without a previous position are left out.

    Returns:
        The mean over channels and pixels, in [0, 1]; what the reference shows itself
        (moving shadows, parallax at edges) is part of it: compare with its row.
    """
    change = change_along_motion(image, previous, motion)
    return float(change[motion_valid].mean()) if motion_valid.any() else float("nan")


def change_along_motion(
    image: np.ndarray, previous: np.ndarray, motion: np.ndarray
) -> np.ndarray:
    """Returns the absolute change of each point's colour, the mean over channels.

    Arguments as `flicker`'s; the frame before is read bilinearly, clamped to edge.
    Any image will do: of two errors it tells how the error changes.
    """
    height, width = motion.shape[:2]
    y, x = np.mgrid[0:height, 0:width]
    at_x, at_y = x + motion[..., 0], y + motion[..., 1]
    x0 = np.clip(np.floor(at_x), 0, width - 1).astype(int)
    y0 = np.clip(np.floor(at_y), 0, height - 1).astype(int)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    fx = np.clip(at_x - x0, 0.0, 1.0)[..., None]
    fy = np.clip(at_y - y0, 0.0, 1.0)[..., None]
    top = previous[y0, x0] * (1 - fx) + previous[y0, x1] * fx
    bottom = previous[y1, x0] * (1 - fx) + previous[y1, x1] * fx
    return np.abs(image - (top * (1 - fy) + bottom * fy)).mean(axis=-1)


def flip(image: np.ndarray, reference: np.ndarray) -> float:
    """Returns the mean LDR-FLIP error, NaN where `flip-evaluator` is not installed."""
    if not flip_available():
        return float("nan")
    if image is reference:
        return 0.0
    import flip_evaluator

    _, mean, _ = flip_evaluator.evaluate(
        np.array(reference, np.float32, order="C"),  # it wants to own what it reads
        np.array(image, np.float32, order="C"),
        "LDR",
        inputsRGB=True,
        applyMagma=False,
    )
    return float(mean)


def flip_available() -> bool:
    """Returns whether the optional package `flip-evaluator` is installed."""
    return importlib.util.find_spec("flip_evaluator") is not None
