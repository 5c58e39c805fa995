"""The tuned preset's TAA and segmentation as fused numba loops; see `fused_kernel`.

Some passes over the image, rows in parallel, every pixel in registers, as a shader
would be written by hand.
"""

# ruff: noqa: ANN001, ANN202 (numba infers types; comments say the shapes)
from typing import Any

import jax
import numba
import numpy as np

from ataa_jax import color as colors
from ataa_jax.types import METHOD_ATAA, METHOD_FXAA, METHOD_TAA

_TOP = np.float32(colors.MAX_RADIANCE / (1.0 + colors.MAX_RADIANCE))
_MAX = np.float32(colors.MAX_RADIANCE)
_HEADROOM = np.float32(1.0 / (1.0 + colors.MAX_RADIANCE))
_LUMA = tuple(np.float32(w) for w in colors.LUMA_WEIGHTS)
_FAST = {"contract", "reassoc", "arcp", "nsz"}  # NaN and inf keep their meaning
_compiled = numba.njit(cache=True, fastmath=_FAST, error_model="numpy")
_parallel = numba.njit(cache=True, fastmath=_FAST, error_model="numpy", parallel=True)


@_compiled
def _clean(x):
    return min(x, _MAX) if x > np.float32(0.0) else np.float32(0.0)


@_compiled
def _srgb(x):
    """Encodes one value; the power by series, within 2e-7, that a loop vectorizes."""
    one, x = np.float32(1.0), min(max(x, np.float32(0.0)), np.float32(1.0))
    bits = np.float32(max(x, np.float32(0.0031308))).view(np.int32)
    # x = 2^e m with m in [1/√2, √2): log2 m by the series of artanh.
    e = (bits - 0x3F3504F3) >> 23
    m = np.int32(bits - (e << 23)).view(np.float32)
    t = (m - one) / (m + one)
    u = t * t
    series = np.float32(1.0 / 7.0) + u * np.float32(1.0 / 9.0)
    series = one + u * (np.float32(1.0 / 3.0) + u * (np.float32(0.2) + u * series))
    log2 = np.float32(e) + np.float32(2.0 / np.log(2.0)) * t * series
    power = log2 * np.float32(1.0 / 2.4)
    whole = np.floor(power + np.float32(0.5))
    v = (power - whole) * np.float32(np.log(2.0))
    tail = np.float32(1.0 / 120.0) + v * (
        np.float32(1.0 / 720.0) + v * np.float32(1.0 / 5040.0)
    )
    tail = np.float32(0.5) + v * (
        np.float32(1.0 / 6.0) + v * (np.float32(1.0 / 24.0) + v * tail)
    )
    raised = (one + v * (one + v * tail)) * np.int32(
        (np.int32(whole) + 127) << 23
    ).view(np.float32)
    high = np.float32(1.055) * raised - np.float32(0.055)
    return high if x > np.float32(0.0031308) else np.float32(12.92) * x


@_compiled
def _floor_index(x, size):
    if not x > np.float32(0.0):
        return 0
    return int(min(np.floor(x), np.float32(size - 1)))


@_parallel
def _enter(image, mapped):
    """Takes linear radiance, (h, w, 3), to the averaging space."""
    for r in numba.prange(image.shape[0]):
        for c in range(image.shape[1]):
            x, y, z = (
                _clean(image[r, c, 0]),
                _clean(image[r, c, 1]),
                _clean(image[r, c, 2]),
            )
            scale = np.float32(1.0) / (np.float32(1.0) + max(x, y, z))
            mapped[r, c, 0], mapped[r, c, 1], mapped[r, c, 2] = (
                x * scale,
                y * scale,
                z * scale,
            )


