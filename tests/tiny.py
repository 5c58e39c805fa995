"""Tiny scenes, built array by array, whose hits can be worked out by hand."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from ataa_jax import types


@dataclass
class Part:
    """One object: triangles with one material in one rigid group."""

    position: np.ndarray  # (t, 3, 3)
    uv: np.ndarray | None = None  # (t, 3, 2); None: zeros
    material: int = 0
    group: int = 0


@dataclass
class Material:
    base_color: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)
    metallic: float = 0.0
    roughness: float = 1.0
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)
    alpha_masked: bool = False
    blended: bool = False
    transmission: float = 0.0
    mirror: bool = False
    alpha_cutoff: float = 0.5
    double_sided: bool = True
    texture: int = types.NO_TEXTURE  # base colour


@dataclass
class Texture:
    texels: np.ndarray  # uint8 (h, w, 4); level 0 only
    wrap_u: int = types.WRAP_REPEAT
    wrap_v: int = types.WRAP_REPEAT


@dataclass
class Light:
    kind: int = types.LIGHT_DIRECTIONAL
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, -1.0, 0.0)
    intensity: tuple[float, float, float] = (3.0, 3.0, 3.0)
    range: float = float("inf")
    cos_inner: float = 1.0
    cos_outer: float = 0.0


@dataclass
class Sky:
    zenith: tuple[float, float, float] = (0.5, 0.5, 0.5)
    horizon: tuple[float, float, float] = (0.5, 0.5, 0.5)
    ground: tuple[float, float, float] = (0.5, 0.5, 0.5)
    visibility: float = 1.0
    bounce: tuple[float, float, float] = (0.0, 0.0, 0.0)


def scene(
    parts: list[Part],
    materials: list[Material] | None = None,
    textures: list[Texture] | None = None,
    lights: list[Light] | None = None,
    sky: Sky | None = None,
) -> types.Scene:
    """Packs parts into a `types.Scene`; object ids are the parts' places in the list.

    Normals are the triangles' own, counter-clockwise seen from outside.
    """
    materials = materials or [Material()]
    counts = [len(part.position) for part in parts]
    position = _join([part.position for part in parts], (0, 3, 3))
    uv = _join(
        [np.zeros((len(p.position), 3, 2)) if p.uv is None else p.uv for p in parts],
        (0, 3, 2),
    )
    return types.Scene(
        geometry=types.Geometry(
            position=jnp.asarray(position),
            normal=jnp.asarray(np.repeat(flat_normal(position)[:, None], 3, axis=1)),
            uv=jnp.asarray(uv),
            material=_ints(np.repeat([p.material for p in parts], counts)),
            object=_ints(np.repeat(np.arange(len(parts)), counts)),
            group=_ints(np.repeat([p.group for p in parts], counts)),
        ),
        materials=_materials(materials),
        textures=_textures(textures or []),
        lights=_lights(lights if lights is not None else [Light()]),
        sky=types.Sky(
            **{
                name: jnp.asarray(value, jnp.float32)
                for name, value in vars(sky or Sky()).items()
            }
        ),
    )


def quad(size: float = 2.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Part:
    """A square in the plane z = at[2], facing +z; uv (0, 0) at its upper left."""
    corner = np.array([[-1, 1, 0], [-1, -1, 0], [1, -1, 0], [1, 1, 0]]) * size / 2
    uv = np.array([[0, 0], [0, 1], [1, 1], [1, 0]], np.float64)
    faces = [[0, 1, 2], [0, 2, 3]]
    return Part((corner + at)[faces].astype(np.float32), uv[faces].astype(np.float32))


def floor(size: float = 20.0, height: float = 0.0) -> Part:
    """A square in the plane y = height, facing up."""
    part = quad(size)
    x, y, z = np.moveaxis(part.position, -1, 0)
    return Part(np.stack([x, z + np.float32(height), -y], axis=-1), part.uv)


def cube(size: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Part:
    """An axis-aligned cube of 12 triangles around `at`, facing outwards."""
    front = quad(size, (0.0, 0.0, size / 2)).position
    x, y, z = np.moveaxis(front, -1, 0)
    faces = [(x, y, z), (-x, y, -z), (z, y, -x), (-z, y, x), (x, z, -y), (x, -z, y)]
    position = np.concatenate([np.stack(face, axis=-1) for face in faces])
    uv = np.tile(quad().uv, (6, 1, 1))  # pyright: ignore[reportArgumentType]
    return Part((position + np.array(at)).astype(np.float32), uv)


def sphere(rows: int = 16, columns: int = 32, radius: float = 1.0) -> Part:
    """A closed sphere of triangles whose corners lie on it, around the origin."""
    theta = np.linspace(0.0, np.pi, rows + 1)[:, None]
    phi = np.linspace(0.0, 2 * np.pi, columns, endpoint=False)[None]
    point = radius * np.stack(
        [
            np.sin(theta) * np.cos(phi),
            np.cos(theta) + 0 * phi,
            -np.sin(theta) * np.sin(phi),
        ],
        axis=-1,
    )
    point[0], point[-1] = (0, radius, 0), (0, -radius, 0)  # one pole each, exactly
    a, b = point[:-1], point[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    lower = np.stack([a, b, c], axis=2)[:-1].reshape(-1, 3, 3)
    upper = np.stack([a, c, d], axis=2)[1:].reshape(-1, 3, 3)
    return Part(np.concatenate([lower, upper]).astype(np.float32))


def checker(cells: int = 4, texels: int = 8) -> Texture:
    """White, with alpha 255 and 0 in a checkerboard; the upper left cell is solid."""
    cell = np.arange(cells * texels) // texels
    alpha = np.where((cell[:, None] + cell[None]) % 2 == 0, 255, 0)
    image = np.full((*alpha.shape, 4), 255, np.uint8)
    image[..., 3] = alpha
    return Texture(image)


def still(groups: int = 1) -> np.ndarray:
    """The `world_from_group` of a scene where nothing has moved."""
    return np.tile(np.eye(3, 4, dtype=np.float32), (groups, 1, 1))


def moved(
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    turn: float = 0.0,
    scale: tuple[float, float, float] | float = 1.0,
) -> np.ndarray:
    """A 3×4 matrix: scale, then turn about +y (radians), then move by `offset`."""
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    linear = rotation @ np.diag(np.broadcast_to(scale, 3))
    return np.column_stack([linear, offset]).astype(np.float32)


def flat_normal(position: np.ndarray) -> np.ndarray:
    """Unit normals of triangles (t, 3, 3); 0 where a triangle has no area."""
    edge1, edge2 = position[:, 1] - position[:, 0], position[:, 2] - position[:, 0]
    normal = np.cross(edge1, edge2)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return (normal / np.where(length > 0, length, 1)).astype(np.float32)


def _join(arrays: list[np.ndarray], empty: tuple[int, ...]) -> np.ndarray:
    return np.concatenate([np.zeros(empty), *arrays]).astype(np.float32)


def _ints(values: np.ndarray) -> jnp.ndarray:
    return jnp.asarray(np.asarray(values), jnp.int32)


def _materials(materials: list[Material]) -> types.Materials:
    def floats(name: str) -> jnp.ndarray:
        return jnp.asarray([getattr(m, name) for m in materials], jnp.float32)

    none = jnp.full(len(materials), types.NO_TEXTURE, jnp.int32)
    return types.Materials(
        base_color=floats("base_color"),
        metallic=floats("metallic"),
        roughness=floats("roughness"),
        emissive=floats("emissive"),
        normal_scale=jnp.ones(len(materials), jnp.float32),
        alpha_cutoff=floats("alpha_cutoff"),
        alpha_masked=jnp.asarray([m.alpha_masked for m in materials]),
        blended=jnp.asarray([m.blended for m in materials]),
        transmission=jnp.asarray([m.transmission for m in materials], jnp.float32),
        mirror=jnp.asarray([m.mirror for m in materials]),
        double_sided=jnp.asarray([m.double_sided for m in materials]),
        base_color_texture=_ints(np.array([m.texture for m in materials])),
        metallic_roughness_texture=none,
        normal_texture=none,
        emissive_texture=none,
    )


def _textures(textures: list[Texture]) -> types.Textures:
    texels, offsets = [np.zeros(0, np.uint32)], [0]
    for texture in textures:
        r, g, b, a = np.moveaxis(texture.texels.astype(np.uint32), -1, 0)
        texels.append((r | g << 8 | b << 16 | a << 24).reshape(-1))
        offsets.append(offsets[-1] + texels[-1].size)
    sizes = np.array([t.texels.shape[:2] for t in textures]).reshape(-1, 2)
    return types.Textures(
        texels=jnp.asarray(np.concatenate([*texels, np.zeros(1, np.uint32)])),
        level_offset=_ints(np.array(offsets[:-1])[:, None]),
        level_height=_ints(sizes[:, :1]),
        level_width=_ints(sizes[:, 1:]),
        level_count=jnp.ones(len(textures), jnp.int32),
        wrap_u=_ints(np.array([t.wrap_u for t in textures], np.int32)),
        wrap_v=_ints(np.array([t.wrap_v for t in textures], np.int32)),
        srgb=jnp.zeros(len(textures), jnp.bool_),
    )


def _lights(lights: list[Light]) -> types.Lights:
    def floats(name: str, *shape: int) -> jnp.ndarray:
        values = np.array([getattr(light, name) for light in lights], np.float32)
        return jnp.asarray(values.reshape(len(lights), *shape))

    return types.Lights(
        kind=_ints(np.array([light.kind for light in lights], np.int32)),
        position=floats("position", 3),
        direction=floats("direction", 3),
        intensity=floats("intensity", 3),
        range=floats("range"),
        cos_inner=floats("cos_inner"),
        cos_outer=floats("cos_outer"),
        casts=jnp.ones((len(lights),), jnp.bool_),
    )
