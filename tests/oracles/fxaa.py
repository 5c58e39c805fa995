"""FXAA 3.11 quality, one pixel at a time, with positions as the shader moves them.

After Lottes's description: texture coordinates that walk, one bilinear fetch a step.
"""

import math

import numpy as np

STEPS = {
    12: [1, 1.5, 2, 4, 12],
    29: [1, 1.5, 2, 2, 2, 2, 2, 2, 2, 2, 4, 8],
    39: [1, 1, 1, 1, 1, 1.5, 2, 2, 2, 2, 4, 8],
}

TIE = 1e-5  # what ties up to rounding counts as reached


def fetch(image, y, x):
    """Bilinear, clamp to edge; y and x have pixel centres at +0.5."""
    height, width = image.shape[:2]
    y, x = y - 0.5, x - 0.5
    r, c = math.floor(y), math.floor(x)
    total = 0.0
    for row, weight_y in ((r, 1 - (y - r)), (r + 1, y - r)):
        for column, weight_x in ((c, 1 - (x - c)), (c + 1, x - c)):
            row_in = min(max(row, 0), height - 1)
            column_in = min(max(column, 0), width - 1)
            total = total + weight_y * weight_x * image[row_in, column_in]
    return total


def pixel(image, luma, row, column, subpix, threshold, threshold_min, preset):
    y, x = row + 0.5, column + 0.5

    def at(r, c):
        return fetch(luma, y + r, x + c)

    m, n, s, w, e = at(0, 0), at(-1, 0), at(1, 0), at(0, -1), at(0, 1)
    highest, lowest = max(m, n, s, w, e), min(m, n, s, w, e)
    span = highest - lowest
    if span < max(threshold_min, highest * threshold) or span == 0:
        return image[row, column]
    nw, ne, sw, se = at(-1, -1), at(-1, 1), at(1, -1), at(1, 1)
    edge_horizontal = abs(nw + sw - 2 * w) + 2 * abs(n + s - 2 * m)
    edge_horizontal += abs(ne + se - 2 * e)
    edge_vertical = abs(nw + ne - 2 * n) + 2 * abs(w + e - 2 * m)
    edge_vertical += abs(sw + se - 2 * s)
    horizontal = edge_horizontal >= edge_vertical - TIE
    before, after = (n, s) if horizontal else (w, e)
    # Move half a pixel to the side of the larger gradient.
    side = -1.0 if abs(before - m) >= abs(after - m) else 1.0
    pair = (m + (before if side < 0 else after)) / 2
    gradient = max(abs(before - m), abs(after - m))
    start = (y + side / 2, x) if horizontal else (y, x + side / 2)
    ends = []
    for direction in (-1.0, 1.0):
        py, px = start
        walked, value, finished = 0.0, 0.0, False
        for index, step in enumerate(STEPS[preset]):
            if finished:
                break
            walked += step
            if horizontal:
                px += direction * step
            else:
                py += direction * step
            if index + 1 < len(STEPS[preset]):
                value = fetch(luma, py, px) - pair
                finished = abs(value) >= gradient / 4 - TIE
        ends.append((walked, value))
    (back, end_back), (forth, end_forth) = ends
    nearer = end_back if back < forth else end_forth
    good = (nearer < 0) != (m - pair < 0)
    offset = 0.5 - min(back, forth) / (back + forth) if good else 0.0
    lone = abs((2 * (n + s + w + e) + nw + ne + sw + se) / 12 - m) / span
    lone = min(max(lone, 0.0), 1.0)
    offset = max(offset, (lone * lone * (3 - 2 * lone)) ** 2 * subpix)
    if horizontal:
        return fetch(image, y + side * offset, x)
    return fetch(image, y, x + side * offset)


def fxaa(image, params, preset):
    image = image.astype(np.float64)
    luma = image @ np.array([0.2126, 0.7152, 0.0722])
    numbers = (params.subpix, params.edge_threshold, params.edge_threshold_min)
    output = np.zeros_like(image)
    for row, column in np.ndindex(luma.shape):
        output[row, column] = pixel(
            image, luma, row, column, *(float(v) for v in numbers), preset
        )
    return output
