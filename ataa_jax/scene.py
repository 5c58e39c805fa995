"""Host-side scene description, and its packing into the arrays that shading reads.

Readers (`gltf`, `builtin`, `mesh_files`) produce a `SceneSource` of plain NumPy
records; `pack` turns it into a `types.Scene`. Nothing here traces a ray.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from ataa_jax import cache, mipmap, pyramids, types
from ataa_jax.errors import InputError


@dataclass(frozen=True)
class TextureSource:
    """One image as glTF uses it: 8-bit texels, a sampler and an encoding."""

    texels: np.ndarray  # uint8 (height, width, 4), row 0 is v = 0
    srgb: bool  # RGB is sRGB-encoded (base colour, emissive), alpha never is
    wrap_u: int = types.WRAP_REPEAT
    wrap_v: int = types.WRAP_REPEAT
    pyramid: pyramids.Pyramid | None = None  # of the texels, where it is known already


@dataclass(frozen=True)
class MaterialSource:
    """A glTF metallic-roughness material; defaults are glTF 2.0's own."""

    name: str = ""
    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)  # linear
    metallic: float = 1.0
    roughness: float = 1.0
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal_scale: float = 1.0
    alpha_mode: str = "OPAQUE"  # OPAQUE, MASK or BLEND
    alpha_cutoff: float = 0.5
    transmission: float = 0.0  # of the diffuse part, let through
    double_sided: bool = False
    base_color_texture: int = types.NO_TEXTURE  # index into SceneSource.textures
    metallic_roughness_texture: int = types.NO_TEXTURE
    normal_texture: int = types.NO_TEXTURE
    emissive_texture: int = types.NO_TEXTURE


@dataclass(frozen=True)
class MeshSource:
    """One drawn object: indexed triangles with one material, in its group's space."""

    name: str
    position: np.ndarray  # float32 (v, 3)
    triangles: np.ndarray  # int32 (t, 3)
    material: int
    normal: np.ndarray | None = None  # float32 (v, 3), unit; None: flat, per triangle
    uv: np.ndarray | None = None  # float32 (v, 2); None: zeros
    group: int = 0  # rigid group; 0 never moves and lies in world space


@dataclass(frozen=True)
class LightSource:
    """One KHR_lights_punctual light, placed in the world."""

    kind: int
    intensity: tuple[float, float, float]  # colour times lux or candela
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, -1.0)  # the way light travels
    range: float = float("inf")
    inner_cone_angle: float = 0.0  # radians
    outer_cone_angle: float = float(np.pi / 4)
    name: str = ""


@dataclass(frozen=True)
class CameraSource:
    """A perspective camera, placed in the world."""

    name: str
    world_from_view: np.ndarray  # float64 (4, 4), rigid
    fov_y: float  # radians


@dataclass(frozen=True)
class SkySource:
    """Radiance of a vertical gradient sky."""

    zenith: tuple[float, float, float]
    horizon: tuple[float, float, float]
    ground: tuple[float, float, float]


def still_groups(count: int) -> Callable[[float], np.ndarray]:
    """Returns the `SceneSource.transforms` of a scene in which nothing moves."""
    identity = np.tile(np.eye(3, 4, dtype=np.float32), (count, 1, 1))
    return lambda time: identity


@dataclass(frozen=True)
class SceneSource:
    """A whole scene as a reader found it, before lights or cameras are supplied."""

    name: str
    meshes: list[MeshSource]
    materials: list[MaterialSource]
    textures: list[TextureSource] = field(default_factory=list)
    lights: list[LightSource] = field(default_factory=list)
    cameras: list[CameraSource] = field(default_factory=list)
    sky: SkySource | None = None  # None: the file says nothing about a sky
    group_names: list[str] = field(default_factory=lambda: ["static"])
    transforms: Callable[[float], np.ndarray] = field(
        default_factory=lambda: still_groups(1)
    )  # seconds -> float32 (g, 3, 4) world_from_group; [0] is always identity
    duration: float = 0.0  # seconds of authored animation; it loops; 0: nothing moves
    warnings: list[str] = field(default_factory=list)
    distinct_meshes: int | None = None  # fewer than `meshes` where objects share one


