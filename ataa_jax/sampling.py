"""Subpixel sample positions: temporal jitter, multisample patterns, reference sets.

Every offset is in pixels from the pixel centre, x right, y down.
"""

import numpy as np

from ataa_jax.errors import InputError

# Direct3D standard multisample patterns in 1/16 pixel (D3D11 functional
# specification, 19.2.4.1). 2x, 4x and 8x are the paper's n-rooks patterns.
_D3D_SIXTEENTHS = {
    1: [(0, 0)],
    2: [(4, 4), (-4, -4)],
    4: [(-2, -6), (6, -2), (-6, 2), (2, 6)],
    8: [(1, -3), (-1, 3), (5, 1), (-3, -5), (-5, 5), (-7, -1), (3, 7), (7, -7)],
    16: [
        *[(1, 1), (-1, -3), (-3, 2), (4, -1), (-5, -2), (2, 5), (5, 3), (3, -5)],
        *[(-2, 6), (0, -7), (-4, -6), (-6, 4), (-8, 0), (7, -4), (6, 7), (-7, -8)],
    ],
}

# The plastic number's powers: additive recurrence of lowest known discrepancy in two
# dimensions (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
_R2_ALPHA = np.array([0.7548776662466927, 0.5698402909980532])


def pattern(samples: int) -> np.ndarray:
    """Returns the Direct3D standard pattern, or for other counts an R2 set.

    Args:
        samples: 1, 2, 4, 8 and 16 give the D3D pattern; any other positive count a
            centred R2 set that shares no point with the reference's.

    Returns:
        Offsets, float32 (samples, 2), px.

    Raises:
        InputError: samples is not positive.
    """
    if samples < 1:
        raise InputError(f"a sample count must be at least 1, not {samples}")
    if samples in _D3D_SIXTEENTHS:
        return np.array(_D3D_SIXTEENTHS[samples], np.float32) / np.float32(16.0)
    return _r2(samples, first=1025)


def reference_pattern(samples: int) -> np.ndarray:
    """Returns the fixed low-discrepancy set of the reference, zero mean.

    The same for every pixel and frame, and not a superset of any D3D pattern: its
    coordinates are irrational, so it cannot flatter the method that shares its points.

    Args:
        samples: positive count.

    Returns:
        Offsets, float32 (samples, 2), px.

    Raises:
        InputError: samples is not positive.
    """
    if samples < 1:
        raise InputError(f"a sample count must be at least 1, not {samples}")
    return _r2(samples, first=1)


def halton_jitter(
    length: int, *, centred: bool = True, bases: tuple[int, int] = (2, 3)
) -> np.ndarray:
    """Returns the temporal jitter sequence: Halton points from index 1.

    Args:
        length: period of the sequence in frames (UE4: 8; Karis 2014).
        centred: subtract the sequence's mean, so that a still image does not shift.
        bases: radical-inverse bases of x and y.

    Returns:
        Offsets, float32 (length, 2), px.
    """
    points = np.array(
        [[_radical_inverse(i, base) for base in bases] for i in range(1, length + 1)]
    )
    points -= points.mean(axis=0) if centred else 0.5
    return points.astype(np.float32)


def _radical_inverse(index: int, base: int) -> float:
    """Mirrors the digits of `index` about the radix point (Halton 1964)."""
    value, scale = 0.0, 1.0
    while index:
        index, digit = divmod(index, base)
        scale /= base
        value += digit * scale
    return value


def _r2(samples: int, first: int) -> np.ndarray:
    """Returns `samples` points of the R2 sequence from an index on, zero mean.

    Centring moves them by less than half the mean spacing, so a few may lie that far
    outside the pixel; an off-centre mean would shift the whole image instead.
    """
    index = np.arange(first, first + samples)[:, None]
    points = (0.5 + index * _R2_ALPHA) % 1.0
    return (points - points.mean(axis=0)).astype(np.float32)
