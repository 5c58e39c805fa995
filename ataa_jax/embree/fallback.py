"""Tracing through embreex's own classes, where the C interface cannot be resolved.

`EmbreeScene.run` knows neither instances nor filters nor a near distance, so moving
groups are traced one after the other in their own spaces, and a hit on a hole of an
alpha mask is followed by another ray that starts just behind it. Two to four times
slower than the packet path; the hits are the same, up to the rounding of transformed
and restarted rays: one that grazes a silhouette or a hole's rim may fall on the other
side of it.
"""

import numpy as np
from embreex.mesh_construction import TriangleMesh  # pyright: ignore[reportMissingImports]
from embreex.rtcore_scene import EmbreeScene  # pyright: ignore[reportMissingImports]

from ataa_jax import types
from ataa_jax.embree import kernels, masks, workers
from ataa_jax.embree.packets import invertible

_CHUNK = kernels.CHUNK
_LAYERS = 512  # our choice: holes one ray may pass before it counts as a miss
# A restarted ray begins this many ulps of its largest coordinate behind the hole.
_STEP = np.float32(8 * np.finfo(np.float32).eps)


class RunBackend:
    """The one-ray-at-a-time path of one scene."""

    def __init__(self, scene: types.Scene, split: masks.Split) -> None:
        position = np.asarray(scene.geometry.position, np.float32)
        self._mask = split.mask
        self._scenes: list[EmbreeScene | None] = []
        self._ids: list[np.ndarray] = []  # per group: opaque ids, then masked
        self._opaque: list[int] = []  # per group: how many of them are opaque
        self._first_row: list[int] = []  # per group: its first row of the mask table
        row = 0
        for opaque, masked in zip(split.opaque, split.masked, strict=True):
            ids = np.concatenate([opaque, masked])
            embree = None
            if ids.size:
                embree = EmbreeScene(robust=True)
                TriangleMesh(embree, np.ascontiguousarray(position[ids]))
                # The first run commits the scene; do it before threads meet here.
                embree.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32))
            self._scenes.append(embree)
            self._ids.append(ids)
            self._opaque.append(opaque.size)
            self._first_row.append(row)
            row += masked.size

    def intersect(
        self,
        world_from_group: np.ndarray,
        origin: np.ndarray,
        direction: np.ndarray,
        tile: tuple[int, int] | None,
        coherent: bool,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns distance, triangle and barycentric of the nearest hits."""
        del tile, coherent  # one ray at a time
        distance, triangle, barycentric = _missed(origin.shape[0])
        rays = np.flatnonzero(_has_path(origin, direction))

        def work(first: int, last: int) -> None:
            mine = rays[first:last]
            far = np.full(mine.size, np.inf, np.float32)
            hits = self._nearest(world_from_group, origin[mine], direction[mine], far)
            distance[mine], triangle[mine], barycentric[mine] = hits
            again = mine[hits[1] < 0]
            if again.size:
                largest = np.abs(direction[again]).max(axis=-1, keepdims=True)
                turned = direction[again] + largest * kernels.NUDGE
                hits = self._nearest(
                    world_from_group, origin[again], turned, far[: again.size]
                )
                distance[again], triangle[again], barycentric[again] = hits

        workers.for_chunks(rays.size, _CHUNK, work)
        return distance, triangle, barycentric

    def bare(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Returns the triangles that `EmbreeScene.run` finds in group 0, as it does.

        Nothing is done beyond the call: a hole of a mask is hit, a miss is a miss.
        """
        ids = np.full(origin.shape[0], -1, np.int32)
        scene = self._scenes[0]
        if scene is not None:

            def work(first: int, last: int) -> None:
                found = scene.run(origin[first:last], direction[first:last], output=1)
                ids[first:last] = found["primID"]

            workers.for_chunks(ids.size, _CHUNK, work)
        return ids

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
        del tile, coherent
        answer = np.zeros(origin.shape[0], np.bool_)
        long_enough = distance > np.finfo(np.float32).tiny
        rays = np.flatnonzero(active & long_enough & _has_path(origin, direction))

        def work(first: int, last: int) -> None:
            mine = rays[first:last]
            far = np.nextafter(distance[mine], np.float32(0.0))
            _, triangle, _ = self._nearest(
                world_from_group, origin[mine], direction[mine], far
            )
            answer[mine] = triangle >= 0

        workers.for_chunks(rays.size, _CHUNK, work)
        return answer

    def _nearest(
        self,
        world_from_group: np.ndarray,
        origin: np.ndarray,
        direction: np.ndarray,
        far: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the nearest hits at 0 < distance ≤ far, over all groups."""
        distance, triangle, barycentric = _missed(origin.shape[0])
        moving = len(self._scenes) > 1
        for group in range(len(self._scenes)):
            matrix = world_from_group[group]
            if self._scenes[group] is None or (moving and not invertible(matrix)):
                continue
            local = (origin, direction)
            if moving:
                local = _into_group(matrix, origin, direction)
            closer, ids, weights = self._nearest_in_group(
                group, *local, np.minimum(far, distance)
            )
            found = (ids >= 0) & (closer < distance)
            distance = np.where(found, closer, distance)
            triangle = np.where(found, ids, triangle)
            barycentric = np.where(found[:, None], weights, barycentric)
        return distance, triangle, barycentric

    def _nearest_in_group(
        self, group: int, origin: np.ndarray, direction: np.ndarray, far: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns the nearest solid hits in one group, passing through holes."""
        count = origin.shape[0]
        distance, triangle, barycentric = _missed(count)
        rays = np.arange(count)
        passed = np.zeros(count, np.float64)  # distance already travelled
        step = np.zeros(count, np.float64)  # the last part of it, behind a hole
        start = origin
        scene = self._scenes[group]
        assert scene is not None
        for _ in range(_LAYERS):
            heading = direction[rays]
            hit = scene.run(start, heading, dists=far[rays].copy(), output=1)
            primitive, u, v = hit["primID"], hit["u"], hit["v"]
            total = (passed + hit["tfar"]).astype(np.float32)
            some = (primitive >= 0) & (total <= far[rays])
            # Not hits: the origin itself, which robust mode reports as ±0, and what
            # was just left, if the step was too small to leave it.
            solid = some & (total > np.finfo(np.float32).tiny) & (hit["tfar"] > step)
            row = primitive - self._opaque[group]
            asked = np.flatnonzero(some & (row >= 0))
            solid[asked] &= masks.solid_many(
                *self._mask, self._first_row[group] + row[asked], u[asked], v[asked]
            )
            mine = rays[solid]
            distance[mine] = total[solid]
            triangle[mine] = self._ids[group][primitive[solid]]
            barycentric[mine] = np.stack([u[solid], v[solid]], axis=-1)

            onward = some & ~solid
            if not onward.any():
                break
            rays, heading = rays[onward], heading[onward]
            at = start[onward] + hit["tfar"][onward, None] * heading
            largest = np.maximum(np.abs(at), np.abs(origin[rays])).max(axis=-1)
            stuck = hit["tfar"][onward] <= step[onward]
            longer = np.maximum(16 * stuck * step[onward], np.finfo(np.float32).tiny)
            step = np.maximum(_STEP * largest / np.abs(heading).max(axis=-1), longer)
            passed = passed[onward] + hit["tfar"][onward] + step
            start = (origin[rays] + passed[:, None] * heading).astype(np.float32)
        return distance, triangle, barycentric


def _missed(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns distance, triangle and barycentric of rays that hit nothing."""
    return (
        np.full(count, np.inf, np.float32),
        np.full(count, -1, np.int32),
        np.zeros((count, 2), np.float32),
    )


def _has_path(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    finite = np.isfinite(origin).all(axis=-1) & np.isfinite(direction).all(axis=-1)
    return finite & (direction != 0).any(axis=-1)


def _into_group(
    world_from_group: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Carries rays into a group's space; distances along them stay the same."""
    matrix = world_from_group.astype(np.float64)
    group_from_world = np.linalg.inv(matrix[:, :3])
    local_origin = (origin - matrix[:, 3]) @ group_from_world.T
    local_direction = direction.astype(np.float64) @ group_from_world.T
    return local_origin.astype(np.float32), local_direction.astype(np.float32)
