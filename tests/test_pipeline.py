"""The whole frame: its order, its state, and what the mask does to the image."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import color, paths, pipeline, raytrace, segmentation, taa, types
from ataa_jax import world as worlds
from ataa_jax.errors import InputError
from ataa_jax.scene import (
    CameraSource,
    LightSource,
    MaterialSource,
    MeshSource,
    SceneSource,
)  # fmt: skip
from tests import tiny

SIZE = (36, 64)


def mesh(part: tiny.Part, name: str, material: int, group: int = 0) -> MeshSource:
    corners = part.position.reshape(-1, 3)
    triangles = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    return MeshSource(name, corners, triangles, material, group=group)


def source(*, moving: bool = False) -> SceneSource:
    """A floor, a ball, a cube that may move, and thin slats."""
    from ataa_jax.camera import look_at

    def transforms(time: float) -> np.ndarray:
        move = tiny.moved((0.4 * np.sin(6.0 * time), 0.0, 0.0))
        return np.stack([tiny.still()[0], move])

    slats = [
        tiny.Part(tiny.cube(1.0).position * (0.012, 1.0, 0.012) + (x, 0.5, 1.2))
        for x in np.linspace(-1.2, 1.2, 15)
    ]
    joined = tiny.Part(np.concatenate([s.position for s in slats]).astype(np.float32))
    eye = look_at(np.array([1.2, 1.4, 4.0]), np.array([0.0, 0.4, 0.0]))
    group = {
        "group_names": ["static", "cube"], "transforms": transforms, "duration": 2.0,
    } if moving else {}  # fmt: skip
    return SceneSource(
        name="tiny",
        meshes=[
            mesh(tiny.floor(20.0), "floor", 0),
            mesh(tiny.sphere(radius=0.6), "ball", 1),
            mesh(tiny.cube(0.5, (-1.0, 0.25, 0.3)), "cube", 2, group=int(moving)),
            mesh(joined, "slats", 3),
        ],
        materials=[
            MaterialSource("floor", (0.5, 0.5, 0.45, 1.0), metallic=0.0),
            MaterialSource("ball", (0.8, 0.2, 0.1, 1.0), metallic=0.0, roughness=0.3),
            MaterialSource("cube", (0.1, 0.3, 0.8, 1.0), metallic=0.0),
            MaterialSource("white", (0.9, 0.9, 0.9, 1.0), metallic=0.0),
        ],
        lights=[
            LightSource(
                types.LIGHT_DIRECTIONAL, (3.0, 3.0, 3.0), direction=(-0.48, -0.8, -0.36)
            )
        ],
        cameras=[CameraSource("main", eye, 0.8)],
        **group,
    )


@pytest.fixture(scope="module")
def world():
    """One world for all tests: each compiles a whole frame."""
    return worlds.prepare(source(moving=True))


def run(world, kind="walk", frames=6, motion=0.01, size=SIZE, **options):
    shot = worlds.sequence(world, paths.CameraPath(kind=kind, motion=motion), size)
    preset = options.pop("preset", "tuned")
    threshold = options.pop("threshold", None)
    config, params = pipeline.preset(preset, world.scene, size, **options)
    if threshold is not None:
        params = pipeline.with_threshold(params, threshold)
    return list(pipeline.sequence(shot, params, config=config, frames=frames))


def methods(output: pipeline.FrameOutput) -> np.ndarray:
    method, _ = segmentation.unpack_mask(output.segmentation.mask)
    return np.asarray(method)


def test_the_first_frame_is_all_fxaa(world):
    (output, state), *_ = run(world, frames=1)
    assert np.all(methods(output) == types.METHOD_FXAA)
    np.testing.assert_array_equal(output.composite, output.raw)
    assert bool(state.history.valid)


def test_the_history_stores_exactly_the_composite_and_never_fxaa(world):
    for output, state in run(world, frames=4, motion=0.05):
        np.testing.assert_array_equal(state.history.color, output.composite)
        method = methods(output)
        shown = np.asarray(color.display(output.composite))
        untouched = method != types.METHOD_FXAA
        # One ulp: the display transform is fused differently inside the frame.
        np.testing.assert_allclose(
            np.asarray(output.image)[untouched], shown[untouched], atol=1.2e-7
        )


def test_every_pixel_is_its_methods_colour(world):
    for output, _ in run(world, frames=5, threshold=0.05):
        method = methods(output)
        composite = np.asarray(output.composite)
        for code, buffer in (
            (types.METHOD_FXAA, output.raw),
            (types.METHOD_TAA, output.taa),
        ):
            where = method == code
            np.testing.assert_array_equal(composite[where], np.asarray(buffer)[where])
        # Eight rays join a history that counts as three frames at most.
        joined = method == types.METHOD_ATAA
        shown, old, new = (
            np.asarray(color.tonemap(image))[joined]
            for image in (output.composite, output.taa, output.traced)
        )
        whole, left = np.abs(new - old), np.abs(new - shown)
        np.testing.assert_allclose(left + np.abs(shown - old), whole, atol=1e-6)
        assert np.all(left <= whole * (3 / 11) + 1e-6)
    assert np.any(joined)


def test_statistics_count_what_the_mask_says(world):
    for output, _ in run(world, frames=4):
        method, stats = methods(output), output.statistics
        traced = np.sum(method == types.METHOD_ATAA)
        assert int(stats.fxaa_pixels) == np.sum(method == types.METHOD_FXAA)
        assert int(stats.ataa_pixels) == traced
        assert int(stats.primary_rays) == 8 * traced


def test_the_budget_is_kept_and_the_overflow_reported(world):
    free = run(world, frames=4, threshold=0.02, budget=np.inf)[-1][0].statistics
    asked = int(free.ataa_pixels)
    budget = 0.25 * asked * 8 / (SIZE[0] * SIZE[1])
    capped = run(world, frames=4, threshold=0.02, budget=budget)[-1][0].statistics
    assert int(capped.primary_rays) <= budget * SIZE[0] * SIZE[1]
    assert int(capped.overflow_pixels) > 0
    none = run(world, frames=4, budget=0.0)[-1][0].statistics
    assert int(none.primary_rays) == 0


def test_a_cut_forgets_everything(world):
    shot = worlds.sequence(world, paths.CameraPath(), SIZE)
    config, params = pipeline.preset("tuned", world.scene, SIZE)
    first = state = pipeline.init(SIZE)

    def frame(state, inputs):
        return pipeline.frame(
            state, inputs, params,
            scene=world.scene, tracer=world.tracer, config=config,
        )  # fmt: skip

    for index in range(2):
        _, state = frame(state, shot.inputs(index))
    inputs = pipeline.with_cut(shot.inputs(2), True)
    output, state = frame(state, inputs)
    assert np.all(methods(output) == types.METHOD_FXAA)
    fresh, fresh_state = frame(first, inputs)
    np.testing.assert_array_equal(output.image, fresh.image)
    jax.tree.map(np.testing.assert_array_equal, state, fresh_state)


def test_same_inputs_same_bits(world):
    first = [np.asarray(output.image) for output, _ in run(world, frames=3)]
    second = [np.asarray(output.image) for output, _ in run(world, frames=3)]
    np.testing.assert_array_equal(first, second)


def test_stage_by_stage_equals_the_jitted_frame(world):
    shot = worlds.sequence(world, paths.CameraPath(), SIZE)
    config, params = pipeline.preset("tuned", world.scene, SIZE)
    states = [pipeline.init(SIZE)] * 2
    for index in range(3):
        inputs = shot.inputs(index)
        outputs = []
        for which, step in enumerate((pipeline.frame, pipeline.stages)):
            output, states[which] = step(
                states[which], inputs, params,
                scene=world.scene, tracer=world.tracer, config=config,
            )  # fmt: skip
            outputs.append(output)
        # Fusion across stages may round differently in the last bits; a pixel whose
        # score lies within 1e-5 of the threshold may then change its class.
        same = methods(outputs[0]) == methods(outputs[1])
        score = np.asarray(outputs[0].segmentation.score)
        near = np.abs(score - float(params.segmentation.threshold)) < 1e-5
        assert np.all(same | near)
        close = np.isclose(outputs[0].image, outputs[1].image, atol=1e-4).all(axis=-1)
        assert close.mean() > 0.999


def test_parameters_do_not_retrace(world):
    shot = worlds.sequence(world, paths.CameraPath(), SIZE)
    config, params = pipeline.preset("tuned", world.scene, SIZE)
    state = pipeline.init(SIZE)

    def step(params: pipeline.Params) -> None:
        pipeline.frame(
            state, shot.inputs(0), params,
            scene=world.scene, tracer=world.tracer, config=config,
        )  # fmt: skip

    step(params)
    before = pipeline.frame._cache_size()
    step(jax.tree.map(lambda x: x + jnp.ones((), x.dtype), params))
    step(pipeline.with_budget(params, 0.3))
    assert pipeline.frame._cache_size() == before


def test_a_warm_pipeline_has_compiled_the_raytrace_stage_of_its_frames(world):
    size = (20, 32)  # that no other test compiles
    shot = worlds.sequence(world, paths.CameraPath(), size)
    config, params = pipeline.preset("tuned", world.scene, size)
    given = {"scene": world.scene, "tracer": world.tracer, "config": config}
    start = raytrace.raytrace._cache_size()
    pipeline.warm(shot.inputs(0), **given)
    assert raytrace.raytrace._cache_size() == start + 1
    state = pipeline.init(size)
    for frame in range(2):
        output, state = pipeline.stages(state, shot.inputs(frame), params, **given)
    assert int(output.statistics.primary_rays) > 0
    assert raytrace.raytrace._cache_size() == start + 1


def test_a_still_unrectified_average_equals_the_mean_of_its_samples():
    world = worlds.prepare(source())  # in which nothing moves
    # Still camera, raster at mip 0, no rectification, weight 1/(n + 1), bilinear:
    # the history is the running mean of the jittered frames, in the averaging space.
    config, params = pipeline.preset("tuned", world.scene, SIZE)
    config = replace(
        config,
        adaptive=False,
        raster=replace(config.raster, mip_maps=False),
        taa=replace(
            config.taa,
            rectify="none", blend="accumulate", history_filter="bilinear",
            motion="pixel", current_filter="none", weighting="tonemap",
        ),
    )  # fmt: skip
    params = pipeline.with_taa(params, taa.default_params())  # no limit to the count
    shot = worlds.sequence(world, paths.CameraPath(kind="still"), SIZE)
    frames = list(pipeline.sequence(shot, params, config=config, frames=16))
    mean = np.mean([color.tonemap(output.raw) for output, _ in frames], axis=0)
    found = color.tonemap(frames[-1][0].composite)
    np.testing.assert_allclose(found, mean, atol=1e-5)


@pytest.mark.parametrize("size", [(1, 1), (7, 3)])
def test_odd_sizes_stay_finite(world, size):
    for output, _ in run(world, frames=3, size=size):
        assert output.image.shape == (*size, 3)
        assert np.all(np.isfinite(output.image))


def test_the_image_is_finite_and_in_range(world):
    for output, _ in run(world, kind="pan", frames=4, motion=0.1):
        image = np.asarray(output.image)
        assert np.all((image >= 0.0) & (image <= 1.0))


def test_bad_presets_are_refused(world):
    for options in ({"name": "best"}, {"samples": 3}, {"budget": -1.0}):
        name = options.pop("name", "tuned")
        with pytest.raises(InputError):
            pipeline.preset(name, world.scene, SIZE, **options)


def test_state_is_a_plain_pytree(world):
    _, state = run(world, frames=1)[0]
    leaves = jax.tree.leaves(state)
    assert all(isinstance(leaf, jax.Array) for leaf in leaves)
    assert eqx.tree_equal(state, jax.tree.map(lambda x: x, state))
