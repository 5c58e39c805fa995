"""Segmentation stage: where TAA will fail, and why (paper, section 3).

Per pixel, in the paper's order, an antialiasing method is chosen:

1. motion vectors: no previous position, or one where something else was seen, is
   FXAA's and overrides all that follows;
2. classification history: a pixel traced of late stays traced for some frames;
3. temporal change of luminance, of 3×3 means;
4. change of depth, a 3×3 Sobel filter of inverse depth;
   3 and 4 weigh equally; together against a threshold they *fire*: the pixel is ATAA's.
   Further criteria, off by default, join their weighted mean.

What passes no test is TAA's. Symbols: m is a pixel's motion vector (previous − current
position, px), m′ the previous frame's at the reprojected pixel, z linear depth.
Border rule of every 3×3 and of every history read: clamp to edge.
"""

from dataclasses import dataclass
from functools import reduce
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import exported, formats, previous_motion, terms, vector, window
from ataa_jax.errors import InputError
from ataa_jax.mask import (
    HOLD_MAX,
    all_taa,
    apply_budget,
    bit,
    pack_mask,
    unpack_mask,
)
from ataa_jax.types import (
    METHOD_ATAA,
    METHOD_FXAA,
    METHOD_TAA,
    WHY_DEPTH,
    WHY_DISOCCLUDED,
    WHY_HELD,
    WHY_LAYERS,
    WHY_LUMINANCE,
    WHY_MATERIAL,
    WHY_NORMAL,
    WHY_OBJECT,
    WHY_OFF_SCREEN,
    WHY_RESET,
    WHY_RESPONSE,
    WHY_SPREAD,
    GBuffer,
    Segmentation,
    State,
)

__all__ = [
    "PRESETS",
    "Config",
    "Criterion",
    "Params",
    "all_taa",
    "apply_budget",
    "criteria",
    "default_params",
    "pack_mask",
    "segment",
    "segmentation",
    "unpack_mask",
]


@dataclass(frozen=True)
class Config:
    """Choices that change the program; the switches are for ablations."""

    # sum: the weighted mean of both terms against one threshold ("weighted equally");
    # either: one term over its own threshold is enough.
    reading: Literal["sum", "either"] = "sum"
    use_disocclusion: bool = True  # False: only pixels without a previous position
    # pixel: the motion at the reprojected pixel alone (paper); neighbourhood: the most
    # similar motion of its 3×3, and only where something nearer was seen there. our
    # choice: jitter hits a wire in one frame and misses it in the next, and the motion
    # of a near wall grows by a fifth a frame in a fast walk; neither is a disocclusion.
    # Typical motion on the built-in scene leaves FXAA 1.1 % of the pixels in place of
    # 1.7 %; a rapid walk in the modern house had 70 % without the nearness.
    disocclusion: Literal["pixel", "neighbourhood"] = "neighbourhood"
    depth_disocclusion: bool = False  # also compare with the previous frame's depth
    use_history: bool = True  # False: nothing is held
    use_luminance: bool = True
    use_depth: bool = True
    # Beyond the paper, off by default; see `terms`.
    use_normal: bool = False  # angle between normals
    use_object: bool = False  # another object in the 3×3
    use_material: bool = False  # another material in the 3×3
    use_spread: bool = False  # luminance varies in the 3×3 as it did not before
    use_response: bool = False  # TAA itself moved far from its history
    use_layers: bool = False  # what is seen through a layer moves otherwise than it


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    threshold: Float[Array, ""]  # reading "sum": fires above it, in [0, 1]
    luminance_threshold: Float[Array, ""]  # reading "either"
    depth_threshold: Float[Array, ""]  # reading "either"
    luminance_weight: Float[Array, ""]  # at least 0
    depth_weight: Float[Array, ""]  # at least 0
    normal_weight: Float[Array, ""]  # of a criterion that is off nothing is read
    object_weight: Float[Array, ""]
    material_weight: Float[Array, ""]
    spread_weight: Float[Array, ""]
    response_weight: Float[Array, ""]
    layers_weight: Float[Array, ""]
    normal_threshold: Float[Array, ""]  # reading "either"
    spread_threshold: Float[Array, ""]  # reading "either"
    response_threshold: Float[Array, ""]  # reading "either"
    layers_threshold: Float[Array, ""]  # reading "either"
    response_contrast: Float[Array, ""]  # local σ that halves the response's square
    luminance_floor: Float[Array, ""]  # tone-mapped luma under which change is noise
    disocclusion_px: Float[Array, ""]  # |m − m′| that says: something else was there
    disocclusion_relative: Float[Array, ""]  # and this share of the longer of the two
    depth_relative: Float[Array, ""]  # depth test: how much nearer the occluder was
    reset_px: Float[Array, ""]  # |m − m′| above which the hold counter is dropped
    hold: Int[Array, ""]  # frames a pixel stays traced after it fired, int32


