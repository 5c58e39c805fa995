"""Packing of scenes: triangles, pyramids, ids, bounds."""

from typing import Any

import numpy as np
import pytest

from ataa_jax import scene
from ataa_jax.errors import InputError

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
FACE = np.array([[0, 1, 2]], np.int32)


def lone(
    texture: scene.TextureSource | None = None,
    finish: scene.MaterialSource | None = None,
    **fields: Any,
) -> scene.SceneSource:
    """A scene of one mesh, a triangle unless told otherwise."""
    mesh = {"name": "mesh", "position": TRIANGLE, "triangles": FACE, "material": 0}
    return scene.SceneSource(
        "lone",
        [scene.MeshSource(**{**mesh, **fields})],
        [finish or scene.MaterialSource()],
        [] if texture is None else [texture],
    )


def pyramid(image: np.ndarray, srgb: bool, alpha_mode: str = "OPAQUE") -> list:
    """The levels of a packed base colour texture, uint8 (h, w, 4)."""
    material = scene.MaterialSource(base_color_texture=0, alpha_mode=alpha_mode)
    source = lone(scene.TextureSource(image, srgb), material)
    table = scene.pack(source)[0].textures
    found = []
    for level in range(int(table.level_count[0])):
        height, width = (
            int(table.level_height[0, level]),
            int(table.level_width[0, level]),
        )
        start = int(table.level_offset[0, level])
        flat = np.asarray(table.texels)[start : start + height * width]
        channels = np.stack([flat >> shift & 255 for shift in (0, 8, 16, 24)], axis=-1)
        found.append(channels.reshape(height, width, 4).astype(np.uint8))
    return found


# --- mip pyramids --------------------------------------------------------------------


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 5), (8, 4), (100, 37)])
@pytest.mark.parametrize("srgb", [True, False])
def test_constant_images_stay_constant_down_to_one_texel(size, srgb):
    for code in range(0, 256, 15):
        image = np.full((*size, 4), (code, 255 - code, 9, 255), np.uint8)
        levels = pyramid(image, srgb)
        assert levels[-1].shape == (1, 1, 4)
        for level in levels:
            np.testing.assert_array_equal(
                level, np.broadcast_to(image[0, 0], level.shape)
            )


def covered(extent: int, half: int) -> np.ndarray:
    """Share of each of `extent` texels in the area that each of `half` covers."""
    edge = np.arange(half + 1) * extent / half
    first, last = edge[:-1, None], edge[1:, None]
    texel = np.arange(extent)[None]
    share = np.minimum(last, texel + 1) - np.maximum(first, texel)
    return np.maximum(share, 0.0) * half / extent


