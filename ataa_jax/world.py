"""A scene made ready to render: packed arrays, tracer, lights, cameras, exposure."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import (
    builtin,
    cache,
    effects,
    embree,
    exposure,
    gltf,
    lighting,
    memory,
    paths,
    shading,
    types,
)
from ataa_jax import camera as cameras
from ataa_jax import scene as scenes
from ataa_jax.errors import InputError
from ataa_jax.scene import CameraSource, LightSource, SceneSource

BUILTIN = "builtin"


@dataclass(frozen=True, eq=False)
class World:
    """Everything that stays the same over a sequence.

    Lights, sky and emission of `scene` are already multiplied by `exposure`, as engines
    pre-expose: radiance anywhere in the package is exposed radiance.
    """

    name: str
    source: SceneSource  # without its images: `scene` holds them, filtered
    scene: types.Scene
    tracer: embree.Tracer
    cameras: list[CameraSource]  # at least one
    lights: list[LightSource]  # as supplied or authored, before exposure
    exposure: float
    notes: list[str]  # warnings of the reader, and what was supplied
    # Secondary rays of a frame of `exposure.PREVIEW` pixels; None: not counted.
    rays: types.Rays | None = None
    looked: list[effects.Effect] = field(default_factory=list)  # what it calls for
    wish: effects.Wish = field(default_factory=effects.Wish)  # what was asked for

    @cached_property
    def shading(self) -> shading.Config:
        """What the frame program shades: what the scene calls for, or everything."""
        if self.wish.everything:
            return effects.everything()
        return effects.required(self.scene)

    @cached_property
    def content_hash(self) -> str:
        """Hashes every array that decides an image of this world."""
        return cache.content_hash(self.scene)

    def camera(self, name: str | None) -> CameraSource:
        """Returns a camera by name, or the first.

        Raises:
            InputError: no camera has this name.
        """
        if name is None:
            return self.cameras[0]
        for camera in self.cameras:
            if camera.name == name:
                return camera
        known = ", ".join(camera.name for camera in self.cameras)
        raise InputError(
            f"the scene has no camera '{name}'; it has: {known}. Camera paths are "
            f"{', '.join(paths.NAMED_KINDS)}, or a .toml file"
        )

    def focus(self, camera: CameraSource) -> float:
        """Returns the distance to what the middle of a camera's image shows."""
        points = lighting.look(
            self.tracer, self.scene, self.source.transforms(0.0), camera
        )
        return lighting.focus_distance(points, fallback=1.0)


@dataclass(frozen=True, eq=False)
class Sequence:
    """A world seen along a path: `inputs(i)` gives the operands of frame i."""

    world: World
    path: paths.CameraPath
    size: tuple[int, int]
    camera: CameraSource
    focus: float

    @property
    def camera_moves(self) -> bool:
        """Whether the camera moves from frame to frame."""
        path = self.path
        return path.kind == "keyframes" or (path.kind != "still" and path.motion > 0)

    @property
    def objects_move(self) -> bool:
        """Whether an animation plays."""
        return self.world.source.duration > 0.0

    @property
    def effects(self) -> effects.Selection:
        """The effects that this sequence calls for, or that were asked for."""
        everything = self.world.wish.everything
        return effects.Selection(
            shading=self.world.shading,
            camera_motion=everything or self.camera_moves,
            object_motion=everything or self.objects_move,
        )

    def pose(self, frame: int) -> paths.Pose:
        """Returns where the camera stands in a frame."""
        aspect = self.size[1] / self.size[0]
        return paths.pose(self.path, self.camera, self.focus, aspect, frame)

    def inputs(self, frame: int, jitter: np.ndarray | None = None) -> types.FrameInputs:
        """Returns the operands of a frame; no jitter means the pixel centre."""
        now, then = self.pose(frame), self.pose(frame - 1)
        if self.path.kind == "still" and self.world.source.duration == 0.0:
            then = now
        transforms = self.world.source.transforms
        offset = np.zeros(2, np.float32) if jitter is None else jitter
        return types.FrameInputs(
            camera=cameras.make(now.world_from_view, now.fov_y),
            previous_camera=cameras.make(then.world_from_view, then.fov_y),
            world_from_group=jnp.asarray(transforms(now.time), jnp.float32),
            previous_world_from_group=jnp.asarray(transforms(then.time), jnp.float32),
            jitter=jnp.asarray(offset, jnp.float32),
            cut=jnp.asarray(frame == 0),
        )


def sequence(world: World, path: paths.CameraPath, size: tuple[int, int]) -> Sequence:
    """Binds a world to a camera path and an image size (height, width).

    Raises:
        InputError: the path names a camera that the scene lacks.
    """
    camera = world.camera(path.camera)
    if not world.wish.keeps(effects.CAMERA_MOTION):
        path = replace(path, kind="still", keyframes=())
    return Sequence(world, path, size, camera, world.focus(camera))


def shot(
    world: World,
    path: str | paths.CameraPath = "walk",
    size: tuple[int, int] = (360, 640),
    *,
    motion: str | float | None = None,
) -> Sequence:
    """Binds a world to a camera path by its name; see `paths.load`.

    Raises:
        InputError: no such path or camera.
    """
    if isinstance(path, str):
        path = paths.load(path, motion, [camera.name for camera in world.cameras])
    return sequence(world, path, size)