def default_params(
    # our choice: of 0.03, 0.06 and 0.1 the largest that loses nothing on six scenes at
    # 0.5 rays a pixel; the budget, not the threshold, bounds the rays of hard views.
    threshold: float = 0.06,
    luminance_threshold: float = 0.1,  # our choice: likewise
    depth_threshold: float = 0.1,  # our choice: likewise
    luminance_weight: float = 1.0,  # paper, section 3: "weighted equally"
    depth_weight: float = 1.0,
    normal_weight: float = 1.0,  # our choice: once on, like the paper's two
    object_weight: float = 1.0,
    material_weight: float = 1.0,
    spread_weight: float = 1.0,
    response_weight: float = 1.0,
    layers_weight: float = 1.0,
    normal_threshold: float = 0.1,  # our choice: 18°
    spread_threshold: float = 0.1,  # our choice: as luminance_threshold
    response_threshold: float = 0.1,  # our choice: as luminance_threshold
    layers_threshold: float = 0.1,  # our choice: as luminance_threshold
    # our choice: of 0.015, 0.03, 0.06, 0.12 and no limit the best on two scenes and
    # within 0.00002 of it on a third, in closed loop at 0.5 rays a pixel
    # (experiments/fit_thresholds.py contrast); SSIM's own √C₂ is 0.03.
    response_contrast: float = 0.06,
    luminance_floor: float = 0.004,  # our choice: one step of an 8-bit linear image
    # our choice: surfaces whose motion agrees within a pixel blur by less than the
    # history's filter does; the relative part forgives what a constant acceleration
    # changes in a frame.
    disocclusion_px: float = 1.0,
    disocclusion_relative: float = 0.1,
    depth_relative: float = 0.1,  # our choice: a camera's step is a smaller share
    reset_px: float = 2.0,  # our choice: "significant" is twice a disocclusion
    hold: int = 4,  # our choice: half a period of UE4's 8-frame jitter
) -> Params:
    """Returns parameters, by default unfitted ones."""
    return Params(
        threshold=jnp.asarray(threshold, jnp.float32),
        luminance_threshold=jnp.asarray(luminance_threshold, jnp.float32),
        depth_threshold=jnp.asarray(depth_threshold, jnp.float32),
        luminance_weight=jnp.asarray(luminance_weight, jnp.float32),
        depth_weight=jnp.asarray(depth_weight, jnp.float32),
        normal_weight=jnp.asarray(normal_weight, jnp.float32),
        object_weight=jnp.asarray(object_weight, jnp.float32),
        material_weight=jnp.asarray(material_weight, jnp.float32),
        spread_weight=jnp.asarray(spread_weight, jnp.float32),
        response_weight=jnp.asarray(response_weight, jnp.float32),
        layers_weight=jnp.asarray(layers_weight, jnp.float32),
        normal_threshold=jnp.asarray(normal_threshold, jnp.float32),
        spread_threshold=jnp.asarray(spread_threshold, jnp.float32),
        response_threshold=jnp.asarray(response_threshold, jnp.float32),
        layers_threshold=jnp.asarray(layers_threshold, jnp.float32),
        response_contrast=jnp.asarray(response_contrast, jnp.float32),
        luminance_floor=jnp.asarray(luminance_floor, jnp.float32),
        disocclusion_px=jnp.asarray(disocclusion_px, jnp.float32),
        disocclusion_relative=jnp.asarray(disocclusion_relative, jnp.float32),
        depth_relative=jnp.asarray(depth_relative, jnp.float32),
        reset_px=jnp.asarray(reset_px, jnp.float32),
        hold=jnp.asarray(hold, jnp.int32),
    )


PRESETS: dict[str, tuple[Config, Params]] = {
    # Section 3: luminance and depth, weighted equally.
    "paper": (Config(), default_params()),
    # data/fitted.toml, by experiments/fit_thresholds.py: six scenes, 0.5 rays a pixel.
    "fitted": (
        Config(use_response=True),
        default_params(
            threshold=0.006840282,
            depth_weight=0.38107407,
            response_weight=54.32708,
            reset_px=2.0158641,
            hold=0,
        ),
    ),
}


@exported.jit("config")
def segment(
    state: State,
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    reprojected: Float[Array, "h w 3"],
    params: Params,
    max_pixels: Int[Array, ""],
    *,
    config: Config,
    blended: Float[Array, "h w 3"] | None = None,
) -> tuple[Segmentation, Int[Array, ""]]:
    """Classifies every pixel, then keeps the ray budget.

    Args:
        state: history and classification of the last frame.
        color: linear radiance of this frame's raster samples.
        gbuffer: depth and motion of the same samples.
        reprojected: linear history before rectification, as TAA read it.
        params: thresholds.
        max_pixels: the most pixels that may be traced, int32.
        config: reading and switches.
        blended: linear TAA result; only the criterion "response" reads it.

    Returns:
        (segmentation within the budget, pixels that asked for rays beyond it).
    """
    wanted = segmentation(
        state, color, gbuffer, reprojected, params, config=config, blended=blended
    )
    return apply_budget(wanted, max_pixels)