@_parallel
def _boxes(mapped, luma, orange, green, box):
    """Returns low and high of the 3×3 in YCoCg; the planes have a border of one."""
    height, width = mapped.shape[:2]
    half = np.float32(0.5)
    for r in numba.prange(height + 2):
        y = min(max(r - 1, 0), height - 1)
        for c in range(width):
            a, b, d = mapped[y, c, 0], mapped[y, c, 1], mapped[y, c, 2]
            outer, middle = np.float32(0.25) * (a + d), half * b
            luma[r, c + 1] = middle + outer
            orange[r, c + 1] = half * (a - d)
            green[r, c + 1] = middle - outer
    for r in numba.prange(height + 2):
        luma[r, 0], luma[r, width + 1] = luma[r, 1], luma[r, width]
        orange[r, 0], orange[r, width + 1] = orange[r, 1], orange[r, width]
        green[r, 0], green[r, width + 1] = green[r, 1], green[r, width]
    for r in numba.prange(height):
        for k, plane in enumerate((luma, orange, green)):
            for c in range(width):
                low, high = plane[r, c], plane[r, c]
                for dy in range(3):
                    for dx in range(3):
                        value = plane[r + dy, c + dx]
                        low, high = min(low, value), max(high, value)
                box[2 * k, r, c], box[2 * k + 1, r, c] = low, high


@_parallel
def _show(mapped_then, mapped_blended, shown_then, moved):
    """Encodes both as sRGB: the history's luma, and how far the result is from it."""
    for r in numba.prange(moved.shape[0]):
        for c in range(moved.shape[1]):
            x, y = _srgb(mapped_then[0, r, c]), _srgb(mapped_then[1, r, c])
            z = _srgb(mapped_then[2, r, c])
            shown_then[r, c] = _LUMA[0] * x + _LUMA[1] * y + _LUMA[2] * z
            x = _srgb(mapped_blended[0, r, c]) - x
            y = _srgb(mapped_blended[1, r, c]) - y
            z = _srgb(mapped_blended[2, r, c]) - z
            moved[r, c] = np.sqrt((x * x + y * y + z * z) * np.float32(1.0 / 3.0))


@_compiled
def _weights(f, out):
    half = np.float32(0.5)
    out[0] = f * (-half + f * (np.float32(1.0) - half * f))
    out[1] = np.float32(1.0) + f * f * (np.float32(-2.5) + np.float32(1.5) * f)
    out[2] = f * (half + f * (np.float32(2.0) - np.float32(1.5) * f))
    out[3] = f * f * (-half + half * f)


