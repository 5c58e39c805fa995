"""The node hierarchy, what is instanced in it, and how it moves (glTF 2.0, 3.5)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ataa_jax import types
from ataa_jax.gltf import accessors
from ataa_jax.gltf.animation import Animation, Pose, unit_quaternion
from ataa_jax.gltf.container import Container, short
from ataa_jax.scene import CameraSource, LightSource

STATIC = -1  # the mover of a node that never moves


@dataclass(frozen=True)
class Node:
    """One node: its record, its parent and its rest transform."""

    record: dict[str, Any]
    name: str
    parent: int  # −1: a root
    rest: Pose
    matrix: np.ndarray | None  # instead of `rest`, where the file gives a matrix


@dataclass(frozen=True)
class Mover:
    """An animated node, relative to the animated node above it."""

    node: int
    parent: int  # its nearest animated proper ancestor, or STATIC
    from_local: np.ndarray  # (4, 4) parent mover's space from the node's parent's


@dataclass(frozen=True)
class Hierarchy:
    """All nodes, which of them the scene shows, and the animated ones."""

    nodes: list[Node]
    shown: list[int]  # depth-first, parents before children
    animation: Animation
    movers: dict[int, Mover]
    nearest: list[int]  # per node: nearest animated ancestor-or-self, or STATIC
    in_mover: list[np.ndarray]  # per node: (4, 4) space of `nearest` from its own
    world: list[np.ndarray]  # per node: (4, 4) world from its own space at time 0

    def world_from_movers(self, time: float) -> dict[int, np.ndarray]:
        """Returns world_from_local, float64 (4, 4), of every animated node."""
        result = {STATIC: np.eye(4)}
        for index, mover in self.movers.items():  # parents come first
            pose = self.animation.pose(index, self.nodes[index].rest, time)
            result[index] = result[mover.parent] @ mover.from_local @ pose.matrix()
        return result


def read_hierarchy(container: Container, animation: Animation) -> Hierarchy:
    """Reads the nodes; refuses cycles and nodes with two parents."""
    nodes = _read_nodes(container)
    order = _parents_first(container, nodes)
    movers: dict[int, Mover] = {}
    nearest = [STATIC] * len(nodes)
    in_mover = [np.eye(4)] * len(nodes)
    world = [np.eye(4)] * len(nodes)
    for index in order:
        node = nodes[index]
        above, above_mover, above_world = STATIC, np.eye(4), np.eye(4)
        if node.parent >= 0:
            above = nearest[node.parent]
            above_mover, above_world = in_mover[node.parent], world[node.parent]
        local = node.matrix
        if local is None:
            local = animation.pose(index, node.rest, 0.0).matrix()
        world[index] = above_world @ local
        if animation.moves(index):
            movers[index] = Mover(index, above, above_mover)
            nearest[index] = index
        else:
            nearest[index] = above
            in_mover[index] = above_mover @ local
    shown = _shown(container, nodes, order)
    for index in shown:
        if not np.isfinite(world[index]).all():
            raise container.fail(
                f"nodes[{index}] has a transform beyond what numbers can hold; correct "
                "it and export the file again"
            )
    return Hierarchy(nodes, shown, animation, movers, nearest, in_mover, world)


def _read_nodes(container: Container) -> list[Node]:
    records = container.items("nodes")
    parents = [-1] * len(records)
    for index, record in enumerate(records):
        where = f"nodes[{index}]"
        for child in container.array(record, "children", where):
            container.check_index(
                child, len(records), f"{where} has the child nodes[{short(child)}]"
            )
            if parents[child] != -1:
                raise container.fail(
                    f"nodes[{child}] has two parents, nodes[{parents[child]}] and "
                    f"{where}; re-export the file"
                )
            parents[child] = index
    result = []
    for index, (record, parent) in enumerate(zip(records, parents, strict=True)):
        where = f"nodes[{index}]"
        name = container.string(record, "name", where)
        matrix = None
        if "matrix" in record:
            entries = container.numbers(record, "matrix", 16, where, ())
            matrix = np.array(entries).reshape(4, 4).T
            matrix[3] = 0.0, 0.0, 0.0, 1.0
        rest = Pose(
            np.array(container.numbers(record, "translation", 3, where, (0.0,) * 3)),
            unit_quaternion(
                np.array(
                    container.numbers(
                        record, "rotation", 4, where, (0.0, 0.0, 0.0, 1.0)
                    )
                )
            ),
            np.array(container.numbers(record, "scale", 3, where, (1.0,) * 3)),
        )
        result.append(Node(record, name, parent, rest, matrix))
    return result


def _parents_first(container: Container, nodes: list[Node]) -> list[int]:
    """Returns all nodes depth-first; what no root leads to must be a cycle."""
    order = []
    pending = [i for i, node in enumerate(nodes) if node.parent == -1][::-1]
    while pending:
        index = pending.pop()
        order.append(index)
        pending.extend(reversed(nodes[index].record.get("children", [])))
    if len(order) < len(nodes):
        stray = min(set(range(len(nodes))).difference(order))
        raise container.fail(
            f"nodes[{stray}] is its own ancestor or below a node that is; re-export "
            "the file"
        )
    return order


def _shown(container: Container, nodes: list[Node], order: list[int]) -> list[int]:
    """Returns the nodes of the file's default scene, or all if it has no scene."""
    scenes = container.items("scenes")
    if not scenes:
        return order
    chosen = container.json.get("scene", 0)
    record = container.item("scenes", chosen, "scene")
    where = f"scenes[{chosen}]"
    if len(scenes) > 1:
        container.warn(f"{len(scenes)} scenes in the file; only {where} is shown")
    roots = set()
    for root in container.array(record, "nodes", where):
        roots.add(
            container.check_index(
                root, len(nodes), f"{where} refers to nodes[{short(root)}]"
            )
        )
    inside: set[int] = set()
    for index in order:
        if index in roots or nodes[index].parent in inside:
            inside.add(index)
    return [index for index in order if index in inside]


