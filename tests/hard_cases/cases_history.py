"""History: bad values, thousands of frames, fireflies, degenerate colour boxes.

Differences are of tone-mapped colours, in [0, 1), unless a row says otherwise.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax import rectification, taa
from ataa_jax.vector import Vec3
from tests.hard_cases import buffers
from tests.hard_cases.buffers import SIZE, STILL
from tests.hard_cases.case import Topic

TOPIC = Topic("history")

EPS = 2.0**-23  # float32's step at 1
BAD = (np.nan, np.inf, -np.inf, 1e30, -3.0)
AT = (3, 6)  # the pixel that is spoiled
PERIOD = 16  # frames of jitter
FRAMES = 10_000

# Where a bad value may come in: (what is replaced, of (state, colour, G-buffer)).
PLACES = {
    "history colour": lambda s, c, g: s.history.color,
    "history count": lambda s, c, g: s.history.count,
    "history depth": lambda s, c, g: s.history.depth,
    "history motion": lambda s, c, g: s.history.motion,
    "colour": lambda s, c, g: c,
    "depth": lambda s, c, g: g.depth,
    "motion": lambda s, c, g: g.motion,
}


@cache
def _spoiled(value: float, place: str) -> list:
    """Frames of a noisy still view; in the first, one pixel holds a bad value.

    Returns:
        (output, state) a frame.
    """
    config, params = buffers.preset()
    views = buffers.noise(PERIOD)
    current = buffers.state(buffers.history(views[0]))
    results = []
    for index in range(8):
        frame = (current, views[index], buffers.gbuffer())
        if index == 0 and place:
            where = PLACES[place]
            spoiled = where(*frame).at[AT].set(value)
            frame = buffers.with_leaf(frame, lambda f, w=where: w(*f), spoiled)
        output, current = buffers.after_raster(
            *frame, jnp.mean(views, axis=0), params, config=config
        )
        results.append((output, current))
    return results


@TOPIC.case(
    "bad values are gone from every colour within the frame",
    danger="NaN, ±inf, 1e30 or −3 in history, colour, count, depth or motion",
    quantity="values that are not finite or out of range, 35 injections × 8 frames",
    bound=0,
    reason="a colour is sanitized where it is read; one survivor would be fed back",
)
def bad_values_left() -> float:
    wrong = 0
    for value in BAD:
        for place in PLACES:
            for output, after in _spoiled(value, place):
                radiance = (output.composite, output.taa, after.history.color)
                for image in (*radiance, output.reprojected):
                    wrong += _outside(image, colors.MAX_RADIANCE)
                wrong += _outside(output.image, 1.0)
                wrong += _outside(output.segmentation.score, 1.0)
                wrong += _outside(after.history.count, 1e9)
    return float(wrong)


def _outside(values, top: float) -> int:
    values = np.asarray(values)
    return int(np.sum(~((values >= 0.0) & (values <= top))))


@TOPIC.case(
    "a bad value changes its own neighbourhood only",
    danger="NaN spreads by the filters' reach every frame",
    quantity="pixels beyond the 3×3 that one bad value changes in its frame",
    bound=0,
    reason="box, Sobel and means read 3×3; a still view reads one texel of the history",
)
def bad_values_spread() -> float:
    clean = np.asarray(_spoiled(0.0, "")[0][1].history.color)
    rows, columns = np.indices(SIZE)
    beyond = np.maximum(abs(rows - AT[0]), abs(columns - AT[1])) > 1
    changed = 0
    for value in BAD:
        for place in PLACES:
            spoiled = np.asarray(_spoiled(value, place)[0][1].history.color)
            changed += int(np.sum((spoiled != clean).any(axis=-1) & beyond))
    return float(changed)


@TOPIC.case(
    "what a bad value left behind fades",
    danger="a spoiled history that the clip or the mask keeps alive",
    quantity="largest difference shown from the clean run after 8 frames, sRGB",
    bound=0.5 / 255.0,
    reason="half a step of an 8-bit image is not seen",
)
def bad_values_fade() -> float:
    clean = np.asarray(_spoiled(0.0, "")[-1][0].image)
    return max(
        float(np.abs(np.asarray(_spoiled(value, place)[-1][0].image) - clean).max())
        for value in BAD
        for place in PLACES
    )


@partial(jax.jit, static_argnames=("config", "periods", "store"))
def _run(views, start, params, *, config, periods, store=jnp.float32):
    """Averages frames of a still view; returns the tone-mapped history a period."""
    surroundings = buffers.gbuffer(views.shape[1:3])

    def step(past, view):
        out = taa.taa(past, view, surroundings, STILL, params, config=config)
        color = out.color.astype(store).astype(jnp.float32)
        return buffers.with_leaf(
            past, lambda p: (p.color, p.count), (color, out.count)
        ), None

    def period(past, _):
        past, _ = jax.lax.scan(step, past, views)
        return past, colors.tonemap(past.color)

    return jax.lax.scan(period, start, None, length=periods)[1]


def _long_run(name: str, size=SIZE) -> np.ndarray:
    views = buffers.noise(PERIOD, size)
    config, params = taa.PRESETS[name]
    start = buffers.history(np.full((*size, 3), 50.0), count=1.0)
    periods = FRAMES // PERIOD
    return np.asarray(_run(views, start, params, config=config, periods=periods))


# An exponential average forgets by 1 − a a frame: rounding adds at most half a step of
# 2^-24 a frame, and a round trip through the tone map (1 + max ≤ 2) as much again;
# summed, 2 · 2^-24 / a, for a = 0.3 under 4e-7, for UE4's 0.04 under 3e-6.
@TOPIC.case(
    "10,000 still frames do not drift, default",
    danger="rounding that always goes one way",
    quantity="largest change of the history from frame 992 to frame 10,000",
    bound=4e-7,
    reason="a forgets rounding: 2 · 2⁻²⁴ / a at a = 0.3",
)
def drift_tuned() -> float:
    return _drift(_long_run("tuned"))


@TOPIC.case(
    "10,000 still frames do not drift, UE4's weight of 0.04",
    danger="rounding that always goes one way",
    quantity="largest change of the history from frame 992 to frame 10,000",
    bound=3e-6,
    reason="a forgets rounding: 2 · 2⁻²⁴ / a at a = 0.04",
)
def drift_ue4() -> float:
    return _drift(_long_run("ue4"))


def _drift(run: np.ndarray) -> float:
    return float(np.abs(run[-1] - run[61]).max())


@TOPIC.case(
    "10,000 still frames of 48×64 pixels do not drift, default",
    danger="a pixel whose values the small image does not have",
    quantity="largest change of the history from frame 992 to frame 10,000",
    bound=4e-7,
    reason="as of the small image",
    hard=True,
)
def drift_large() -> float:
    return _drift(_long_run("tuned", (48, 64)))


MEAN = taa.Config(rectify="none", blend="accumulate", motion="pixel")


@TOPIC.case(
    "a running mean over 10,000 frames stays the mean",
    danger="at 1/(n + 1) new samples fall below the history's last bit",
    quantity="largest difference from the mean in float64",
    bound=1.5e-4,
    # Frame k's rounding, at most 2^-24 · ½ and the tone map's two more, weighs k/n in
    # the end: n/2 · 3 · 2^-25 if all go one way.
    reason="n/2 roundings of 2⁻²⁵ each, three a frame, were they all of one sign",
)
def running_mean() -> float:
    views = buffers.noise(PERIOD)
    start = buffers.history(views[0], count=0.0)
    periods = FRAMES // PERIOD
    run = _run(views, start, taa.default_params(), config=MEAN, periods=periods)
    wide = np.asarray(views, np.float64)
    mean = (wide / (1.0 + wide.max(axis=-1, keepdims=True))).mean(axis=0)
    return float(np.abs(np.asarray(run[-1]) - mean).max())


@TOPIC.case(
    "a constant image does not drift in a running mean over 10,000 frames",
    danger="the round trip through the tone map errs one way, and a vanishing weight "
    "pulls nothing back",
    quantity="largest relative change of radiance 0.01 to 1000",
    # color.inverse_tonemap states 2^-24 · (1 + max) for a round trip, 6e-5 at 1000. It
    # must settle: 10,000 trips that add up would be 0.6.
    bound=2 * 2.0**-24 * 1001.0,
    reason="two round trips of 2⁻²⁴ · (1 + max) at 1000; added up they would be 0.6",
)
def constant_mean() -> float:
    levels = np.geomspace(0.01, 1000.0, SIZE[0] * SIZE[1]).reshape(*SIZE, 1)
    image = jnp.asarray(levels * np.array([1.0, 0.7, 0.3]), jnp.float32)
    views = jnp.broadcast_to(image, (PERIOD, *image.shape))
    start = buffers.history(image, count=0.0)
    periods = FRAMES // PERIOD
    run = _run(views, start, taa.default_params(), config=MEAN, periods=periods)
    last = np.asarray(colors.inverse_tonemap(run[-1]), np.float64)
    return float(np.abs(last / np.asarray(image) - 1.0).max())


EXPONENTIAL = taa.Config(
    history_filter="bilinear", rectify="none", motion="pixel", weighting="linear"
)


@cache
def _step_response(weight: float, half: bool) -> float:
    """From 0.55 toward a constant 0.95: how much is missing after 4,000 frames."""
    target = np.float32(0.95)
    views = jnp.full((PERIOD, *SIZE, 3), target)
    run = _run(
        views,
        buffers.history(np.full((*SIZE, 3), 0.55)),
        taa.default_params(weight),
        config=EXPONENTIAL,
        periods=250,
        store=jnp.float16 if half else jnp.float32,
    )
    last = np.asarray(colors.inverse_tonemap(run[-1]), np.float64)
    return float(np.abs(last - target).max())


@TOPIC.case(
    "a float16 history stalls, as its half step over the weight says",
    danger="a (c − h) below half an ulp of h changes nothing",
    quantity="distance at which it stalls at a = 0.04, over ½ · 2⁻¹¹ / a = 0.0061",
    bound=0.9,
    # Between ½ and 1 float16's step is 2^-11. It stalls at the first value closer than
    # that: within one step of 2^-11, 4 % of the distance twice over.
    reason="it stalls within a step of that distance; were it stored wider, far below",
    at_least=True,
)
def half_stalls() -> float:
    return _step_response(0.04, half=True) / (0.5 * 2.0**-11 / 0.04)


@TOPIC.case(
    "the default's float32 history does not stall visibly",
    danger="a (c − h) below half an ulp of h changes nothing",
    quantity="distance at which it stalls at a = 0.04",
    bound=1e-6,
    # Half a step of 2^-24 between ½ and 1, over a: 7.5e-7; the tone map of the row
    # that is compared rounds once more.
    reason="½ · 2⁻²⁴ / a = 7.5e-7, and the last rounding",
)
def float_does_not_stall() -> float:
    return _step_response(0.04, half=False)


FIREFLY = 1e4
GREY = 0.5


@cache
def _firefly(name: str) -> np.ndarray:
    """Grey frames, one pixel of frame 4 at 1e4: tone-mapped results, a frame."""
    config, params = taa.PRESETS[name]
    past = buffers.history(np.full((*SIZE, 3), GREY), count=params.count_limit)
    seen = []
    for index in range(12):
        view = jnp.full((*SIZE, 3), GREY)
        if index == 4:
            view = view.at[AT].set(FIREFLY)
        out = taa.taa(past, view, buffers.gbuffer(), STILL, params, config=config)
        past = buffers.history(out.color, count=out.count)
        seen.append(np.asarray(colors.tonemap(out.color)))
    return np.stack(seen)


@TOPIC.case(
    "a firefly of 1e4 weighs no more than the blend gives it",
    danger="in linear radiance its mean outshines the picture for dozens of frames",
    quantity="share of the step from grey to white that its pixel takes, default",
    bound=0.3 + 1e-6,
    reason="the preset's weight of 0.3, in the tone-mapped space, and rounding",
)
def firefly_weight() -> float:
    grey, white = GREY / (1 + GREY), FIREFLY / (1 + FIREFLY)
    return float((_firefly("tuned")[4][AT].max() - grey) / (white - grey))


@TOPIC.case(
    "a firefly is gone in the frame after",
    danger="its trail flickers",
    quantity="largest difference from grey one frame later, default and UE4",
    bound=2e-6,
    # The clip leaves 1e-6 of a flat box (rectification.clip), and the tone map rounds.
    reason="the box of the next frame is grey; its floor is 1e-6 wide",
)
def firefly_trail() -> float:
    grey = GREY / (1 + GREY)
    return max(float(np.abs(_firefly(n)[5:] - grey).max()) for n in taa.PRESETS)


@TOPIC.case(
    "a firefly does not bleed into its neighbours",
    danger="a widened colour box lets the neighbours' history turn bright",
    quantity="largest difference of any other pixel from grey, all frames, default",
    bound=2e-7,
    reason="a grey history and a grey sample blend to grey, up to two roundings",
)
def firefly_bleeds() -> float:
    others = np.ones(SIZE, bool)
    others[AT] = False
    return float(np.abs(_firefly("tuned")[:, others] - GREY / (1 + GREY)).max())


@TOPIC.case(
    "a history is pulled into boxes that are flat in some channels or all",
    danger="0/0 where the box has no size, or its centre lies on its border",
    quantity="largest distance outside the box",
    bound=1e-6 + 4 * EPS,
    reason="a flat box counts as 1e-6 wide; four roundings of values ≤ 1",
)
def flat_boxes() -> float:
    rng = np.random.default_rng(0)
    n = 20_000
    sizes = rng.choice([0.0, 1e-40, 1e-9, 1e-7, 1e-3, 0.5], (3, n))
    low = rng.uniform(0.0, 0.5, (3, n)).astype(np.float32)
    high = (low + sizes).astype(np.float32)
    centre = np.float32(0.5) * (low + high)
    value = rng.choice([0.0, 1.0, 0.25], (3, n)).astype(np.float32)
    value[:, ::7] = centre[:, ::7]  # exactly the centre
    value[:, 1::7] = low[:, 1::7]  # exactly a corner
    v, lo, mid, hi = (
        Vec3(*(jnp.asarray(c, jnp.float32) for c in part))
        for part in (value, low, centre, high)
    )
    clipped = rectification.clip(v, rectification.Box(lo, mid, hi))
    result = np.stack([clipped.x, clipped.y, clipped.z]).astype(np.float64)
    outside = np.maximum(low - result, result - high)
    return float(np.max(np.where(np.isfinite(result), outside, np.inf)))


@TOPIC.case(
    "a history equal to the current colour passes",
    danger="h + a (c − h), luma weights or the clip move what should stay",
    quantity="largest difference, radiance 0.007 to 3000, default",
    bound=4 * EPS,
    reason="tone map, YCoCg and the way back: eight roundings of 2⁻²⁴ of values to 1",
)
def equal_history() -> float:
    rng = np.random.default_rng(1)
    flat = jnp.asarray(np.exp(rng.uniform(-5, 8, (*SIZE, 3))), jnp.float32)
    config, params = taa.PRESETS["tuned"]
    out = taa.taa(
        buffers.history(flat), flat, buffers.gbuffer(), STILL, params, config=config
    )
    shown = [np.asarray(colors.tonemap(image)) for image in (out.color, flat)]
    return float(np.abs(shown[0] - shown[1]).max())


TOPIC.covered(
    "bad values in TAA's colours and counts are gone within the frame",
    danger="a filter or rectifier that lets NaN through",
    test="test_taa.py::test_bad_values_are_gone_within_the_frame",
    bound="colours and counts finite and ≥ 0; 20 drawn frames, seven configurations",
    reason="a value is sanitized where it is read; one survivor would be fed back",
)
TOPIC.covered(
    "the first frame is the current frame whatever the history holds",
    danger="NaN · 0 of an unused history",
    test="test_taa.py::test_the_first_frame_is_the_current_frame",
    bound="bit-equal; count 1, no pixel valid",
    reason="an unused history is selected away, not weighted by 0",
)