@_parallel
def _taa(
    then, linear_then, then_count, then_valid, now, linear, depth, motion, motion_valid,
    box, count_limit, blended, reprojected, count, luma_now, luma_then,
    mapped_then, mapped_blended,
):  # fmt: skip
    """Reprojects, clips and blends; notes what segmentation reads in 3×3 windows.

    `then`, `now` and `mapped_*` are in the averaging space; `luma_*` are lumas there.
    """
    height, width = depth.shape
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    for r in numba.prange(height):
        wy, wx = np.empty(4, np.float32), np.empty(4, np.float32)
        h, p = np.empty(3, np.float32), np.empty(3, np.float32)
        for c in range(width):
            mx, my = motion[r, c, 0], motion[r, c, 1]
            usable = motion_valid[r, c] and np.isfinite(mx) and np.isfinite(my)
            if not (np.isfinite(mx) and np.isfinite(my)):
                mx, my = zero, zero
            nearest = depth[r, c]
            for dy in (0, -1, 1):
                y = min(max(r + dy, 0), height - 1)
                for dx in (0, -1, 1):
                    x = min(max(c + dx, 0), width - 1)
                    if depth[y, x] < nearest and motion_valid[y, x]:
                        nearest = depth[y, x]
                        mx, my, usable = motion[y, x, 0], motion[y, x, 1], True
            row, column = np.float32(r) + my, np.float32(c) + mx
            inside = -half <= row <= height - half and -half <= column <= width - half
            red, green, blue = now[r, c, 0], now[r, c, 1], now[r, c, 2]
            luma_now[r, c] = _LUMA[0] * red + _LUMA[1] * green + _LUMA[2] * blue
            if not (then_valid and usable and inside):
                count[r, c] = one
                for k in range(3):
                    value = _clean(linear[r, c, k])
                    blended[r, c, k], reprojected[r, c, k] = value, value
                luma_then[r, c] = luma_now[r, c]
                for k in range(3):
                    mapped_then[k, r, c] = mapped_blended[k, r, c] = now[r, c, k]
                continue
            top, left = np.floor(row), np.floor(column)
            fy, fx = row - top, column - left
            _weights(fy, wy)
            _weights(fx, wx)
            h[0], h[1], h[2] = zero, zero, zero
            for j in range(4):
                y = min(max(int(top) + j - 1, 0), height - 1)
                for i in range(4):
                    x = min(max(int(left) + i - 1, 0), width - 1)
                    weight = wy[j] * wx[i]
                    h[0] += weight * then[y, x, 0]
                    h[1] += weight * then[y, x, 1]
                    h[2] += weight * then[y, x, 2]
            for k in range(3):
                h[k] = min(max(h[k], zero), _TOP)
            # What is handed on, before rectification.
            peak = one / max(one - max(h[0], h[1], h[2]), _HEADROOM)
            if fy == zero and fx == zero:
                y, x = (
                    min(max(int(top), 0), height - 1),
                    min(max(int(left), 0), width - 1),
                )
                for k in range(3):
                    reprojected[r, c, k] = _clean(linear_then[y, x, k])
            else:
                for k in range(3):
                    reprojected[r, c, k] = _clean(h[k] * peak)
            luma_then[r, c] = _LUMA[0] * h[0] + _LUMA[1] * h[1] + _LUMA[2] * h[2]
            for k in range(3):
                mapped_then[k, r, c] = h[k]
            # Clip toward the box's centre, in YCoCg.
            low0, low1, low2 = box[0, r, c], box[2, r, c], box[4, r, c]
            high0, high1, high2 = box[1, r, c], box[3, r, c], box[5, r, c]
            outer, green2 = np.float32(0.25) * (h[0] + h[2]), half * h[1]
            c0, c1, c2 = (
                half * (low0 + high0),
                half * (low1 + high1),
                half * (low2 + high2),
            )
            d0, d1, d2 = (
                green2 + outer - c0,
                half * (h[0] - h[2]) - c1,
                green2 - outer - c2,
            )
            least = np.float32(1e-6)
            over = max(
                abs(d0) / max(half * (high0 - low0), least),
                abs(d1) / max(half * (high1 - low1), least),
                abs(d2) / max(half * (high2 - low2), least),
            )
            share = one / max(over, one)
            luma, co, cg = c0 + d0 * share, c1 + d1 * share, c2 + d2 * share
            p[0], p[1], p[2] = luma - cg + co, luma + cg, luma - cg - co
            y, x = _floor_index(row + half, height), _floor_index(column + half, width)
            frames = then_count[y, x]
            frames = min(frames, np.float32(1e9)) if frames > zero else zero
            a = one / (frames + one)
            for k in range(3):
                p[k] = min(max(p[k], zero), _TOP)
                p[k] += (now[r, c, k] - p[k]) * a
                mapped_blended[k, r, c] = p[k]
            peak = one / max(one - max(p[0], p[1], p[2]), _HEADROOM)
            for k in range(3):
                blended[r, c, k] = _clean(p[k] * peak)
            more = min(frames + one, count_limit)
            count[r, c] = (
                max(frames - one, count_limit) if frames > count_limit else more
            )


