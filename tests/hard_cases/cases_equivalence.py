"""Equivalences: batches, loops, precision. A frame here is all that follows raster."""

from functools import cache, partial
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax import pipeline, taa
from tests.hard_cases import buffers
from tests.hard_cases.buffers import SIZE, STILL
from tests.hard_cases.case import Topic
from tests.oracles import taa as oracle

TOPIC = Topic("equivalences")

REORDERED = "another order of operations"

FRAMES = 12


@cache
def _walk():
    """Frames of a view that moves by a fraction of a pixel, with a step in depth."""
    rng = np.random.default_rng(0)
    views = buffers.noise(FRAMES)
    traced = jnp.mean(views, axis=0)
    depth = np.where(np.arange(SIZE[1]) < 4, 2.0, 5.0) + np.zeros(SIZE)
    motion = rng.uniform(-0.8, 0.8, (FRAMES, 1, 1, 2)) + np.zeros((FRAMES, *SIZE, 2))
    one = buffers.gbuffer(depth=depth)
    stacked = jax.tree.map(lambda x: jnp.broadcast_to(x, (FRAMES, *x.shape)), one)
    return (
        views,
        eqx.tree_at(lambda g: g.motion, stacked, jnp.asarray(motion, jnp.float32)),
        traced,
    )


# The default; one that traces nearly all; one whose budget binds; one that traces none.
THRESHOLDS = (None, 0.0, 0.01, 0.5)
BUDGETS = (np.inf, np.inf, 0.3, 0.0)


def _numbers(index):
    """One set of parameters."""
    _, params = buffers.preset()
    threshold = THRESHOLDS[index]
    if threshold is not None:
        params = pipeline.with_threshold(params, threshold)
    return pipeline.with_budget(params, BUDGETS[index])


def _start():
    views, _, _ = _walk()
    return buffers.state(buffers.history(views[0]))


@partial(jax.jit, static_argnames="config")
def _batched(sets, start, views, stacked, traced, *, config):
    """All parameter sets by vmap, all frames by scan."""

    def run(params):
        def body(current, frame):
            output, after = buffers.after_raster(
                current, *frame, traced, params, config=config
            )
            return after, (output.image, output.segmentation.mask)

        return jax.lax.scan(body, start, (views, stacked))[1]

    return jax.vmap(run)(sets)


@cache
def _together():
    """Images and masks of all sets and frames."""
    return _run_together()


def _run_together():
    sets = [_numbers(index) for index in range(len(THRESHOLDS))]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *sets)
    config, _ = buffers.preset()
    return jax.tree.map(
        np.asarray, _batched(stacked, _start(), *_walk(), config=config)
    )


def _difference(index: int) -> float:
    """One parameter set, frame by frame, against all together; 1: a mask differs."""
    views, stacked, traced = _walk()
    config, _ = buffers.preset()
    images, masks = _together()
    worst, current = 0.0, _start()
    for k in range(FRAMES):
        one = jax.tree.map(lambda x, k=k: x[k], stacked)
        output, current = buffers.after_raster(
            current, views[k], one, traced, _numbers(index), config=config
        )
        apart = np.abs(np.asarray(output.image) - images[index, k]).max()
        changed = np.any(np.asarray(output.segmentation.mask) != masks[index, k])
        worst = max(worst, float(apart), float(changed))
    return worst


@TOPIC.case(
    "frames one at a time equal frames in a lax.scan",
    danger="state that is not in the state",
    quantity="largest difference shown, sRGB; 1 where a mask differs",
    # XLA fuses another program otherwise: multiply and add round once in place of
    # twice, 6e-8 of a value of 1, and sRGB's slope of 12.9 in the dark.
    bound=1e-5,
    reason="twelve frames of a few roundings, each times sRGB's steepest slope, 12.9",
)
def one_by_one() -> float:
    return _difference(0)


@TOPIC.case(
    "a batch of parameter sets by vmap equals one set after the other",
    danger="a branch that becomes a select; a loop that runs for the longest",
    quantity="largest difference shown, sRGB; 1 where a mask differs",
    bound=1e-5,
    reason="as of the scan",
)
def batched_parameters() -> float:
    return max(_difference(index) for index in (1, 2, 3))


