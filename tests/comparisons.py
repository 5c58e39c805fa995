"""A comparison without a renderer: a picket fence and a disc, drawn by formula."""

import numpy as np

from ataa_jax import metrics
from ataa_jax.compare import REFERENCE, Comparison, Score
from ataa_jax.methods import Options

SAMPLES = {
    "none": 1,
    "fxaa": 1,
    "taa": 2,
    "ataa2": 2,
    "ataa8": 6,
    "ssaa4": 4,
    "ssaa8": 8,
}


def draw(size: tuple[int, int], frame: int, samples: int) -> np.ndarray:
    """Returns float64 sRGB (h, w, 3): sky, a disc and thin slanted bars."""
    height, width = size
    total = np.zeros((height, width, 3))
    for s in range(samples):
        x, y = (s + 0.5) / samples, (s * 0.618 + 0.5) % 1.0
        row, column = np.mgrid[:height, :width].astype(np.float64)
        v, u = (row + y) / height, (column + x + 1.3 * frame) / height
        image = np.stack([0.45 + 0.3 * v, 0.6 + 0.2 * v, 0.9 - 0.2 * v], axis=-1)
        disc = (u - 1.0) ** 2 + (v - 0.5) ** 2 < 0.12
        stripes = np.sin(220.0 * (u + 0.3 * v) ** 2) > 0
        image[disc] = np.where(stripes, 0.8, 0.25)[disc][:, None] * (1.0, 0.7, 0.5)
        bars = np.abs((u * 9.0 + v * 1.7) % 1.0 - 0.5) < 0.035
        image[bars & (v > 0.3)] = (0.12, 0.13, 0.15)
        total += image
    return total / samples


def comparison(
    size: tuple[int, int] = (36, 64), frames: int = 2, **options: object
) -> Comparison:
    """Returns a whole comparison, masks and times included, from fixed numbers."""
    result = Comparison(
        scene="picket fence",
        path="walk",
        size=size,
        options=Options(frames=frames, reference_samples=16, **options),  # type: ignore[arg-type]
        notes=["no light in the scene: a sun was supplied", "<b>not</b> markup"],
    )
    random = np.random.default_rng(0)
    for frame in range(frames):
        truth = draw(size, frame, 16).astype(np.float32)
        edge = np.abs(np.diff(truth.mean(-1), axis=1, prepend=0.5)) > 0.08
        mask = np.where(edge, 2, 1).astype(np.uint8)
        mask[:, -max(size[1] // 32, 1) :] = 0
        why = np.where(edge, 8 + 16 * (random.random(size) < 0.5), 0).astype(np.uint16)
        why[mask == 0] = 1
        for name, samples in SAMPLES.items():
            image = draw(size, frame, samples).astype(np.float32)
            adaptive = name.startswith("ataa")
            if adaptive:
                result.masks.setdefault(name, []).append(mask)
                result.whys.setdefault(name, []).append(why)
            _add(result, name, frame, image, truth, mask if adaptive else None)
        _add(result, REFERENCE, frame, truth, truth, None)
    for name in SAMPLES:
        result.stage_ms[name] = {"raster": [3.0, 5.0, 4.0], "rest": [1.0]}
    result.peak_memory_bytes = 3 << 28
    return result


def _add(
    result: Comparison,
    name: str,
    frame: int,
    image: np.ndarray,
    truth: np.ndarray,
    mask: np.ndarray | None,
) -> None:
    shares = {}
    if mask is not None:
        fxaa, taa, ataa = (float(np.mean(mask == value)) for value in range(3))
        shares = {"fxaa_share": fxaa, "taa_share": taa, "ataa_share": ataa}
        shares["rays_per_pixel"] = ataa * int(name[-1])
    elif name.startswith("ssaa"):
        shares["rays_per_pixel"] = float(name[-1])
    result.scores.append(
        Score(
            method=name,
            frame=frame,
            ssim=metrics.ssim(image, truth),
            psnr=metrics.psnr(image, truth),
            flip=float(np.abs(image - truth).mean()),
            flicker=float("nan") if frame == 0 else 1e-3 * (1.0 + len(name)),
            border_mse=metrics.border_error(image, truth),
            thin_mse=metrics.mean_squared_error(image, truth),
            **shares,
        )
    )
    result.images.setdefault(name, []).append(
        np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    )