@_parallel
def _segment(
    depth, motion, motion_valid, then_depth, then_motion, then_valid,
    luma_now, luma_then, shown_then, moved, threshold, depth_weight, response_weight,
    contrast, floor, disocclusion_px, disocclusion_relative, depth_relative,
    method, score,
):  # fmt: skip
    """Motion vectors, then the three criteria's weighted mean against the threshold."""
    height, width = depth.shape
    zero, one, half = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    total = one / (one + depth_weight + response_weight)
    for r in numba.prange(height):
        for c in range(width):
            mx, my = motion[r, c, 0], motion[r, c, 1]
            row, column = np.float32(r) + my, np.float32(c) + mx
            inside = -half <= row <= height - half and -half <= column <= width - half
            score[r, c] = zero
            if not (then_valid and motion_valid[r, c] and inside):
                method[r, c] = METHOD_FXAA
                continue
            row, column = row + half, column + half
            least, length = np.float32(np.inf), zero
            for dy in range(-1, 2):
                y = _floor_index(row + np.float32(dy), height)
                for dx in range(-1, 2):
                    x = _floor_index(column + np.float32(dx), width)
                    px, py = then_motion[y, x, 0], then_motion[y, x, 1]
                    apart = (mx - px) * (mx - px) + (my - py) * (my - py)
                    if apart < least:
                        least, length = apart, px * px + py * py
            longer = np.sqrt(max(mx * mx + my * my, length))
            before = then_depth[_floor_index(row, height), _floor_index(column, width)]
            then_inverse = one / before if before > np.float32(1e-30) else zero
            inverse = one / depth[r, c] if depth[r, c] > np.float32(1e-30) else zero
            nearer = then_inverse - inverse > depth_relative * then_inverse
            limit = disocclusion_px + disocclusion_relative * longer
            if nearer and not np.sqrt(least) <= limit:
                method[r, c] = METHOD_FXAA
                continue
            mean_now, mean_then, mean_shown, largest = zero, zero, zero, zero
            gx, gy = zero, zero
            for dy in range(-1, 2):
                y = min(max(r + dy, 0), height - 1)
                for dx in range(-1, 2):
                    x = min(max(c + dx, 0), width - 1)
                    mean_now += luma_now[y, x]
                    mean_then += luma_then[y, x]
                    mean_shown += shown_then[y, x]
                    inverse = (
                        one / depth[y, x] if depth[y, x] > np.float32(1e-30) else zero
                    )
                    largest = max(largest, inverse)
                    gx += np.float32(dx * (2 - abs(dy))) * inverse
                    gy += np.float32(dy * (2 - abs(dx))) * inverse
            ninth = np.float32(1.0 / 9.0)
            mean_now, mean_then, mean_shown = (
                mean_now * ninth,
                mean_then * ninth,
                mean_shown * ninth,
            )
            variance = zero
            for dy in range(-1, 2):
                y = min(max(r + dy, 0), height - 1)
                for dx in range(-1, 2):
                    x = min(max(c + dx, 0), width - 1)
                    off = shown_then[y, x] - mean_shown
                    variance += off * off
            larger = max(mean_now, mean_then)
            seen = larger >= floor and larger > zero
            luminance = abs(mean_now - mean_then) / larger if seen else zero
            scale = one / largest if largest > zero else zero
            gx, gy = gx * scale, gy * scale
            edge = np.sqrt(gx * gx + gy * gy) * np.float32(0.125)
            busy = variance * ninth / (contrast * contrast) + one
            response = moved[r, c] / np.sqrt(busy)
            value = (
                luminance + depth_weight * edge + response_weight * response
            ) * total
            method[r, c] = METHOD_ATAA if value > threshold else METHOD_TAA
            score[r, c] = value


def fused(
    state: Any, color: np.ndarray, gbuffer: Any, params: Any
) -> tuple[np.ndarray, ...]:
    """Runs the loops on NumPy arrays; arguments as the stages'.

    Returns:
        TAA's result, the history as read, its count; method and score.
    """
    size = color.shape[:2]
    now, then = np.empty_like(color), np.empty_like(color)
    _enter(color, now)
    _enter(state.history.color, then)
    blended, reprojected = np.empty_like(color), np.empty_like(color)
    count, luma_now, luma_then = (np.empty(size, np.float32) for _ in range(3))
    shown, moved = np.empty(size, np.float32), np.empty(size, np.float32)
    box = np.empty((6, *size), np.float32)
    ycocg = np.empty((3, size[0] + 2, size[1] + 2), np.float32)
    _boxes(now, ycocg[0], ycocg[1], ycocg[2], box)
    mapped_then = np.empty((3, *size), np.float32)
    mapped_blended = np.empty((3, *size), np.float32)
    history, valid = state.history, bool(state.history.valid)
    numbers = jax.tree.map(lambda x: x[()], (params.taa, params.segmentation))
    s = numbers[1]
    _taa(
        then, history.color, history.count, valid, now, color, gbuffer.depth,
        gbuffer.motion, gbuffer.motion_valid, box, numbers[0].count_limit, blended,
        reprojected, count, luma_now, luma_then, mapped_then, mapped_blended,
    )  # fmt: skip
    _show(mapped_then, mapped_blended, shown, moved)
    method, score = np.empty(size, np.uint32), np.empty(size, np.float32)
    _segment(
        gbuffer.depth, gbuffer.motion, gbuffer.motion_valid, history.depth,
        history.motion, valid, luma_now, luma_then, shown, moved, s.threshold,
        s.depth_weight, s.response_weight, s.response_contrast, s.luminance_floor,
        s.disocclusion_px, s.disocclusion_relative, s.depth_relative, method, score,
    )  # fmt: skip
    return blended, reprojected, count, method, score