@TOPIC.case(
    "TAA in float32 stays by TAA in float64 over 16 frames",
    danger="rounding that feeds on itself through the history",
    quantity="largest difference, tone-mapped",
    # A position below 10 px is rounded by 2^-21 px at most; in two axes, times the
    # slope of Catmull-Rom's weights, 1.5 of a contrast of 1, summed by 1/a = 1/0.3.
    bound=2 * 1.5 * 2.0**-21 / 0.3,
    reason="a position's 2⁻²¹ px in two axes, times a filter's slope of 1.5, over a",
)
def against_float64() -> float:
    config, params = taa.PRESETS["tuned"]
    rng = np.random.default_rng(3)
    views = np.asarray(buffers.noise(16, low=0.0, high=2.0, seed=4))
    past = buffers.history(views[0])
    wide = jax.tree.map(np.asarray, past)
    worst = 0.0
    for view in views:
        motion = rng.uniform(-1.5, 1.5, (*SIZE, 2))
        around = buffers.gbuffer(motion=motion)
        out = taa.taa(past, jnp.asarray(view), around, STILL, params, config=config)
        numbers = (wide, view, jax.tree.map(np.asarray, around), np.asarray(STILL))
        color, _, count, _ = oracle.taa(*numbers, params, config)
        past = buffers.history(out.color, count=out.count)
        # The oracle's own history, in float64, which an `eqx.Module` would not hold.
        wide = SimpleNamespace(color=color, count=count, valid=True)
        mapped = color / (1.0 + color.max(axis=-1, keepdims=True))
        found = np.asarray(colors.tonemap(out.color), np.float64)
        worst = max(worst, float(np.abs(found - mapped).max()))
    return worst


@TOPIC.case(
    "the mask is a function of its input: a second run gives the same bits",
    danger="sums whose order depends on threads",
    quantity="masks and images of 4 × 12 frames that differ in a bit",
    bound=0,
    reason="same program, same input",
)
def repeatable() -> float:
    first, second = _together(), _run_together()
    return float(sum(int(np.sum(a != b)) for a, b in zip(first, second, strict=True)))


TOPIC.covered(
    "jit equals eager: TAA",
    danger=REORDERED,
    test="test_taa.py::test_jit_equals_eager",
    bound="rtol 1e-5, atol 1e-6",
    reason="compiled code contracts a·b + c to one rounding where eager takes two",
)
TOPIC.covered(
    "jit equals eager: segmentation",
    danger=REORDERED,
    test="test_segmentation.py::test_jit_equals_eager",
    bound="atol 1e-6, rtol 1e-7",
    reason="compiled code contracts a·b + c to one rounding where eager takes two",
)
TOPIC.covered(
    "jit equals eager: sparse rays",
    danger=REORDERED,
    test="test_raytrace.py::test_jit_equals_eager",
    bound="rtol 1e-4, atol 1e-5",
    reason="contracted products change the last bit of rays' directions",
)
TOPIC.covered(
    "jit equals eager: resolve",
    danger=REORDERED,
    test="test_resolve.py::test_jit_equals_eager",
    bound="bit-equal",
    reason="it selects, and computes nothing that could be contracted",
)
TOPIC.covered(
    "jit equals eager: FXAA",
    danger=REORDERED,
    test="test_fxaa.py::test_jit_equals_eager",
    bound="atol 1e-6, rtol 1e-7",
    reason="one rounding against two",
)
TOPIC.covered(
    "the jitted frame equals its stages one by one",
    danger=REORDERED,
    test="test_pipeline.py::test_stage_by_stage_equals_the_jitted_frame",
    bound="> 0.999 of pixels within atol 1e-4, rtol 1e-5; methods equal but where the "
    "score is within 1e-5 of the threshold",
    reason="fusion across stages may round differently in the last bits",
)
TOPIC.covered(
    "hits do not depend on the number of threads",
    danger=REORDERED,
    test="test_embree_backends.py::test_results_do_not_depend_on_the_number_of_threads",
    bound="bit-equal with 1, 2 and 7 threads",
    reason="a ray is traced by one thread, whichever it is",
)
TOPIC.covered(
    "packets and the fallback hit the same",
    danger=REORDERED,
    test="test_embree_backends.py::test_backends_agree_exactly_on_opaque_still_scenes",
    bound="distances bit-equal; > 0.999 of triangles the same",
    reason="where two triangles are hit at one distance, either may be named",
)
TOPIC.covered(
    "tiles of an image and scan order hit the same",
    danger=REORDERED,
    test="test_embree.py::test_tiles_change_the_order_of_tracing_only",
    bound="bit-equal",
    reason="the order of tracing changes, no ray does",
)
TOPIC.covered(
    "TAA in float32 equals float64, one frame, seven configurations",
    danger=REORDERED,
    test="test_taa.py::test_every_choice_agrees_with_the_oracle",
    bound="atol 2e-5, rtol 2e-5",
    reason="a few roundings, amplified by the clip's division and by leaving the tone "
    "map",
)
