"""Mitsuba 3 as the brute-force competitor: the same scene, supersampled throughout.

Mitsuba (Jakob et al., https://mitsuba-renderer.org) is an optional extra. It is given
the world's own triangles, textures, camera and punctual lights, a BSDF that computes
the equations of `material`, and an integrator that casts the rays of `transport`; see
`plugins`. What it does not get: sky, emission and reflections, which the package
approximates in ways of its own. `one_light` and `lamps` take them from a world, so
that both renderers draw the same.

Mitsuba averages linear radiance, the package tone-mapped samples by default: compare
it with `reference.reference(..., average="linear")`.
"""

import functools
import importlib
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ataa_jax import effects, lighting, types
from ataa_jax import scene as scenes
from ataa_jax.competitor import library
from ataa_jax.errors import InputError
from ataa_jax.world import Sequence, World, replace_lights

_LEFT_OUT = frozenset({"sky", "emission", "emissive-textures", "reflections"})

# our choice: samples a pixel that are rendered at once. Mitsuba's stratified sampler
# rounds 32 up to 35, and powers of two up to 16 not at all.
_AT_ONCE = 16


def lamps(world: World) -> World:
    """Returns the world lit by its punctual lights alone.

    With several, a sample of Mitsuba's sees one light at random, weighted by their
    number, and one of the package's sees all: equal in the mean, not in cost or noise.

    Args:
        world: any; its exposure stays.

    Returns:
        Without sky, emission and reflections.
    """
    wish = world.wish
    wish = replace(wish, everything=False, left_out=wish.left_out | _LEFT_OUT)
    return replace(world, scene=effects.without(world.scene, wish), wish=wish)


def one_light(world: World) -> World:
    """Returns the world lit by one directional light alone.

    Args:
        world: any; its exposure stays.

    Returns:
        As `lamps`, with the strongest of the scene's directional lights; where it has
        none, with the sun that `lighting` would supply to its first camera.
    """
    world = lamps(world)
    lights = world.scene.lights
    power = np.asarray(lights.intensity).max(axis=1)
    power = np.where(np.asarray(lights.kind) == types.LIGHT_DIRECTIONAL, power, -1.0)
    if power.size and power.max() >= 0.0:
        chosen = int(power.argmax())
        kept = [world.lights[chosen]]
    else:
        camera, transforms = world.cameras[0], world.source.transforms(0.0)
        points = lighting.look(world.tracer, world.scene, transforms, camera)
        kept = [lighting.best_sun(world.tracer, transforms, points, camera)[0]]
    packed = scenes.pack_lights(kept)
    exposed = packed.intensity * world.exposure
    packed = eqx.tree_at(lambda light: light.intensity, packed, exposed)
    return replace(
        world, lights=kept, scene=replace_lights(world.scene, packed, world.scene.sky)
    )


class Competitor:
    """A sequence in Mitsuba, ready to be rendered frame by frame."""

    def __init__(self, sequence: Sequence) -> None:
        """Builds the scene as it stands in frame 0.

        Args:
            sequence: of a world by `one_light` or `lamps`.

        Raises:
            InputError: Mitsuba or LLVM is missing, or the world is lit by more than
                punctual lights.
        """
        if sequence.world.shading.sky or sequence.world.shading.emission:
            raise InputError(
                "Mitsuba is compared without sky and emission; give a world by "
                "`competitor.one_light` or `competitor.lamps`"
            )
        self._mitsuba = library.load()
        self._sequence = sequence
        self._parts = _parts(sequence.world.scene)
        self._pose = np.zeros((4, 4))
        self._transforms = np.asarray(sequence.inputs(0).world_from_group)
        built = _build(self._mitsuba, sequence, self._parts, self._transforms)
        self._scene = built[0]
        self._parameters = [self._mitsuba.traverse(scene) for scene in built]
        self._draw = None
        self.place(0)

    def render(self, index: int, spp: int, seed: int = 0) -> np.ndarray:
        """Renders one frame, and waits for it.

        Args:
            index: frame of the sequence; a change of frame is `place`'s to make.
            spp: samples a pixel, at least 1, averaged in linear radiance.
            seed: of the stratified samples; the same seed gives the same image.

        Returns:
            Linear radiance, float32 (h, w, 3).

        Raises:
            InputError: spp is not positive.
        """
        if spp < 1:
            raise InputError(f"a sample count must be at least 1, not {spp}")
        self.place(index)
        if self._draw is None:
            self._draw = _frozen(self._mitsuba)
        total = np.zeros((*self._sequence.size, 3), np.float32)
        left = spp
        while left:
            count = min(_AT_ONCE, 1 << (left.bit_length() - 1))
            key = self._mitsuba.UInt32((seed << 16) + left)
            part = self._draw(self._scene, key, count)
            total += np.asarray(part, np.float32) * np.float32(count / spp)
            left -= count
        return total

    def place(self, index: int) -> None:
        """Moves the camera, and the rigid groups that moved since the last frame.

        Args:
            index: frame of the sequence. The fields of view of all are frame 0's.
        """
        inputs = self._sequence.inputs(index)
        pose = np.asarray(inputs.camera.world_from_view, np.float64)
        transforms = np.asarray(inputs.world_from_group)
        if not np.array_equal(pose, self._pose):
            turned = _camera_transform(self._mitsuba, pose)
            self._parameters[0]["sensor.to_world"] = turned
        for name, part in self._parts.items():
            now = transforms[part.group]
            if not np.array_equal(now, self._transforms[part.group]):
                self._move(name, *part.placed(now))
        self._pose, self._transforms = pose, transforms
        for parameters in self._parameters:
            parameters.update()

    def _move(self, name: str, position: np.ndarray, normal: np.ndarray) -> None:
        """Sets a part's corners in every scene that holds it.

        The program is recorded anew after that: the old one would go on reading the
        corners' old place in memory (drjit 1.5.0).
        """
        self._draw = None
        for parameters in self._parameters:
            if f"{name}.vertex_positions" in parameters:
                parameters[f"{name}.vertex_positions"] = position.reshape(-1)
                parameters[f"{name}.vertex_normals"] = normal.reshape(-1)


