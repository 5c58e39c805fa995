"""Checks of every frame by itself: lost and frozen ones, NaN, enlarged motion.

Frames are read one after the other, so that a long sequence takes no more memory.
"""

import itertools

import numpy as np

from ataa_jax.capture.findings import ERROR, WARNING, Finding
from ataa_jax.capture.record import Capture, Raw

_KINDS = ("color", "reference", "motion", "depth")


def check(capture: Capture) -> list[Finding]:
    """Reads all frames.

    Raises:
        InputError: a file is damaged.
    """
    found = _numbers(capture)
    broken: dict[str, list[tuple[int, int]]] = {kind: [] for kind in _KINDS}
    aligned, other = [], []
    before: Raw | None = None
    for index, frame in enumerate(capture.frames):
        raw = capture.raw(index)
        images = {
            "color": raw.color,
            "reference": capture.pixels(index, "reference"),
            "motion": raw.motion,
            "depth": raw.depth,
        }
        for kind, image in images.items():
            count = 0 if image is None else _broken(kind, image)
            if count:
                broken[kind].append((frame.number, count))
        aligned.append(_equal_blocks(raw.motion, 0))
        other.append(_equal_blocks(raw.motion, 1))
        jitter = capture.frames[index - 1].jitter if index else frame.jitter
        if before is not None and not frame.cut and frame.jitter != jitter:
            found += _frozen(before, raw, frame.number)
        before = raw
    found += [_not_finite(kind, held) for kind, held in broken.items() if held]
    return found + _enlarged(float(np.mean(aligned)), float(np.mean(other)))


def _numbers(capture: Capture) -> list[Finding]:
    found = []
    for before, after in itertools.pairwise(capture.frames):
        step = after.number - before.number
        if step != 1 and not after.cut:
            text = f"frame {after.number} follows frame {before.number}"
            found.append(
                Finding(
                    ERROR,
                    "dropped frame",
                    f"before frame {after.number}",
                    f"{text}; {step - 1} are missing" if step > 1 else text,
                    "capture the sequence again, or mark the frame after as a cut",
                )
            )
    return found


def _broken(kind: str, image: np.ndarray) -> int:
    """Returns how many pixels are not finite; depth may be inf."""
    bad = np.isnan(image) if kind == "depth" else ~np.isfinite(image)
    return int((bad if bad.ndim == 2 else bad.any(axis=-1)).sum())


def _not_finite(kind: str, held: list[tuple[int, int]]) -> Finding:
    more = f" and {len(held) - 1} more" if len(held) > 1 else ""
    return Finding(
        WARNING,
        "NaN or inf pixels",
        f"frame {held[0][0]}{more}",
        f"{sum(count for _, count in held)} pixels of {kind} are not finite",
        "they are taken as black, as sky or as without history; find the shader that "
        "divides by zero",
    )


def _frozen(before: Raw, now: Raw, number: int) -> list[Finding]:
    if not np.array_equal(before.color, now.color, equal_nan=True):
        return []
    return [
        Finding(
            ERROR,
            "frozen frame",
            f"frame {number}",
            "its colour equals the frame before in every pixel, though the jitter "
            "changed",
            "the frame was lost and the last one written again: capture anew",
        )
    ]


def _enlarged(aligned: float, other: float) -> list[Finding]:
    """Motion that was enlarged from half the size is equal in every 2×2 block."""
    if not (aligned > 0.98 and other < 0.5 * aligned):
        return []
    return [
        Finding(
            ERROR,
            "half-resolution motion",
            "",
            f"{aligned:.0%} of the 2×2 blocks hold one motion vector, of blocks "
            f"shifted by a pixel {other:.0%}: it was rendered at half the size",
            "write motion vectors at the colour's resolution, one a pixel",
        )
    ]


def _equal_blocks(motion: np.ndarray, start: int) -> float:
    part = motion[start:, start:]
    part = part[: part.shape[0] // 2 * 2, : part.shape[1] // 2 * 2]
    corner = part[::2, ::2]
    same = np.ones(corner.shape[:2], bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1)):
        same &= np.all(part[dy::2, dx::2] == corner, axis=-1)
    return float(same.mean()) if same.size else 0.0
