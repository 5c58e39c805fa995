"""numba loops that carry rays into Embree in packets, and hits back out.

A packet is a block of rows of 16, 8 or 4 lanes, laid out as ``RTCRayHit16``,
``RTCRayHit8`` or ``RTCRayHit4``: rows 0–2 origin, 3 tnear, 4–6 direction, 7 time,
8 tfar, 9 mask, 10 id, 11 flags; then the hit: 12–14 normal, 15 u, 16 v, 17 primitive,
18 geometry, 19 instance (20, instance primitive, exists where Embree is built with
instance arrays; the buffer has room for it).

Rays are walked in packets of neighbours: along the batch, or in tiles of an image, of
4×4 pixels, two rows of 4, or 2×2. Rays that are not to be traced (inactive, not finite,
no direction) leave their lane to the next ray, so they cost no traversal.

The functions take Embree's entry points as plain addresses: a function that closed
over them could not be kept in numba's on-disk cache.
"""
# ruff: noqa: ANN001, ANN201, ANN202 (numba infers types; comments say the shapes)

from typing import no_type_check

import numpy as np
from llvmlite import ir
from numba import types as nb
from numba.core import cgutils
from numba.extending import intrinsic

from ataa_jax import loops

CHUNK = 4096  # rays a call; fixed, so that no result depends on the thread count

_ROWS = 22
_BYTES = 64  # alignment of a 16-lane packet; smaller ones need less
# Hits lie strictly beyond the origin: the smallest normal float, since Embree's
# processor mode reads smaller ones as 0.
_NEAR = np.float32(np.finfo(np.float32).tiny)
_INF = np.float32(np.inf)
# A missed ray's second direction: these shares of its largest component are added.
# 16 ulps, 1/250 of a pixel at 1080p; of 9,154 leaks 1 ulp left 41, 4 one, 16 none.
NUDGE = np.float32(np.finfo(np.float32).eps) * np.array([16.0, -9.6, 4.8], np.float32)


@intrinsic
@no_type_check
def _call(typing_context, function, valid, scene, packet, arguments):
    """Calls the C function at an address with four pointers given as int64."""

    def codegen(context, builder, signature, values):
        pointer = cgutils.voidptr_t
        kind = ir.FunctionType(ir.VoidType(), [pointer] * 4)
        callee = builder.inttoptr(values[0], kind.as_pointer())
        builder.call(callee, [builder.inttoptr(v, pointer) for v in values[1:]])
        return context.get_dummy_value()

    return nb.void(nb.int64, nb.int64, nb.int64, nb.int64, nb.int64), codegen