def load(
    path: str | Path,
    *,
    camera: str | None = None,
    size: tuple[int, int] | None = None,
    backend: str = "auto",
    wish: effects.Wish | None = None,
) -> World:
    """Loads a scene file, or the built-in scene by the name `builtin`.

    Args:
        path: ``builtin``, a ``.glb`` or ``.gltf``, or any mesh that trimesh reads.
        camera: the camera for which light and exposure are decided; the first by
            default.
        size: image (height, width) that will be rendered; loading is faster where it
            is known, see `exposure`.
        backend: Embree's entry points, see `embree.build`.
        wish: effects asked for in place of those that the scene calls for; light and
            exposure are decided with the latter.

    Returns:
        The world, with light, sky, camera and exposure supplied where it has none.

    Raises:
        InputError: the file is missing, malformed or asks for what is not supported.
    """
    return prepare(
        read(path, size), camera=camera, size=size, backend=backend, wish=wish
    )


def read(path: str | Path, size: tuple[int, int] | None = None) -> SceneSource:
    """Reads a scene without making it ready to render; see `load`.

    Args:
        path: as `load` takes it.
        size: image (height, width) that will be rendered; the allocator is suited to
            it, see `memory.suit`.
    """
    if size is not None:
        memory.suit(size)
    if not str(path):
        raise InputError("the scene's name is empty; give a file, or 'builtin'")
    if str(path) == BUILTIN:
        return builtin.garden_house()
    if Path(path).suffix.lower() in (".glb", ".gltf"):
        return gltf.load(path)
    from ataa_jax import mesh_files  # here, for trimesh takes its time to import

    return mesh_files.load(path)


def prepare(
    source: SceneSource,
    *,
    camera: str | None = None,
    size: tuple[int, int] | None = None,
    backend: str = "auto",
    wish: effects.Wish | None = None,
) -> World:
    """Turns a scene description into a world; see `load`."""
    memory.release_after_compiling()
    packed, notes = scenes.pack(source)
    source = replace(source, textures=[])  # in the packed scene they are, and smaller
    if size is not None and memory.scarce(size):
        memory.release()  # before XLA compiles, which takes half a gigabyte
    notes = [*source.warnings, *notes]
    tracer = embree.build(packed, backend=backend)
    all_cameras = source.cameras
    if not all_cameras:
        all_cameras = [lighting.framing_camera(source)]
        notes.append("no camera in the scene: one that frames it was supplied")
    transforms = source.transforms(0.0)
    world = World(
        name=source.name,
        source=source,
        scene=packed,
        tracer=tracer,
        cameras=all_cameras,
        lights=[],
        exposure=1.0,
        notes=notes,
    )
    chosen = world.camera(camera)
    points = lighting.look(tracer, packed, transforms, chosen)
    lights, sky, supplied = lighting.supply(source, tracer, transforms, points, chosen)
    visibility = lighting.sky_visibility(tracer, transforms, points)
    supplied.append(
        f"the sky's ambient light is scaled by {visibility:.2f}, the share of it that "
        "visible surfaces see"
    )
    packed = replace_lights(
        packed, scenes.pack_lights(lights), scenes.pack_sky(sky, visibility)
    )
    brightness = exposure.measure(
        packed,
        tracer,
        transforms,
        cameras.make(chosen.world_from_view, chosen.fov_y),
        visibility,
        size=size,
        object_motion=source.duration > 0.0,
    )
    packed = eqx.tree_at(lambda s: s.sky.bounce, packed, jnp.asarray(brightness.bounce))
    world = replace(
        world,
        scene=_exposed(packed, float(brightness.exposure)),
        lights=lights,
        exposure=float(brightness.exposure),
        notes=[*notes, *supplied],
        rays=brightness.rays if size is None else None,
        looked=[
            *effects.look(packed),
            *effects.look_at_motion(source.duration > 0.0),
        ],
    )
    memory.release()  # what packing and measuring left
    return world if wish is None else wished(world, wish, backend=backend)


def wished(world: World, wish: effects.Wish, *, backend: str = "auto") -> World:
    """Returns the world with other effects than those that it calls for."""
    refused = effects.refusals(wish, world.looked)
    scene, tracer = effects.without(world.scene, wish), world.tracer
    source = world.source
    if not (wish.keeps("alpha-mask") and wish.keeps("transparency")):
        tracer = embree.build(scene, backend=backend)
    if not wish.keeps(effects.OBJECT_MOTION):
        pose = source.transforms(0.0)
        source = replace(source, transforms=lambda time: pose, duration=0.0)
    return replace(
        world,
        scene=scene,
        tracer=tracer,
        source=source,
        wish=wish,
        notes=[*world.notes, *refused],
    )


def replace_lights(
    packed: types.Scene, lights: types.Lights, sky: types.Sky
) -> types.Scene:
    """Returns the scene under other lights."""
    return types.Scene(
        geometry=packed.geometry,
        materials=packed.materials,
        textures=packed.textures,
        lights=lights,
        sky=sky,
    )


def _exposed(packed: types.Scene, exposure: float) -> types.Scene:
    """Multiplies everything that emits by the exposure."""

    def parts(s: types.Scene) -> tuple:
        sky = s.sky
        return (
            s.lights.intensity,
            sky.zenith,
            sky.horizon,
            sky.ground,
            sky.bounce,
            s.materials.emissive,
        )

    exposed = [np.asarray(part) * np.float32(exposure) for part in parts(packed)]
    return eqx.tree_at(parts, packed, tuple(jax.device_put(part) for part in exposed))
