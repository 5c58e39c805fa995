"""A loss with gradients: a soft mask over a replay's own terms.

The composite is x = b + p (t − b): b what TAA gives, t what tracing gives, both as they
are shown, and p in (0, 1) a mask made soft,

    p = sᵏ / (sᵏ + τᵏ) = sigmoid((log s − log τ) / T),    k = 1/T,

with s the weighted mean of the terms, τ the threshold and T the temperature, annealed
0.5 → 0.25 → 0.125; it has no unit, for only s/τ enters.

With e = b − truth and d = t − b, a pixel's squared error is |e + p d|² = (√C p + B/√C)²
+ A − B²/C, where A = |e|², B = e·d, C = |d|²: one residual a pixel, and a constant.
SSIM's contrast and structure term is 1 − var(x − y) / (var x + var y + C₂), so each
pixel's error is divided by that denominator, taken once from b and the truth: the sum
is 1 − SSIM to first order. A price a ray adds λ · samples · p, as its root squared.

Feedback through the history is left to the outer loop: replay with the hard mask,
record terms, b and t, fit, replay again. Terms are data here, so no gradient passes a
Sobel's or a luminance's kink: equal luminances and flat depths cannot make a NaN.
"""

from collections.abc import Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt
from scipy.ndimage import gaussian_filter

from ataa_jax import color as colors
from ataa_jax import pipeline, segmentation
from ataa_jax.fit import replay
from ataa_jax.fit.recording import Recorded
from ataa_jax.fit.replay import Take
from ataa_jax.types import METHOD_FXAA, State

TEMPERATURES = (0.5, 0.25, 0.125)
_C2 = 0.03**2  # SSIM's, for a data range of 1
# our choice: far under any threshold; keeps log s finite where every term is 0.
_LEAST_SCORE = 1e-6


class Pixels(eqx.Module):
    """A sample of pixels, of all sequences and frames: the data of the relaxed loss."""

    terms: Float[Array, "n k"]  # in the order of the weights
    cross: Float[Array, " n"]  # B, over the denominator
    gain: Float[Array, " n"]  # C, over the denominator
    base: Float[Array, " n"]  # A, over the denominator


class Soft(eqx.Module):
    """What the loss reads beside the pixels."""

    temperature: Float[Array, ""]
    price: Float[Array, ""]  # loss a sparse ray a pixel
    samples: Float[Array, ""]  # rays a traced pixel


class Shown(eqx.Module):
    """What a mask chooses between, a frame; stacked along a leading axis."""

    terms: Float[Array, "h w k"]
    blended: Float[Array, "h w 3"]
    traced: Float[Array, "h w 3"]
    method: UInt[Array, "h w"]  # METHOD_*, of the hard mask


@partial(jax.jit, static_argnames=("config", "names"))
def look(
    frames: Recorded,
    params: pipeline.Params,
    *,
    config: pipeline.Config,
    names: tuple[str, ...],
) -> Shown:
    """Replays the hard mask, and keeps what a soft one would choose between."""
    choose = replay.by_criteria(config.segmentation)

    def body(state: State, recorded: Recorded) -> tuple[State, Shown]:
        after, blended, method, _ = replay.composed(
            state, recorded, params, config=config, choose=choose
        )
        found = segmentation.criteria(
            recorded.color, recorded.gbuffer, blended.reprojected, blended.color,
            params.segmentation, config.segmentation,
        )  # fmt: skip
        by_name = {each.name: each.term for each in found}
        shown = Shown(
            terms=jnp.stack([by_name[name] for name in names], axis=-1),
            blended=colors.display(blended.color),
            traced=colors.display(replay.traced_pixel(recorded, blended, config)),
            method=method,
        )
        return after, shown

    _, shown = jax.lax.scan(
        body, pipeline.init(config.raster.size, config.resolve.history), frames
    )
    return shown


