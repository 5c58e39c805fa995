"""Mitsuba as the competitor; what needs it is skipped, with its reason, without it."""

import importlib
from dataclasses import replace

import jax
import numpy as np
import pytest

from ataa_jax import camera as cameras
from ataa_jax import color, competitor, embree, metrics, paths, reference, types
from ataa_jax import scene as scenes
from ataa_jax import world as worlds
from ataa_jax.competitor import library
from ataa_jax.errors import InputError
from ataa_jax.scene import (
    CameraSource,
    LightSource,
    MaterialSource,
    MeshSource,
    SceneSource,
    SkySource,
    TextureSource,
)
from tests import tiny

SIZE = (36, 48)  # rows, columns
SAMPLES = 64
SUN = LightSource(types.LIGHT_DIRECTIONAL, (3.0, 2.8, 2.5), direction=(0.3, -1.0, -0.4))


@pytest.fixture(scope="module")
def mitsuba():
    try:
        return library.load()
    except InputError as error:
        pytest.skip(str(error))


def mesh(part, material, group=0, normal=None):
    corners = part.position.reshape(-1, 3)
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    uv = None if part.uv is None else part.uv.reshape(-1, 2)
    if normal is not None:
        normal = normal.reshape(-1, 3)
    return MeshSource(
        "part", corners, faces, material, normal=normal, uv=uv, group=group
    )


def noise(seed, low=0, high=256):
    """An image of 8×8 random texels, opaque."""
    texels = np.random.default_rng(seed).integers(low, high, (8, 8, 4), np.uint8)
    texels[..., 3] = 255
    return texels


def sequence(meshes, materials, textures=(), sun=SUN):
    """A still camera above and before the origin; group 1 turns and goes right."""

    def transforms(time):
        return np.stack([tiny.moved(), tiny.moved((6.0 * time, 0.3, 0.8), turn=time)])

    source = SceneSource(
        name="tiny",
        meshes=meshes,
        materials=materials,
        textures=list(textures),
        lights=[sun],
        group_names=["static", "moving"],
        transforms=transforms,
        duration=1.0,
    )
    packed, _ = scenes.pack(source)
    matrix = cameras.look_at(np.array([0.3, 2.0, 3.0]), np.array([0.0, 0.2, 0.0]))
    camera = CameraSource("eye", matrix, 0.8)
    world = worlds.World(
        name="tiny",
        source=source,
        scene=packed,
        tracer=embree.build(packed),
        cameras=[camera],
        lights=[sun],
        exposure=1.0,
        notes=[],
    )
    path = paths.CameraPath("still")
    return worlds.Sequence(competitor.one_light(world), path, SIZE, camera, 3.0)


@pytest.fixture(scope="module")
def shot():
    """Every kind of surface: maps, smooth normals, a mask, a pane, a moving cube."""
    floor, cover, pane = (tiny.floor(4.0), tiny.floor(0.8, 0.6), tiny.floor(0.7, 0.5))
    floor.uv = floor.uv * np.float32(2.5)  # beyond 1, where the wrap modes tell
    cover.position = cover.position + np.float32((-0.7, 0.0, 0.3))
    pane.position = pane.position + np.float32((0.6, 0.0, 0.9))
    ball = tiny.sphere(12, 24, 0.4)
    smooth = ball.position / np.float32(0.4)
    ball.position = ball.position + np.float32((0.1, 0.4, -0.3))
    bumps = noise(3, 90, 166) | np.array([0, 0, 128, 0], np.uint8)
    textures = [
        TextureSource(noise(1), srgb=True),
        TextureSource(noise(2, 40), srgb=False, wrap_u=types.WRAP_MIRROR),
        TextureSource(bumps, srgb=False),
        TextureSource(tiny.checker().texels, srgb=True),
    ]
    white = MaterialSource(metallic=0.0)
    materials = [
        MaterialSource(
            metallic=0.8,
            roughness=0.7,
            normal_scale=0.8,
            base_color_texture=0,
            metallic_roughness_texture=1,
            normal_texture=2,
        ),
        MaterialSource(base_color=(0.9, 0.6, 0.2, 1.0), metallic=0.5, roughness=0.3),
        replace(white, alpha_mode="MASK", base_color_texture=3),
        replace(
            white,
            base_color=(0.2, 0.9, 0.4, 0.5),
            roughness=0.4,
            alpha_mode="BLEND",
            transmission=0.5,
        ),
        white,
    ]
    meshes = [
        mesh(floor, 0),
        mesh(ball, 1, normal=smooth),
        mesh(cover, 2),
        mesh(pane, 3),
        mesh(tiny.cube(0.5), 4, group=1),
    ]
    return sequence(meshes, materials, textures)


