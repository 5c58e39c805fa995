"""Rays against triangles by brute force: every pair, in float64, no Embree."""

import numpy as np


def nearest(
    position: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Finds nearest hits as Möller and Trumbore (1997) do.

    With corners p0 p1 p2 and edges e1 = p1 − p0, e2 = p2 − p0, the point
    o + t d = p0 + u e1 + v e2 has, for s = o − p0 and D = (d × e2) · e1,

        u = (d × e2) · s / D,   v = (s × e1) · d / D,   t = (s × e1) · e2 / D.

    Args:
        position: (t, 3, 3).
        origin: (n, 3).
        direction: (n, 3).

    Returns:
        Distance (n,), inf for a miss; triangle (n,), −1 for a miss; (u, v) (n, 2).
    """
    distance, u, v = all_pairs(position, origin, direction)
    triangle = np.argmin(distance, axis=1)
    ray = np.arange(len(origin))
    best = distance[ray, triangle]
    hit = np.isfinite(best)
    weights = np.stack([u[ray, triangle], v[ray, triangle]], axis=-1)
    return (
        best,
        np.where(hit, triangle, -1),
        np.where(hit[:, None], weights, 0.0),
    )


def all_pairs(
    position: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns distance (inf: no hit), u and v of every ray with every triangle."""
    p0, p1, p2 = np.moveaxis(position.astype(np.float64), 1, 0)
    e1, e2 = p1 - p0, p2 - p0
    d = direction.astype(np.float64)[:, None]
    s = origin.astype(np.float64)[:, None] - p0
    h, q = np.cross(d, e2), np.cross(s, e1)
    det = np.sum(h * e1, axis=-1)
    safe = np.where(det == 0, 1, det)
    u = np.sum(h * s, axis=-1) / safe
    v = np.sum(q * d, axis=-1) / safe
    t = np.sum(q * e2, axis=-1) / safe
    inside = (det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.where(inside, t, np.inf), u, v