def gather(
    takes: Sequence[Take],
    params: Sequence[pipeline.Params],
    names: tuple[str, ...],
    *,
    pixels: int = 1 << 17,
    seed: int = 0,
) -> Pixels:
    """Replays every sequence under the hard mask and samples its pixels.

    Args:
        takes: the sequences, their configurations with the terms switched on.
        params: each sequence's, with the threshold that meets its budget.
        names: the terms, in the order of the weights.
        pixels: how many, shared evenly; with all of them and more, all are taken.
        seed: of the sample.
    """
    rng = np.random.default_rng(seed)
    parts: list[list[np.ndarray]] = [[], [], [], []]
    for take, own in zip(takes, params, strict=True):
        shown = look(take.frames, own, config=take.config, names=names)
        terms, b, t, method = (
            np.asarray(leaf)[take.lead_in :]
            for leaf in (shown.terms, shown.blended, shown.traced, shown.method)
        )
        truth = np.asarray(take.frames.truth)[take.lead_in :]
        below = _variance(b) + _variance(truth) + _C2
        e, d = b - truth, t - b
        where = np.flatnonzero(method != METHOD_FXAA)
        share = max(pixels // len(takes), 1)
        if len(where) > share:
            where = np.sort(rng.choice(where, share, replace=False))
        flat = (
            terms.reshape(-1, len(names)),
            *(
                (x * y / below).mean(-1).reshape(-1)
                for x, y in ((e, d), (d, d), (e, e))
            ),
        )
        for part, values in zip(parts, flat, strict=True):
            part.append(values[where])
    terms, cross, gain, base = (jnp.asarray(np.concatenate(part)) for part in parts)
    return Pixels(terms=terms, cross=cross, gain=gain, base=base)


def _variance(images: np.ndarray) -> np.ndarray:
    """Returns the variance under SSIM's Gaussian window, (f, h, w, 3)."""
    blur = partial(gaussian_filter, sigma=(0.0, 1.5, 1.5, 0.0), truncate=3.5)
    mean = blur(images)
    return np.maximum(blur(images * images) - mean * mean, 0.0)


def mask(
    y: Float[Array, " k"], pixels: Pixels, temperature: Float[Array, ""]
) -> Float[Array, " n"]:
    """Returns p.

    Args:
        y: log of the weights but the first, which is 1, and last the log threshold.
        pixels: the terms.
        temperature: T.
    """
    weights = jnp.concatenate([jnp.ones(1, y.dtype), jnp.exp(y[:-1])])
    score = pixels.terms @ (weights / jnp.sum(weights))
    return jax.nn.sigmoid((jnp.log(score + _LEAST_SCORE) - y[-1]) / temperature)


def rays(y: Float[Array, " k"], pixels: Pixels, soft: Soft) -> Float[Array, ""]:
    """Returns the soft mask's rays a pixel, of the pixels that are not FXAA's."""
    return jnp.mean(mask(y, pixels, soft.temperature)) * soft.samples


def residuals(
    y: Float[Array, " k"], args: tuple[Pixels, Soft]
) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Returns residuals whose squares sum to `loss`, but for a constant."""
    pixels, soft = args
    p = mask(y, pixels, soft.temperature)
    count = jnp.asarray(pixels.cross.shape[0], y.dtype)
    root = jnp.sqrt(jnp.maximum(pixels.gain, 1e-12))
    error = (root * p + pixels.cross / root) / jnp.sqrt(count)
    # √p has a finite slope in y: p' is of the order of p.
    price = jnp.sqrt(soft.price * soft.samples * (p + 1e-12) / count)
    return error, price


def loss(y: Float[Array, " k"], args: tuple[Pixels, Soft]) -> Float[Array, ""]:
    """Returns the mean weighted squared error plus the price of the rays."""
    pixels, soft = args
    p = mask(y, pixels, soft.temperature)
    error = pixels.base + p * (2.0 * pixels.cross + p * pixels.gain)
    return jnp.mean(error) + soft.price * soft.samples * jnp.mean(p)


def at_budget(
    params: pipeline.Params,
    pixels: Pixels,
    names: tuple[str, ...],
    budget: float,
    *,
    temperature: float = TEMPERATURES[-1],
    samples: int = 8,
) -> float:
    """Returns the loss without a price, its threshold solved for the soft mask's rays.

    Args:
        params: give the weights.
        pixels: what `gather` found.
        names: the terms.
        budget: rays a pixel.
        temperature: of the mask.
        samples: rays a traced pixel.
    """
    own = params.segmentation
    values = [getattr(own, f"{name}_weight") for name in names]
    weights = jnp.log(jnp.stack(values[1:]) / values[0]) if names[1:] else jnp.zeros(0)
    soft = Soft(
        temperature=jnp.float32(temperature),
        price=jnp.float32(0.0),
        samples=jnp.float32(samples),
    )
    return float(_loss_at_budget(weights, pixels, soft, jnp.float32(budget)))


@jax.jit
def _loss_at_budget(
    weights: Float[Array, " k"], pixels: Pixels, soft: Soft, budget: Float[Array, ""]
) -> Float[Array, ""]:
    def refine(_: int, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = 0.5 * (low + high)
        dear = rays(jnp.append(weights, middle), pixels, soft) > budget
        return jnp.where(dear, middle, low), jnp.where(dear, high, middle)

    # Log thresholds; 30 halvings of a range of 16 are below float32's step.
    bounds = (jnp.float32(-14.0), jnp.float32(2.0))
    low, high = jax.lax.fori_loop(0, 30, refine, bounds)
    return loss(jnp.append(weights, 0.5 * (low + high)), (pixels, soft))