@exported.jit("config")
def segmentation(
    state: State,
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    reprojected: Float[Array, "h w 3"],
    params: Params,
    *,
    config: Config,
    blended: Float[Array, "h w 3"] | None = None,
) -> Segmentation:
    """Classifies every pixel, without a budget; arguments as `segment`'s.

    Returns:
        Mask, why-bits and terms. The score of a pixel that is held but does not fire
        is at least the threshold's: held pixels compete for the budget as if they
        just fired. FXAA's pixels have score 0.
    """
    images = (state, color, gbuffer, reprojected, blended)
    state, color, gbuffer, reprojected, blended = formats.widen(images)
    on = criteria(color, gbuffer, reprojected, blended, params, config)
    position = window.history_position(gbuffer.motion[..., 0], gbuffer.motion[..., 1])
    # Materialized together: fused into all that reads them, the terms would be computed
    # several times, and their images would stay until the end.
    measured, (row, column) = vector.materialize(([c.term for c in on], position))
    on = [c._replace(term=term) for c, term in zip(on, measured, strict=True)]
    previous = window.nearest_index(row, column)
    new = ~(state.history.valid & gbuffer.motion_valid & window.inside(row, column))
    change, limit = _motion_change(state, gbuffer, row, column, ~new, params, config)

    disoccluded = jnp.zeros_like(new)
    if config.use_disocclusion:
        disoccluded = ~(change <= limit)  # a previous motion of NaN disoccludes
        then = window.read(state.history.depth, previous)
        nearer = _was_hidden(gbuffer.depth, then, params.depth_relative)
        if config.disocclusion == "neighbourhood":
            disoccluded &= nearer
        if config.depth_disocclusion:
            disoccluded |= nearer
    disoccluded &= ~new
    fxaa = new | disoccluded

    held_frames = jnp.zeros(new.shape, jnp.uint32)
    if config.use_history:
        held_frames = window.read(state.classification.mask, previous) >> jnp.uint32(16)
    reset = (held_frames > 0) & ~(change <= params.reset_px) & ~fxaa
    held = (held_frames > 0) & ~reset & ~fxaa

    score, firing_score = _score(on, params, config)
    fires = (score > firing_score) & ~fxaa
    score = jnp.where(held, jnp.maximum(score, firing_score), score)

    # Paper: held pixels may exit early. Here they are still tested, at no loss, so that
    # the counter runs from the last frame that fired; holding alone never renews it.
    full = jnp.clip(params.hold, 0, HOLD_MAX).astype(jnp.uint32)
    counter = jnp.where(held, held_frames - jnp.uint32(1), jnp.uint32(0))
    counter = jnp.where(fires, full if config.use_history else jnp.uint32(0), counter)
    method = jnp.where(
        fxaa,
        jnp.uint32(METHOD_FXAA),
        jnp.where(held | fires, jnp.uint32(METHOD_ATAA), jnp.uint32(METHOD_TAA)),
    )
    why = (
        bit(new, WHY_OFF_SCREEN)
        | bit(disoccluded, WHY_DISOCCLUDED)
        | bit(held, WHY_HELD)
        | bit(reset, WHY_RESET)
    )
    zeros = jnp.zeros(new.shape, jnp.float32)
    found: dict[int, Array] = {WHY_LUMINANCE: zeros, WHY_DEPTH: zeros}
    for each in on:
        limit = params.threshold if config.reading == "sum" else each.threshold
        why |= bit(fires & (each.term > limit), each.why)
        found[each.why] = each.term
    return Segmentation(
        mask=pack_mask(method, counter),
        why=why,
        score=jnp.where(fxaa, 0.0, score),
        luminance=found[WHY_LUMINANCE],
        depth=found[WHY_DEPTH],
    )


class Criterion(NamedTuple):
    """One term that is switched on, and how it counts."""

    name: str  # as in the names of its weight and its switch
    why: int  # its bit
    term: Float[Array, "h w"]  # in [0, 1]
    weight: Float[Array, ""]
    threshold: Float[Array, ""]  # reading "either"


