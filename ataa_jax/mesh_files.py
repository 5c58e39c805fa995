"""A reader of the mesh formats beside glTF: OBJ, PLY, STL and what else trimesh knows.

They hold triangles, normals, texture coordinates and a base colour with its texture;
what they lack of a glTF material is supplied: rough, not metallic, double-sided.
"""

import io
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from trimesh.resolvers import FilePathResolver
from trimesh.visual import ColorVisuals

from ataa_jax import mipmap, types
from ataa_jax.errors import InputError
from ataa_jax.scene import MaterialSource, MeshSource, SceneSource, TextureSource


def load(path: str | Path) -> SceneSource:
    """Reads a mesh file.

    Args:
        path: the file.

    Returns:
        The scene; nothing moves in it, and it has neither lights nor cameras.

    Raises:
        InputError: the file is missing, of an unknown kind, malformed, or holds no
            triangles.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(
            f"scene {path} is a folder; give the path of a file in it: .glb, .gltf, or "
            "a mesh such as .obj, .ply or .stl"
        )
    if not path.is_file():
        raise InputError(f"scene {path} does not exist; give the path of a file")
    suffix = path.suffix.lower().lstrip(".")
    known = {"glb", "gltf", *trimesh.available_formats()}
    if suffix not in known:
        what = f"the unknown suffix '.{suffix}'" if suffix else "no suffix"
        raise InputError(
            f"scene {path} has {what}; known are "
            f"{', '.join('.' + name for name in sorted(known))}"
        )
    try:
        companions = _Companions(str(path))
        # Not processed: trimesh would drop vertices that are not numbers unseen.
        loaded = trimesh.load_scene(path, process=False, resolver=companions)
        placed = _placed(loaded)
    except ImportError:
        raise InputError(
            f"scene {path} cannot be read as {suffix}: it is malformed, or its text is "
            "not UTF-8; check the file"
        ) from None
    except Exception as error:  # trimesh's readers raise whatever they stumble over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"scene {path} cannot be read as {suffix}: {reason}; check the file"
        ) from None
    materials: list[MaterialSource] = []
    textures: list[TextureSource] = []
    meshes: list[MeshSource] = []
    warnings = companions.warnings
    for index, (mesh, normal) in enumerate(placed):
        if len(mesh.faces) == 0:
            continue
        if not np.all(np.isfinite(mesh.vertices)):
            raise InputError(f"scene {path} has vertices that are not finite numbers")
        uv = getattr(mesh.visual, "uv", None)
        name = str(mesh.metadata.get("name", f"mesh {index}"))
        materials.append(_mesh_material(mesh, name, textures, warnings))
        meshes.append(
            MeshSource(
                name=name,
                position=np.asarray(mesh.vertices, np.float32),
                triangles=np.asarray(mesh.faces, np.int32),
                material=len(materials) - 1,
                normal=None if normal is None else np.asarray(normal, np.float32),
                uv=None if uv is None else _flipped(np.asarray(uv, np.float32)),
            )
        )
    if not meshes:
        raise InputError(f"scene {path} holds no triangles; nothing to draw")
    return SceneSource(path.stem, meshes, materials, textures, warnings=warnings)


class _Companions(FilePathResolver):
    """Fetches the files that a mesh file names; trimesh goes on in silence without."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self.warnings: list[str] = []

    def get(self, name: str) -> bytes:
        """Returns the bytes of a file; warns, once, of one that cannot be used."""
        try:
            data = super().get(name)
        except FileNotFoundError:
            self._warn(name, "does not exist")
            raise
        except ValueError:
            self._warn(name, "lies outside the scene's folder")
            raise
        except OSError:
            self._warn(name, "cannot be read")
            raise
        if Path(name.strip()).suffix.lower() in Image.registered_extensions():
            try:
                with Image.open(io.BytesIO(data)) as image:
                    image.load()
            except Exception:  # Pillow raises whatever its decoders stumble over
                self._warn(name, "is no image that can be decoded")
                raise
        return data

    def _warn(self, name: str, what: str) -> None:
        warning = f"the file {name}, which the scene names, {what}: left out"
        if warning not in self.warnings:
            self.warnings.append(warning)


def _placed(
    loaded: trimesh.Scene,
) -> list[tuple[trimesh.Trimesh, np.ndarray | None]]:
    """Returns the meshes of a trimesh scene in world space, with the file's normals."""
    found = []
    for node in loaded.graph.nodes_geometry:
        matrix, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        normal = None
        # Only normals from the file stand here before anyone asks: `vertex_normals`
        # would make up smooth ones, which round off every edge of a file without, and
        # `Scene.dump` forgets those of the file.
        if "vertex_normals" in mesh._cache:
            x, y, z = np.asarray(matrix, np.float64)[:3, :3].T
            cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], 1)
            side = np.copysign(1.0, x @ np.cross(y, z))
            normal = np.asarray(mesh.vertex_normals) @ (side * cofactors).T
        mesh = mesh.copy()
        mesh.apply_transform(matrix)
        found.append((mesh, normal))
    return found


def _flipped(uv: np.ndarray) -> np.ndarray:
    """Turns trimesh's v, up from the image's bottom, into glTF's."""
    return np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=-1)


def _mesh_material(
    mesh: trimesh.Trimesh,
    name: str,
    textures: list[TextureSource],
    warnings: list[str],
) -> MaterialSource:
    """Maps trimesh's materials: base colour and its texture, rough and not metallic.

    Vertex colours are sRGB and averaged. An MTL's Kd is linear, as Blender reads it.
    """
    material = getattr(mesh.visual, "material", None)
    if material is None:
        if not isinstance(mesh.visual, ColorVisuals) or mesh.visual.kind is None:
            return _plain(name, _srgb(np.full(4, 200.0)), types.NO_TEXTURE)
        warnings.append(f"vertex colours of '{name}' are averaged to one base colour")
        colors = np.asarray(mesh.visual.vertex_colors, np.float64)
        return _plain(name, _srgb(colors.mean(axis=0)), types.NO_TEXTURE)
    name = str(getattr(material, "name", "") or name)
    image = getattr(material, "baseColorTexture", None)
    if image is None:
        image = getattr(material, "image", None)
    if image is not None:
        textures.append(TextureSource(np.asarray(image.convert("RGBA")), srgb=True))
        return _plain(name, np.ones(4), len(textures) - 1)
    color = getattr(material, "main_color", None)
    rgba = np.ones(4) if color is None else np.asarray(color) / 255.0
    return _plain(name, rgba, types.NO_TEXTURE)


def _srgb(rgba: np.ndarray) -> np.ndarray:
    """Decodes sRGB codes in [0, 255]; alpha is linear already."""
    return np.append(mipmap.decode_srgb(rgba[:3] / 255.0), rgba[3] / 255.0)


def _plain(name: str, linear: np.ndarray, texture: int) -> MaterialSource:
    r, g, b, a = (float(channel) for channel in linear)
    return MaterialSource(
        name=name,
        base_color=(r, g, b, a),
        metallic=0.0,
        roughness=0.8,
        double_sided=True,
        base_color_texture=texture,
    )
