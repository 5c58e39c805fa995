"""Meshes: their primitives, and how an instance of one is baked (glTF 2.0, 3.7)."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ataa_jax.gltf import accessors
from ataa_jax.gltf.container import Container, short
from ataa_jax.gltf.materials import Materials

_TRIANGLES, _STRIP, _FAN = 4, 5, 6


@dataclass(frozen=True)
class Primitive:
    """The triangles of one primitive, in the mesh's own space."""

    position: np.ndarray  # float32 (v, 3)
    triangles: np.ndarray  # int32 (t, 3)
    material: int
    normal: np.ndarray | None  # float32 (v, 3), not yet unit
    uv: np.ndarray | None  # float32 (v, 2)
    joints: np.ndarray | None = None  # int64 (v, 4 n)
    weights: np.ndarray | None = None  # float32 (v, 4 n), sums to 1


def read_mesh(
    container: Container, index: int, materials: Materials
) -> list[Primitive]:
    """Reads all primitives of a mesh that consist of triangles."""
    record = container.items("meshes")[index]
    where = f"meshes[{index}]"
    result = []
    for number, primitive in enumerate(container.records(record, "primitives", where)):
        found = _primitive(
            container, primitive, f"{where}.primitives[{number}]", materials
        )
        if found is not None:
            result.append(found)
    return result


def _primitive(
    container: Container, record: dict[str, Any], where: str, materials: Materials
) -> Primitive | None:
    mode = container.integer(record, "mode", where, _TRIANGLES)
    if mode > _FAN:
        raise container.fail(
            f"{where}.mode is {mode}, which glTF 2.0 does not define; re-export the "
            "file"
        )
    if mode < _TRIANGLES:
        container.warn("points and lines are left out")
        return None
    attributes = container.table(record, "attributes", where)
    if "POSITION" not in attributes:
        container.warn(f"{where} has no positions; left out")
        return None
    if record.get("targets"):
        container.warn("morph targets are ignored")
    if "COLOR_0" in attributes:
        container.warn("vertex colours are ignored")

    position = _attribute(container, attributes, "POSITION", ("VEC3",), where)
    count = len(position)
    if "indices" in record:
        indices = accessors.read_indices(
            container, record["indices"], f"{where}.indices"
        )
        if indices.max() >= count:
            raise container.fail(
                f"{where}.indices reaches vertex {indices.max()}, but there are only "
                f"{count}; re-export the file"
            )
    else:
        indices = np.arange(count)
    triangles = _triangles(container, indices, mode, where)
    if len(triangles) == 0:
        return None

    material = len(materials.sources) - 1
    if "material" in record:
        material = container.check_index(
            record["material"],
            material,
            f"{where} refers to materials[{short(record['material'])}]",
        )
    normal = None
    if "NORMAL" in attributes:
        normal = _attribute(container, attributes, "NORMAL", ("VEC3",), where, count)
    found = Primitive(
        position,
        triangles.astype(np.int32),
        material,
        normal,
        _uv(container, attributes, where, count, materials, material),
        *_skin(container, attributes, where, count),
    )
    return _compact(found)


def _attribute(
    container: Container,
    attributes: dict[str, Any],
    name: str,
    kinds: tuple[str, ...],
    where: str,
    count: int | None = None,
) -> np.ndarray:
    user = f"{where}.attributes.{name}"
    values = accessors.read_finite(container, attributes[name], user, kinds)
    if count is not None and len(values) != count:
        raise container.fail(
            f"{user} has {len(values)} elements for {count} positions; re-export the "
            "file"
        )
    return values


def _triangles(
    container: Container, indices: np.ndarray, mode: int, where: str
) -> np.ndarray:
    """Returns (t, 3) indices of a list, strip or fan, wound alike."""
    if mode == _TRIANGLES:
        whole = len(indices) // 3 * 3
        if whole < len(indices):
            container.warn(f"{where} ends with an incomplete triangle; left out")
        return indices[:whole].reshape(-1, 3)
    n = max(len(indices) - 2, 0)
    if mode == _FAN:
        hub = np.repeat(indices[:1], n)
        return np.stack([indices[1 : n + 1], indices[2 : n + 2], hub], axis=1)
    i = np.arange(n)
    odd = i % 2
    strip = np.stack([indices[i], indices[i + 1 + odd], indices[i + 2 - odd]], axis=1)
    a, b, c = strip.T
    return strip[(a != b) & (b != c) & (c != a)]  # drop the stitches between strips


def _uv(
    container: Container,
    attributes: dict[str, Any],
    where: str,
    count: int,
    materials: Materials,
    material: int,
) -> np.ndarray | None:
    uv_map = materials.uv_maps[material]
    if uv_map is None:
        return None
    name = f"TEXCOORD_{uv_map.set}"
    if name not in attributes:
        container.warn(
            f"material {short(materials.sources[material].name)} has textures, but a "
            f"mesh that uses it lacks {name}; zeros are used"
        )
        return None
    uv = uv_map.apply(_attribute(container, attributes, name, ("VEC2",), where, count))
    if not np.isfinite(uv).all():
        raise container.fail(
            f"{where}.attributes.{name} leaves the range of numbers when its texture "
            "transform is applied; correct the transform"
        )
    return uv


