"""Textures of plants, cut out by their alpha: leaves, sprays, tufts, a line of trees.

Shapes are drawn as polygons at `_SUPERSAMPLE` times the size and averaged down, so that
alpha is coverage. Images are as in `images`.
"""

import numpy as np
from skimage.measure import grid_points_in_poly

from ataa_jax.builtin import images
from ataa_jax.builtin.images import Color

_SUPERSAMPLE = 2


class _Canvas:
    """A transparent image to draw polygons on; positions are (x, y) in [0, 1]."""

    def __init__(self, width: int, height: int) -> None:
        self.pixels = np.zeros((height * _SUPERSAMPLE, width * _SUPERSAMPLE, 4))
        self.scale = np.array([width, height], float) * _SUPERSAMPLE

    def fill(self, outline: np.ndarray, color: np.ndarray) -> None:
        """Fills a polygon (n, 2) with an sRGB colour."""
        corners = (outline * self.scale - 0.5)[:, ::-1]  # row, column
        last = np.array(self.pixels.shape[:2]) - 1
        low = np.clip(np.floor(corners.min(axis=0)), 0, last).astype(int)
        high = np.clip(np.ceil(corners.max(axis=0)), 0, last).astype(int)
        inside = grid_points_in_poly(tuple(high - low + 1), corners - low)
        box = self.pixels[low[0] : high[0] + 1, low[1] : high[1] + 1]
        box[inside] = (*np.clip(color, 0.0, 1.0), 1.0)

    def stroke(
        self, start: np.ndarray, end: np.ndarray, width: float, color: np.ndarray
    ) -> None:
        """Draws a straight line of some width."""
        side = _across(end - start) * width / 2.0
        self.fill(np.stack([start - side, start + side, end + side, end - side]), color)

    def finish(self) -> np.ndarray:
        """Shrinks the drawing; hidden texels get the mean colour of the visible."""
        k = _SUPERSAMPLE
        h, w = self.pixels.shape[0] // k, self.pixels.shape[1] // k
        small = self.pixels.reshape(h, k, w, k, 4).mean(axis=(1, 3))
        alpha = small[..., 3:]
        color = small[..., :3] / np.maximum(alpha, 1e-6)
        mean = small[..., :3].sum(axis=(0, 1)) / alpha.sum()
        return np.concatenate([np.where(alpha > 0.0, color, mean), alpha], axis=-1)


def _across(along: np.ndarray) -> np.ndarray:
    return np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-6)


def _leaf(
    canvas: _Canvas,
    base: np.ndarray,
    tip: np.ndarray,
    width: float,
    color: np.ndarray,
) -> None:
    """Draws one pointed leaf with a lighter half and a midrib."""
    s = np.linspace(0.0, 1.0, 6)[:, None]
    along = tip - base
    bulge = width * np.sin(np.pi * s**0.8) * (1.0 - 0.25 * s)
    spine = base + along * s
    for side, gain in ((1.0, 0.86), (-1.0, 1.12)):
        edge = spine + side * bulge * _across(along)
        canvas.fill(np.concatenate([edge, spine[::-1]]), color * gain)
    canvas.stroke(base, tip, 0.1 * width, color * 1.3)


def foliage(dark: Color, light: Color, seed: int, leaves: int = 90) -> np.ndarray:
    """Returns a spray of small leaves on twigs, 256 by 256, its root at the bottom."""
    random = np.random.default_rng(seed)
    canvas = _Canvas(256, 256)
    root = np.array([0.5, 0.98])
    d, c = np.array(dark), np.array(light)
    twigs = []
    for angle in np.linspace(-1.15, 1.15, 9) + random.normal(0, 0.06, 9):
        reach = (0.62 + 0.3 * np.cos(angle)) * random.uniform(0.85, 1.0)
        tip = root + reach * np.array([np.sin(angle), -np.cos(angle)])
        twigs.append(np.clip(tip, 0.06, 0.96))
        canvas.stroke(root, twigs[-1], 0.006, d * 0.8)
    for k in range(leaves):
        tip = twigs[k % len(twigs)]
        base = root + (tip - root) * random.uniform(0.3, 1.0)
        heading = np.arctan2(*(tip - root)[::-1]) + random.choice([-1, 1]) * 0.9
        heading += random.normal(0, 0.35)
        length = random.uniform(0.10, 0.17)
        end = base + length * np.array([np.cos(heading), np.sin(heading)])
        _leaf(canvas, base, end, 0.028, d + (c - d) * random.random())
    return canvas.finish()


def blade(dark: Color, light: Color) -> np.ndarray:
    """Returns one long leaf with a midrib and side veins, 64 by 256."""
    canvas = _Canvas(64, 256)
    color = (np.array(dark) + np.array(light)) / 2.0
    s = np.linspace(0.0, 1.0, 25)
    half = 0.46 * np.sin(np.pi * s**0.75) ** 0.8
    y = 0.995 - 0.99 * s
    for side, gain in ((-1.0, 0.85), (1.0, 1.1)):
        x = 0.5 + side * half
        outline = np.stack([np.append(x, 0.5), np.append(y, y[-1])], axis=1)
        canvas.fill(np.concatenate([outline, [[0.5, y[0]]]]), color * gain)
        for i in range(2, 22, 2):
            vein = np.stack([[0.5, y[i]], [0.5 + side * half[i] * 0.9, y[i] - 0.05]])
            canvas.stroke(vein[0], vein[1], 0.006, color * 1.25)
    canvas.stroke(np.array([0.5, y[0]]), np.array([0.5, y[-1]]), 0.05, np.array(light))
    return canvas.finish()


def tuft(dark: Color, light: Color, seed: int, count: int = 44) -> np.ndarray:
    """Returns a tuft of grass blades, 256 by 256."""
    random = np.random.default_rng(seed)
    canvas = _Canvas(256, 256)
    d, c = np.array(dark), np.array(light)
    s = np.linspace(0.0, 1.0, 6)
    for _ in range(count):
        x = random.normal(0.5, 0.13)
        lean, height = random.normal(0, 0.2), random.uniform(0.35, 0.95)
        spine = np.stack([x + (x - 0.5) * 0.4 * s + lean * s**2, 1.0 - height * s], 1)
        half = np.stack([0.012 * (1.0 - s) + 0.0015, np.zeros_like(s)], axis=1)
        outline = np.concatenate([spine - half, (spine + half)[::-1]])
        canvas.fill(outline, d + (c - d) * random.random())
    return canvas.finish()


def treeline(dark: Color, light: Color, seed: int) -> np.ndarray:
    """Returns the ragged tops of far trees, repeating in u, 128 by 512."""
    height, width = 128, 512
    random = np.random.default_rng(seed)
    bumps = images.noise(width, 12, seed, 5)[0] * 0.55
    bumps = bumps + images.noise(width, 5, seed + 1)[7] * 0.5
    top = 0.75 - bumps * 0.75
    v = (np.arange(height) + 0.5)[:, None] / height
    depth = v - top[None]
    alpha = np.clip(depth * 40.0 + 0.5, 0.0, 1.0)
    speckle = images.noise(width, 48, seed + 2, 3)[:height] * 0.7
    speckle = speckle + random.random((height, width)) * 0.3
    value = speckle * np.clip(1.1 - depth * 1.1, 0.25, 1.0)
    color = images.tint(value, dark, light)
    return np.concatenate([color, alpha[..., None]], axis=2)