def read_cameras(container: Container, hierarchy: Hierarchy) -> list[CameraSource]:
    """Returns the perspective cameras as they stand at time 0."""
    result = []
    for index in hierarchy.shown:
        node = hierarchy.nodes[index]
        if "camera" not in node.record:
            continue
        number = node.record["camera"]
        record = container.item("cameras", number, f"nodes[{index}]")
        where = f"cameras[{number}]"
        name = node.name or container.string(record, "name", where) or where
        if container.string(record, "type", where) != "perspective":
            container.warn(f"camera {short(name)} is not a perspective one; left out")
            continue
        lens = container.table(record, "perspective", where)
        fov_y = container.number(lens, "yfov", f"{where}.perspective")
        if not 0.0 < fov_y < np.pi:
            raise container.fail(
                f"{where}.perspective.yfov is {fov_y:g} radians, but must lie between "
                "0 and pi; correct it or re-export the file"
            )
        pose = _rigid(hierarchy.world[index])
        if pose is None:
            container.warn(f"camera {short(name)} is scaled to nothing; left out")
            continue
        if hierarchy.nearest[index] != STATIC:
            container.warn(f"camera {short(name)} is animated; it stays as at t = 0")
        result.append(CameraSource(name, pose, fov_y))
    return result


def _rigid(world: np.ndarray) -> np.ndarray | None:
    """Returns a transform without scale, shear and mirroring; None: impossible.

    The view direction is kept exactly, the up direction as far as it is
    perpendicular to it.
    """
    back, up = _unit(world[:3, 2]), _unit(world[:3, 1])
    if back is None or up is None:
        return None
    up = _unit(up - (up @ back) * back)
    if up is None:
        return None
    result = np.eye(4)
    result[:3, :3] = np.stack([np.cross(up, back), up, back], axis=1)
    result[:3, 3] = world[:3, 3]
    return result


def _unit(vector: np.ndarray) -> np.ndarray | None:
    largest = np.abs(vector).max()
    if not 0.0 < largest < np.inf:
        return None
    vector = vector / largest  # so that squares neither overflow nor vanish
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-6 else None