@pytest.mark.parametrize("size", [(7, 5), (8, 4), (13, 1), (3, 2)])
@pytest.mark.parametrize("srgb", [True, False])
def test_a_level_is_the_mean_light_of_the_area_it_covers(size, srgb):
    image = np.random.default_rng(0).integers(0, 256, (*size, 4), np.uint8)
    image[..., 3] = 255
    light = image[..., :3] / 255.0
    if srgb:
        high = ((light + 0.055) / 1.055) ** 2.4
        light = np.where(light <= 0.04045, light / 12.92, high)
    half = [max(extent // 2, 1) for extent in size]
    rows, columns = covered(size[0], half[0]), covered(size[1], half[1])
    mean = np.einsum("ah,bw,hwc->abc", rows, columns, light)
    if srgb:
        high = 1.055 * mean ** (1 / 2.4) - 0.055
        mean = np.where(mean <= 0.0031308, mean * 12.92, high)
    levels = pyramid(image, srgb)
    np.testing.assert_array_equal(levels[0], image)
    # Half a code of rounding, and 1/40 of one from the table that encodes sRGB.
    assert np.abs(levels[1][..., :3] - mean * 255.0).max() <= 0.53


def test_the_colour_behind_holes_does_not_darken_leaves():
    image = np.zeros((4, 4, 4), np.uint8)
    image[::2] = 10, 200, 30, 255
    for level in pyramid(image, True, "MASK")[1:]:
        np.testing.assert_array_equal(
            level[..., :3], level[..., :3] * 0 + [10, 200, 30]
        )
        np.testing.assert_array_equal(level[..., 3], level[..., 3] * 0 + 128)


def test_a_scene_without_textures_gets_one_white_texel():
    assert np.asarray(scene.pack(lone())[0].textures.texels).tolist() == [0xFFFFFFFF]


# --- triangles -----------------------------------------------------------------------


def test_triangles_without_area_or_not_finite_are_left_out_and_counted():
    position = np.vstack([TRIANGLE, [[np.nan, 0, 0], [2, 0, 0]]]).astype(np.float32)
    faces = np.array([[0, 1, 2], [0, 1, 4], [0, 1, 3], [0, 0, 1]], np.int32)
    packed, notes = scene.pack(lone(position=position, triangles=faces))
    np.testing.assert_array_equal(packed.geometry.position, [TRIANGLE])
    assert [note.split()[0] for note in notes] == ["3"]
    with pytest.raises(InputError):
        scene.pack(lone(position=position, triangles=faces[3:]))


@pytest.mark.parametrize("scale", [1e-18, 1.0, 3e38])
def test_normals_are_unit_at_any_scale_of_float32(scale):
    packed, _ = scene.pack(lone(position=TRIANGLE * np.float32(scale)))
    np.testing.assert_array_equal(packed.geometry.normal, [[[0, 0, 1]] * 3])


def test_bad_normals_become_flat_and_bad_uv_zero():
    normal = np.array([[0, 0, 0], [np.nan, 0, 1], [0, 3, 4]], np.float32)
    uv = np.array([[np.nan, 1], [np.inf, 0], [2, 3]], np.float32)
    geometry = scene.pack(lone(normal=normal, uv=uv))[0].geometry
    # One rounding of float32 in the length.
    np.testing.assert_allclose(
        geometry.normal[0], [[0, 0, 1], [0, 0, 1], [0, 0.6, 0.8]], atol=1e-7
    )
    np.testing.assert_array_equal(geometry.uv[0], [[0, 1], [0, 0], [2, 3]])


@pytest.mark.parametrize(
    "bad",
    [
        {"material": 1},
        {"material": -1},
        {"group": 1},
        {"triangles": np.array([[0, 1, 3]], np.int32)},
        {"triangles": np.array([[0, 1, -1]], np.int32)},
    ],
)
def test_ids_that_name_nothing_are_refused(bad):
    with pytest.raises(InputError, match="there are"):
        scene.pack(lone(**bad))


def test_a_texture_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="texture 4"):
        scene.pack(lone(finish=scene.MaterialSource(base_color_texture=4)))


HALF = (1.0, 1.0, 1.0, 0.5)


@pytest.mark.parametrize(
    ("material", "blended"),
    [
        (scene.MaterialSource(alpha_mode="BLEND"), False),  # opaque everywhere
        (
            scene.MaterialSource(alpha_mode="BLEND", base_color=(1.0, 1.0, 1.0, 0.5)),
            True,
        ),
        (
            scene.MaterialSource(alpha_mode="MASK", base_color=(1.0, 1.0, 1.0, 0.5)),
            False,
        ),
        (
            scene.MaterialSource(base_color=(1.0, 1.0, 1.0, 0.5)),
            False,
        ),  # alpha is not read
        (scene.MaterialSource(transmission=0.3), True),
    ],
)
def test_a_material_is_blended_where_something_shows_through(material, blended):
    packed = scene.pack(lone(finish=material))[0].materials
    assert bool(packed.blended[0]) == blended
    assert bool(packed.alpha_masked[0]) == (material.alpha_mode == "MASK")


@pytest.mark.parametrize(
    ("material", "mirror"),
    [
        (scene.MaterialSource(roughness=0.0), True),
        (scene.MaterialSource(roughness=0.079), True),
        (scene.MaterialSource(roughness=0.08), False),
        (scene.MaterialSource(roughness=0.0, alpha_mode="MASK"), False),
    ],
)
def test_a_smooth_material_is_a_mirror(material, mirror):
    packed = scene.pack(lone(finish=material))[0].materials
    assert bool(packed.mirror[0]) == mirror


def test_a_scene_may_have_no_lights():
    lights = scene.pack(lone())[0].lights
    assert (lights.kind.shape, lights.position.shape) == ((0,), (0, 3))


def test_bounds_follow_the_moving_groups():
    def transforms(time: float) -> np.ndarray:
        matrices = np.tile(np.eye(3, 4, dtype=np.float32), (2, 1, 1))
        matrices[1, 0, 3] = 10.0 * time
        return matrices

    meshes = [
        scene.MeshSource(name, TRIANGLE, FACE, 0, group=group)
        for group, name in enumerate(("still", "moving"))
    ]
    source = scene.SceneSource(
        "two",
        meshes,
        [scene.MaterialSource()],
        group_names=["static", "moving"],
        transforms=transforms,
        duration=1.0,
    )
    low, high = scene.bounds(source, 0.5)
    np.testing.assert_array_equal([low, high], [[0, 0, 0], [6, 1, 0]])
