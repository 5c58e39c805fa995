"""The built-in scene holds what it promises, is well formed, and is always the same."""

import numpy as np
import pytest

from ataa_jax.builtin import garden_house, shapes
from ataa_jax.builtin.moving import DURATION
from ataa_jax.scene import MeshSource, SceneSource
from ataa_jax.types import LIGHT_DIRECTIONAL, NO_TEXTURE

_CYLINDER = [(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 2.0), (1.0, 2.0), (0.0, 2.0)]
THIN = ("wire", "rope", "slat", "rail", "leaf")


@pytest.fixture(scope="module")
def source() -> SceneSource:
    return garden_house()


def _world(source: SceneSource, mesh: MeshSource, at: float = 0.0) -> np.ndarray:
    matrix = source.transforms(at)[mesh.group].astype(np.float64)
    return mesh.position @ matrix[:, :3].T + matrix[:, 3]


def _view(source: SceneSource, name: str, world: np.ndarray) -> np.ndarray:
    (camera,) = (c for c in source.cameras if c.name == name)
    to_view = np.linalg.inv(camera.world_from_view)
    return world @ to_view[:3, :3].T + to_view[:3, 3]


def test_two_calls_give_equal_scenes(source):
    again = garden_house()
    assert [m.name for m in again.meshes] == [m.name for m in source.meshes]
    for a, b in zip(source.meshes, again.meshes, strict=True):
        for field in ("position", "triangles", "normal", "uv"):
            np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    for a, b in zip(source.textures, again.textures, strict=True):
        np.testing.assert_array_equal(a.texels, b.texels)
    assert source.materials == again.materials


def test_size_is_moderate(source):
    assert len(source.meshes) < 150
    assert 60_000 <= sum(len(m.triangles) for m in source.meshes) <= 200_000


def test_names_are_unique_and_every_thin_feature_is_found_by_its_prefix(source):
    names = [m.name for m in source.meshes]
    assert len(set(names)) == len(names)
    for prefix in THIN:
        assert any(name.startswith(prefix) for name in names), prefix


@pytest.mark.parametrize(
    "name",
    [
        "brick walls", "white walls above", "cladding above", "roof slabs",
        "window frames", "window panes", "rail bars", "sofa", "lamp glow", "awning",
        "terrace boards", "steps", "slat fence west", "wire overhead", "insulators",
        "wire to the house", "leaf straps", "pots terracotta", "wood shade trees",
        "leaf shade trees", "leaf hedge", "leaf tufts", "boat hull", "boat transom",
        "boat furled sails", "rope standing rigging", "rope ratlines", "rope moorings",
        "jetty boards", "gravel path", "lawn", "shore stones", "water", "leaf far line",
        "hill far", "car body", "wind wheel blades",
    ],
)  # fmt: skip
def test_scene_holds(source, name):
    assert name in [m.name for m in source.meshes]


def test_arrays_are_finite_and_of_the_promised_types_and_extents(source):
    for mesh in source.meshes:
        count = len(mesh.position)
        assert mesh.normal is not None
        assert mesh.uv is not None
        assert mesh.position.dtype == mesh.normal.dtype == mesh.uv.dtype == np.float32
        assert mesh.triangles.dtype == np.int32
        assert mesh.position.shape == mesh.normal.shape == (count, 3), mesh.name
        assert mesh.uv.shape == (count, 2)
        assert mesh.triangles.min() >= 0
        assert mesh.triangles.max() < count
        for array in (mesh.position, mesh.normal, mesh.uv):
            assert np.isfinite(array).all(), mesh.name


def test_normals_have_length_one(source):
    for mesh in source.meshes:
        assert mesh.normal is not None
        # float32 keeps a unit vector's length to a few times 2^-24.
        np.testing.assert_allclose(
            np.linalg.norm(mesh.normal, axis=1), 1.0, atol=1e-6, err_msg=mesh.name
        )


def test_shading_normals_agree_with_the_winding(source):
    for mesh in source.meshes:
        assert mesh.normal is not None
        a, b, c = (mesh.position[mesh.triangles[:, k]] for k in range(3))
        plane = np.cross(b - a, c - a)
        mean = mesh.normal[mesh.triangles].mean(axis=1)
        agree = np.sum(plane * mean, axis=1) >= 0.0
        # Soft normals of leaves, and ends of smooth strips, may lean over the edge.
        area = np.linalg.norm(plane, axis=1)
        assert (area * agree).sum() > 0.97 * area.sum(), mesh.name