@loops.compiled
@no_type_check
def _aligned_rows(lanes):
    """Returns a zeroed float32 (_ROWS + 1, lanes) block that starts on 64 bytes."""
    block = np.zeros((_ROWS + 1) * lanes + _BYTES // 4, np.float32)
    skip = (-block.ctypes.data % _BYTES) // 4
    return block[skip : skip + (_ROWS + 1) * lanes].reshape((_ROWS + 1, lanes))


@loops.compiled
@no_type_check
def tile_of(lanes):
    """Returns rows and columns of the tile of an image that makes a packet."""
    columns = 4 if lanes > 4 else 2
    return lanes // columns, columns


@loops.compiled
@no_type_check
def _ray_at(packet, lane, lanes, height, width):
    """Returns which ray lane `lane` of packet `packet` is of; −1: none.

    A batch that is no image has height 0 and width n.
    """
    if height == 0:
        ray = packet * lanes + lane
        return ray if ray < width else -1
    rows, columns = tile_of(lanes)
    tiles = (width + columns - 1) // columns
    row = packet // tiles * rows + lane // columns
    column = packet % tiles * columns + lane % columns
    return row * width + column if row < height and column < width else -1


@loops.compiled
@no_type_check
def _fill(rows, bits, lane, ray, origin, direction, far):
    """Puts one ray into a lane; False, and nothing useful there, if it has no path."""
    largest = np.float32(0.0)
    wild = np.float32(0.0)  # stays 0 while every number is finite: inf · 0 is NaN
    for axis in range(3):
        o, d = origin[ray, axis], direction[ray, axis]
        rows[axis, lane] = o
        rows[4 + axis, lane] = d
        largest = max(largest, abs(d))
        wild += (o * np.float32(0.0)) + (d * np.float32(0.0))
    rows[3, lane] = _NEAR
    rows[8, lane] = far
    bits[9, lane] = -1
    return wild == 0 and largest > 0


@loops.compiled
@no_type_check
def _nudge(rows):
    """Turns the directions of all lanes by a few ulps."""
    for lane in range(rows.shape[1]):
        largest = max(abs(rows[4, lane]), abs(rows[5, lane]), abs(rows[6, lane]))
        for axis in range(3):
            rows[4 + axis, lane] += largest * NUDGE[axis]


@loops.compiled
@no_type_check
def intersect(
    function,  # address of rtcIntersect16, 8 or 4
    lanes,  # 16, 8 or 4
    scene,  # address of the scene
    arguments,  # address of an RTCIntersectArguments
    first,  # first packet
    last,  # one past the last packet
    height,  # rows of the image, 0: not an image
    width,  # columns of the image, or rays
    origin,  # float32 (n, 3)
    direction,  # float32 (n, 3)
    base,  # int64 (2 g,): where geometry (group, masked) starts in `ids`
    ids,  # int32: triangle ids, geometry by geometry
    distance,  # out: float32 (n,)
    triangle,  # out: int32 (n,)
    barycentric,  # out: float32 (n, 2)
):
    """Traces some packets of a batch for their nearest hits."""
    rows = _aligned_rows(lanes)
    bits = rows.view(np.int32)
    valid = bits[_ROWS]
    ray_of = np.empty(lanes, np.int64)
    filled = 0
    for packet in range(first, last):
        for place in range(lanes):
            ray = _ray_at(packet, place, lanes, height, width)
            if ray >= 0:
                distance[ray] = _INF
                triangle[ray] = -1
                barycentric[ray, 0] = barycentric[ray, 1] = np.float32(0.0)
                if _fill(rows, bits, filled, ray, origin, direction, _INF):
                    ray_of[filled] = ray
                    bits[18, filled] = -1
                    bits[19, filled] = -1
                    filled += 1
            at_end = packet == last - 1 and place == lanes - 1
            if filled == lanes or (at_end and filled > 0):
                for lane in range(lanes):
                    valid[lane] = -1 if lane < filled else 0
                _call(function, valid.ctypes.data, scene, rows.ctypes.data, arguments)
                missed = 0
                for lane in range(lanes):
                    valid[lane] = -1 if lane < filled and bits[18, lane] < 0 else 0
                    missed -= valid[lane]
                if missed > 0:
                    _nudge(rows)
                    _call(
                        function, valid.ctypes.data, scene, rows.ctypes.data, arguments
                    )
                for lane in range(filled):
                    geometry = bits[18, lane]
                    if geometry >= 0:
                        r = ray_of[lane]
                        group = max(bits[19, lane], 0)
                        distance[r] = rows[8, lane]
                        triangle[r] = ids[base[2 * group + geometry] + bits[17, lane]]
                        barycentric[r, 0] = rows[15, lane]
                        barycentric[r, 1] = rows[16, lane]
                filled = 0


@loops.compiled
@no_type_check
def occluded(
    function,  # address of rtcOccluded16, 8 or 4
    lanes,
    scene,
    arguments,
    first,
    last,
    height,
    width,
    origin,
    direction,
    length,  # float32 (n,)
    active,  # bool (n,)
    answer,  # out: bool (n,)
):
    """Traces some packets of a batch for any hit closer than `length`."""
    rows = _aligned_rows(lanes)
    bits = rows.view(np.int32)
    valid = bits[_ROWS]
    ray_of = np.empty(lanes, np.int64)
    filled = 0
    for packet in range(first, last):
        for place in range(lanes):
            ray = _ray_at(packet, place, lanes, height, width)
            if ray >= 0:
                answer[ray] = False
                far = length[ray]
                if (
                    active[ray]
                    and far > _NEAR
                    and _fill(rows, bits, filled, ray, origin, direction, far)
                ):
                    # Embree's interval is closed, ours open: the next float down.
                    bits[8, filled] -= 1
                    ray_of[filled] = ray
                    filled += 1
            at_end = packet == last - 1 and place == lanes - 1
            if filled == lanes or (at_end and filled > 0):
                for lane in range(lanes):
                    valid[lane] = -1 if lane < filled else 0
                _call(function, valid.ctypes.data, scene, rows.ctypes.data, arguments)
                for lane in range(filled):
                    answer[ray_of[lane]] = rows[8, lane] == -_INF
                filled = 0