def pack(source: SceneSource) -> tuple[types.Scene, list[str]]:
    """Packs a description into the arrays that shading and tracing read.

    Triangles without area or with corners that are not finite are left out; missing,
    zero or non-finite normals are replaced by the triangle's own. A BLEND material
    that is opaque everywhere is packed as opaque.

    Args:
        source: what a reader found. Its lights may be empty.

    Returns:
        The scene, object ids being places in `source.meshes`, and what was left out,
        one sentence each.

    Raises:
        InputError: no triangle is left, or an id names nothing.
    """
    _check_ids(source)
    parts = [_unindexed(mesh) for mesh in source.meshes]
    dropped = sum(part[3] for part in parts)
    counts = [len(part[0]) for part in parts]
    if sum(counts) == 0:
        raise InputError(
            f"scene '{source.name}' has no triangles with an area; nothing to draw"
        )
    notes = []
    if dropped:
        notes.append(f"{dropped} triangles without area or not finite were left out")

    def repeated(values: list[int]) -> jax.Array:
        return _put(np.repeat(values, counts), np.int32)

    geometry = types.Geometry(
        position=_put(np.concatenate([part[0] for part in parts]), np.float32),
        normal=_put(np.concatenate([part[1] for part in parts]), np.float32),
        uv=_put(np.concatenate([part[2] for part in parts]), np.float32),
        material=repeated([mesh.material for mesh in source.meshes]),
        object=repeated(list(range(len(source.meshes)))),
        group=repeated([mesh.group for mesh in source.meshes]),
    )
    black = (0.0, 0.0, 0.0)
    sky = source.sky or SkySource(black, black, black)
    scene = types.Scene(
        geometry=geometry,
        materials=_pack_materials(source.materials, source.textures),
        textures=_pack_textures(source.textures),
        lights=pack_lights(source.lights),
        sky=pack_sky(sky, 1.0),
    )
    return scene, notes


