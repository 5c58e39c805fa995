"""The Embree 4 C interface inside the embreex wheel, reached through `ctypes`.

embreex's own classes trace one ray at a time. The library it ships also has the
entry points for packets of rays, and the extension module depends on it: opening the
extension with `ctypes.CDLL` therefore resolves every exported ``rtc*`` symbol, and no
file name is guessed. Constants and layouts are those of Embree 4's public headers
(``rtcore_common.h``, ``rtcore_device.h``, ``rtcore_ray.h``, ``rtcore_scene.h``); tests
hold every one of them against hits that were computed without Embree.
"""

import ctypes
import functools
import weakref

import embreex.rtcore_scene
import numpy as np

TRIANGLES = 0  # RTC_GEOMETRY_TYPE_TRIANGLE
INSTANCE = 121  # RTC_GEOMETRY_TYPE_INSTANCE
BUFFER_INDEX, BUFFER_VERTEX = 0, 1  # RTC_BUFFER_TYPE_*
FORMAT_UINT3 = 0x5003
FORMAT_FLOAT3 = 0x9003
FORMAT_3X4_ROW_MAJOR = 0x9134
SCENE_ROBUST = 1 << 2  # edges shared by two triangles are hit without cracks
QUERY_COHERENT = 1 << 16
# RTC_DEVICE_PROPERTY_NATIVE_RAY*_SUPPORTED: the processor has vectors of so many rays.
NATIVE_RAYS = {16: 34, 8: 33, 4: 32}
FEATURES_ALL = 0xFFFFFFFF

_POINTER = ctypes.c_void_p
_UINT = ctypes.c_uint
_SIGNATURES = {  # name: (result, arguments)
    "rtcNewDevice": (_POINTER, [ctypes.c_char_p]),
    "rtcReleaseDevice": (None, [_POINTER]),
    "rtcGetDeviceError": (ctypes.c_int, [_POINTER]),
    "rtcGetDeviceProperty": (ctypes.c_ssize_t, [_POINTER, ctypes.c_int]),
    "rtcNewScene": (_POINTER, [_POINTER]),
    "rtcRetainScene": (None, [_POINTER]),
    "rtcReleaseScene": (None, [_POINTER]),
    "rtcSetSceneFlags": (None, [_POINTER, ctypes.c_int]),
    "rtcCommitScene": (None, [_POINTER]),
    "rtcNewGeometry": (_POINTER, [_POINTER, ctypes.c_int]),
    "rtcReleaseGeometry": (None, [_POINTER]),
    "rtcCommitGeometry": (None, [_POINTER]),
    "rtcAttachGeometryByID": (None, [_POINTER, _POINTER, _UINT]),
    "rtcSetSharedGeometryBuffer": (
        None,
        [_POINTER, ctypes.c_int, _UINT, ctypes.c_int, _POINTER]
        + [ctypes.c_size_t] * 3,  # byte offset, byte stride, item count
    ),
    "rtcSetGeometryUserData": (None, [_POINTER, _POINTER]),
    "rtcSetGeometryIntersectFilterFunction": (None, [_POINTER, _POINTER]),
    "rtcSetGeometryOccludedFilterFunction": (None, [_POINTER, _POINTER]),
    "rtcSetGeometryInstancedScene": (None, [_POINTER, _POINTER]),
    "rtcSetGeometryTransform": (
        None,
        [_POINTER, _UINT, ctypes.c_int, _POINTER],
    ),
    **{
        f"rtc{query}{lanes}": (None, [_POINTER] * 4)
        for query in ("Intersect", "Occluded")
        for lanes in NATIVE_RAYS
    },
}
_ERRORS = {
    1: "unknown error",
    2: "invalid argument",
    3: "invalid operation",
    4: "out of memory",
    5: "unsupported CPU",
    6: "cancelled",
}


@functools.cache
def load() -> ctypes.CDLL | None:
    """Opens the library and types its functions; None where a symbol is missing."""
    try:
        library = ctypes.CDLL(embreex.rtcore_scene.__file__)
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype = result
            function.argtypes = arguments
    except (OSError, AttributeError):
        return None
    return library


def address_of(function: object) -> int:
    """Returns the address of a `ctypes` function, to be called from numba."""
    return ctypes.cast(function, _POINTER).value or 0  # pyright: ignore[reportArgumentType]