@pytest.mark.parametrize(
    "name",
    [
        "roof slabs", "terrace boards", "columns", "rail bars", "rail posts", "poles",
        "pots terracotta", "insulators", "wire overhead", "rope standing rigging",
        "boat spars", "boat furled sails", "slat fence west", "slat fence east",
        "shore stones", "stepping stones", "brick walls", "car body", "car wheels",
        "jetty posts", "wood shade trees", "lamp bulbs", "chimney", "sofa",
    ],
)  # fmt: skip
def test_closed_shapes_wind_outward(source, name):
    (mesh,) = (m for m in source.meshes if m.name == name)
    centred = mesh.position.astype(np.float64) - mesh.position.mean(axis=0)
    a, b, c = (centred[mesh.triangles[:, k]] for k in range(3))
    assert np.sum(a * np.cross(b, c)) > 0.0


@pytest.mark.parametrize(
    ("shape", "volume"),
    [
        (shapes.box((0.0, 0.0, 0.0), (1.0, 2.0, 3.0)), 6.0),
        (shapes.beam((1.0, 2.0, 3.0), (4.0, 6.0, 3.0), 0.5, 0.2), 0.5),
        (
            shapes.pierced_wall(
                (0.0, 0.0, 0.0), (4.0, 3.0, 0.5), [(1.0, 2.0, 0.5, 2.5)]
            ),
            5.0,
        ),
        # A 64-gon has 0.9984 of its circle's area.
        (shapes.lathe(_CYLINDER, 64), 2.0 * np.pi * 0.9984),
        (shapes.line((0.0, 0.0, 0.0), (3.0, 4.0, 0.0), 1.0, 64), 5.0 * np.pi * 0.9984),
    ],
)
def test_primitives_enclose_their_volume(shape, volume):
    assert shapes.signed_volume(shape) == pytest.approx(volume, rel=1e-3)


def test_materials_and_textures_are_valid(source):
    for mesh in source.meshes:
        assert 0 <= mesh.material < len(source.materials)
        assert 0 <= mesh.group < len(source.group_names)
    for material in source.materials:
        if material.name != "steel":
            assert material.metallic == 0.0, material.name
        for index in (material.base_color_texture, material.normal_texture):
            assert index == NO_TEXTURE or 0 <= index < len(source.textures)
    for texture in source.textures:
        assert texture.texels.dtype == np.uint8
        assert texture.texels.ndim == 3
        assert texture.texels.shape[2] == 4


def test_every_material_is_used(source):
    used = {mesh.material for mesh in source.meshes}
    assert [m.name for i, m in enumerate(source.materials) if i not in used] == []


def test_leaves_are_cut_by_alpha_and_nothing_else_is(source):
    for mesh in source.meshes:
        material = source.materials[mesh.material]
        assert (material.alpha_mode == "MASK") == mesh.name.startswith("leaf")
        if material.alpha_mode == "MASK":
            alpha = source.textures[material.base_color_texture].texels[..., 3]
            visible = (alpha > 255 * material.alpha_cutoff).mean()
            assert 0.05 < visible < 0.95, material.name
            assert material.double_sided


def test_normal_maps_point_outward_on_average(source):
    for material in source.materials:
        if material.normal_texture != NO_TEXTURE:
            texture = source.textures[material.normal_texture]
            assert not texture.srgb
            mean = texture.texels[..., :3].mean(axis=(0, 1)) / 127.5 - 1.0
            # A surface that repeats has no mean slope; the photographs nearly so.
            np.testing.assert_allclose(mean[:2], 0.0, atol=0.02)
            assert mean[2] > 0.5


def test_static_group_never_moves_and_the_others_do(source):
    count = len(source.group_names)
    identity = np.eye(3, 4, dtype=np.float32)
    start = source.transforms(0.0)
    for t in np.linspace(0.0, DURATION, 17):
        matrices = source.transforms(float(t))
        assert matrices.shape == (count, 3, 4)
        assert matrices.dtype == np.float32
        np.testing.assert_array_equal(matrices[0], identity)
    for group in range(1, count):
        assert np.abs(source.transforms(1.0)[group] - start[group]).max() > 0.05
        assert any(mesh.group == group for mesh in source.meshes)


def test_groups_stay_rigid(source):
    for t in np.linspace(0.0, DURATION, 9):
        for matrix in source.transforms(float(t)).astype(np.float64):
            rotation = matrix[:, :3]
            # float32 rotations are orthogonal to a few times 2^-24.
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
            assert np.linalg.det(rotation) > 0.0


