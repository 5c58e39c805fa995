"""Rays against the scene: the one module that knows Embree.

`build` makes a `Tracer` from a scene, once. `intersect` and `occluded` trace batches
of rays under `jit`, as host callbacks that are pure functions of their operands; the
tracer's ``*_numpy`` methods do the same for host code.

A hit lies strictly beyond the ray's origin and, for `occluded`, strictly before its
distance. Both sides of a triangle are hit; shading turns the normal. A masked
material is hit where its mask is solid (`masks` states the rule). Surfaces that
something shows through are not hit: `Tracer.clear` holds them. A ray that is not
finite, or has no direction, misses.

Two ways lead to Embree, with the same hits: packets of 16 or 8 rays through its C
interface (`packets`), and one at a time through embreex's classes (`fallback`), two to
four times slower, where that interface cannot be reached.

Cracks. Embree runs in robust mode: no ray slips through an edge that two triangles
share. Through a vertex it can (Embree's issue 181): of rays aimed at the vertices of
a closed sphere up to 2 % left it, of 48 million random ones none. `intersect` traces
a missed ray once more, turned by 16 ulps, and then none of them leaves; that costs
about 6 ns a miss. `occluded` does not: it would double the cost of every lit point.
"""

import copy
import ctypes
import hashlib
import weakref
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ataa_jax import cache, errors, hostcall, types
from ataa_jax.embree import holding, library, masks
from ataa_jax.embree.fallback import RunBackend
from ataa_jax.embree.packets import PacketBackend
from ataa_jax.embree.workers import set_threads, threads

__all__ = [
    "HostHits",
    "Tracer",
    "bare_run",
    "build",
    "intersect",
    "occluded",
    "set_threads",
    "threads",
]

# Asynchronous dispatch has hung host callbacks on the CPU (jax issue 25861). This
# acts when JAX makes its CPU client, so it stands at import, before any array exists.
jax.config.update("jax_cpu_enable_async_dispatch", False)

BACKENDS = ("auto", "packet", "run")


class HostHits(NamedTuple):
    """`types.Hits` as NumPy arrays. A miss has triangle −1 and distance inf."""

    distance: np.ndarray  # float32 (n,), in units of the ray direction's length
    triangle: np.ndarray  # int32 (n,)
    barycentric: np.ndarray  # float32 (n, 2), weights of corners 1 and 2


# What `build` returned, by its key, as long as someone holds it.
_living: "weakref.WeakValueDictionary[int, Tracer]" = weakref.WeakValueDictionary()


class Tracer:
    """A scene's geometry inside Embree.

    A pytree whose leaves are keys: a compiled program is given a tracer like any other
    operand, so scenes of equal shapes share it. The memory is Embree's own. It goes
    with the object that `build` returned or, if programs are under way then, at a
    `build` after they have ended. Any number of threads may use it.

    Attributes:
        group_count: Rigid groups it knows; `world_from_group` has at least as many.
        backend: ``packet`` or ``run``; ``operand`` inside a compiled program.
        key: 64 bits of a hash of what it was built from, uint32 (2,), high word first,
            by which programs name it.
        clear: Traces the surfaces that something shows through, which this tracer
            does not have; None where the scene has none.
    """

    def __init__(
        self,
        backend: str,
        group_count: int,
        way: PacketBackend | RunBackend,
        key: int,
        clear: "Tracer | None" = None,
    ) -> None:
        self.backend = backend
        self.group_count = group_count
        self.key: Any = np.array([key >> 32, key & 0xFFFFFFFF], np.uint32)
        self.clear = clear
        self._way = way
        _living[key] = self
        holding.hold(key, copy.copy(self), owner=self)

    def __repr__(self) -> str:
        return f"Tracer(backend={self.backend!r}, group_count={self.group_count})"

    def intersect_numpy(
        self,
        world_from_group: np.ndarray,
        origin: np.ndarray,
        direction: np.ndarray,
        *,
        tile: tuple[int, int] | None = None,
        coherent: bool = True,
    ) -> HostHits:
        """Does what `intersect` does, on NumPy arrays."""
        _check(self, world_from_group, origin, direction, tile)
        return HostHits(
            *self._way.intersect(
                self._matrices(world_from_group),
                _float32(origin),
                _float32(direction),
                tile,
                coherent,
            )
        )

    def occluded_numpy(
        self,
        world_from_group: np.ndarray,
        origin: np.ndarray,
        direction: np.ndarray,
        distance: np.ndarray,
        active: np.ndarray,
        *,
        tile: tuple[int, int] | None = None,
        coherent: bool = True,
    ) -> np.ndarray:
        """Does what `occluded` does, on NumPy arrays."""
        _check(self, world_from_group, origin, direction, tile)
        _check_lengths(origin, distance, active)
        return self._way.occluded(
            self._matrices(world_from_group),
            _float32(origin),
            _float32(direction),
            _float32(distance),
            np.ascontiguousarray(active, np.bool_),
            tile,
            coherent,
        )

    def _matrices(self, world_from_group: np.ndarray) -> np.ndarray:
        matrices = np.array(world_from_group, np.float32)[: self.group_count]
        matrices[0] = np.eye(3, 4, dtype=np.float32)  # group 0 is the world
        return matrices


