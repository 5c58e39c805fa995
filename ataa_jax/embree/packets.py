"""Tracing in packets through the Embree 4 C interface.

A packet has as many rays as the processor's vectors hold: 16 with AVX-512, 8 with AVX.

One Embree scene is built for each rigid group, once. If there are several, a small
scene of instances is put on top for each set of transforms that is asked for, and
never changed afterwards: concurrent calls may hold different ones, and the last few
are kept.
"""

import ctypes
import threading
from collections import OrderedDict

import numpy as np

from ataa_jax import types
from ataa_jax.embree import kernels, library, masks, workers

_KEPT = 8  # our choice: top-level scenes kept; two frames' worth for a few callers


class PacketBackend:
    """The packet path of one scene."""

    def __init__(
        self, clib: ctypes.CDLL, scene: types.Scene, split: masks.Split, config: str
    ) -> None:
        self._device = library.Device(clib, config)
        self.lanes = self._device.lanes()
        self._intersect, self._occluded = (
            library.address_of(getattr(clib, f"rtc{query}{self.lanes}"))
            for query in ("Intersect", "Occluded")
        )
        self._arguments = {flag: _query_arguments(flag) for flag in (False, True)}

        geometries = [
            ids for pair in zip(split.opaque, split.masked, strict=True) for ids in pair
        ]
        sizes = np.array([ids.size for ids in geometries], np.int64)
        self._base = np.cumsum(sizes) - sizes
        self._ids = np.concatenate([*geometries, np.full(1, -1, np.int32)])

        position = np.asarray(scene.geometry.position, np.float32)
        self._groups: list[library.EmbreeHandle] = []
        self._occupied: list[bool] = []
        row = 0
        for opaque, masked in zip(split.opaque, split.masked, strict=True):
            group = self._device.new_scene()
            if opaque.size:
                self._device.attach_triangles(group, 0, position[opaque], None)
            if masked.size:
                data = masks.filter_data(split.mask, row, row + masked.size)
                group.keep += [*split.mask, data]
                self._device.attach_triangles(
                    group,
                    1,
                    position[masked],
                    (masks.filter_address(), data.ctypes.data),
                )
                row += masked.size
            self._device.commit(group)
            self._groups.append(group)
            self._occupied.append(opaque.size + masked.size > 0)
        self._lock = threading.Lock()
        self._placed: OrderedDict[bytes, library.EmbreeHandle] = OrderedDict()

    def intersect(
        self,
        world_from_group: np.ndarray,
        origin: np.ndarray,
        direction: np.ndarray,
        tile: tuple[int, int] | None,
        coherent: bool,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns distance, triangle and barycentric of the nearest hits."""
        count = origin.shape[0]
        distance = np.empty(count, np.float32)
        triangle = np.empty(count, np.int32)
        barycentric = np.empty((count, 2), np.float32)
        placed = self._place(world_from_group)
        arguments = self._arguments[coherent].ctypes.data
        height, width, packets = _walk(tile, count, self.lanes)

        def work(first: int, last: int) -> None:
            kernels.intersect(
                self._intersect,
                self.lanes,
                placed.handle,
                arguments,
                first,
                last,
                height,
                width,
                origin,
                direction,
                self._base,
                self._ids,
                distance,
                triangle,
                barycentric,
            )

        workers.for_chunks(packets, kernels.CHUNK // self.lanes, work)
        return distance, triangle, barycentric

    def occluded(
        self,
        world_from_group: np.ndarray,
        origin: np.ndarray,
        direction: np.ndarray,
        distance: np.ndarray,
        active: np.ndarray,
        tile: tuple[int, int] | None,
        coherent: bool,
    ) -> np.ndarray:
        """Returns whether anything lies closer than `distance`."""
        count = origin.shape[0]
        answer = np.empty(count, np.bool_)
        placed = self._place(world_from_group)
        arguments = self._arguments[coherent].ctypes.data
        height, width, packets = _walk(tile, count, self.lanes)

        def work(first: int, last: int) -> None:
            kernels.occluded(
                self._occluded,
                self.lanes,
                placed.handle,
                arguments,
                first,
                last,
                height,
                width,
                origin,
                direction,
                distance,
                active,
                answer,
            )

        workers.for_chunks(packets, kernels.CHUNK // self.lanes, work)
        return answer

    def _place(self, world_from_group: np.ndarray) -> library.EmbreeHandle:
        """Returns the scene to trace, with every group where it belongs."""
        if len(self._groups) == 1:
            return self._groups[0]
        key = world_from_group.tobytes()
        with self._lock:
            placed = self._placed.get(key)
            if placed is None:
                placed = self._place_anew(world_from_group)
                self._placed[key] = placed
                if len(self._placed) > _KEPT:
                    # Released when the last call that traces it lets go of it.
                    self._placed.popitem(last=False)
            self._placed.move_to_end(key)
        return placed

    def _place_anew(self, world_from_group: np.ndarray) -> library.EmbreeHandle:
        top = self._device.new_scene()
        for group, matrix in enumerate(world_from_group):
            if self._occupied[group] and invertible(matrix):
                self._device.attach_instance(top, group, self._groups[group], matrix)
        self._device.commit(top)
        return top


def invertible(matrix: np.ndarray) -> bool:
    """Returns whether rays can be carried into a group moved by a 3×4 matrix.

    A group that is scaled to nothing, flattened or sheared flat has no inverse; one
    with NaN is nowhere. Such a group is not hit at all.
    """
    if not np.isfinite(matrix).all():
        return False
    linear = matrix[:, :3].astype(np.float64)
    lengths = np.linalg.norm(linear, axis=0)
    volume = float(np.prod(lengths))
    # Embree divides by the determinant in float32, which must not over- or underflow.
    if not 1e-30 < volume < 1e30:
        return False
    flatness = abs(float(np.linalg.det(linear / lengths)))  # 1: axes at right angles
    return flatness > 1e-6


def _walk(tile: tuple[int, int] | None, count: int, lanes: int) -> tuple[int, int, int]:
    """Returns height (0: no image), width, and the number of packets."""
    if tile is None:
        return 0, count, -(-count // lanes)
    rows, columns = kernels.tile_of(lanes)
    return *tile, -(-tile[0] // rows) * -(-tile[1] // columns)


def _query_arguments(coherent: bool) -> np.ndarray:
    """Lays out an RTCIntersectArguments (RTCOccludedArguments is the same).

    32-bit flags and feature mask, then four pointers that stay null (query context,
    filter, intersect function) and the optional minimum width.
    """
    block = np.zeros(16, np.uint32)
    block[0] = library.QUERY_COHERENT if coherent else 0
    block[1] = library.FEATURES_ALL
    return block