class Device:
    """One Embree device, and everything made with it; freed when it is collected."""

    def __init__(self, library: ctypes.CDLL, config: str) -> None:
        self.library = library
        self.handle = library.rtcNewDevice(config.encode())
        if not self.handle:
            self._raise(library.rtcGetDeviceError(None), f"a device for {config!r}")
        # Not at exit: Embree's own worker threads may be gone by then, and the
        # operating system takes the memory back anyway. A scene holds references to
        # its geometries and to the device, so the order of releases is free.
        weakref.finalize(self, library.rtcReleaseDevice, self.handle).atexit = False

    def check(self, what: str) -> None:
        """Raises RuntimeError if a call of this thread has failed since the last check.

        Args:
            what: What was being made, for the message.
        """
        self._raise(self.library.rtcGetDeviceError(self.handle), what)

    def _raise(self, code: int, what: str) -> None:
        if code:
            reason = _ERRORS.get(code, f"error {code}")
            raise RuntimeError(f"Embree could not make {what}: {reason}")

    def lanes(self) -> int:
        """Returns how many rays the processor's vectors hold: 16, 8 or 4.

        Embree takes wider packets too: with AVX2, 16 at a time ran at half the rate.
        """
        for lanes, number in NATIVE_RAYS.items():
            if self.library.rtcGetDeviceProperty(self.handle, number):
                return lanes
        return min(NATIVE_RAYS)

    def new_scene(self) -> "EmbreeHandle":
        """Makes an empty scene in robust mode."""
        scene = self.library.rtcNewScene(self.handle)
        self.library.rtcSetSceneFlags(scene, SCENE_ROBUST)
        self.check("a scene")
        return EmbreeHandle(self, scene)

    def attach_triangles(
        self,
        scene: "EmbreeHandle",
        geometry_id: int,
        position: np.ndarray,
        mask: tuple[int, int] | None,
    ) -> None:
        """Adds unindexed triangles to a scene that is not committed yet.

        Args:
            scene: Their scene; it keeps the buffers alive.
            geometry_id: The id that hits will report.
            position: float32 (t, 3, 3), corners in the scene's space.
            mask: Addresses of the filter function, for both kinds of rays, and of the
                data it reads; None where every hit is solid.
        """
        count = position.shape[0]
        # Embree loads vertices by 16 bytes: one float more than the last one has.
        vertices = np.zeros(count * 9 + 4, np.float32)
        vertices[: count * 9] = position.reshape(-1)
        indices = np.arange(count * 3, dtype=np.uint32)
        scene.keep += [vertices, indices]
        library = self.library
        geometry = library.rtcNewGeometry(self.handle, TRIANGLES)
        for kind, form, array, items in (
            (BUFFER_VERTEX, FORMAT_FLOAT3, vertices, count * 3),
            (BUFFER_INDEX, FORMAT_UINT3, indices, count),
        ):
            library.rtcSetSharedGeometryBuffer(
                geometry, kind, 0, form, array.ctypes.data, 0, 12, items
            )
        if mask is not None:
            library.rtcSetGeometryIntersectFilterFunction(geometry, mask[0])
            library.rtcSetGeometryOccludedFilterFunction(geometry, mask[0])
            library.rtcSetGeometryUserData(geometry, mask[1])
        self._attach(scene, geometry, geometry_id, f"{count} triangles")

    def attach_instance(
        self,
        scene: "EmbreeHandle",
        instance_id: int,
        instanced: "EmbreeHandle",
        world_from_group: np.ndarray,
    ) -> None:
        """Adds a committed scene, moved by a 3×4 float32 matrix, to another scene."""
        library = self.library
        matrix = np.ascontiguousarray(world_from_group, np.float32)
        geometry = library.rtcNewGeometry(self.handle, INSTANCE)
        library.rtcSetGeometryInstancedScene(geometry, instanced.handle)
        library.rtcSetGeometryTransform(
            geometry, 0, FORMAT_3X4_ROW_MAJOR, matrix.ctypes.data
        )
        self._attach(scene, geometry, instance_id, "an instance")

    def _attach(
        self, scene: "EmbreeHandle", geometry: int, geometry_id: int, what: str
    ) -> None:
        self.library.rtcCommitGeometry(geometry)
        self.library.rtcAttachGeometryByID(scene.handle, geometry, geometry_id)
        self.library.rtcReleaseGeometry(geometry)  # the scene holds its own reference
        self.check(what)

    def commit(self, scene: "EmbreeHandle") -> None:
        """Builds the scene's acceleration structure; it never changes afterwards."""
        self.library.rtcCommitScene(scene.handle)
        self.check("an acceleration structure")


class EmbreeHandle:
    """An Embree scene with the buffers it reads; released when it is collected."""

    def __init__(self, device: Device, handle: int) -> None:
        self.device = device
        self.handle = handle
        self.keep: list[np.ndarray] = []
        release = device.library.rtcReleaseScene
        weakref.finalize(
            self, _release_scene, release, handle, self.keep
        ).atexit = False


def _release_scene(release: object, handle: int, keep: list[np.ndarray]) -> None:
    release(handle)  # pyright: ignore[reportCallIssue]
    keep.clear()  # only now: until its release the scene may read its buffers
