"""TAA pixel by pixel in float64, from the definitions: Karis 2014, Salvi 2016."""

import numpy as np

MAX_RADIANCE = 65504.0
LOOK_ORDER = [(r, c) for r in (0, -1, 1) for c in (0, -1, 1)]


def enter(color, weighting):
    color = np.nan_to_num(color, nan=0.0, posinf=MAX_RADIANCE, neginf=0.0)
    color = np.clip(color, 0.0, MAX_RADIANCE).astype(np.float64)
    if weighting == "tonemap":
        color = color / (1.0 + color.max(axis=-1, keepdims=True))
    return color


def leave(value, weighting):
    if weighting == "tonemap":
        value = value / (1.0 - value.max(axis=-1, keepdims=True))
    return np.clip(value, 0.0, MAX_RADIANCE)


def keys_cubic(t):
    """Keys' interpolating kernel with a = −1/2, which is Catmull-Rom's."""
    t = abs(t)
    if t < 1:
        return 1.5 * t**3 - 2.5 * t**2 + 1
    if t < 2:
        return -0.5 * t**3 + 2.5 * t**2 - 4 * t + 2
    return 0.0


def hat(t):
    return max(0.0, 1.0 - abs(t))


def at(image, row, column):
    height, width = image.shape[:2]
    return image[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]


def sample(image, row, column, kernel, weighting):
    total = np.zeros(3)
    for r in range(int(np.floor(row)) - 1, int(np.floor(row)) + 3):
        for c in range(int(np.floor(column)) - 1, int(np.floor(column)) + 3):
            total += kernel(row - r) * kernel(column - c) * at(image, r, c)
    top = MAX_RADIANCE / (1 + MAX_RADIANCE) if weighting == "tonemap" else MAX_RADIANCE
    return np.clip(total, 0.0, top)


def to_space(rgb, space):
    if space == "rgb":
        return rgb
    r, g, b = rgb
    return np.array([r / 4 + g / 2 + b / 4, (r - b) / 2, -r / 4 + g / 2 - b / 4])


def from_space(value, space):
    if space == "rgb":
        return value
    y, co, cg = value
    return np.array([y + co - cg, y + cg, y - co - cg])


def one_box(values, offsets, rectify, gamma):
    values = np.array([values[o] for o in offsets])
    if rectify == "variance_clip":
        mean, sigma = values.mean(axis=0), values.std(axis=0)
        return mean - gamma * sigma, mean, mean + gamma * sigma
    low, high = values.min(axis=0), values.max(axis=0)
    return low, (low + high) / 2, high


def box_of(values, config, gamma):
    square = [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)]
    plus = [(r, c) for r, c in square if abs(r) + abs(c) <= 1]
    shapes = {"box": [square], "plus": [plus], "rounded": [square, plus]}
    boxes = [
        one_box(values, offsets, config.rectify, gamma)
        for offsets in shapes[config.neighbourhood]
    ]
    return [np.mean(part, axis=0) for part in zip(*boxes, strict=True)]


def rectified(history, now, row, column, config, gamma):
    if config.rectify == "none":
        return history, None
    values = {
        (r, c): to_space(at(now, row + r, column + c), config.space)
        for r, c in LOOK_ORDER
    }
    low, centre, high = box_of(values, config, gamma)
    h = to_space(history, config.space)
    if config.rectify == "clamp":
        h = np.clip(h, low, high)
    else:
        share = 1.0
        for k in range(3):
            reach, d = (high[k] - low[k]) / 2, abs(h[k] - centre[k])
            if d > max(reach, 1e-6):
                share = min(share, max(reach, 1e-6) / d)
        h = centre + share * (h - centre)
    return np.maximum(from_space(h, config.space), 0.0), (low, high)


def filtered(now, row, column, jitter, config):
    if config.current_filter == "none":
        return at(now, row, column)
    total, norm = np.zeros(3), 0.0
    for r, c in LOOK_ORDER:
        value = at(now, row + r, column + c)
        squared = (r + jitter[1]) ** 2 + (c + jitter[0]) ** 2
        weight = np.exp(-2.29 * squared) * luma_weight(value, config)
        total, norm = total + weight * value, norm + weight
    return total / norm


def luma_weight(value, config):
    if config.weighting != "luma":
        return 1.0
    return 1.0 / (4.0 + value[0] + 2.0 * value[1] + value[2])


def leading_motion(motion, valid, depth, row, column, config):
    lead, nearest = (row, column), depth[row, column]
    usable = valid[row, column]
    if config.motion == "nearest_depth":
        for r, c in LOOK_ORDER:
            height, width = depth.shape
            y = min(max(row + r, 0), height - 1)
            x = min(max(column + c, 0), width - 1)
            if valid[y, x] and depth[y, x] < nearest:
                lead, nearest, usable = (y, x), depth[y, x], True
    return motion[lead], usable


def taa(history, color, gbuffer, jitter, params, config):
    """Returns (color, reprojected, count, valid), arrays; inputs are NumPy pytrees."""
    now = enter(color, config.weighting)
    then = enter(history.color, config.weighting)
    height, width = now.shape[:2]
    blended, read = np.zeros_like(now), np.zeros_like(now)
    count, valid = np.ones((height, width)), np.zeros((height, width), bool)
    kernel = hat if config.history_filter == "bilinear" else keys_cubic
    for row in range(height):
        for column in range(width):
            m, usable = leading_motion(
                gbuffer.motion, gbuffer.motion_valid, gbuffer.depth, row, column, config
            )
            y, x = row + 0.5 + float(m[1]), column + 0.5 + float(m[0])
            usable &= bool(history.valid) and 0 <= y <= height and 0 <= x <= width
            current = filtered(now, row, column, jitter, config)
            if not usable:
                blended[row, column] = current
                read[row, column] = now[row, column]
                continue
            valid[row, column] = True
            h = sample(then, y - 0.5, x - 0.5, kernel, config.weighting)
            read[row, column] = h
            h, box = rectified(
                h, now, row, column, config, float(params.variance_gamma)
            )
            if config.clamp_current and box is not None:
                inner = np.clip(to_space(current, config.space), *box)
                current = np.maximum(from_space(inner, config.space), 0.0)
            frames = at(history.count, int(np.floor(y)), int(np.floor(x)))
            frames, limit = float(frames), float(params.count_limit)
            if frames > limit:
                count[row, column] = max(frames - 1, limit)
            else:
                count[row, column] = min(frames + 1, limit)
            if config.blend == "accumulate":
                a = 1.0 / (frames + 1.0)
            else:
                speed = min(np.hypot(*m) / float(params.motion_px), 1.0)
                a = float(params.current_weight) * (1 - speed)
                a += float(params.current_weight_moving) * speed
            w_c = a * luma_weight(current, config)
            w_h = (1 - a) * luma_weight(h, config)
            blended[row, column] = (w_c * current + w_h * h) / (w_c + w_h)
    return leave(blended, config.weighting), leave(read, config.weighting), count, valid