@pytest.fixture(scope="module")
def rival(mitsuba, shot):
    return competitor.Competitor(shot)


@pytest.mark.parametrize("index", [0, 4])
def test_mitsuba_draws_the_same_image(rival, shot, index):
    own = reference.reference(shot, index, SAMPLES, average="linear", use_cache=False)
    ours, theirs = np.asarray(own.color), rival.render(index, SAMPLES)
    # Both take 64 stratified samples, which leaves an error of some 1 % at an edge of
    # full contrast. Inside of surfaces, where over half of the pixels lie, what is left
    # is the textures' half floats, 2^-11, and the samples' places on the texture.
    shown = [np.asarray(color.display(image)) for image in (theirs, ours)]
    assert metrics.ssim(*shown) > 0.99
    assert np.median(np.abs(theirs - ours)) < 4e-3 * ours.max()
    assert np.abs(theirs.mean() - ours.mean()) < 0.01 * ours.mean()
    assert ours.mean() > 0.02  # something is lit


def test_a_moving_group_follows_its_transform(rival):
    first, moved = rival.render(0, 4), rival.render(4, 4)
    assert np.abs(moved - first).max() > 0.1
    for _ in range(4):  # and back again, every time
        rival.place(4)
        np.testing.assert_array_equal(rival.render(0, 4), first)


