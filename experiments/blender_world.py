"""Builds a scene of the package in Blender, from what `blender_export.py` wrote.

Base colour, normal map, metalness, roughness, the sun and its shadows are Blender's
own. The ambient light is not: Cycles would sample the sky and cast its shadows; here
the package's ambient term, diffuse and specular (`shading._ambient`), is emitted by the
surface.
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
    """Returns diffuse × (irradiance × visibility + bounce) + specular + emission."""
    zenith, horizon, ground, bounce = data["sky"]
    share = float(data["sky_visibility"])
    mirror = _mirror(tree, color, normal, row, data)
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
    lit = _mix(tree, "ADD", lit, mirror)
    emission = tree.nodes.new("ShaderNodeRGB")
    emission.outputs[0].default_value = (*row[5:8], 1.0)
    return _mix(tree, "ADD", lit, emission.outputs[0])


def _mirror(
    tree: "bpy.types.NodeTree",
    color: "bpy.types.NodeSocket",
    normal: "bpy.types.NodeSocket",
    row: np.ndarray,
    data: dict[str, np.ndarray],
) -> "bpy.types.NodeSocket":
    """Returns the sky in a surface: Karis's environment BRDF, as `_ambient` has it."""
    zenith, horizon, ground, _ = data["sky"]
    share, metallic, rough = float(data["sky_visibility"]), row[3], row[4]
    incoming = tree.nodes.new("ShaderNodeNewGeometry").outputs["Incoming"]
    cosine = _vector(tree, "DOT_PRODUCT", normal, incoming, "Value")
    cosine = _math(tree, "MAXIMUM", cosine, 1e-4)
    power = _math(tree, "POWER", 2.0, _math(tree, "MULTIPLY", cosine, -9.28))
    a004 = _math(tree, "MINIMUM", power, (1.0 - rough) ** 2)
    a004 = _math(tree, "MULTIPLY", a004, 1.0 - rough)
    a004 = _math(tree, "ADD", a004, 0.0425 - 0.0275 * rough)
    scale = _math(tree, "MULTIPLY", a004, -1.04)
    scale = _math(tree, "ADD", scale, 1.04 - 0.572 * rough)
    bias = _math(tree, "MULTIPLY", a004, 1.04)
    bias = _math(tree, "ADD", bias, 0.022 * rough - 0.04)
    # f0 = 0.04 + (color − 0.04) · metallic
    f0 = _mix(tree, "MULTIPLY", color, _constant(tree, [metallic] * 3))
    f0 = _mix(tree, "ADD", f0, _constant(tree, [0.04 * (1.0 - metallic)] * 3))
    specular = _mix(tree, "MULTIPLY", f0, _grey(tree, scale))
    specular = _mix(tree, "ADD", specular, _grey(tree, bias))
    away = _vector(tree, "SCALE", incoming, -1.0, "Vector")
    mirrored = _vector(tree, "REFLECT", away, normal, "Vector")
    sky = _gradient(tree, _height(tree, mirrored), zenith, horizon, ground)
    up = _math(tree, "MULTIPLY", _height(tree, normal), 0.5)
    up = _math(tree, "ADD", up, 0.5)
    around = _between(tree, up, _constant(tree, ground),
                      _constant(tree, 0.5 * (zenith + horizon)))  # fmt: skip
    blurred = _between(tree, rough, sky, around)
    lit = _mix(tree, "MULTIPLY", specular, blurred)
    return _mix(tree, "MULTIPLY", lit, _constant(tree, [share] * 3))


def _math(
    tree: "bpy.types.NodeTree", kind: str, *values: object
) -> "bpy.types.NodeSocket":
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = kind
    for socket, value in zip(node.inputs, values, strict=False):
        _feed(tree, socket, value)
    return node.outputs[0]


def _vector(
    tree: "bpy.types.NodeTree", kind: str, a: object, b: object, out: str
) -> "bpy.types.NodeSocket":
    node = tree.nodes.new("ShaderNodeVectorMath")
    node.operation = kind
    _feed(tree, node.inputs[0], a)
    _feed(tree, node.inputs["Scale"] if kind == "SCALE" else node.inputs[1], b)
    return node.outputs[out]


def _feed(
    tree: "bpy.types.NodeTree", socket: "bpy.types.NodeSocket", value: object
) -> None:
    if isinstance(value, int | float | np.floating):
        socket.default_value = float(value)
    else:
        tree.links.new(value, socket)


def _constant(tree: "bpy.types.NodeTree", rgb: object) -> "bpy.types.NodeSocket":
    node = tree.nodes.new("ShaderNodeRGB")
    red, green, blue = rgb  # type: ignore[misc]
    node.outputs[0].default_value = (red, green, blue, 1.0)
    return node.outputs[0]


def _grey(
    tree: "bpy.types.NodeTree", value: "bpy.types.NodeSocket"
) -> "bpy.types.NodeSocket":
    node = tree.nodes.new("ShaderNodeCombineColor")
    for socket in node.inputs:
        tree.links.new(value, socket)
    return node.outputs[0]


def _height(
    tree: "bpy.types.NodeTree", vector: "bpy.types.NodeSocket"
) -> "bpy.types.NodeSocket":
    split = tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(vector, split.inputs[0])
    return split.outputs["Z"]


def _between(
    tree: "bpy.types.NodeTree",
    share: object,
    a: "bpy.types.NodeSocket",
    b: "bpy.types.NodeSocket",
) -> "bpy.types.NodeSocket":
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type = "RGBA"
    _feed(tree, node.inputs[0], share)
    tree.links.new(a, node.inputs[6])
    tree.links.new(b, node.inputs[7])
    return node.outputs[2]


def _gradient(
    tree: "bpy.types.NodeTree",
    height: "bpy.types.NodeSocket",
    zenith: np.ndarray,
    horizon: np.ndarray,
    ground: np.ndarray,
) -> "bpy.types.NodeSocket":
    """Returns the sky's radiance by the z of a direction (`shading.sky_radiance`)."""
    below = _ramp(tree, height, ground, horizon, (2.0, 1.0))
    above = _ramp(tree, height, zenith, horizon, (1.0, 0.5))
    return _between(tree, _math(tree, "GREATER_THAN", height, 0.0), below, above)


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
    place = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    color = _gradient(tree, _height(tree, place), zenith, horizon, ground)
    shade = tree.nodes.new("ShaderNodeBackground")
    tree.links.new(color, shade.inputs["Color"])
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