def read_lights(container: Container, hierarchy: Hierarchy) -> list[LightSource]:
    """Returns the KHR_lights_punctual lights as they stand at time 0."""
    name = "KHR_lights_punctual"
    holder = container.extension(container.json, name, "the file") or {}
    records = container.records(holder, "lights", name)
    result = []
    for index in hierarchy.shown:
        node = hierarchy.nodes[index]
        reference = container.extension(node.record, name, f"nodes[{index}]")
        if reference is None:
            continue
        wanted = reference.get("light")
        number = container.check_index(
            wanted, len(records), f"nodes[{index}] refers to lights[{short(wanted)}]"
        )
        fields = _light(
            container, records[number], f"lights[{number}]", hierarchy.world[index]
        )
        if fields is None:
            continue
        light = LightSource(**{**fields, "name": node.name or fields["name"]})
        if hierarchy.nearest[index] != STATIC:
            container.warn(
                f"light {short(light.name)} is animated; it stays as at t = 0"
            )
        result.append(light)
    return result


_KINDS = {
    "directional": types.LIGHT_DIRECTIONAL,
    "point": types.LIGHT_POINT,
    "spot": types.LIGHT_SPOT,
}


def _light(
    container: Container, record: dict[str, Any], where: str, world: np.ndarray
) -> dict[str, Any] | None:
    """Returns the fields of a `LightSource`, or None if it cannot be aimed."""
    kind = container.string(record, "type", where)
    if kind not in _KINDS:
        raise container.fail(
            f"{where}.type is {short(kind)}, but must be directional, point or spot; "
            "correct it or re-export the file"
        )
    color = container.numbers(record, "color", 3, where, (1.0, 1.0, 1.0))
    strength = container.number(record, "intensity", where, 1.0)
    fields: dict[str, Any] = {
        "name": container.string(record, "name", where) or where,
        "kind": _KINDS[kind],
        "intensity": tuple(min(max(c * strength, 0.0), 1e30) for c in color),
        "position": tuple(world[:3, 3].tolist()),
    }
    if "range" in record:
        reach = container.number(record, "range", where)
        if reach <= 0.0:
            raise container.fail(
                f"{where}.range is {reach:g}, but must be positive; correct it or "
                "leave it out"
            )
        fields["range"] = reach
    if kind == "point":
        return fields
    axis = _unit(-world[:3, 2])
    if axis is None:
        container.warn(f"light {short(fields['name'])} is scaled to nothing; left out")
        return None
    fields["direction"] = tuple(axis.tolist())
    if kind == "spot":
        cone = container.table(record, "spot", where)
        inner = container.number(cone, "innerConeAngle", f"{where}.spot", 0.0)
        outer = container.number(cone, "outerConeAngle", f"{where}.spot", np.pi / 4)
        if not 0.0 <= inner < outer <= np.pi / 2 + 1e-6:
            raise container.fail(
                f"{where}.spot has cone angles {inner:g} and {outer:g}, but 0 <= inner "
                "< outer <= pi/2 is expected; correct them"
            )
        fields["inner_cone_angle"], fields["outer_cone_angle"] = inner, outer
    return fields


def joint_matrices(
    container: Container, hierarchy: Hierarchy, index: Any, user: str
) -> np.ndarray:
    """Returns world_from_mesh of every joint of a skin at time 0, float64 (j, 4, 4)."""
    record = container.item("skins", index, user)
    where = f"skins[{index}]"
    joints = container.array(record, "joints", where)
    for joint in joints:
        container.check_index(
            joint, len(hierarchy.nodes), f"{where} refers to nodes[{short(joint)}]"
        )
    if not joints:
        raise container.fail(f"{where} has no joints; re-export the file")
    world = np.stack([hierarchy.world[joint] for joint in joints])
    if "inverseBindMatrices" not in record:
        return world
    inverse = accessors.read_finite(
        container,
        record["inverseBindMatrices"],
        f"{where}.inverseBindMatrices",
        ("MAT4",),
    ).astype(np.float64)
    if len(inverse) < len(joints):
        raise container.fail(
            f"{where} has {len(joints)} joints but {len(inverse)} inverse bind "
            "matrices; re-export the file"
        )
    inverse = inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)
    return world @ inverse