def bare_run(scene: types.Scene) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Returns embreex's `EmbreeScene.run` on all threads, to compare speeds with.

    It takes origins and directions, float32 (n, 3), and returns the triangles of group
    0 that they hit, −1 for none; holes of masks and what is transparent are hit too.
    """
    return RunBackend(scene, masks.split(scene)).bare


def _flatten(tracer: Tracer) -> tuple[tuple[Any, Tracer | None], int]:
    return (tracer.key, tracer.clear), tracer.group_count


def _unflatten(group_count: int, leaves: tuple[Any, Tracer | None]) -> Tracer:
    """Returns what a program sees of a tracer: its keys, and no memory."""
    tracer = object.__new__(Tracer)
    tracer.key, tracer.clear = leaves
    tracer.group_count = group_count
    tracer.backend = "operand"
    return tracer


jax.tree_util.register_pytree_node(Tracer, _flatten, _unflatten)


def build(
    scene: types.Scene, *, backend: str = "auto", device_config: str = ""
) -> Tracer:
    """Builds Embree's acceleration structures, once a scene.

    While a tracer lives, the same geometry, masks and arguments give that tracer again:
    a scene that is loaded twice is built once.

    Args:
        scene: The scene; its arrays are copied.
        backend: ``packet`` (16 or 8 rays at a time), ``run`` (one at a time), or
            ``auto``: packets where Embree's C interface can be reached.
        device_config: Handed to Embree's ``rtcNewDevice``, for example
            ``"isa=avx2"`` or ``"threads=1"``; only packets have it.

    Returns:
        The tracer.

    Raises:
        InputError: The backend is unknown, or packets were asked for and cannot be
            had, or a triangle names a material or group that does not exist.
        RuntimeError: Embree reported an error.
    """
    if backend not in BACKENDS:
        raise errors.InputError(
            f"backend is {backend!r}; choose one of {', '.join(BACKENDS)}"
        )
    clib = None if backend == "run" else library.load()
    if backend == "packet" and clib is None:
        raise errors.InputError(
            "Embree's C interface was not found in the embreex package; "
            "install embreex 4.4 or later, or choose backend 'run'"
        )
    _check_ids(scene)
    parts = (scene.geometry, scene.materials, scene.textures)
    content = f"{cache.content_hash(parts)} {clib is not None} {device_config}"
    holding.sweep()
    if (found := _living.get(_key(content))) is not None:
        return found
    return _build(scene, clib, device_config, content)


def _key(content: str) -> int:
    digest = hashlib.blake2b(content.encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big")


def _build(
    scene: types.Scene, clib: ctypes.CDLL | None, device_config: str, content: str
) -> Tracer:
    def tracer(split: masks.Split, content: str, clear: Tracer | None = None) -> Tracer:
        key, count = _key(content), len(split.opaque)
        if clib is None:
            return Tracer("run", count, RunBackend(scene, split), key, clear)
        way = PacketBackend(clib, scene, split, device_config)
        return Tracer("packet", count, way, key, clear)

    used = np.unique(np.asarray(scene.geometry.material))
    if not np.any(np.asarray(scene.materials.blended)[used]):
        return tracer(masks.split(scene), content)
    clear = tracer(masks.split(scene, blended=True), f"{content} clear")
    return tracer(masks.split(scene), content, clear)


def intersect(
    tracer: Tracer,
    world_from_group: Float[Array, "g 3 4"],
    origin: Float[Array, "n 3"],
    direction: Float[Array, "n 3"],
    *,
    tile: tuple[int, int] | None = None,
    coherent: bool = True,
) -> types.Hits:
    """Finds the nearest solid hit of each ray, inside `jit` or outside.

    Not differentiable: no gradient flows through it, into rays or transforms.

    Args:
        tracer: The scene.
        world_from_group: Where the rigid groups are. Row 0 is not read: group 0 is
            the world. A group without an inverse (scaled to nothing, or flattened)
            is not there.
        origin: World space.
        direction: World space, of any length but 0.
        tile: (height, width) if the rays are the pixels of an image in row-major
            order: rays of 4×4 pixels then travel together, which is faster.
        coherent: A hint that neighbouring rays take similar ways.

    Returns:
        The hits, in the order of the rays; distance > 0.

    Raises:
        InputError: The shapes do not fit together.
    """
    _check(tracer, world_from_group, origin, direction, tile)
    count = origin.shape[0]
    shapes = (
        jax.ShapeDtypeStruct((count,), jnp.float32),
        jax.ShapeDtypeStruct((count,), jnp.int32),
        jax.ShapeDtypeStruct((count, 2), jnp.float32),
    )
    distance, triangle, barycentric = hostcall.call(
        intersect_host,
        shapes,
        jnp.asarray(tracer.key),
        *jax.lax.stop_gradient((world_from_group, origin, direction)),
        **_numbers(tile, coherent),
    )
    return types.Hits(distance=distance, triangle=triangle, barycentric=barycentric)


def occluded(
    tracer: Tracer,
    world_from_group: Float[Array, "g 3 4"],
    origin: Float[Array, "n 3"],
    direction: Float[Array, "n 3"],
    distance: Float[Array, " n"],
    active: Bool[Array, " n"],
    *,
    tile: tuple[int, int] | None = None,
    coherent: bool = True,
) -> Bool[Array, " n"]:
    """Says which rays meet anything solid, inside `jit` or outside.

    Args:
        tracer: The scene.
        world_from_group: As in `intersect`.
        origin: World space.
        direction: World space, of any length but 0.
        distance: A hit counts if 0 < its distance < this, in units of the direction's
            length; inf: anywhere along the ray; 0, negative or NaN: nowhere.
        active: Rays to trace; the others cost nothing and answer False.
        tile: As in `intersect`.
        coherent: As in `intersect`.

    Returns:
        True where something is in the way.

    Raises:
        InputError: The shapes do not fit together.
    """
    _check(tracer, world_from_group, origin, direction, tile)
    _check_lengths(origin, distance, active)
    operands = (world_from_group, origin, direction, distance)
    (answer,) = hostcall.call(
        occluded_host,
        (jax.ShapeDtypeStruct((origin.shape[0],), jnp.bool_),),
        jnp.asarray(tracer.key),
        *jax.lax.stop_gradient(operands),
        active,
        **_numbers(tile, coherent),
    )
    return answer


def _numbers(tile: tuple[int, int] | None, coherent: bool) -> dict[str, int]:
    height, width = tile or (0, 0)
    return {"height": height, "width": width, "coherent": int(coherent)}


def _named(key: np.ndarray) -> Tracer:
    high, low = (int(word) for word in key)
    if (found := holding.find(high << 32 | low)) is None:
        raise RuntimeError("the tracer of this scene was freed before its rays ran")
    return found


@hostcall.target
def intersect_host(
    key: np.ndarray,
    world_from_group: np.ndarray,
    origin: np.ndarray,
    direction: np.ndarray,
    *,
    height: int,
    width: int,
    coherent: int,
) -> HostHits:
    """Does `intersect` for the tracer of a key; a tile of height 0 is none."""
    return _named(key).intersect_numpy(
        world_from_group,
        origin,
        direction,
        tile=(height, width) if height else None,
        coherent=bool(coherent),
    )


@hostcall.target
def occluded_host(
    key: np.ndarray,
    world_from_group: np.ndarray,
    origin: np.ndarray,
    direction: np.ndarray,
    distance: np.ndarray,
    active: np.ndarray,
    *,
    height: int,
    width: int,
    coherent: int,
) -> tuple[np.ndarray]:
    """Does `occluded` for the tracer of a key; a tile of height 0 is none."""
    blocked = _named(key).occluded_numpy(
        world_from_group,
        origin,
        direction,
        distance,
        active,
        tile=(height, width) if height else None,
        coherent=bool(coherent),
    )
    return (blocked,)


def _float32(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float32)


def _check(
    tracer: Tracer,
    world_from_group: Array | np.ndarray,
    origin: Array | np.ndarray,
    direction: Array | np.ndarray,
    tile: tuple[int, int] | None,
) -> None:
    """Checks shapes, once for all callers: nothing may fail inside a callback."""
    matrices = world_from_group.shape
    if matrices[1:] != (3, 4) or matrices[0] < tracer.group_count:
        raise errors.InputError(
            f"world_from_group has shape {matrices}; "
            f"the scene needs ({tracer.group_count}, 3, 4)"
        )
    if origin.shape != direction.shape or origin.shape[1:] != (3,):
        raise errors.InputError(
            f"rays have origins of shape {origin.shape} and directions of shape "
            f"{direction.shape}; both must be (n, 3)"
        )
    if tile is not None and tile[0] * tile[1] != origin.shape[0]:
        raise errors.InputError(
            f"tile {tile} is an image of {tile[0] * tile[1]} pixels, "
            f"but there are {origin.shape[0]} rays"
        )


def _check_lengths(origin: Array | np.ndarray, *others: Array | np.ndarray) -> None:
    for other in others:
        if other.shape != origin.shape[:1]:
            raise errors.InputError(
                f"{origin.shape[0]} rays need as many distances and active flags; "
                f"got shape {other.shape}"
            )


def _check_ids(scene: types.Scene) -> None:
    group = np.asarray(scene.geometry.group)
    if group.size and group.min() < 0:
        raise errors.InputError(f"rigid group {group.min()} of a triangle is negative")
    material = np.asarray(scene.geometry.material)
    count = np.asarray(scene.materials.alpha_masked).size
    if material.size and (material.min() < 0 or material.max() >= count):
        raise errors.InputError(
            f"triangles name materials {material.min()} to {material.max()}, "
            f"but the scene has {count}"
        )
