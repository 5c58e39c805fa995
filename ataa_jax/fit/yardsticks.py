"""What a fit is measured against: TAA, chance, an oracle, a grid.

Every one of them has the same FXAA pixels, and its own feedback in the loop.

*Oracle*: in every frame the pixels whose squared error in sRGB tracing lowers the most,
chosen with the reference in hand, as many as the budget pays for. A strong yardstick,
not a bound: it looks neither at structure nor at the frames to come.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ataa_jax import color as colors
from ataa_jax import pipeline, segmentation, taa
from ataa_jax.fit import replay, score, space
from ataa_jax.fit.recording import Recorded
from ataa_jax.fit.replay import Take
from ataa_jax.types import METHOD_ATAA, METHOD_FXAA, Segmentation, State


def taa_alone(take: Take, params: pipeline.Params) -> score.Result:
    """Scores plain TAA, as engines run it: no mask, no rays, no FXAA."""
    return score.chosen(take, params, _nothing, None)


def masked_without_rays(take: Take, params: pipeline.Params) -> score.Result:
    """Scores TAA with FXAA where there is no history: the mask's pixels, no rays."""
    choices = take.config.segmentation
    choose = partial(_highest, score=_zero, config=choices, pixels=0)
    return score.chosen(take, params, choose, None)


def random(
    take: Take, params: pipeline.Params, budget: float, seed: int = 0
) -> score.Result:
    """Scores pixels drawn anew in every frame."""
    count = jax.tree.leaves(take.frames)[0].shape[0]
    keys = jax.random.split(jax.random.key(seed), count)
    choose = partial(
        _highest,
        score=_chance,
        config=take.config.segmentation,
        pixels=affordable(take, budget),
    )
    return score.chosen(take, params, choose, keys)


def oracle(take: Take, params: pipeline.Params, budget: float) -> score.Result:
    """Scores the oracle mask."""
    choose = partial(
        _highest,
        score=partial(gain, config=take.config),
        config=take.config.segmentation,
        pixels=affordable(take, budget),
    )
    return score.chosen(take, params, choose, None)


def affordable(take: Take, budget: float) -> int:
    """Returns the pixels a frame that a budget pays for."""
    height, width = take.config.raster.size
    return int(budget * height * width / take.samples)


def gain(
    recorded: Recorded,
    blended: taa.TaaOutput,
    extra: object,
    *,
    config: pipeline.Config,
) -> Float[Array, "h w"]:
    """Returns the squared error in sRGB that tracing removes from TAA's result."""
    del extra

    def error(image: Array) -> Array:
        return jnp.sum((colors.display(image) - recorded.truth) ** 2, axis=-1)

    traced = replay.traced_pixel(recorded, blended, config)
    return jnp.maximum(error(blended.color) - error(traced), 0.0)


def _chance(recorded: Recorded, blended: taa.TaaOutput, extra: Any) -> Array:
    del blended
    return jax.random.uniform(extra, recorded.gbuffer.depth.shape)


def _zero(recorded: Recorded, blended: taa.TaaOutput, extra: object) -> Array:
    del blended, extra
    return jnp.zeros_like(recorded.gbuffer.depth)


def _nothing(
    state: State,
    recorded: Recorded,
    blended: taa.TaaOutput,
    params: pipeline.Params,
    extra: object,
) -> Segmentation:
    del state, blended, params, extra
    height, width = recorded.gbuffer.depth.shape
    return segmentation.all_taa((height, width))


def _highest(
    state: State,
    recorded: Recorded,
    blended: taa.TaaOutput,
    params: pipeline.Params,
    extra: object,
    *,
    score: Callable[[Recorded, taa.TaaOutput, Any], Array],
    config: segmentation.Config,
    pixels: int,
) -> Segmentation:
    """Traces the pixels of highest score, `pixels` of those that are not FXAA's."""
    bare = replace(space.switched(config, space.PAPER_TERMS), use_history=False)
    found = segmentation.segmentation(
        state, recorded.color, recorded.gbuffer, blended.reprojected,
        params.segmentation, config=bare,
    )  # fmt: skip
    method, _ = segmentation.unpack_mask(found.mask)
    method = jnp.where(method == METHOD_FXAA, method, jnp.uint32(METHOD_ATAA))
    wanted = Segmentation(
        mask=segmentation.pack_mask(method, jnp.zeros_like(method)),
        why=found.why,
        score=score(recorded, blended, extra),
        luminance=found.luminance,
        depth=found.depth,
    )
    limited, _ = segmentation.apply_budget(wanted, jnp.int32(pixels))
    return limited


def efficiency(ssim: float, taa_ssim: float, oracle_ssim: float) -> float:
    """Returns the share of the oracle's gain over TAA; NaN where it has none."""
    gained = oracle_ssim - taa_ssim
    return (ssim - taa_ssim) / gained if gained > 0.0 else float("nan")


def closed(ssim: float, equal_ssim: float, oracle_ssim: float) -> float:
    """Returns the share of the way from equal weights to the oracle; NaN: no way."""
    return efficiency(ssim, equal_ssim, oracle_ssim)


def grid(
    takes: tuple[Take, ...],
    params: pipeline.Params,
    quantities: tuple[space.Quantity, ...],
    budget: float,
    *,
    values: int = 9,
    progress: Callable[[str, int, int], None] = lambda text, done, total: None,
) -> list[tuple[np.ndarray, list[float]]]:
    """Scores every point of a grid over the optimizer's own bounds.

    Returns:
        (coordinates in the unit box, SSIM of each sequence) of every point.
    """
    axis = np.linspace(0.0, 1.0, values, dtype=np.float32)
    points = list(itertools.product(axis, repeat=len(quantities)))
    found = []
    for done, point in enumerate(points):
        at = space.place(params, quantities, jnp.asarray(point))
        ssim = [score.at_budget(take, at, budget).ssim for take in takes]
        found.append((np.asarray(point), ssim))
        progress("grid", done + 1, len(points))
    return found