def bounds(source: SceneSource, time: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lowest and highest corner of all meshes at a time, world.

    Args:
        source: the scene.
        time: seconds of its animation.

    Returns:
        Two float64 (3,), over the finite corners of triangles.

    Raises:
        InputError: no corner is finite.
    """
    transforms = np.asarray(source.transforms(time), np.float64)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for mesh in source.meshes:
        used = mesh.position[np.unique(mesh.triangles)].astype(np.float64)
        used = used[np.isfinite(used).all(axis=1)]
        matrix = transforms[mesh.group]
        world = used @ matrix[:, :3].T + matrix[:, 3]
        low = np.minimum(low, world.min(axis=0, initial=np.inf))
        high = np.maximum(high, world.max(axis=0, initial=-np.inf))
    if not np.isfinite([low, high]).all():
        raise InputError(
            f"scene '{source.name}' has no triangles with finite corners; give a scene "
            "with at least one"
        )
    return low, high


def _check_ids(source: SceneSource) -> None:
    """Refuses ids that name nothing: NumPy would wrap them, JAX would clamp them."""
    groups = len(source.group_names)

    def check(low: int, high: int, count: int, what: str) -> None:
        if low < 0 or high >= count:
            raise InputError(
                f"scene '{source.name}': {what} {low if low < 0 else high}, but there "
                f"are {count}; correct the scene"
            )

    for mesh in source.meshes:
        name = f"mesh '{mesh.name}' names"
        check(mesh.material, mesh.material, len(source.materials), f"{name} material")
        check(mesh.group, mesh.group, groups, f"{name} rigid group")
        if mesh.triangles.size:
            low, high = int(mesh.triangles.min()), int(mesh.triangles.max())
            check(low, high, len(mesh.position), f"{name} vertex")
    for material in source.materials:
        for texture in (
            material.base_color_texture,
            material.metallic_roughness_texture,
            material.normal_texture,
            material.emissive_texture,
        ):
            if texture != types.NO_TEXTURE:
                what = f"material '{material.name}' names texture"
                check(texture, texture, len(source.textures), what)


def _put(values: Any, dtype: type[np.generic]) -> jax.Array:
    """Returns values as JAX has them; `jnp.asarray` compiles a program a shape."""
    return jax.device_put(np.asarray(values, dtype))


def _aligned(count: int) -> np.ndarray:
    """Returns room for numbers, uint32 (count,), that JAX takes over without a copy.

    On the CPU it does where an array begins at a multiple of 64 bytes.
    """
    room = np.empty(4 * count + 64, np.uint8)
    first = -room.ctypes.data % 64
    return room[first : first + 4 * count].view(np.uint32)


def pack_lights(lights: list[LightSource]) -> types.Lights:
    """Packs lights; directions are normalized."""

    def floats(values: list[Any], *shape: int) -> jax.Array:
        array = np.array(values, np.float64).reshape(len(lights), *shape)
        return _put(array, np.float32)

    direction = np.array([x.direction for x in lights], np.float64).reshape(-1, 3)
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    return types.Lights(
        kind=_put([x.kind for x in lights], np.int32),
        position=floats([x.position for x in lights], 3),
        direction=_put(direction / np.maximum(length, 1e-30), np.float32),
        intensity=floats([x.intensity for x in lights], 3),
        range=floats([x.range for x in lights]),
        cos_inner=floats([np.cos(x.inner_cone_angle) for x in lights]),
        cos_outer=floats([np.cos(x.outer_cone_angle) for x in lights]),
        casts=_put(np.ones(len(lights)), np.bool_),
    )


def pack_sky(sky: SkySource, visibility: float) -> types.Sky:
    """Packs a sky and the share of it that surfaces see."""
    return types.Sky(
        zenith=_put(sky.zenith, np.float32),
        horizon=_put(sky.horizon, np.float32),
        ground=_put(sky.ground, np.float32),
        visibility=_put(visibility, np.float32),
        bounce=_put(np.zeros(3), np.float32),
    )


def _unindexed(
    mesh: MeshSource,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Returns corners, unit normals and uv per triangle, and how many were dropped."""
    corners = np.asarray(mesh.position, np.float32)[mesh.triangles]
    wide = corners.astype(np.float64)  # the product of large edges overflows float32
    with np.errstate(invalid="ignore"):  # corners that are not finite are left out
        cross = np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0])
        area = np.linalg.norm(cross, axis=1)
    keep = np.isfinite(area) & (area > 0.0)
    flat = (cross[keep] / area[keep][:, None]).astype(np.float32)
    count = int(keep.sum())
    if mesh.normal is None:
        normals = np.repeat(flat[:, None], 3, axis=1)
    else:
        with np.errstate(invalid="ignore", over="ignore"):
            normals = np.asarray(mesh.normal, np.float32)[mesh.triangles[keep]]
            length = np.linalg.norm(normals, axis=2, keepdims=True)
            usable = np.isfinite(length) & (length > 0.0)
            unit = normals / np.where(usable, length, 1.0)
        normals = np.where(usable, unit, flat[:, None]).astype(np.float32)
    if mesh.uv is None:
        uv = np.zeros((count, 3, 2), np.float32)
    else:
        uv = np.asarray(mesh.uv, np.float32)[mesh.triangles[keep]]
        uv = np.where(np.isfinite(uv), uv, np.float32(0.0))
    return corners[keep], normals, uv, len(keep) - count


# Perceptual roughness below which a surface mirrors: our choice. At 0.05 GGX's lobe is
# narrower than a pixel of a 640-pixel image; by 0.08 it spreads over several.
MIRROR_ROUGHNESS = 0.08
_MIRROR_SHARE = 0.01  # our choice: of the texels; a stray one calls for nothing


def _shows_through(material: MaterialSource, textures: list[TextureSource]) -> bool:
    """Returns whether a material lets anything through, at any texel."""
    if material.alpha_mode == "MASK":
        return False
    if material.transmission > 0.0:
        return True
    if material.alpha_mode != "BLEND":
        return False
    texture = material.base_color_texture
    if material.base_color[3] < 1.0 or texture == types.NO_TEXTURE:
        return material.base_color[3] < 1.0
    return bool(np.any(textures[texture].texels[..., 3] < 255))


