"""numba loops that carry rays into Embree 16 at a time, and hits back out.

A packet is a block of rows of 16 lanes, laid out as ``RTCRayHit16``: rows 0–2 origin,
3 tnear, 4–6 direction, 7 time, 8 tfar, 9 mask, 10 id, 11 flags; then the hit: 12–14
normal, 15 u, 16 v, 17 primitive, 18 geometry, 19 instance (20, instance primitive,
exists where Embree is built with instance arrays; the buffer has room for it).

Rays are walked in packets of 16 neighbours: along the batch, or in 4×4 tiles of an
image. Rays that are not to be traced (inactive, not finite, no direction) leave their
lane to the next ray, so they cost no traversal.

The functions take Embree's entry points as plain addresses: a function that closed
over them could not be kept in numba's on-disk cache.
"""

import numba
import numpy as np
from numba.core import cgutils, types as nb
from numba.extending import intrinsic

LANES = 16
CHUNK = 256  # packets a call; fixed, so that no result depends on the thread count

_ROWS = 22
_BYTES = 64  # alignment of a 16-lane packet
# Hits lie strictly beyond the origin: the smallest normal float, since Embree's
# processor mode reads smaller ones as 0.
_NEAR = np.float32(np.finfo(np.float32).tiny)
_INF = np.float32(np.inf)


@intrinsic
def _call(typing_context, function, valid, scene, packet, arguments):  # noqa: ANN001, ANN202, ARG001
    """Calls the C function at an address with four pointers given as int64."""

    def codegen(context, builder, signature, values):  # noqa: ANN001, ANN202, ARG001
        pointer = cgutils.voidptr_t
        from llvmlite import ir

        kind = ir.FunctionType(ir.VoidType(), [pointer] * 4)
        callee = builder.inttoptr(values[0], kind.as_pointer())
        builder.call(callee, [builder.inttoptr(v, pointer) for v in values[1:]])
        return context.get_dummy_value()

    return nb.void(nb.int64, nb.int64, nb.int64, nb.int64, nb.int64), codegen


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _aligned_rows():  # noqa: ANN202
    """Returns a zeroed float32 (_ROWS + 1, 16) block that starts on 64 bytes."""
    block = np.zeros((_ROWS + 1) * LANES + LANES, np.float32)
    skip = (-block.ctypes.data % _BYTES) // 4
    return block[skip : skip + (_ROWS + 1) * LANES].reshape((_ROWS + 1, LANES))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _ray_at(packet, lane, height, width):  # noqa: ANN001, ANN202
    """Returns which ray lane `lane` of packet `packet` is of; −1: none.

    A batch that is no image has height 0 and width n.
    """
    if height == 0:
        ray = packet * LANES + lane
        return ray if ray < width else -1
    tiles = (width + 3) // 4
    row = packet // tiles * 4 + lane // 4
    column = packet % tiles * 4 + lane % 4
    return row * width + column if row < height and column < width else -1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill(rows, bits, lane, ray, origin, direction, far):  # noqa: ANN001, ANN202
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def intersect(  # noqa: ANN201
    function,  # noqa: ANN001  address of rtcIntersect16
    scene,  # noqa: ANN001  address of the scene
    arguments,  # noqa: ANN001  address of an RTCIntersectArguments
    first,  # noqa: ANN001  first packet
    last,  # noqa: ANN001  one past the last packet
    height,  # noqa: ANN001  rows of the image, 0: not an image
    width,  # noqa: ANN001  columns of the image, or rays
    origin,  # noqa: ANN001  float32 (n, 3)
    direction,  # noqa: ANN001  float32 (n, 3)
    base,  # noqa: ANN001  int64 (2 g,): where geometry (group, masked) starts in `ids`
    ids,  # noqa: ANN001  int32: triangle ids, geometry by geometry
    distance,  # noqa: ANN001  out: float32 (n,)
    triangle,  # noqa: ANN001  out: int32 (n,)
    barycentric,  # noqa: ANN001  out: float32 (n, 2)
):
    """Traces some packets of a batch for their nearest hits."""
    rows = _aligned_rows()
    bits = rows.view(np.int32)
    valid = bits[_ROWS]
    ray_of = np.empty(LANES, np.int64)
    filled = 0
    for packet in range(first, last):
        for place in range(LANES):
            ray = _ray_at(packet, place, height, width)
            if ray >= 0:
                distance[ray] = _INF
                triangle[ray] = -1
                barycentric[ray, 0] = barycentric[ray, 1] = np.float32(0.0)
                if _fill(rows, bits, filled, ray, origin, direction, _INF):
                    ray_of[filled] = ray
                    bits[18, filled] = -1
                    bits[19, filled] = -1
                    filled += 1
            at_end = packet == last - 1 and place == LANES - 1
            if filled == LANES or (at_end and filled > 0):
                for lane in range(LANES):
                    valid[lane] = -1 if lane < filled else 0
                _call(function, valid.ctypes.data, scene, rows.ctypes.data, arguments)
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def occluded(  # noqa: ANN201
    function,  # noqa: ANN001  address of rtcOccluded16
    scene,  # noqa: ANN001
    arguments,  # noqa: ANN001
    first,  # noqa: ANN001
    last,  # noqa: ANN001
    height,  # noqa: ANN001
    width,  # noqa: ANN001
    origin,  # noqa: ANN001
    direction,  # noqa: ANN001
    length,  # noqa: ANN001  float32 (n,)
    active,  # noqa: ANN001  bool (n,)
    answer,  # noqa: ANN001  out: bool (n,)
):
    """Traces some packets of a batch for any hit closer than `length`."""
    rows = _aligned_rows()
    bits = rows.view(np.int32)
    valid = bits[_ROWS]
    ray_of = np.empty(LANES, np.int64)
    filled = 0
    for packet in range(first, last):
        for place in range(LANES):
            ray = _ray_at(packet, place, height, width)
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
            at_end = packet == last - 1 and place == LANES - 1
            if filled == LANES or (at_end and filled > 0):
                for lane in range(LANES):
                    valid[lane] = -1 if lane < filled else 0
                _call(function, valid.ctypes.data, scene, rows.ctypes.data, arguments)
                for lane in range(filled):
                    answer[ray_of[lane]] = rows[8, lane] == -_INF
                filled = 0