@dataclass(frozen=True)
class _Part:
    """The triangles of one material in one rigid group, in the group's space."""

    material: int
    group: int
    position: np.ndarray  # float32 (t, 3, 3)
    normal: np.ndarray  # float32 (t, 3, 3)
    uv: np.ndarray  # float32 (t, 3, 2)

    def placed(self, world_from_group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns world positions and normals, by a (3, 4) transform."""
        linear, origin = world_from_group[:, :3], world_from_group[:, 3]
        x, y, z = linear.T
        # Normals follow the cofactor matrix, as `vector.Affine.rotate_normal`.
        cofactor = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
        normal = self.normal @ cofactor
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        return self.position @ linear.T + origin, normal / np.maximum(length, 1e-30)


def _parts(scene: types.Scene) -> dict[str, _Part]:
    """Sorts the triangles by material and rigid group; names are Mitsuba's ids."""
    geometry = scene.geometry
    material, group = np.asarray(geometry.material), np.asarray(geometry.group)
    position, normal = np.asarray(geometry.position), np.asarray(geometry.normal)
    uv = np.asarray(geometry.uv)
    parts = {}
    for m, g in np.unique(np.stack([material, group], axis=1), axis=0):
        own = (material == m) & (group == g)
        parts[f"part_{m}_{g}"] = _Part(
            material=int(m),
            group=int(g),
            position=position[own],
            normal=normal[own],
            uv=uv[own],
        )
    return parts


def _frozen(mi: Any) -> Any:
    """Returns Mitsuba's `render` as a program that is recorded once a sample count.

    Otherwise every frame would trace the materials' Python code anew, one thread's
    work of some 100 ms that plugins in C++ have not.
    """
    drjit = importlib.import_module("drjit")

    def draw(scene: Any, seed: Any, spp: int) -> Any:
        return mi.render(scene, spp=spp, seed=seed)

    return drjit.freeze(draw)


def _build(
    mi: Any, sequence: Sequence, parts: dict[str, _Part], transforms: np.ndarray
) -> list[Any]:
    """Returns the scene of a sequence, and those of its solid and clear surfaces.

    The last is missing where every surface is solid.
    """
    plugins = importlib.import_module(f"{__name__}.plugins")
    scene = sequence.world.scene
    rows = _rows(plugins, scene, {part.material for part in parts.values()})
    bsdfs = {material: plugins.GltfBsdf(row) for material, row in rows.items()}
    meshes, solid, clear = {}, {}, {}
    for name, part in parts.items():
        row = rows[part.material]
        kind = solid if row.cutoff is None and not row.blended else clear
        # A mesh of its own for each scene, which alone then moves it.
        for each in (meshes, kind):
            bsdf, transform = bsdfs[part.material], transforms[part.group]
            each[name] = _mesh(mi, name, part, transform, bsdf)
    layered = any(row.blended for row in rows.values())
    hiding = mi.load_dict({"type": "scene", **solid})
    passing = mi.load_dict({"type": "scene", **clear}) if clear else None
    drawn: dict[str, Any] = {
        "type": "scene",
        "integrator": plugins.DirectLight(hiding, passing, layered),
        "sensor": _sensor(sequence),
        **meshes,
    }
    for index in range(scene.lights.kind.shape[0]):
        light = jax.tree.map(lambda x, i=index: np.asarray(x)[i], scene.lights)
        drawn[f"light_{index}"] = _emitter(plugins, light)
    return [mi.load_dict(drawn), hiding, *([passing] if clear else [])]


def _mesh(mi: Any, name: str, part: _Part, transform: np.ndarray, bsdf: Any) -> Any:
    """Returns the triangles of a part, placed in the world."""
    properties = mi.Properties()
    properties["bsdf"] = bsdf
    count = len(part.position)
    mesh = mi.Mesh(
        name, 3 * count, count, props=properties,
        has_vertex_normals=True, has_vertex_texcoords=True,
    )  # fmt: skip
    position, normal = part.placed(transform)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = position.reshape(-1)
    parameters["vertex_normals"] = normal.reshape(-1)
    parameters["vertex_texcoords"] = part.uv.reshape(-1)
    parameters["faces"] = np.arange(3 * count, dtype=np.uint32)
    parameters.update()
    return mesh


def _sensor(sequence: Sequence) -> dict[str, Any]:
    """Describes the camera: a pinhole, a box filter, stratified samples."""
    height, width = sequence.size
    fov_y = 2.0 * np.arctan(float(sequence.inputs(0).camera.tan_half_fov_y))
    return {
        "type": "perspective",
        "fov": float(np.degrees(fov_y)),
        "fov_axis": "y",
        "near_clip": 1e-3 * sequence.focus,
        "far_clip": 1e4 * sequence.focus,
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        },
        "sampler": {"type": "multijitter"},
    }