def _skin(
    container: Container, attributes: dict[str, Any], where: str, count: int
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Returns joints and weights of all sets together, weights summing to 1."""
    joints, weights = [], []
    while f"JOINTS_{len(joints)}" in attributes:
        name = f"JOINTS_{len(joints)}"
        user = f"{where}.attributes.{name}"
        found = accessors.read(container, attributes[name], user, ("VEC4",))
        if found.dtype.kind != "u" or len(found) != count:
            raise container.fail(
                f"{user} must hold {count} vectors of unsigned integers; re-export "
                "the file"
            )
        name = f"WEIGHTS_{len(joints)}"
        if name not in attributes:
            raise container.fail(f"{where} has joints but no {name}; re-export it")
        weights.append(_attribute(container, attributes, name, ("VEC4",), where, count))
        joints.append(found.astype(np.int64))
    if not joints:
        return None, None
    weight = np.concatenate(weights, axis=1).astype(np.float64)
    total = weight.sum(axis=1, keepdims=True)
    weight = np.where(total > 1e-9, weight / np.where(total > 1e-9, total, 1.0), 0.0)
    weight[total[:, 0] <= 1e-9, 0] = 1.0
    return np.concatenate(joints, axis=1), weight.astype(np.float32)


def _compact(primitive: Primitive) -> Primitive:
    """Drops vertices that no triangle uses.

    Some files give all primitives one long list of vertices; each would carry it all.
    """
    if len(primitive.position) <= primitive.triangles.size:
        return primitive
    used, triangles = np.unique(primitive.triangles, return_inverse=True)

    def pick(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[used]

    return replace(
        primitive,
        position=primitive.position[used],
        triangles=triangles.reshape(-1, 3).astype(np.int32),
        normal=pick(primitive.normal),
        uv=pick(primitive.uv),
        joints=pick(primitive.joints),
        weights=pick(primitive.weights),
    )


@dataclass(frozen=True)
class Baked:
    """A primitive after a transform."""

    position: np.ndarray  # float32 (v, 3)
    triangles: np.ndarray  # int32 (t, 3)
    normal: np.ndarray | None  # float32 (v, 3), unit


def bake(primitive: Primitive, matrix: np.ndarray, mirrored: bool) -> Baked:
    """Transforms a primitive.

    Args:
        primitive: In mesh space.
        matrix: float64 (4, 4), or (v, 4, 4) for one a vertex.
        mirrored: Whether the winding must be reversed. A mover above `matrix` may
            mirror too, so that `matrix` alone does not tell.
    """
    linear, offset = matrix[..., :3, :3], matrix[..., :3, 3]
    position = primitive.position.astype(np.float64)
    position = (linear @ position[:, :, None])[..., 0] + offset
    triangles = primitive.triangles
    if mirrored:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    normal = None
    if primitive.normal is not None:
        # Inverse transpose, up to a positive factor: the cofactor matrix, which a
        # flattening scale leaves defined, with the determinant's sign.
        direct = np.linalg.det(linear)
        cofactors = np.where(direct < 0, -1.0, 1.0)[..., None, None] * _cofactors(
            linear
        )
        normal = (cofactors @ primitive.normal.astype(np.float64)[:, :, None])[..., 0]
        normal = _unit_normals(normal, position, triangles)
    return Baked(position.astype(np.float32), triangles, normal)


def _cofactors(linear: np.ndarray) -> np.ndarray:
    """Returns det(M) inverse(M) transposed, without dividing."""
    x, y, z = linear[..., :, 0], linear[..., :, 1], linear[..., :, 2]
    return np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)], axis=-1)


def _unit_normals(
    normal: np.ndarray, position: np.ndarray, triangles: np.ndarray
) -> np.ndarray:
    """Normalizes; a vanishing normal becomes the mean of its triangles' planes."""
    largest = np.abs(normal).max(axis=1, keepdims=True)
    good = (largest > 1e-30) & np.isfinite(largest)
    normal = normal / np.where(good, largest, 1.0)
    normal /= np.where(good, np.linalg.norm(normal, axis=1, keepdims=True), 1.0)
    bad = ~good[:, 0]
    if bad.any():
        a, b, c = (position[triangles[:, corner]] for corner in range(3))
        plane = np.cross(b - a, c - a)
        mean = np.zeros_like(position)
        for corner in range(3):
            np.add.at(mean, triangles[:, corner], plane)
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        mean = np.where(length > 0, mean / np.where(length > 0, length, 1.0), (0, 0, 1))
        normal[bad] = mean[bad]
    return normal.astype(np.float32)