def test_the_seed_decides_the_samples(rival):
    one, again, other = (rival.render(0, 5, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.any(one != other)


def test_light_and_eye_pass_the_holes_of_a_mask(mitsuba):
    # Straight light on a white floor, roughness 1: a cover just above it whose mask is
    # a checkerboard shades half of its square. Nowhere is anything darker than the
    # shade, which is black, and the holes show the floor as if there were no cover.
    sun = LightSource(types.LIGHT_DIRECTIONAL, (3.0, 3.0, 3.0))
    sun = replace(sun, direction=(0.0, -1.0, 0.0))
    white = MaterialSource(metallic=0.0)
    cut = replace(
        white, alpha_mode="MASK", base_color=(0.0, 0.0, 0.0, 1.0), base_color_texture=0
    )
    texture = [TextureSource(tiny.checker(2, 32).texels, srgb=True)]

    def light(*meshes):
        shot = sequence(list(meshes), [white, cut], texture, sun=sun)
        return competitor.Competitor(shot).render(0, 16).mean(axis=-1)

    floor, cover = mesh(tiny.floor(4.0), 0), mesh(tiny.floor(1.6, height=1e-3), 1)
    without, holed = light(floor), light(floor, cover)
    whole = light(floor, replace(cover, uv=np.zeros_like(cover.uv) + np.float32(0.25)))
    # The share of the cover's square that is dark, weighted alike by the eye's view.
    share = (without - holed).sum() / (without - whole).sum()
    assert 0.45 < share < 0.55  # half, but for perspective and the cover's own gleam
    assert np.all(holed < 1.05 * without.max())
    assert np.percentile(np.abs(holed - without), 60) < 1e-3  # the rest is the floor


def test_a_lamp_fades_by_its_range_and_cone(mitsuba):
    # From one place, so that the BRDF cancels in the ratio of two lights' images: what
    # is left is KHR_lights_punctual's window and cone, at the point that a pixel shows.
    bulb = LightSource(types.LIGHT_POINT, (5.0, 5.0, 5.0), position=(0.2, 1.0, 0.1))
    spot = replace(
        bulb,
        kind=types.LIGHT_SPOT,
        direction=(0.0, -1.0, 0.0),
        range=2.0,
        inner_cone_angle=0.3,
        outer_cone_angle=1.2,
    )
    shot = sequence([mesh(tiny.floor(40.0), 0)], [MaterialSource(metallic=0.0)])

    def light(lamp):
        packed = scenes.pack_lights([lamp])
        scene = worlds.replace_lights(shot.world.scene, packed, shot.world.scene.sky)
        world = competitor.lamps(replace(shot.world, scene=scene, lights=[lamp]))
        return competitor.Competitor(replace(shot, world=world)).render(0, 16)

    eye = shot.inputs(0).camera
    x, y = cameras.pixel_centres(SIZE)
    way = np.stack(jax.tree.leaves(cameras.directions(eye, SIZE, x, y)), axis=-1)
    near = way[:, 1] < -0.3  # the floor before the eye, not its horizon
    way = way[near]
    start = np.asarray(eye.world_from_view)[:3, 3]
    point = start - way * (start[1] / way[:, 1:2])
    offset = np.array(bulb.position) - point
    squared = np.sum(offset**2, axis=1)
    window = np.clip(1.0 - (squared / 4.0) ** 2, 0.0, 1.0)
    inner, outer = np.cos(0.3), np.cos(1.2)
    cosine = offset[:, 1] / np.sqrt(squared)
    cone = np.clip((cosine - outer) / (inner - outer), 0.0, 1.0)
    ratio = (light(spot)[..., 0] / light(bulb)[..., 0]).reshape(-1)[near]
    # A pixel is the mean over its area, over which both change by some percent.
    # A pixel is the mean over its area; where the cone's clamp begins it bends.
    np.testing.assert_allclose(ratio, window * cone**2, atol=0.02)
    assert ratio.min() < 0.05 < 0.8 < ratio.max()


def test_a_lit_sky_is_refused(mitsuba):
    shot = sequence([mesh(tiny.floor(1.0), 0)], [MaterialSource()])
    bright = scenes.pack_sky(
        SkySource((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)), 1.0
    )
    scene = worlds.replace_lights(shot.world.scene, shot.world.scene.lights, bright)
    with pytest.raises(InputError, match="one_light"):
        competitor.Competitor(replace(shot, world=replace(shot.world, scene=scene)))


def lit_by(world, lights, exposure=1.0):
    packed = scenes.pack_lights(lights)
    scene = worlds.replace_lights(world.scene, packed, world.scene.sky)
    return competitor.one_light(
        replace(world, scene=scene, lights=lights, exposure=exposure)
    )


def test_one_light_keeps_the_strongest_sun_or_supplies_one():
    world = sequence([mesh(tiny.floor(1.0), 0)], [MaterialSource()]).world
    lamp = LightSource(types.LIGHT_POINT, (100.0, 100.0, 100.0))
    weak = replace(SUN, intensity=(1.0, 1.0, 1.0), direction=(1.0, 0.0, 0.0))
    kept = lit_by(world, [lamp, weak, SUN]).scene.lights
    np.testing.assert_allclose(kept.intensity, [SUN.intensity], rtol=1e-6)
    supplied = lit_by(world, [lamp], exposure=2.0)
    (light,) = supplied.lights
    assert light.kind == types.LIGHT_DIRECTIONAL
    assert light.direction[1] < 0.0  # from above
    expected = [2.0 * np.array(light.intensity)]
    np.testing.assert_allclose(supplied.scene.lights.intensity, expected, rtol=1e-6)


# ---- finding Mitsuba and LLVM


def test_a_missing_llvm_library_is_told_with_what_to_install(monkeypatch):
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(library, "_candidates", lambda: ["/usr/lib/libLLVM-15.so.1"])
    monkeypatch.setattr(library.sys, "platform", "linux")
    with pytest.raises(InputError, match=r"ataa-jax\[mitsuba\].*libllvm19.*DRJIT"):
        library.load()


def test_a_wrong_path_to_llvm_is_told(monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    with pytest.raises(InputError, match=r"names '/nowhere/libLLVM.so', which is no"):
        library.load()


def test_a_missing_mitsuba_is_told_with_what_to_install(monkeypatch, tmp_path):
    def nothing(name):
        raise ImportError(f"No module named '{name}'")

    file = tmp_path / "libLLVM.so.19.1"
    file.touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(file))
    monkeypatch.setattr(importlib, "import_module", nothing)
    with pytest.raises(InputError, match=r"No module named.*ataa-jax\[mitsuba\]"):
        library.load()


def test_the_newest_llvm_wins():
    files = [
        "/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1",
        "/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1",
        "/usr/lib/x86_64-linux-gnu/libLLVM-17.so.1",
        "/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1",
        "/usr/lib/llvm-19/lib/libLLVMCore.a",
    ]
    assert library.newest(files) == files[3]
    assert library.newest(files[:3]) == files[2]
    assert library.newest(files[:2]) is None