def test_animation_is_continuous_and_loops(source):
    assert source.duration == DURATION
    frame = 1.0 / 30.0
    times = np.arange(0.0, DURATION + 1.5 * frame, frame)
    matrices = np.stack([source.transforms(float(t)) for t in times])
    # Nothing moves faster than 3 m/s (translation), nor turns over 2 rad/s.
    assert np.abs(np.diff(matrices, axis=0)).max() < 3.0 * frame
    np.testing.assert_allclose(
        source.transforms(DURATION + 0.3), source.transforms(0.3), atol=1e-5
    )


@pytest.mark.parametrize(
    ("name", "thickness"),
    [("wire overhead", 0.012), ("wire to the house", 0.012), ("rope ratlines", 0.006),
     ("rope standing rigging", 0.008), ("rope running rigging", 0.01)],
)  # fmt: skip
def test_wires_and_ropes_are_thinner_than_a_pixel_from_the_main_camera(
    source, name, thickness
):
    (mesh,) = (m for m in source.meshes if m.name == name)
    view = _view(source, "main", _world(source, mesh))
    (camera,) = (c for c in source.cameras if c.name == "main")
    pixel = 2.0 * np.tan(camera.fov_y / 2.0) / 360.0  # at unit depth, 640×360
    depth = -view[:, 2]
    ahead = depth > 0.0
    seen = ahead & (np.abs(view[:, 1] / depth) < np.tan(camera.fov_y / 2.0))
    assert seen.any()
    assert thickness / depth[seen].min() < pixel


def test_thin_tubes_have_the_stated_thickness():
    wire = shapes.tube(shapes.sagging((0.0, 5.0, 0.0), (20.0, 5.0, 0.0), 0.5), 0.006, 5)
    axis_y = 5.0 - 4.0 * 0.5 * (wire.position[:, 0] / 20) * (
        1 - wire.position[:, 0] / 20
    )
    away = np.hypot(wire.position[:, 1] - axis_y, wire.position[:, 2])
    # The wire's slope, at most 0.1, tilts the section: x and y mix by half a percent.
    assert away.max() < 0.0061


@pytest.mark.parametrize("name", ["main", "boat", "fence", "walk_start"])
def test_cameras_are_rigid_and_upright(source, name):
    (camera,) = (c for c in source.cameras if c.name == name)
    rotation = camera.world_from_view[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation[1, 1] > 0.9  # the view's up is nearly the world's
    assert np.radians(40.0) < camera.fov_y < np.radians(60.0)


@pytest.mark.parametrize(
    ("camera", "prefix"),
    [("main", "rope standing"), ("main", "wire overhead"), ("main", "slat fence"),
     ("main", "leaf straps"), ("main", "rail bars"), ("boat", "boat transom"),
     ("fence", "slat fence west"), ("walk_start", "wind wheel blades")],
)  # fmt: skip
def test_camera_has_in_view(source, camera, prefix):
    (found,) = (c for c in source.cameras if c.name == camera)
    tan_y = np.tan(found.fov_y / 2.0)
    inside = 0
    for mesh in source.meshes:
        if mesh.name.startswith(prefix):
            view = _view(source, camera, _world(source, mesh))
            x, y, depth = view[:, 0], view[:, 1], -view[:, 2]
            wide = np.abs(x) < 16.0 / 9.0 * tan_y * depth
            inside += int((wide & (np.abs(y) < tan_y * depth)).sum())
    assert inside > 0


def test_the_wheels_shadow_falls_on_the_garden_in_view_of_the_main_camera(source):
    (mesh,) = (m for m in source.meshes if m.name == "wind wheel blades")
    (sun,) = source.lights
    world = _world(source, mesh)
    shadow = world - np.array(sun.direction) * (world[:, 1:2] / sun.direction[1])
    for points, seen in ((world, "occluder"), (shadow, "shadow")):
        view = _view(source, "main", points)
        depth = -view[:, 2]
        tan_y = np.tan(source.cameras[0].fov_y / 2.0)
        inside = (np.abs(view[:, 1]) < tan_y * depth) & (
            np.abs(view[:, 0]) < 16.0 / 9.0 * tan_y * depth
        )
        share = inside.mean()
        if seen == "shadow":
            assert share == 1.0
        else:
            assert share < 0.7  # partly out of view


def test_one_sun_shines_and_a_lamp_glows(source):
    (sun,) = source.lights
    assert sun.kind == LIGHT_DIRECTIONAL
    assert sun.direction[1] < 0.0
    assert source.sky is not None
    glowing = [m for m in source.materials if max(m.emissive) > 0.0]
    assert [m.name for m in glowing] == ["lamp"]
