"""Builds a scene of the package in Blender, from what `blender_export.py` wrote.

Base colour, normal map, metalness, roughness, the sun and its shadows are Blender's
own. The ambient light is not: Cycles would sample the sky and cast its shadows; here
the package's ambient term, the sky's mean over the hemisphere about the normal, is
emitted by the surface. The reflection of the sky by smooth surfaces is left out.
"""

from pathlib import Path

import bpy  # pyright: ignore[reportMissingImports]
import numpy as np

_AXES = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


def build(file: Path) -> None:
    """Replaces the open scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    data = dict(np.load(file))
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 0, len(data["cameras"]) - 3
    height, width = (int(x) for x in data["size"])
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.fps = int(data["fps"])
    # One bounce of nothing: direct light alone, as the package shades.
    scene.cycles.max_bounces = 0
    scene.cycles.light_sampling_threshold = 0.0
    scene.cycles.transparent_max_bounces = 64
    images = _images(data)
    materials = [_material(row, images, data) for row in data["materials"]]
    count = data["groups"].shape[1]
    parents = [_group(k, data["groups"][:, k]) for k in range(count)]
    k = 0
    while f"mesh{k}_position" in data:
        _mesh(k, data, materials, parents)
        k += 1
    for row in data["suns"]:
        _sun(row)
    _sky(data["sky"])
    _camera(data)


def _images(data: dict[str, np.ndarray]) -> list["bpy.types.Image"]:
    images = []
    while f"texture{len(images)}" in data:
        k = len(images)
        texels = data[f"texture{k}"]
        height, width = texels.shape[:2]
        image = bpy.data.images.new(f"texture{k}", width, height, alpha=True)
        srgb = bool(data[f"texture{k}_srgb"])
        image.colorspace_settings.name = "sRGB" if srgb else "Non-Color"
        image.alpha_mode = "CHANNEL_PACKED"
        image.pixels.foreach_set((texels[::-1] / np.float32(255)).ravel())
        image.pack()
        images.append(image)
    return images


def _material(
    row: np.ndarray, images: list["bpy.types.Image"], data: dict[str, np.ndarray]
) -> "bpy.types.Material":
    """Makes a material; `row` is as `blender_export._materials` writes it."""
    material = bpy.data.materials.new("m")
    material.use_nodes = True
    # The ambient term is no lamp: chosen as one, it would make the sun's light noise.
    material.cycles.emission_sampling = "NONE"
    tree = material.node_tree
    nodes, link = tree.nodes, tree.links.new
    nodes.clear()
    shader = nodes.new("ShaderNodeBsdfPrincipled")
    shader.inputs["Metallic"].default_value = row[3]
    shader.inputs["Roughness"].default_value = row[4]
    base = nodes.new("ShaderNodeRGB")
    base.outputs[0].default_value = (*row[:3], 1.0)
    color, alpha = base.outputs[0], None
    if row[9] >= 0:
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = images[int(row[9])]
        color = _mix(tree, "MULTIPLY", texture.outputs["Color"], color)
        alpha = texture.outputs["Alpha"]
    normal = nodes.new("ShaderNodeNewGeometry").outputs["Normal"]
    if row[10] >= 0:
        bump = nodes.new("ShaderNodeTexImage")
        bump.image = images[int(row[10])]
        tangent = nodes.new("ShaderNodeNormalMap")
        tangent.inputs["Strength"].default_value = row[11]
        link(bump.outputs["Color"], tangent.inputs["Color"])
        link(tangent.outputs["Normal"], shader.inputs["Normal"])
        normal = tangent.outputs["Normal"]
    link(color, shader.inputs["Base Color"])
    glow = _ambient(tree, color, normal, row, data)
    link(glow, shader.inputs["Emission Color"])
    shader.inputs["Emission Strength"].default_value = 1.0
    surface = shader.outputs[0]
    if row[8] >= 0.0 and alpha is not None:
        surface = _cut(tree, surface, alpha, row[8])
    output = nodes.new("ShaderNodeOutputMaterial")
    link(surface, output.inputs["Surface"])
    return material


def _ambient(
    tree: "bpy.types.NodeTree",
    color: "bpy.types.NodeSocket",
    normal: "bpy.types.NodeSocket",
    row: np.ndarray,
    data: dict[str, np.ndarray],
) -> "bpy.types.NodeSocket":
    """Returns diffuse × (irradiance × visibility + bounce) + emission."""
    zenith, horizon, ground, bounce = data["sky"]
    share = float(data["sky_visibility"])
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(normal, split.inputs[0])
    up = tree.nodes.new("ShaderNodeMath")
    up.operation = "MULTIPLY_ADD"
    up.inputs[1].default_value = up.inputs[2].default_value = 0.5
    tree.links.new(split.outputs["Z"], up.inputs[0])
    around = tree.nodes.new("ShaderNodeMix")
    around.data_type = "RGBA"
    around.clamp_factor = True
    ends = ground * share + bounce, 0.5 * (zenith + horizon) * share + bounce
    for socket, value in zip((6, 7), ends, strict=True):
        around.inputs[socket].default_value = (*value, 1.0)
    tree.links.new(up.outputs[0], around.inputs[0])
    diffuse = tree.nodes.new("ShaderNodeRGB")
    # The package's diffuse albedo leaves out what a dielectric reflects.
    diffuse.outputs[0].default_value = (*([1.0 - row[3]] * 3), 1.0)
    lit = _mix(tree, "MULTIPLY", around.outputs[2], diffuse.outputs[0])
    lit = _mix(tree, "MULTIPLY", color, lit)
    emission = tree.nodes.new("ShaderNodeRGB")
    emission.outputs[0].default_value = (*row[5:8], 1.0)
    return _mix(tree, "ADD", lit, emission.outputs[0])


def _mix(
    tree: "bpy.types.NodeTree",
    kind: str,
    a: "bpy.types.NodeSocket",
    b: "bpy.types.NodeSocket",
) -> "bpy.types.NodeSocket":
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type, node.blend_type = "RGBA", kind
    node.clamp_result = False
    node.inputs[0].default_value = 1.0
    tree.links.new(a, node.inputs[6])
    tree.links.new(b, node.inputs[7])
    return node.outputs[2]


def _cut(
    tree: "bpy.types.NodeTree",
    surface: "bpy.types.NodeSocket",
    alpha: "bpy.types.NodeSocket",
    cutoff: float,
) -> "bpy.types.NodeSocket":
    """Returns the surface where alpha is over the cutoff, nothing elsewhere."""
    over = tree.nodes.new("ShaderNodeMath")
    over.operation = "GREATER_THAN"
    over.inputs[1].default_value = cutoff
    tree.links.new(alpha, over.inputs[0])
    mix = tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(over.outputs[0], mix.inputs[0])
    nothing = tree.nodes.new("ShaderNodeBsdfTransparent")
    tree.links.new(nothing.outputs[0], mix.inputs[1])
    tree.links.new(surface, mix.inputs[2])
    return mix.outputs[0]


def _group(k: int, matrices: np.ndarray) -> "bpy.types.Object | None":
    """Makes what moves as one; `matrices` are of frames −1 onward."""
    if np.all(matrices == np.eye(4)):
        return None
    empty = bpy.data.objects.new(f"group{k}", None)
    bpy.context.scene.collection.objects.link(empty)
    _animate(empty, matrices)
    return empty


def _animate(item: "bpy.types.Object", matrices: np.ndarray) -> None:
    from mathutils import Matrix  # pyright: ignore[reportMissingImports]

    item.rotation_mode = "QUATERNION"
    last = None
    for frame, matrix in enumerate(matrices, -1):
        place, turn, scale = Matrix(matrix.tolist()).decompose()
        if last is not None and last.dot(turn) < 0.0:
            turn.negate()
        last = turn
        item.location, item.rotation_quaternion, item.scale = place, turn, scale
        for name in ("location", "rotation_quaternion", "scale"):
            item.keyframe_insert(name, frame=frame)


def _mesh(
    k: int,
    data: dict[str, np.ndarray],
    materials: list["bpy.types.Material"],
    parents: list,
) -> None:
    place = data[f"mesh{k}_position"].astype(np.float64) @ _AXES.T
    triangles = data[f"mesh{k}_triangles"]
    material, group = (int(x) for x in data[f"mesh{k}_head"])
    mesh = bpy.data.meshes.new(f"mesh{k}")
    mesh.from_pydata(place.tolist(), [], triangles.tolist())
    mesh.materials.append(materials[material])
    if f"mesh{k}_uv" in data:
        uv = data[f"mesh{k}_uv"][triangles.ravel()].astype(np.float64)
        layer = mesh.uv_layers.new(name="uv")
        layer.data.foreach_set("uv", np.stack([uv[:, 0], 1.0 - uv[:, 1]], -1).ravel())
    smooth = f"mesh{k}_normal" in data
    mesh.polygons.foreach_set("use_smooth", np.full(len(triangles), smooth))
    if smooth:
        normal = data[f"mesh{k}_normal"].astype(np.float64) @ _AXES.T
        mesh.normals_split_custom_set_from_vertices(normal.tolist())
    mesh.update()
    item = bpy.data.objects.new(mesh.name, mesh)
    item.pass_index = k + 1
    bpy.context.scene.collection.objects.link(item)
    item.parent = parents[group]


def _sun(row: np.ndarray) -> None:
    from mathutils import Vector  # pyright: ignore[reportMissingImports]

    light = bpy.data.lights.new("sun", "SUN")
    light.energy, light.color, light.angle = 1.0, row[3:].tolist(), 0.0
    item = bpy.data.objects.new("sun", light)
    item.rotation_mode = "QUATERNION"
    travel = Vector((_AXES @ row[:3]).tolist())
    item.rotation_quaternion = travel.to_track_quat("-Z", "Y")
    bpy.context.scene.collection.objects.link(item)


def _sky(sky: np.ndarray) -> None:
    """Shows the gradient to the camera; surfaces have their ambient term."""
    zenith, horizon, ground, _ = sky
    world = bpy.data.worlds.new("sky")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    place = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(place.outputs["Generated"], split.inputs[0])
    below = _ramp(tree, split.outputs["Z"], ground, horizon, (2.0, 1.0))
    above = _ramp(tree, split.outputs["Z"], zenith, horizon, (1.0, 0.5))
    sign = tree.nodes.new("ShaderNodeMath")
    sign.operation = "GREATER_THAN"
    sign.inputs[1].default_value = 0.0
    tree.links.new(split.outputs["Z"], sign.inputs[0])
    choose = tree.nodes.new("ShaderNodeMix")
    choose.data_type = "RGBA"
    tree.links.new(sign.outputs[0], choose.inputs[0])
    tree.links.new(below, choose.inputs[6])
    tree.links.new(above, choose.inputs[7])
    shade = tree.nodes.new("ShaderNodeBackground")
    tree.links.new(choose.outputs[2], shade.inputs["Color"])
    output = tree.nodes.new("ShaderNodeOutputWorld")
    tree.links.new(shade.outputs[0], output.inputs["Surface"])
    world.cycles.sampling_method = "NONE"  # else half the light samples go to it
    for name in ("diffuse", "glossy", "transmission", "scatter"):
        setattr(world.cycles_visibility, name, False)


def _ramp(
    tree: "bpy.types.NodeTree",
    height: "bpy.types.NodeSocket",
    end: np.ndarray,
    horizon: np.ndarray,
    curve: tuple[float, float],
) -> "bpy.types.NodeSocket":
    """Returns horizon + (end − horizon) · min((a |height|)^b, 1); curve is (a, b)."""
    size = tree.nodes.new("ShaderNodeMath")
    size.operation = "ABSOLUTE"
    tree.links.new(height, size.inputs[0])
    scaled = tree.nodes.new("ShaderNodeMath")
    scaled.operation = "MULTIPLY"
    scaled.inputs[1].default_value = curve[0]
    tree.links.new(size.outputs[0], scaled.inputs[0])
    root = tree.nodes.new("ShaderNodeMath")
    root.operation = "POWER"
    root.use_clamp = True
    root.inputs[1].default_value = curve[1]
    tree.links.new(scaled.outputs[0], root.inputs[0])
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    tree.links.new(root.outputs[0], mix.inputs[0])
    mix.inputs[6].default_value = (*horizon, 1.0)
    mix.inputs[7].default_value = (*end, 1.0)
    return mix.outputs[2]


def _camera(data: dict[str, np.ndarray]) -> None:
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit = "VERTICAL"
    lens.lens_unit = "FOV"
    lens.angle_y = float(data["fov_y"])
    lens.clip_start, lens.clip_end = 0.01, 1e4
    item = bpy.data.objects.new("camera", lens)
    bpy.context.scene.collection.objects.link(item)
    bpy.context.scene.camera = item
    _animate(item, data["cameras"])
