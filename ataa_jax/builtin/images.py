"""Textures of surfaces: drawn by code, or photographs that come with scikit-image.

Images are float arrays (height, width, 3 or 4), sRGB-encoded, in [0, 1], until `texels`
turns them into the uint8 RGBA that `scene.TextureSource` holds. All repeat seamlessly.
"""

import numpy as np
from skimage import data

Color = tuple[float, float, float]


def texels(image: np.ndarray) -> np.ndarray:
    """Returns uint8 (h, w, 4); images without alpha become opaque."""
    if image.shape[2] == 3:
        image = np.concatenate([image, np.ones((*image.shape[:2], 1))], axis=2)
    return np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def normals(height: np.ndarray, strength: float) -> np.ndarray:
    """Returns a glTF normal map (green up) of a height field that repeats."""
    dx = _sobel(height, axis=1) * strength
    dy = _sobel(height, axis=0) * strength
    n = np.stack([-dx, dy, np.ones_like(dx)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return n * 0.5 + 0.5


def _sobel(image: np.ndarray, axis: int) -> np.ndarray:
    """Derives along one axis and smooths along the other; the border wraps."""
    slope = np.roll(image, -1, axis) - np.roll(image, 1, axis)
    other = 1 - axis
    return (2 * slope + np.roll(slope, 1, other) + np.roll(slope, -1, other)) / 8.0


def noise(size: int, cells: int, seed: int, octaves: int = 4) -> np.ndarray:
    """Returns smooth value noise (size, size) that repeats, in about [0, 1]."""
    random = np.random.default_rng(seed)
    total, weight = np.zeros((size, size)), 0.0
    for octave in range(octaves):
        n = cells << octave
        if n > size:
            break
        lattice = random.random((n, n))
        x = np.arange(size) * n / size
        i = x.astype(int)
        f = x - i
        f = f * f * (3.0 - 2.0 * f)
        j = (i + 1) % n
        rows = lattice[i] * (1 - f)[:, None] + lattice[j] * f[:, None]
        total += (rows[:, i] * (1 - f) + rows[:, j] * f) * 0.5**octave
        weight += 0.5**octave
    return total / weight


def tint(grey: np.ndarray, dark: Color, light: Color) -> np.ndarray:
    """Maps grey in [0, 1] to colours from dark to light."""
    d, c = np.array(dark), np.array(light)
    return d + (c - d) * np.clip(grey, 0.0, 1.0)[..., None]


def _photograph(name: str) -> np.ndarray:
    """Returns a grey photograph, made to repeat, without broad light and shade."""
    image = getattr(data, name)().astype(float) / 255.0
    spectrum = np.fft.rfft2(image)
    frequency = np.hypot(
        np.fft.fftfreq(image.shape[0])[:, None], np.fft.rfftfreq(image.shape[1])[None]
    )
    broad = frequency < 4.0 / image.shape[0]
    spectrum[broad & (frequency > 0)] *= 0.25
    image = np.fft.irfft2(spectrum, image.shape)
    # A shifted copy, whose seams lie in the middle, covers the seams at the border.
    size = image.shape[0]
    edge = np.minimum(np.arange(size), size - 1 - np.arange(size))
    keep = np.clip(edge / 48.0, 0.0, 1.0)
    keep = np.minimum(keep[:, None], keep[None, :])
    shifted = np.roll(image, (size // 2, size // 2 + 37), axis=(0, 1))
    mean = image.mean()
    mixed = (image - mean) * keep + (shifted - mean) * (1.0 - keep)
    # Blending two independent images loses contrast; this gives it back.
    return mean + mixed / np.sqrt(keep**2 + (1.0 - keep) ** 2)


def grass() -> tuple[np.ndarray, np.ndarray]:
    """Returns lawn: colour and normal map."""
    grey = _photograph("grass")
    patch = noise(512, 4, seed=1)
    color = tint(grey * 1.25 - 0.08, (0.09, 0.16, 0.05), (0.50, 0.62, 0.27))
    dry = np.array([1.10, 1.0, 0.78])
    return color * (1.0 + (dry - 1.0) * patch[..., None]), normals(grey, 3.0)


def gravel() -> tuple[np.ndarray, np.ndarray]:
    """Returns pale gravel: colour and normal map."""
    grey = _photograph("gravel")
    color = tint(grey * 1.2 - 0.05, (0.30, 0.27, 0.23), (0.95, 0.91, 0.83))
    return color, normals(grey, 4.0)


def _mottled(size: int, seed: int) -> np.ndarray:
    fine = np.random.default_rng(seed).random((size, size))
    return 0.6 * noise(size, 8, seed) + 0.4 * fine


def brick() -> tuple[np.ndarray, np.ndarray]:
    """Returns brickwork in running bond, 4 bricks by 12 courses: 0.96 m by 0.96 m."""
    size, columns, courses = 512, 4, 12
    random = np.random.default_rng(3)
    y = (np.arange(size) + 0.5) / size * courses
    course = y.astype(int)
    x = (np.arange(size) + 0.5)[None, :] / size * columns + 0.5 * (course % 2)[:, None]
    column = np.floor(x).astype(int) % columns
    # Distance from the joint in metres: a course is 8 cm, a brick 24 cm, a joint 1 cm.
    inner = np.minimum(
        (0.5 - np.abs(x % 1.0 - 0.5)) * 0.24,
        (0.5 - np.abs(y % 1 - 0.5))[:, None] * 0.08,
    )
    body = np.clip((inner - 0.004) / 0.003, 0.0, 1.0)
    tone = random.random((courses, columns))[course[:, None], column]
    hue = random.random((courses, columns))[course[:, None], column]
    face = tint(tone, (0.42, 0.20, 0.14), (0.69, 0.38, 0.27))
    face = face + (hue[..., None] - 0.5) * np.array([0.04, 0.07, 0.08])
    face = face * (0.82 + 0.36 * _mottled(size, 4))[..., None]
    mortar = tint(_mottled(size, 5), (0.60, 0.57, 0.52), (0.80, 0.77, 0.71))
    color = mortar + (face - mortar) * body[..., None]
    return color, normals(body + 0.15 * _mottled(size, 4), 2.0)


def boards(
    dark: Color, light: Color, seed: int, count: int = 8, gap: float = 0.05
) -> tuple[np.ndarray, np.ndarray]:
    """Returns boards side by side along u, grain along v: colour and normal map.

    Args:
        dark: colour of the darkest grain.
        light: colour of the lightest board.
        seed: of the grain.
        count: boards in one repeat.
        gap: share of a board's width that the joint takes.
    """
    size = 512
    random = np.random.default_rng(seed)
    x = (np.arange(size) + 0.5) / size * count
    board = x.astype(int)
    across = x % 1.0
    wide = noise(size, 4, seed, octaves=2)
    streaks = random.random((1, size)) * 0.5 + noise(size, 64, seed + 1, 1) * 0.5
    sway = np.round(wide * 24).astype(int)
    grain = streaks[0][(np.arange(size)[None] + sway) % size]
    tone = random.random(count)[board][None, :]
    knots = np.clip(1.0 - 6.0 * np.abs(noise(size, 6, seed + 2, 2) - 0.78), 0, 1)
    value = 0.45 * tone + 0.35 * grain + 0.2 * wide - 0.3 * knots**4
    joint = np.clip((0.5 - np.abs(across - 0.5)) / gap - 0.5, 0.0, 1.0)[None, :]
    color = tint(value, dark, light) * (0.12 + 0.88 * joint)[..., None]
    return color, normals(joint + 0.06 * grain, 2.5)


def plaster() -> tuple[np.ndarray, np.ndarray]:
    """Returns white render with a faint grain: colour and normal map."""
    grain = _mottled(256, 8)
    stain = noise(256, 3, seed=9)
    color = tint(0.4 * grain + 0.6 * stain, (0.86, 0.85, 0.82), (0.95, 0.94, 0.92))
    return color, normals(grain, 0.5)


def paving() -> tuple[np.ndarray, np.ndarray]:
    """Returns stone slabs, 2 by 3 in a repeat: colour and normal map."""
    size = 512
    y = (np.arange(size) + 0.5) / size * 3.0
    row = y.astype(int)
    x = (np.arange(size) + 0.5)[None] / size * 2.0 + np.array([0.0, 0.35, 0.7])[
        row, None
    ]
    inner = np.minimum(
        0.5 - np.abs(x % 1.0 - 0.5), (0.5 - np.abs(y % 1.0 - 0.5))[:, None]
    )
    body = np.clip((inner - 0.008) / 0.012, 0.0, 1.0)
    tone = np.random.default_rng(11).random((3, 2))[
        row[:, None], np.floor(x).astype(int) % 2
    ]
    value = 0.35 * tone + 0.65 * _mottled(size, 12)
    color = tint(value, (0.50, 0.48, 0.45), (0.80, 0.78, 0.73))
    color = color * (0.35 + 0.65 * body)[..., None]
    return color, normals(body + 0.1 * _mottled(size, 12), 1.5)


def stripes(first: Color, second: Color) -> np.ndarray:
    """Returns awning cloth: three pairs of stripes in a repeat, along v."""
    x = (np.arange(256) + 0.5) / 256 * 3.0 % 1.0
    weave = 0.94 + 0.06 * np.random.default_rng(13).random((256, 256))
    row = np.where((x < 0.5)[:, None], np.array(first), np.array(second))
    return np.tile(row[None], (256, 1, 1)) * weave[..., None]


def sailcloth() -> np.ndarray:
    """Returns sail cloth: sewn panels, one in a repeat along v."""
    v = (np.arange(256) + 0.5) / 256
    seam = 1.0 - 0.16 * (np.abs(v - 0.5) < 0.012) - 0.08 * (np.abs(v - 0.46) < 0.008)
    tone = 0.97 + 0.03 * noise(256, 4, seed=14)
    return np.array([0.96, 0.93, 0.86]) * (tone * seam[:, None])[..., None]


def ripples() -> np.ndarray:
    """Returns a normal map of small waves, by a sum of waves that repeat."""
    size = 256
    random = np.random.default_rng(15)
    y, x = np.mgrid[:size, :size] / size * 2.0 * np.pi
    height = np.zeros((size, size))
    for _ in range(48):
        kx, ky = random.integers(-9, 10), random.integers(2, 16)
        length = np.hypot(kx, ky)
        height += np.sin(kx * x + ky * y + random.random() * 2 * np.pi) / length**1.3
    return normals(height, 1.6)


def pane() -> np.ndarray:
    """Returns window glass: a dark room, and trees and sky that it mirrors."""
    size = 256
    v = (np.arange(size) + 0.5)[:, None] / size
    trees = 0.52 + 0.16 * (noise(size, 6, seed=16) - 0.5) * 2.0
    above = np.clip((trees - v) * 14.0, 0.0, 1.0)
    sky = tint(
        np.broadcast_to(1.0 - v, above.shape), (0.42, 0.50, 0.56), (0.25, 0.34, 0.45)
    )
    dark = tint(noise(size, 16, seed=17), (0.06, 0.09, 0.07), (0.15, 0.19, 0.13))
    return dark + (sky - dark) * above[..., None]