def _camera_transform(mi: Any, world_from_view: np.ndarray) -> Any:
    """Returns Mitsuba's camera, which looks along +z with +x to the left."""
    return mi.ScalarTransform4f(world_from_view @ np.diag([-1.0, 1.0, -1.0, 1.0]))


def _emitter(plugins: Any, light: types.Lights) -> Any:
    """Returns one punctual light."""
    kind, direction = int(light.kind), np.asarray(light.direction, np.float64)
    intensity = np.asarray(light.intensity, np.float64).tolist()
    if kind == types.LIGHT_DIRECTIONAL:
        return {
            "type": "directional",
            "direction": direction.tolist(),
            "irradiance": {"type": "rgb", "value": intensity},
        }
    cosines = float(light.cos_inner), float(light.cos_outer)
    return plugins.Lamp(
        np.asarray(light.position, np.float64).tolist(),
        direction.tolist(),
        intensity,
        float(light.range),
        cosines if kind == types.LIGHT_SPOT else None,
    )


def _rows(plugins: Any, scene: types.Scene, used: set[int]) -> dict[int, Any]:
    """Returns the materials in use, each texture decoded once a use."""
    table = jax.tree.map(np.asarray, scene.materials)
    textures = jax.tree.map(np.asarray, scene.textures)

    @functools.cache
    def image(texture: int, channels: tuple[int, ...], srgb: bool) -> Any:
        if texture == types.NO_TEXTURE:
            return None
        wrap = int(textures.wrap_u[texture]), int(textures.wrap_v[texture])
        return plugins.Image.of(_texels(textures, texture), channels, srgb, wrap)

    def row(m: int) -> Any:
        base, masked = int(table.base_color_texture[m]), bool(table.alpha_masked[m])
        return plugins.Row(
            base_color=tuple(table.base_color[m].tolist()),
            metallic=float(table.metallic[m]),
            roughness=float(table.roughness[m]),
            normal_scale=float(table.normal_scale[m]),
            cutoff=float(table.alpha_cutoff[m]) if masked else None,
            blended=bool(table.blended[m]),
            transmission=float(table.transmission[m]) * bool(table.blended[m]),
            base_image=image(base, (0, 1, 2, 3), True),
            alpha_image=image(base, (3,), False) if masked else None,
            metallic_roughness_image=image(
                int(table.metallic_roughness_texture[m]), (1, 2), False
            ),
            normal_image=image(int(table.normal_texture[m]), (0, 1, 2), False),
        )

    return {m: row(m) for m in sorted(used)}


def _texels(textures: types.Textures, texture: int) -> np.ndarray:
    """Returns a texture's mip level 0, uint8 (h, w, 4)."""
    height = int(textures.level_height[texture, 0])
    width = int(textures.level_width[texture, 0])
    first = int(textures.level_offset[texture, 0])
    flat = np.asarray(textures.texels[first : first + height * width], "<u4")
    return flat.view(np.uint8).reshape(height, width, 4)