def _mirrors(material: MaterialSource, textures: list[TextureSource]) -> bool:
    """Returns whether a material's smooth texels call for reflection rays.

    A cut-out does not: it is a leaf or a chain.
    """
    if material.alpha_mode == "MASK":
        return False
    if material.roughness < MIRROR_ROUGHNESS:
        return True
    texture = material.metallic_roughness_texture
    if texture == types.NO_TEXTURE:
        return False
    green = textures[texture].texels[..., 1]
    smooth = green < MIRROR_ROUGHNESS / material.roughness * 255.0
    return float(np.mean(smooth)) > _MIRROR_SHARE


def _pack_materials(
    materials: list[MaterialSource], textures: list[TextureSource]
) -> types.Materials:
    def floats(values: list[Any]) -> jax.Array:
        return _put(values, np.float32)

    def ids(values: list[int]) -> jax.Array:
        return _put(values, np.int32)

    def flags(values: list[bool]) -> jax.Array:
        return _put(values, np.bool_)

    return types.Materials(
        base_color=floats([m.base_color for m in materials]),
        metallic=floats([m.metallic for m in materials]),
        roughness=floats([m.roughness for m in materials]),
        emissive=floats([m.emissive for m in materials]),
        normal_scale=floats([m.normal_scale for m in materials]),
        alpha_cutoff=floats([m.alpha_cutoff for m in materials]),
        alpha_masked=flags([m.alpha_mode == "MASK" for m in materials]),
        blended=flags([_shows_through(m, textures) for m in materials]),
        transmission=floats([m.transmission for m in materials]),
        mirror=flags([_mirrors(m, textures) for m in materials]),
        double_sided=flags([m.double_sided for m in materials]),
        base_color_texture=ids([m.base_color_texture for m in materials]),
        metallic_roughness_texture=ids(
            [m.metallic_roughness_texture for m in materials]
        ),
        normal_texture=ids([m.normal_texture for m in materials]),
        emissive_texture=ids([m.emissive_texture for m in materials]),
    )


def _pack_textures(sources: list[TextureSource]) -> types.Textures:
    """Lays the mip pyramids out in one array; those not known are built, in threads."""
    sources = sources or [TextureSource(np.full((1, 1, 4), 255, np.uint8), srgb=False)]
    shapes = [mipmap.level_shapes(*s.texels.shape[:2]) for s in sources]
    levels = max(len(shape) for shape in shapes)
    # Levels beyond a texture's last repeat its last.
    table = np.array([s + s[-1:] * (levels - len(s)) for s in shapes], np.int32)
    height, width = table[..., 0], table[..., 1]
    counts = np.array([len(shape) for shape in shapes], np.int32)
    sizes = np.where(np.arange(levels) < counts[:, None], height * width, 0)
    ends = np.cumsum(sizes.reshape(-1)).reshape(sizes.shape)
    starts = ends - sizes
    last = np.minimum(np.arange(levels), counts[:, None] - 1)
    offset = np.take_along_axis(starts, last, axis=1).astype(np.int32)
    flat = _aligned(int(ends[-1, -1]))

    def fill(row: int) -> None:
        source = sources[row]
        known = source.pyramid
        made = known.levels if known else mipmap.pyramid(source.texels, source.srgb)
        for level, texels in enumerate(made):
            first = starts[row, level]
            flat[first : first + texels.size] = texels.reshape(-1)

    with ThreadPoolExecutor() as pool:
        list(pool.map(fill, range(len(sources))))
    texels = _put(flat, np.uint32)
    digests = [s.pyramid.digest for s in sources if s.pyramid]
    if len(digests) == len(sources):
        cache.know(texels, b"".join(digests))
    return types.Textures(
        texels=texels,
        level_offset=_put(offset, np.int32),
        level_height=_put(height, np.int32),
        level_width=_put(width, np.int32),
        level_count=_put(counts, np.int32),
        wrap_u=_put([s.wrap_u for s in sources], np.int32),
        wrap_v=_put([s.wrap_v for s in sources], np.int32),
        srgb=_put([s.srgb for s in sources], np.bool_),
    )