def criteria(
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    reprojected: Float[Array, "h w 3"],
    blended: Float[Array, "h w 3"] | None,
    params: Params,
    config: Config,
) -> list[Criterion]:
    """Returns the terms that the configuration switches on; no other is computed."""
    found: list[Criterion] = []

    def add(name: str, why: int, term: Array, threshold: Array) -> None:
        weight = getattr(params, f"{name}_weight")
        found.append(Criterion(name, why, term, weight, threshold))

    half = jnp.float32(0.5)  # an edge between ids is 0 or 1
    if config.use_luminance:
        term = terms.luminance(color, reprojected, params.luminance_floor)
        add("luminance", WHY_LUMINANCE, term, params.luminance_threshold)
    if config.use_depth:
        term = terms.depth_edge(gbuffer.depth)
        add("depth", WHY_DEPTH, term, params.depth_threshold)
    if config.use_normal:
        term = terms.normal_edge(gbuffer.normal)
        add("normal", WHY_NORMAL, term, params.normal_threshold)
    if config.use_object:
        add("object", WHY_OBJECT, terms.id_edge(gbuffer.object), half)
    if config.use_material:
        add("material", WHY_MATERIAL, terms.id_edge(gbuffer.material), half)
    if config.use_spread:
        term = terms.spread(color, reprojected, params.luminance_floor)
        add("spread", WHY_SPREAD, term, params.spread_threshold)
    if config.use_response:
        if blended is None:
            raise ValueError("the criterion 'response' asks for the TAA result")
        term = terms.response(blended, reprojected, params.response_contrast)
        add("response", WHY_RESPONSE, term, params.response_threshold)
    if config.use_layers:
        if gbuffer.second_motion is None or gbuffer.second_share is None:
            raise InputError(
                "the criterion 'layers' reads the motion of what is seen through them: "
                "draw it by raster.Config(second_motion=True), or leave the criterion "
                "out where nobody can tell it, as of an engine's frames"
            )
        term = terms.layers(gbuffer.motion, gbuffer.second_motion, gbuffer.second_share)
        add("layers", WHY_LAYERS, term, params.layers_threshold)
    return found


def _motion_change(
    state: State,
    gbuffer: GBuffer,
    row: Float[Array, "h w"],
    column: Float[Array, "h w"],
    known: Bool[Array, "h w"],
    params: Params,
    config: Config,
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """Returns (|m − m′|, the most that may be for no disocclusion), px.

    Under "neighbourhood" m′ is the one of the 3×3 that differs least. It is looked for
    only where it matters: among `known` pixels, and where m′ of the reprojected pixel
    itself differs by more than a limit, for one that differs less is within the limits
    as well.
    """
    motion, then = gbuffer.motion, state.history.motion
    own = motion[..., 0] ** 2 + motion[..., 1] ** 2
    found = previous_motion.at_pixel(motion, then, row, column)
    if config.disocclusion == "neighbourhood":
        limit = jnp.minimum(_motion_limit(jnp.sqrt(own), params), params.reset_px)
        # Longer motion may not lower the limit; and NaN is never within it.
        within = jnp.sqrt(found.difference) <= limit
        within &= params.disocclusion_relative >= 0.0
        found = previous_motion.look_around(
            found, known & ~within, motion, then, row, column
        )
    longer = jnp.maximum(own, found.length)
    change, longer = vector.materialize((jnp.sqrt(found.difference), jnp.sqrt(longer)))
    return change, _motion_limit(longer, params)


def _motion_limit(length: Float[Array, "h w"], params: Params) -> Float[Array, "h w"]:
    """Returns by how much motion of a length, both px, may change in a frame."""
    return params.disocclusion_px + params.disocclusion_relative * length


def _was_hidden(
    depth: Float[Array, "h w"], then: Float[Array, "h w"], relative: Float[Array, ""]
) -> Bool[Array, "h w"]:
    """Returns whether something nearer than this point was seen in its place.

    1/z′ − 1/z > relative · 1/z′, that is z′ < (1 − relative) z; sky is at 1/z = 0.
    """
    inverse, inverse_then = terms.inverse_depth(depth), terms.inverse_depth(then)
    return inverse_then - inverse > relative * inverse_then


def _score(
    on: list[Criterion], params: Params, config: Config
) -> tuple[Float[Array, "h w"] | Float[Array, ""], Float[Array, ""]]:
    """Returns (score, the value above which a pixel fires).

    sum: the weighted mean of the terms, against the threshold. either: with r the
    largest ratio of a term to its threshold, r / (1 + r), which passes ½ where r
    passes 1 and ranks pixels by how far they are over.
    """
    zero = jnp.float32(0.0)
    if config.reading == "either":
        least = 1e-6  # a threshold of 0 fires at the smallest change
        ratios = [c.term / jnp.maximum(c.threshold, least) for c in on]
        ratio = reduce(jnp.maximum, ratios, zero)
        return ratio / (1.0 + ratio), jnp.float32(0.5)
    total = sum((c.weight for c in on), zero)
    weighted = sum((c.weight * c.term for c in on), zero)
    return weighted / jnp.where(total > 0.0, total, 1.0), params.threshold
