"""The fit: gradients at every kink, numbers at their bounds, data without a signal."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import segmentation, taa, terms, types
from ataa_jax.fit import relaxed, soft, space
from tests.hard_cases import buffers
from tests.hard_cases.buffers import SIZE, STILL
from tests.hard_cases.case import Topic

TOPIC = Topic("fit")

TERMS = ("luminance", "depth", "response")


def _infinite(tree) -> int:
    return sum(int(np.sum(~np.isfinite(np.asarray(x)))) for x in jax.tree.leaves(tree))


def _kinks() -> list[tuple[jax.Array, jax.Array]]:
    """Pairs of images with kinks: equal, black, flat, at the floor, at the maximum."""
    rng = np.random.default_rng(0)
    some = rng.uniform(0.0, 2.0, (*SIZE, 3))
    levels = (0.0, 0.004 / 0.996, 0.5, 65504.0)  # the second: a luma of the floor
    images = [some, *(np.full((*SIZE, 3), level) for level in levels)]
    pairs = [(a, b) for a in images for b in images]
    return [
        (jnp.asarray(a, jnp.float32), jnp.asarray(b, jnp.float32)) for a, b in pairs
    ]


@TOPIC.case(
    "gradients of the terms by colour are finite at every kink",
    danger="√0, 0/0 and maxima of equals: equal images, black, the floor, the maximum",
    quantity="derivatives that are not finite, 25 pairs of images × 3 terms",
    bound=0,
    reason="one NaN in a gradient is a NaN step of the optimizer",
)
def terms_by_colour() -> float:
    floor, contrast = jnp.float32(0.004), jnp.float32(0.06)

    @jax.jit
    def slopes(a, b):
        return (
            jax.grad(lambda *i: jnp.sum(terms.luminance(*i, floor)), (0, 1))(a, b),
            jax.grad(lambda *i: jnp.sum(terms.spread(*i, floor)), (0, 1))(a, b),
            jax.grad(lambda *i: jnp.sum(terms.response(*i, contrast)), (0, 1))(a, b),
        )

    return float(sum(_infinite(slopes(a, b)) for a, b in _kinks()))


@TOPIC.case(
    "gradients of the depth term are finite at every kink",
    danger="the Sobel's root at 0 on flat depth; 1/z of the sky",
    quantity="derivatives that are not finite, flat, sky, sky's edge, not positive",
    bound=0,
    reason="as of the terms by colour",
)
def depth_by_depth() -> float:
    slope = jax.jit(jax.grad(lambda z: jnp.sum(terms.depth_edge(z))))
    edge = np.where(np.arange(SIZE[1]) < 4, 2.0, np.inf) + np.zeros(SIZE)
    flat = (np.full(SIZE, value) for value in (1.0, 1e6, np.inf, 0.0, -1.0))
    return float(
        sum(_infinite(slope(jnp.asarray(z, jnp.float32))) for z in (*flat, edge))
    )


@TOPIC.case(
    "gradients of TAA by its parameters and the colour are finite at every kink",
    danger="the clip at the box's border, σ = 0 of a flat box, maxima of equals",
    quantity="derivatives that are not finite, variance clip, 25 pairs of images",
    bound=0,
    reason="as of the terms by colour",
)
def taa_by_parameters() -> float:
    # It has the clip of both, and a root besides.
    config = taa.Config(
        rectify="variance_clip",
        history_filter="bilinear",
        motion="pixel",
        space="rgb",
        weighting="linear",  # the tone map's kinks are those of the terms
    )
    past = buffers.history(np.zeros((*SIZE, 3)))

    def loss(params, color, then):
        before = buffers.with_leaf(past, lambda h: h.color, then)
        return jnp.sum(
            taa.taa(
                before, color, buffers.gbuffer(), STILL, params, config=config
            ).color
        )

    slope = jax.jit(jax.grad(loss, (0, 1)))
    pairs = _kinks()
    return float(sum(_infinite(slope(taa.default_params(), *pair)) for pair in pairs))


def _pixels(kind: str) -> relaxed.Pixels:
    rng = np.random.default_rng(1)
    told = rng.uniform(0.0, 1.0, (64, 3))
    gain, cross = rng.uniform(0.01, 1.0, 64), rng.normal(size=64) * 0.3
    if kind == "identical frames":  # no term fires, tracing gains nothing
        told, gain, cross = told * 0.0, gain * 0.0, cross * 0.0
    if kind == "saturated terms":
        told = np.ones((64, 3))
    if kind == "the reference equals TAA":  # e = 0: any mask but none is worse
        cross = cross * 0.0
    base = cross * cross / np.maximum(gain, 1e-12)
    arrays = (jnp.asarray(x, jnp.float32) for x in (told, cross, gain, base))
    return relaxed.Pixels(*arrays)


KINDS = ("any", "identical frames", "saturated terms", "the reference equals TAA")


def _soft() -> relaxed.Soft:
    return relaxed.Soft(
        temperature=jnp.float32(0.125), price=jnp.float32(0.01), samples=jnp.float32(8)
    )


@TOPIC.case(
    "the relaxed loss has finite gradients with every weight at its bounds",
    danger="log 0 and the flat ends of a sigmoid",
    quantity="derivatives that are not finite, 4 kinds of data × 4 corners × 3 levels",
    bound=0,
    reason="as of the terms by colour",
)
def loss_at_bounds() -> float:
    limits = [(np.log(q.low), np.log(q.high)) for q in space.weights(TERMS)]

    @jax.jit
    def slopes(y, pixels):
        args = (pixels, _soft())
        return jax.grad(relaxed.loss)(y, args), jax.jacfwd(relaxed.residuals)(y, args)

    wrong = 0
    for kind in KINDS:
        for a in limits[0]:
            for b in limits[1]:
                for threshold in (-40.0, -1.0, 40.0):
                    y = jnp.asarray([a, b, threshold], jnp.float32)
                    wrong += _infinite(slopes(y, _pixels(kind)))
    return float(wrong)


@TOPIC.case(
    "a search without a signal ends at finite weights",
    danger="a singular step of Levenberg and Marquardt: identical frames, a reference "
    "that equals TAA, saturated terms",
    quantity="weights and losses that are not finite, 4 kinds of data",
    bound=0,
    reason="a fit's file is read by others",
)
def search_without_signal() -> float:
    start = jnp.asarray([[0.0, 0.0, -1.0]], jnp.float32)
    limits = soft.limits_of(space.weights(("luminance", "depth", "response")))
    wrong = 0
    for kind in KINDS:
        data = (_pixels(kind), _soft())
        wrong += _infinite(soft.minimise(start, data, limits, solver="lm"))
    return float(wrong)


@TOPIC.case(
    "every number of the parameters at 0 and at 1e9 gives scores in [0, 1]",
    danger="thresholds and weights of 0, all of them: 0/0",
    quantity="scores outside [0, 1] or methods that do not exist",
    bound=0,
    reason="a mask is defined for every parameter that the command line takes",
)
def parameters_at_extremes() -> float:
    rng = np.random.default_rng(2)
    color = jnp.asarray(rng.uniform(0, 2, (*SIZE, 3)), jnp.float32)
    then = color * jnp.asarray(rng.uniform(0.5, 1.5, (*SIZE, 1)), jnp.float32)
    depth = np.where(rng.random(SIZE) < 0.3, np.inf, rng.uniform(1, 4, SIZE))
    current = buffers.state(buffers.history(color))
    inputs = (current, color, buffers.gbuffer(depth=depth), then)
    plain = segmentation.default_params()
    fields = [name for name in vars(plain) if name != "hold"]
    # One set a field and value, then all fields at once, stacked for vmap.
    sets = []
    for value in (0.0, 1e9):
        for chosen in (*([name] for name in fields), fields):
            numbers = {n: value if n in chosen else getattr(plain, n) for n in fields}
            sets.append({n: jnp.float32(v) for n, v in numbers.items()})
    stacked = {n: jnp.stack([each[n] for each in sets]) for n in fields}
    wrong = 0
    for reading in ("sum", "either"):
        config = segmentation.Config(use_response=True, reading=reading)

        def found(numbers, config=config):
            params = replace(plain, **numbers)
            out = segmentation.segmentation(
                *inputs, params, config=config, blended=color
            )
            return out.score, segmentation.unpack_mask(out.mask)[0]

        score, method = (np.asarray(x) for x in jax.jit(jax.vmap(found))(stacked))
        wrong += int(np.sum(~((score >= 0.0) & (score <= 1.0 + 1e-6))))
        wrong += int(np.sum(method > types.METHOD_ATAA))
    return float(wrong)


TOPIC.covered(
    "where TAA is exact nothing is fitted, and that is said",
    danger="0/0 of gains",
    test="test_fit.py::test_where_taa_is_exact_nothing_is_fitted_and_that_is_said",
    bound="SSIM 1 ± 1e-5, and a note that nothing was fitted",
    reason="the picture is its own reference: SSIM is 1 but for float32",
)
TOPIC.covered(
    "masks of none or all and pixels without a signal have finite gradients",
    danger="flat ends of a sigmoid",
    test="test_fit.py::"
    "test_pixels_without_a_signal_and_masks_of_none_or_all_give_finite_gradients",
    bound="every gradient of the loss and of the residuals finite",
    reason="one pixel's NaN would be the sum's",
)
TOPIC.covered(
    "gradients agree with differences in float64",
    danger="a wrong derivative",
    test="test_fit.py::test_gradients_of_loss_and_residuals_agree_with_differences",
    bound="rtol 1e-5, atol 1e-5; loss to order 2, residuals to order 1",
    reason="the defaults of JAX's check_grads in float64, for its step of 1e-4",
)
