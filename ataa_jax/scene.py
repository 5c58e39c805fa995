"""Host-side scene description, and its packing into the arrays that shading reads.

Readers (`gltf`, `builtin`, the mesh formats below) produce a `SceneSource` of plain
NumPy records; `pack` turns it into a `types.Scene`. Nothing here traces a ray.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ataa_jax import types


@dataclass(frozen=True)
class TextureSource:
    """One image as glTF uses it: 8-bit texels, a sampler and an encoding."""

    texels: np.ndarray  # uint8 (height, width, 4), row 0 is v = 0
    srgb: bool  # RGB is sRGB-encoded (base colour, emissive), alpha never is
    wrap_u: int = types.WRAP_REPEAT
    wrap_v: int = types.WRAP_REPEAT


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
