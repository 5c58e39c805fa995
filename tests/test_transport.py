"""Transport: layers composite in order, lights pass through them, mirrors reflect."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from ataa_jax import effects, embree, raster, raytrace, shading
from tests import frames, furnished, tiny

SIZE = (12, 16)
BLACK = tiny.Sky(*((0.0, 0.0, 0.0),) * 3)
CENTRE = (6, 8)


def glow(color, **options) -> tiny.Material:
    """A material whose colour is known: it emits, and reflects nothing."""
    rgba = (0.0, 0.0, 0.0, options.pop("alpha", 1.0))
    return tiny.Material(base_color=rgba, emissive=color, **options)


def pane(color, alpha: float) -> tiny.Material:
    return glow(color, alpha=alpha, blended=True)


def draw(
    scene, eye=(0.0, 0.0, 4.0), target=(0.0, 0.0, 0.0), second_motion=False, **previous
):
    config = raster.Config(
        size=SIZE, shading=effects.required(scene), second_motion=second_motion
    )
    return raster.raster(
        scene,
        frames.inputs(eye, target, **previous),
        raster.default_params(),
        tracer=embree.build(scene),
        config=config,
    )


def quads(*depths: float) -> list[tiny.Part]:
    """Large squares at z = depth, the k-th of material k."""
    parts = [tiny.quad(40.0, (0.0, 0.0, z)) for z in depths]
    return [
        tiny.Part(part.position, part.uv, material=index)
        for index, part in enumerate(parts)
    ]


def over(layers, background) -> np.ndarray:
    """Composites nearest-first layers of (colour, alpha) back to front."""
    result = np.array(background)
    for color, alpha in reversed(layers):
        result = alpha * np.array(color) + (1.0 - alpha) * result
    return result


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 2, 0)])
def test_layers_composite_back_to_front_whatever_their_order_in_the_file(order):
    layers = [((0.9, 0.1, 0.0), 0.3), ((0.0, 0.8, 0.2), 0.6), ((0.1, 0.2, 0.7), 0.2)]
    parts = quads(-3.0, 0.0, 1.0, 2.0)  # wall; the panes of materials 1, 2, 3
    by_depth = {z: layers[order[index]] for index, z in enumerate((0.0, 1.0, 2.0))}
    wall = (0.4, 0.5, 0.6)
    materials = [glow(wall), *(pane(c, a) for c, a in by_depth.values())]
    scene = tiny.scene(parts, materials, lights=[], sky=BLACK)
    nearest_first = [by_depth[z] for z in (2.0, 1.0, 0.0)]
    found = np.asarray(draw(scene).color)
    # float32, a dozen operations of order 1
    np.testing.assert_allclose(found[CENTRE], over(nearest_first, wall), atol=1e-6)
    np.testing.assert_allclose(found, found[CENTRE][None, None] + 0 * found, atol=1e-6)


@pytest.mark.parametrize("bands", [120, 1 << 20])
@pytest.mark.parametrize("shot", [furnished.yard, furnished.workshop])
def test_bands_and_shading_only_what_was_hit_change_nothing(shot, bands, monkeypatch):
    made = shot()
    config = raster.Config(size=made.size, shading=effects.required(made.scene))

    def drawn() -> raster.RasterOutput:
        return raster.raster.jitted(
            made.scene, made.inputs, raster.default_params(made.mip_bias),
            tracer=embree.build(made.scene), config=config,
        )  # fmt: skip

    assert made.size[0] * made.size[1] < shading.CHUNK
    whole = drawn()
    monkeypatch.setattr(shading, "CHUNK", 100)
    monkeypatch.setattr(raster, "_BAND_PIXELS", bands)
    raster.raster.jitted.clear_cache()
    packed = drawn()
    raster.raster.jitted.clear_cache()
    # Another program rounds elsewhere: a unit in the last place of a texture coordinate
    # is up to 1e-5 of a colour where texels are noise.
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5),
        whole,
        packed,
    )


def test_sixty_four_layers_deep():
    layers = 64
    depths = np.linspace(2.0, -2.0, layers)
    parts = [tiny.quad(40.0, (0.0, 0.0, z)) for z in depths]
    wall = tiny.quad(40.0, (0.0, 0.0, -3.0))
    color, alpha = (0.2, 0.4, 0.6), 0.05
    scene = tiny.scene(
        [wall, *(tiny.Part(p.position, p.uv, material=1) for p in parts)],
        [glow((1.0, 1.0, 1.0)), pane(color, alpha)],
        lights=[],
        sky=BLACK,
    )
    found = np.asarray(draw(scene).color)[CENTRE]
    expected = over([(color, alpha)] * layers, (1.0, 1.0, 1.0))
    # 64 roundings of 6e-8 each, on values of order 1
    np.testing.assert_allclose(found, expected, atol=5e-6)


def test_a_pane_behind_the_wall_is_not_seen():
    scene = tiny.scene(
        quads(0.0, -1.0),
        [glow((0.5, 0.5, 0.5)), pane((9.0, 9.0, 9.0), 0.5)],
        lights=[],
        sky=BLACK,
    )
    out = draw(scene)
    np.testing.assert_allclose(out.color, 0.5, atol=1e-6)


def test_the_sky_is_seen_through_a_pane():
    sky = tiny.Sky(*((0.3, 0.6, 0.9),) * 3, visibility=0.0)
    parts = [tiny.Part(tiny.quad(40.0).position, material=0)]
    scene = tiny.scene(parts, [pane((1.0, 0.0, 0.0), 0.25)], lights=[], sky=sky)
    found = np.asarray(draw(scene).color)[CENTRE]
    expected = over([((1.0, 0.0, 0.0), 0.25)], (0.3, 0.6, 0.9))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_tinted_glass_lets_its_base_colours_share_through():
    tint = (0.9, 0.5, 0.1)
    glass = tiny.Material(
        base_color=(*tint, 1.0), blended=True, transmission=0.8, roughness=0.5
    )
    scene = tiny.scene(
        quads(-1.0, 1.0), [glow((1.0, 1.0, 1.0)), glass], lights=[], sky=BLACK
    )
    found = np.asarray(draw(scene, eye=(0.0, 0.0, 400.0)).color)[CENTRE]
    # At normal incidence 4 % are reflected; the rest of the share passes, tinted.
    np.testing.assert_allclose(found, 0.96 * 0.8 * np.array(tint), rtol=1e-3)


@pytest.mark.parametrize(("alpha", "panes"), [(0.0, 1), (0.25, 1), (0.25, 3), (1.0, 1)])
def test_a_light_is_attenuated_by_every_pane_on_its_way(alpha, panes):
    ground = tiny.Part(tiny.floor(50.0).position, material=0)
    above = [
        tiny.Part(tiny.floor(50.0, height=3.0 + k).position, material=1)
        for k in range(panes)
    ]
    white = tiny.Material(base_color=(0.5, 0.5, 0.5, 1.0))
    clear = tiny.Material(base_color=(0.0, 0.0, 0.0, alpha), blended=True)
    light = tiny.Light(direction=(0.0, -1.0, 0.0))

    def brightness(parts) -> float:
        scene = tiny.scene(parts, [white, clear], lights=[light], sky=BLACK)
        out = draw(scene, eye=(0.0, 2.0, 4.0))
        return float(np.asarray(out.color)[CENTRE][0])

    open_sky = brightness([ground])
    through = brightness([ground, *above])
    assert open_sky > 0.1
    np.testing.assert_allclose(through, open_sky * (1 - alpha) ** panes, atol=1e-6)


@pytest.mark.parametrize(("alpha", "shown"), [(0.2, 0), (0.49, 0), (0.51, 1), (1.0, 1)])
def test_the_gbuffer_shows_the_first_surface_that_hides_more_than_half(alpha, shown):
    scene = tiny.scene(
        quads(0.0, 1.0),
        [glow((0.5, 0.5, 0.5)), pane((1.0, 0.0, 0.0), alpha)],
        lights=[],
        sky=BLACK,
    )
    gbuffer = draw(scene).gbuffer
    np.testing.assert_array_equal(gbuffer.object, shown)
    np.testing.assert_allclose(gbuffer.depth, 4.0 - shown, rtol=1e-5)


@pytest.mark.parametrize(
    ("alphas", "share", "moves"),
    [
        # The wall is shown; of the panes before it, the one that is seen more.
        ((0.2,), 0.2, True),
        ((0.1, 0.3), 0.9 * 0.3, True),
        # A pane is shown; behind it the wall.
        ((0.8,), 0.2, True),
        ((0.0,), 0.0, False),
    ],
)
def test_the_second_motion_is_that_of_what_is_seen_beside(alphas, share, moves):
    panes = [pane((1.0, 0.0, 0.0), alpha) for alpha in alphas]
    depths = [2.0 - k for k in range(len(alphas))]
    scene = tiny.scene(
        quads(0.0, *depths), [glow((0.5, 0.5, 0.5)), *panes], lights=[], sky=BLACK
    )
    # The camera steps to the right; a point at distance z moves by f / z.
    before = {"previous_eye": (-0.1, 0.0, 4.0), "previous_target": (-0.1, 0.0, 0.0)}
    plain = draw(scene, **before)
    assert plain.gbuffer.second_motion is None
    found = draw(scene, second_motion=True, **before)
    bare = replace(found.gbuffer, second_motion=None, second_share=None)
    for a, b in zip(
        jax.tree.leaves((found.color, bare, found.rays)),
        jax.tree.leaves((plain.color, plain.gbuffer, plain.rays)),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_allclose(found.gbuffer.second_share, share, atol=1e-6)
    if moves:
        own, other = (
            np.asarray(x)[CENTRE][0]
            for x in (found.gbuffer.motion, found.gbuffer.second_motion)
        )
        z_own = float(np.asarray(found.gbuffer.depth)[CENTRE])
        z_other = 4.0 - depths[-1] if alphas[0] < 0.5 else 4.0
        assert own != other
        np.testing.assert_allclose(own * z_own, other * z_other, rtol=1e-4)


def test_without_layers_nothing_is_seen_beside():
    found = draw(mirror_scene(), second_motion=True).gbuffer
    assert not np.any(found.second_share)
    assert np.all(np.isfinite(found.second_motion))


def mirror_scene(roughness: float = 0.0, **parts) -> object:
    """A mirror that fills the view, and a glowing wall behind the camera."""
    silver = tiny.Material(
        base_color=(1.0, 1.0, 1.0, 1.0), metallic=1.0, roughness=roughness, mirror=True
    )
    behind = tiny.Part(tiny.quad(400.0, (0.0, 0.0, 20.0)).position, material=1)
    front = tiny.Part(tiny.quad(400.0).position, material=0)
    return tiny.scene(
        [front, behind], [silver, glow((0.2, 0.5, 0.8))], lights=[], sky=BLACK
    )


def test_a_silver_mirror_shows_what_stands_before_it():
    out = draw(mirror_scene())
    found = np.asarray(out.color)
    # Karis's fit reflects 1 − 0.55 roughness of a white metal, whatever the angle.
    expected = (1.0 - 0.55 * 0.045) * np.array([0.2, 0.5, 0.8])
    np.testing.assert_allclose(found, expected + 0 * found, rtol=1e-4)
    assert int(out.rays.reflection) == SIZE[0] * SIZE[1]


def test_the_reflection_fades_out_with_roughness():
    at = [
        float(np.asarray(draw(mirror_scene(roughness)).color)[CENTRE][2])
        for roughness in (0.0, 0.05, 0.065, 0.08, 0.2)
    ]
    assert at[0] == pytest.approx(at[1], rel=1e-2)
    assert at[2] == pytest.approx(0.5 * at[1], rel=2e-2)
    assert at[3] == at[4] == 0.0  # black: there is no sky to reflect


def test_a_mirrors_image_stands_where_the_mirrored_camera_sees_it():
    silver = tiny.Material((1.0,) * 4, metallic=1.0, roughness=0.0, mirror=True)
    mirror = tiny.Part(tiny.quad(400.0).position, material=0)
    centre = np.float32((0.7, 0.3, 2.0))
    ball = tiny.Part(tiny.sphere(radius=0.6).position + centre, material=1)
    eye = (-0.5, 0.2, 5.0)
    materials = [silver, glow((1.0, 1.0, 1.0))]
    scene = tiny.scene([mirror, ball], materials, lights=[], sky=BLACK)
    seen = np.asarray(draw(scene, eye=eye, target=(0.0, 0.0, -5.0)).color)[..., 0]
    # The mirror image of the ball, without the mirror.
    image = tiny.Part(ball.position * np.float32((1, 1, -1)), material=1)
    scene = tiny.scene([image, ball], materials, lights=[], sky=BLACK)
    direct = np.asarray(draw(scene, eye=eye, target=(0.0, 0.0, -5.0)).color)[..., 0]
    assert 5 < np.sum(direct > 0.5) < 180
    assert np.mean((seen > 0.5) == (direct > 0.5)) > 0.99


def test_forcing_effects_that_are_not_called_for_changes_no_bit():
    unused = [tiny.Texture(np.full((1, 1, 4), 255, np.uint8))]
    scene = tiny.scene([tiny.floor(), tiny.cube(1.0, (0.0, 0.5, 0.0))], textures=unused)
    expected = draw(scene)
    config = raster.Config(size=SIZE, shading=effects.everything())
    found = raster.raster(
        scene,
        frames.inputs((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)),
        raster.default_params(),
        tracer=embree.build(scene),
        config=config,
    )
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def callbacks(scene, **config) -> int:
    tracer = embree.build(scene)
    chosen = raster.Config(size=SIZE, shading=effects.required(scene), **config)
    jaxpr = jax.make_jaxpr(
        lambda s, i, p: raster.raster(s, i, p, tracer=tracer, config=chosen)
    )(scene, frames.inputs(), raster.default_params())
    return str(jaxpr).count("pure_callback[")


def test_the_program_holds_the_callbacks_of_its_effects_and_no_others():
    plain = [tiny.floor(), tiny.cube()]
    solid = tiny.scene(plain)
    assert callbacks(solid) == 2  # a primary and a shadow ray
    unlit = effects.without(solid, effects.parse("no-shadows"))
    assert callbacks(unlit) == 1
    assert callbacks(tiny.scene(plain, lights=[])) == 1
    glass = tiny.scene(quads(0.0, 1.0), [tiny.Material(), pane((1.0, 0, 0), 0.5)])
    assert callbacks(glass) > 2
    opaque = effects.without(glass, effects.parse("no-transparency"))
    assert callbacks(opaque) == 2


def test_the_tracer_sees_layers_and_mirrors_as_the_raster_stage_does():
    layers = [((0.9, 0.1, 0.0), 0.3), ((0.0, 0.8, 0.2), 0.6)]
    wall = (0.4, 0.5, 0.6)
    materials = [glow(wall), *(pane(c, a) for c, a in layers)]
    scene = tiny.scene(quads(-3.0, 2.0, 1.0), materials, lights=[], sky=BLACK)
    everywhere = np.ones(SIZE, bool)
    for subject, expected in (
        (scene, over(layers, wall)),
        (mirror_scene(), np.asarray(draw(mirror_scene()).color)[CENTRE]),
    ):
        config = raytrace.Config(samples=2, shading=effects.required(subject))
        found = raytrace.raytrace(
            subject,
            frames.inputs((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)),
            everywhere,
            tracer=embree.build(subject),
            config=config,
        )
        np.testing.assert_allclose(
            np.asarray(found.color)[CENTRE], expected, rtol=1e-4, atol=1e-6
        )
