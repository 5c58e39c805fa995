"""Segmentation pixel by pixel, in the order that the paper tells it."""

import numpy as np

LUMA = np.array([0.2126, 0.7152, 0.0722])
SOBEL = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]], float)


def at(image, row, column):
    height, width = image.shape[:2]
    return image[min(max(row, 0), height - 1), min(max(column, 0), width - 1)]


def window(image, row, column):
    return np.array(
        [[at(image, row + r, column + c) for c in (-1, 0, 1)] for r in (-1, 0, 1)]
    )


def luminance_term(color, reprojected, row, column, floor):
    means = []
    for image in (color, reprojected):
        mapped = image / (1.0 + image.max(axis=-1, keepdims=True))
        means.append(window(mapped @ LUMA, row, column).mean())
    larger = max(means)
    return 0.0 if larger < floor else abs(means[0] - means[1]) / larger


def depth_term(depth, row, column):
    inverse = 1.0 / window(depth.astype(float), row, column)
    if inverse.max() == 0.0:
        return 0.0
    gradient = np.hypot((SOBEL * inverse).sum(), (SOBEL.T * inverse).sum())
    return gradient / (8.0 * inverse.max())


def normal_term(normal, row, column):
    own = at(normal, row, column).astype(float)
    nine = window(normal.astype(float), row, column).reshape(9, 3)
    angles = [
        np.arctan2(np.linalg.norm(np.cross(own, other)), own @ other)
        for other in nine
        if own.any() and other.any()
    ]
    return max(angles, default=0.0) / np.pi


def id_term(ids, row, column):
    return float(len(np.unique(window(ids, row, column))) > 1)


def spread_term(color, reprojected, row, column, floor):
    means, deviations = [], []
    for image in (color, reprojected):
        mapped = image / (1.0 + image.max(axis=-1, keepdims=True))
        nine = window(mapped @ LUMA, row, column)
        means.append(nine.mean())
        deviations.append(nine.std())
    if max(means) < floor:
        return 0.0
    return abs(deviations[0] - deviations[1]) / (np.sqrt(8.0) * max(means))


def terms(color, gbuffer, reprojected, row, column, p, config):
    """Returns (why-bit, term, weight, threshold of "either") of what is switched on."""
    found = []
    if config.use_luminance:
        term = luminance_term(color, reprojected, row, column, p.luminance_floor)
        found.append((8, term, p.luminance_weight, p.luminance_threshold))
    if config.use_depth:
        term = depth_term(gbuffer.depth, row, column)
        found.append((16, term, p.depth_weight, p.depth_threshold))
    if config.use_normal:
        term = normal_term(gbuffer.normal, row, column)
        found.append((128, term, p.normal_weight, p.normal_threshold))
    if config.use_object:
        found.append((256, id_term(gbuffer.object, row, column), p.object_weight, 0.5))
    if config.use_material:
        term = id_term(gbuffer.material, row, column)
        found.append((512, term, p.material_weight, 0.5))
    if config.use_spread:
        term = spread_term(color, reprojected, row, column, p.luminance_floor)
        found.append((1024, term, p.spread_weight, p.spread_threshold))
    return found


def segmentation(state, color, gbuffer, reprojected, params, config):
    """Returns (method, hold counter, why, score), arrays; inputs are NumPy pytrees."""
    height, width = gbuffer.depth.shape
    method, hold = np.zeros((2, height, width), int)
    why, score = np.zeros((height, width), int), np.zeros((height, width))
    color, reprojected = color.astype(float), reprojected.astype(float)
    p = params
    for row in range(height):
        for column in range(width):
            m = gbuffer.motion[row, column].astype(float)
            y, x = row + 0.5 + m[1], column + 0.5 + m[0]
            seen = bool(state.history.valid) and bool(gbuffer.motion_valid[row, column])
            if not (seen and 0 <= y <= height and 0 <= x <= width):
                why[row, column] = 1
                continue
            y, x = int(np.floor(y)), int(np.floor(x))
            reach = (-1, 0, 1) if config.disocclusion == "neighbourhood" else (0,)
            motions = [
                at(state.history.motion, y + r, x + c).astype(float)
                for r in reach
                for c in reach
            ]
            m_then = min(motions, key=lambda then: np.hypot(*(m - then)))
            change = np.hypot(*(m - m_then))
            length = max(np.hypot(*m), np.hypot(*m_then))
            limit = p.disocclusion_px + p.disocclusion_relative * length
            hidden = config.use_disocclusion and change > limit
            z, z_then = gbuffer.depth[row, column], at(state.history.depth, y, x)
            nearer = z_then < (1.0 - p.depth_relative) * z and np.isfinite(z_then)
            if config.disocclusion == "neighbourhood":
                hidden = hidden and nearer
            if config.use_disocclusion and config.depth_disocclusion:
                hidden |= nearer
            if hidden:
                why[row, column] = 2
                continue
            held = (
                at(state.classification.mask, y, x) >> 16 if config.use_history else 0
            )
            if held and change > p.reset_px:
                held, why[row, column] = 0, 64
            found = terms(color, gbuffer, reprojected, row, column, p, config)
            if config.reading == "sum":
                total = sum(float(weight) for _, _, weight, _ in found)
                value = sum(float(w) * term for _, term, w, _ in found)
                value, least = value / max(total, 1e-30), p.threshold
            else:
                over = max((term / limit for _, term, _, limit in found), default=0.0)
                value, least = over / (1.0 + over), 0.5
            fires = value > least
            if held:
                why[row, column] |= 4
                value = max(value, least)
            for bit, term, _, limit in found if fires else ():
                passes = term > (p.threshold if config.reading == "sum" else limit)
                why[row, column] |= bit * bool(passes)
            method[row, column] = 2 if held or fires else 1
            hold[row, column] = max(int(held) - 1, 0)
            if fires and config.use_history:
                hold[row, column] = min(max(int(p.hold), 0), 65535)
            score[row, column] = value
    return method, hold, why, score


def budget(method, score, allowed):
    """Returns the mask of pixels that keep their rays, by a plain stable sort."""
    wants = np.flatnonzero(method.reshape(-1) == 2)
    ranked = sorted(wants, key=lambda index: (-score.reshape(-1)[index], index))
    keeps = np.zeros(method.size, bool)
    keeps[ranked[: max(allowed, 0)]] = True
    return keeps.reshape(method.shape)
