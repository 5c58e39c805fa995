"""Meshes beside glTF: what is read, what is warned of, and what is refused."""

from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from ataa_jax import mesh_files, scene, types
from ataa_jax.errors import InputError


def write_obj(folder, texture: str = "") -> Any:
    Image.fromarray(np.full((2, 2, 3), (0, 255, 0), np.uint8)).save(folder / "t.png")
    (folder / "a.mtl").write_text(f"newmtl paint\nKd 0.5 0.25 1\n{texture}\n")
    (folder / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
        "usemtl paint\nf 1/1 2/2 3/3\n"
    )
    return folder / "a.obj"


def test_the_diffuse_colour_of_an_mtl_is_linear(tmp_path):
    (material,) = mesh_files.load(write_obj(tmp_path)).materials
    # trimesh keeps Kd as 8-bit codes.
    np.testing.assert_allclose(material.base_color, [0.5, 0.25, 1, 1], atol=0.5 / 255)
    assert material.metallic == 0.0
    assert material.base_color_texture == types.NO_TEXTURE


def test_an_obj_texture_is_read_with_v_turned_down(tmp_path):
    source = mesh_files.load(write_obj(tmp_path, "map_Kd t.png"))
    mesh = source.meshes[0]
    assert source.textures[0].texels[0, 0].tolist() == [0, 255, 0, 255]
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv[:, 1], 1.0 - mesh.position[:, 1])


def test_a_file_without_normals_keeps_its_facets(tmp_path):
    trimesh.creation.box().export(tmp_path / "box.stl")
    geometry = scene.pack(mesh_files.load(tmp_path / "box.stl"))[0].geometry
    assert np.abs(np.asarray(geometry.normal)).max(axis=-1).min() == 1.0


def test_normals_in_a_file_are_kept(tmp_path):
    (tmp_path / "a.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0.6 0.8\nf 1//1 2//1 3//1\n"
    )
    normal = mesh_files.load(tmp_path / "a.obj").meshes[0].normal
    assert normal is not None
    np.testing.assert_allclose(normal, [[0, 0.6, 0.8]] * 3, atol=1e-6)


def test_vertex_colours_are_averaged_with_a_warning(tmp_path):
    box = trimesh.creation.box()
    red = np.tile([255, 0, 0, 255], (8, 1)).astype(np.uint8)
    box.visual = trimesh.visual.ColorVisuals(box, vertex_colors=red)
    box.export(tmp_path / "box.ply")
    source = mesh_files.load(tmp_path / "box.ply")
    assert source.materials[0].base_color == (1.0, 0.0, 0.0, 1.0)
    assert len(source.warnings) == 1


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.obj", b"hello"),
        ("a.obj", b"v 0 0 0\nf 1 2 9\n"),
        ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("a.obj", b"\xff\xfe\x00"),
        ("a.stl", b"xx"),
        ("a.ply", b""),
        ("a.ply", b"ply\nbad"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n"),
        ("a.xyz", b"0 0 0\n1 1 1\n"),  # points, no triangles
        ("a.zip", b"PK"),
        ("a.unknown", b"x"),
        ("a", b"x"),
    ],
)
def test_malformed_meshes_are_refused_in_one_sentence(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError) as caught:
        mesh_files.load(tmp_path / name)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_without_a_suffix_is_told_the_known_ones_once(tmp_path):
    (tmp_path / "a").write_bytes(b"x")
    with pytest.raises(InputError, match=r"a has no suffix; known are ") as caught:
        mesh_files.load(tmp_path / "a")
    listed = str(caught.value).split("known are ")[1].split(", ")
    assert {".glb", ".gltf", ".obj", ".ply", ".stl"} <= set(listed)
    assert len(set(listed)) == len(listed)


def test_missing_meshes_and_folders_are_refused(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        mesh_files.load(tmp_path / "none.obj")
    with pytest.raises(InputError, match=r"is a folder; give the path of a file"):
        mesh_files.load(tmp_path)


def test_a_missing_material_file_is_warned_of(tmp_path):
    path = write_obj(tmp_path)
    assert mesh_files.load(path).warnings == []
    (tmp_path / "a.mtl").unlink()
    (warning,) = mesh_files.load(path).warnings
    assert "a.mtl" in warning
    assert "does not exist" in warning


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        ("none.png", None, "does not exist"),
        ("../up.png", None, "outside"),
        ("bad.png", b"no picture", "is no image"),
        ("", b"", "cannot be read"),  # the folder itself
    ],
)
def test_a_texture_that_cannot_be_had_is_warned_of(tmp_path, name, data, reason):
    folder = tmp_path / "scene"
    folder.mkdir()
    Image.new("RGB", (1, 1)).save(tmp_path / "up.png")
    path = write_obj(folder, f"map_Kd {name or '.'}")
    if data:
        (folder / name).write_bytes(data)
    source = mesh_files.load(path)
    (warning,) = source.warnings
    assert name in warning
    assert reason in warning
    assert source.textures == []


def test_a_texture_that_breaks_off_is_warned_of(tmp_path):
    path = write_obj(tmp_path, "map_Kd noise.png")
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png")
    data = (tmp_path / "noise.png").read_bytes()
    (tmp_path / "noise.png").write_bytes(data[:2000])
    source = mesh_files.load(path)
    (warning,) = source.warnings
    assert "noise.png, which the scene names, is no image" in warning
    assert source.textures == []
