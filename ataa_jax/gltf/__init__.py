"""A reader of glTF 2.0 scenes, binary (.glb) and JSON (.gltf).

`load` bakes what stands still into world space and what moves into its rigid group's
space. Read are: triangles with normals and one set of texture coordinates,
metallic-roughness materials, PNG and JPEG images, perspective cameras, punctual
lights and node animation. What a file holds beyond that is named in
`SceneSource.warnings`.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ataa_jax.gltf import meshes
from ataa_jax.gltf.animation import read_animation
from ataa_jax.gltf.container import Container, open_container
from ataa_jax.gltf.materials import Materials, read_materials
from ataa_jax.gltf.nodes import (
    STATIC,
    Hierarchy,
    joint_matrices,
    read_cameras,
    read_hierarchy,
    read_lights,
)
from ataa_jax.scene import MeshSource, SceneSource, still_groups

MAX_TRIANGLES = 1 << 26  # of all instances together


def load(path: str | Path) -> SceneSource:
    """Reads a glTF 2.0 file.

    Args:
        path: A ``.glb`` or ``.gltf`` file. Buffers and images that it names must lie
            in its folder or below.

    Returns:
        The scene. Skinned meshes, cameras and lights stand as at time 0.

    Raises:
        InputError: the file is missing, malformed, or needs what is not supported.
    """
    container = open_container(path)
    with np.errstate(all="ignore"):  # overflow is looked for, and said in words
        hierarchy = read_hierarchy(container, read_animation(container))
        materials = read_materials(container)
        builder = _Builder(container, hierarchy, materials)
        builder.add_all()
        cameras = read_cameras(container, hierarchy)
        lights = read_lights(container, hierarchy)
    groups = builder.groups
    moving = len(groups) > 1
    sources = materials.sources
    if all(mesh.material < len(sources) - 1 for mesh in builder.meshes):
        sources = sources[:-1]  # nobody needs the default material
    return SceneSource(
        name=container.path.stem,
        meshes=builder.meshes,
        materials=sources,
        textures=materials.textures,
        lights=lights,
        cameras=cameras,
        group_names=["static"]
        + [hierarchy.nodes[g].name or f"nodes[{g}]" for g in groups[1:]],
        transforms=_transforms(hierarchy, groups) if moving else still_groups(1),
        duration=hierarchy.animation.duration if moving else 0.0,
        warnings=container.warnings,
        distinct_meshes=builder.distinct_meshes,
    )


class _Builder:
    """Collects the mesh of every node, and the groups they need."""

    def __init__(
        self, container: Container, hierarchy: Hierarchy, materials: Materials
    ) -> None:
        self.meshes: list[MeshSource] = []
        self.groups = [STATIC]  # the animated node of each group
        self._container = container
        self._hierarchy = hierarchy
        self._materials = materials
        self._primitives: dict[int, list[meshes.Primitive]] = {}
        self._triangles = 0

    def add_all(self) -> None:
        """Adds the meshes of all shown nodes."""
        container = self._container
        skinned = 0
        for index in self._hierarchy.shown:
            record = self._hierarchy.nodes[index].record
            if "EXT_mesh_gpu_instancing" in container.table(
                record, "extensions", f"nodes[{index}]"
            ):
                container.warn("instances by EXT_mesh_gpu_instancing are drawn once")
            if "mesh" in record:
                skinned += self._add(index)
        if not self.meshes:
            raise container.fail(
                "holds no triangles; give a scene with at least one triangle mesh"
            )
        if skinned:
            container.warn(
                "skinned meshes stand still, in their pose of t = 0: "
                f"{skinned} triangles"
            )

    @property
    def distinct_meshes(self) -> int:
        """Counts the drawn objects of the file, each once however often it is drawn."""
        return sum(map(len, self._primitives.values()))

    def _add(self, index: int) -> int:
        """Adds a node's mesh; returns how many of its triangles are skinned."""
        container, hierarchy = self._container, self._hierarchy
        node = hierarchy.nodes[index]
        number = node.record["mesh"]
        record = container.item("meshes", number, f"nodes[{index}]")
        if number not in self._primitives:
            self._primitives[number] = meshes.read_mesh(
                container, number, self._materials
            )
        where = f"meshes[{number}]"
        name = node.name or container.string(record, "name", where) or where
        joints = None
        if "skin" in node.record:
            joints = joint_matrices(
                container, hierarchy, node.record["skin"], f"nodes[{index}]"
            )
        skinned = 0
        for primitive in self._primitives[number]:
            self._triangles += len(primitive.triangles)
            if self._triangles > MAX_TRIANGLES:
                raise container.fail(
                    f"draws more than {MAX_TRIANGLES} triangles, all instances "
                    "counted; simplify the scene"
                )
            if joints is not None and primitive.joints is not None:
                skinned += len(primitive.triangles)
                baked = self._bake_skin(primitive, joints, f"nodes[{index}]")
                group = 0
            else:
                mirrored = bool(np.linalg.det(hierarchy.world[index][:3, :3]) < 0)
                baked = meshes.bake(primitive, hierarchy.in_mover[index], mirrored)
                group = self._group(hierarchy.nearest[index])
            if not np.isfinite(baked.position).all():
                raise container.fail(
                    f"nodes[{index}] carries vertices beyond what 32-bit numbers can "
                    "hold; correct its scale and export the file again"
                )
            self.meshes.append(
                MeshSource(
                    name=name,
                    position=baked.position,
                    triangles=baked.triangles,
                    material=primitive.material,
                    normal=baked.normal,
                    uv=primitive.uv,
                    group=group,
                )
            )
        return skinned

    def _bake_skin(
        self, primitive: meshes.Primitive, matrices: np.ndarray, user: str
    ) -> meshes.Baked:
        joints, weights = primitive.joints, primitive.weights
        assert joints is not None
        assert weights is not None
        if joints.max() >= len(matrices):
            raise self._container.fail(
                f"{user} uses joint {joints.max()} of a skin with {len(matrices)}; "
                "re-export the file"
            )
        blended = np.zeros((len(joints), 4, 4))
        for slot in range(joints.shape[1]):
            blended += weights[:, slot, None, None] * matrices[joints[:, slot]]
        direct = np.linalg.det(blended[:, :3, :3])
        return meshes.bake(primitive, blended, bool((np.sign(direct)).sum() < 0))

    def _group(self, mover: int) -> int:
        if mover not in self.groups:
            self.groups.append(mover)
        return self.groups.index(mover)


def _transforms(
    hierarchy: Hierarchy, groups: list[int]
) -> Callable[[float], np.ndarray]:
    """Returns `SceneSource.transforms`."""
    duration = hierarchy.animation.duration

    def transforms(time: float) -> np.ndarray:
        world = hierarchy.world_from_movers(time % duration)
        return np.stack([world[g][:3] for g in groups]).astype(np.float32)

    return transforms
