"""TAA stage: reproject the history, rectify it, blend it (paper, section 2).

The base case that ATAA runs on most pixels: an exponentially weighted moving average
of jittered frames, the history fetched along the motion vectors (Karis 2014; survey:
Yang, Liu and Salvi 2020), with the public variants as choices.

Symbols: c is the current sample, h the history at the reprojected position, a the
weight of the current sample, so the result is h + a (c − h). They live in the
*averaging space* that `Config.weighting` names; what goes in and out of the stage is
linear radiance. Border rule of every neighbourhood and history read: clamp to edge.
"""

from dataclasses import dataclass
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ataa_jax import color as colors
from ataa_jax import exported, formats, rectification, vector, window
from ataa_jax.types import GBuffer, History
from ataa_jax.vector import Vec3

# UE4's current-frame filter exp(−2.29 d²), d in px: a Gaussian fit of a Blackman-Harris
# window 3.3 px wide (Karis 2014).
GAUSSIAN_FALLOFF = 2.29


@dataclass(frozen=True)
class Config:
    """Choices that change the program; the defaults are the tuned preset's."""

    # catmull_rom: the full separable 4×4 kernel, what "9-tap" shaders fetch with nine
    # bilinear taps.
    history_filter: Literal["bilinear", "catmull_rom"] = "catmull_rom"
    # Limit the filtered history to the range of the 2×2 texels around the position.
    # our choice: off; the rectifier bounds the overshoot of Catmull-Rom already.
    dering: bool = False
    # clamp: per component into the box; clip: along the line to the box's centre;
    # variance_clip: the box is mean ± γσ, and the line leads to the mean (Salvi 2016).
    rectify: Literal["none", "clamp", "clip", "variance_clip"] = "clip"
    neighbourhood: rectification.Neighbourhood = "box"
    space: Literal["rgb", "ycocg"] = "ycocg"  # in which the box is axis-aligned
    # exponential: a is current_weight; accumulate: a = 1/(n + 1), a running mean of at
    # most count_limit frames: an exponential average that starts as a plain mean and
    # trusts traced colours for what they count as.
    blend: Literal["exponential", "accumulate"] = "exponential"
    # tonemap: averages of x/(1 + max(r, g, b)); luma: linear radiance, each sample
    # weighted by UE4's 1/(4 + luma), in place of the tone map; linear: neither.
    weighting: Literal["tonemap", "luma", "linear"] = "tonemap"
    # nearest_depth: motion of the nearest surface in the 3×3, so that an object's
    # antialiased edge moves with the object.
    motion: Literal["pixel", "nearest_depth"] = "nearest_depth"
    # gaussian: current samples of the 3×3 weighted by distance from the pixel centre.
    current_filter: Literal["none", "gaussian"] = "none"
    # Filament: also limit the current sample to the box; else a clipped history may
    # outlive a bright outlier.
    clamp_current: bool = False
    # Read by whoever draws the frames: period of the Halton jitter, and whether its
    # mean is subtracted. our choice: 16, as Filament, Godot and Intel have it.
    jitter_length: int = 16
    jitter_centred: bool = True


class Params(eqx.Module):
    """Numbers one may sweep or fit."""

    current_weight: Float[Array, ""]  # a of a pixel at rest, in [0, 1]
    current_weight_moving: Float[Array, ""]  # a at and beyond motion_px
    motion_px: Float[Array, ""]  # a rises linearly from rest to here
    variance_gamma: Float[Array, ""]  # γ: the box is mean ± γ standard deviations
    count_limit: Float[Array, ""]  # accumulate: TAA's own a stays over 1/(limit + 1)


def default_params(
    current_weight: float = 0.3,  # experiments/tune_taa.py: best of 0.1, 0.2 … 0.5
    current_weight_moving: float | None = None,  # None: the same as at rest
    motion_px: float = 40.0,  # UE4 (Karis 2014)
    variance_gamma: float = 1.0,  # Salvi 2016; Filament 1.0, UE4 1.25
    # our choice: no limit in practice, a still image converges to the plain mean.
    count_limit: float = 65535.0,
) -> Params:
    """Returns parameters, by default the tuned preset's."""
    moving = current_weight if current_weight_moving is None else current_weight_moving
    return Params(
        current_weight=jnp.asarray(current_weight, jnp.float32),
        current_weight_moving=jnp.asarray(moving, jnp.float32),
        motion_px=jnp.asarray(motion_px, jnp.float32),
        variance_gamma=jnp.asarray(variance_gamma, jnp.float32),
        count_limit=jnp.asarray(count_limit, jnp.float32),
    )


PRESETS: dict[str, tuple[Config, Params]] = {
    # Karis 2014, and UE4's TemporalAA.usf. It looks for the nearest depth at the four
    # diagonals only; here it is the whole 3×3.
    "ue4": (
        Config(
            history_filter="bilinear",
            rectify="clamp",
            neighbourhood="plus",
            weighting="luma",
            current_filter="gaussian",
            jitter_length=8,
            jitter_centred=False,
        ),
        default_params(0.04, 0.2, 40.0, 1.25),
    ),
    # experiments/tune_taa.py: best mean SSIM over still, typical and rapid sequences
    # of six scenes, with a texture mip bias of −2. An accumulated mean of at most
    # 1/0.3 − 1 frames has the same weight once a pixel is no longer new.
    "tuned": (
        Config(blend="accumulate"),
        default_params(count_limit=1.0 / 0.3 - 1.0),
    ),
}


class TaaOutput(eqx.Module):
    """The TAA result, and what the later stages read beside it."""

    color: Float[Array, "h w 3"]  # linear; the current sample where not valid
    # linear; history before rectification; the current sample where not valid
    reprojected: Float[Array, "h w 3"]
    count: Float[Array, "h w"]  # frames in `color`, this one included
    valid: Bool[Array, "h w"]  # the history could be used at the pixel
    previous_px: Float[Array, "h w 2"]  # (row, column) it was read at, centres at +0.5


@exported.jit("config")
def taa(
    history: History,
    color: Float[Array, "h w 3"],
    gbuffer: GBuffer,
    jitter: Float[Array, " 2"],
    params: Params,
    *,
    config: Config,
) -> TaaOutput:
    """Blends this frame with the reprojected history.

    Args:
        history: what the last frame left; unused where its `valid` is False. NaN, inf
            and negative radiance in it or in `color` count as 0 or the largest
            radiance, and are gone from the result.
        color: linear radiance of this frame, one jittered sample a pixel.
        gbuffer: depth and motion of the same samples.
        jitter: offset of the samples from the pixel centre, px, x right, y down.
        params: weights.
        config: filters, rectifier and averaging space.

    Returns:
        Blended and reprojected colour, linear. A pixel that did not move, or moved by
        whole pixels, reads its texel of the history bit by bit.
    """
    history, color, gbuffer = formats.widen((history, color, gbuffer))
    linear = colors.sanitize_vec(vector.unstack(color))
    current = vector.materialize(_to_average(linear, config))
    bordered = Vec3(*(window.border(c) for c in (current.x, current.y, current.z)))

    motion_x, motion_y, motion_valid = _motion(gbuffer, config)
    row, column = window.history_position(motion_x, motion_y)
    row, column = vector.materialize((row, column))
    valid = history.valid & motion_valid & window.inside(row, column)

    filtered, exact = _read_history(history.color, row, column, config)
    reprojected = vector.select(valid, filtered, current)

    alone = sample = _filter_current(bordered, jitter, config)
    rectified, sample = _rectify(reprojected, sample, bordered, params, config)
    nearest = window.nearest_index(row, column)
    frames = _finite(window.read(history.count, nearest))
    speed = jnp.sqrt(motion_x * motion_x + motion_y * motion_y)
    weight = _current_weight(speed, frames, params, config)
    blended = _to_linear(_blend(rectified, sample, weight, config), config)

    # Where nothing was interpolated the linear values themselves are handed on, so
    # that no round trip through the averaging space costs their last bits.
    alone = linear if config.current_filter == "none" else _to_linear(alone, config)
    whole = (row == jnp.round(row)) & (column == jnp.round(column))
    handed_on = vector.select(whole, exact, _to_linear(filtered, config))
    blended, handed_on = vector.materialize(
        (vector.select(valid, blended, alone), vector.select(valid, handed_on, linear))
    )
    return TaaOutput(
        color=vector.stack(blended),
        reprojected=vector.stack(handed_on),
        count=jnp.where(valid, _next_count(frames, params.count_limit), 1.0),
        valid=valid,
        previous_px=jnp.stack([row + 0.5, column + 0.5], axis=-1),
    )


def _to_average(linear: Vec3, config: Config) -> Vec3:
    average = "tonemap" if config.weighting == "tonemap" else "linear"
    return colors.to_average_vec(linear, average)


def _to_linear(value: Vec3, config: Config) -> Vec3:
    """Leaves the averaging space; what filters overshot is limited to radiance."""
    average = "tonemap" if config.weighting == "tonemap" else "linear"
    return colors.sanitize_vec(colors.from_average_vec(value, average))


def _finite(value: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Returns a count that is at least 0, NaN included, and finite."""
    return jnp.where(value > 0.0, jnp.minimum(value, 1e9), 0.0)


def _motion(
    gbuffer: GBuffer, config: Config
) -> tuple[Float[Array, "h w"], Float[Array, "h w"], Bool[Array, "h w"]]:
    """Returns (x, y, valid) of the motion that reprojects each pixel.

    Nearest depth: among the 3×3 with a valid motion vector, the nearest surface; a
    neighbour must be nearer than the pixel itself to lead it. Of equally near ones the
    pixel's own row comes first, then the one above, then below; within a row the
    middle, then left, then right.
    """
    own_x, own_y = gbuffer.motion[..., 0], gbuffer.motion[..., 1]
    finite = jnp.isfinite(own_x) & jnp.isfinite(own_y)
    own_valid = gbuffer.motion_valid & finite
    own_x, own_y = jnp.where(finite, own_x, 0.0), jnp.where(finite, own_y, 0.0)
    if config.motion == "pixel":
        return own_x, own_y, own_valid
    candidate = jnp.where(own_valid, gbuffer.depth, jnp.inf)
    planes = tuple(window.border(p) for p in (candidate, own_x, own_y))

    def nearer(a: tuple[Array, ...], b: tuple[Array, ...]) -> tuple[Array, ...]:
        take = b[0] < a[0]  # strictly: the first of equals stays
        return tuple(jnp.where(take, q, p) for p, q in zip(a, b, strict=True))

    left, middle, right = (
        tuple(p[:, s : s + own_x.shape[1]] for p in planes) for s in range(3)
    )
    rows = nearer(nearer(middle, left), right)
    rows = vector.materialize(rows)
    above, own, below = (
        tuple(p[s : s + own_x.shape[0]] for p in rows) for s in range(3)
    )
    depth, x, y = nearer(nearer(own, above), below)
    led = depth < gbuffer.depth
    return jnp.where(led, x, own_x), jnp.where(led, y, own_y), own_valid | led


def _read_history(
    image: Float[Array, "h w 3"],
    row: Float[Array, "h w"],
    column: Float[Array, "h w"],
    config: Config,
) -> tuple[Vec3, Vec3]:
    """Filters the history at a position in index units (integers: pixel centres).

    Returns:
        (filtered value in the averaging space, linear texel that the position's floor
        falls on). All weights but one are exactly 0 at a pixel centre.
    """
    height, width = row.shape
    mapped = _to_average(vector.unstack(image), config)
    # Texels with their channels side by side, four of them, the last unused: a read is
    # one load of a vector, and the filter twice as fast as with three.
    channels = (mapped.x, mapped.y, mapped.z, jnp.zeros_like(mapped.x))
    texels = vector.materialize(jnp.stack(channels, axis=-1)).reshape(-1, 4)
    fraction_y, fraction_x = row - jnp.floor(row), column - jnp.floor(column)
    if config.history_filter == "bilinear":
        reach = range(2)
        weights_y, weights_x = _linear(fraction_y), _linear(fraction_x)
    else:
        reach = range(-1, 3)
        weights_y, weights_x = _catmull_rom(fraction_y), _catmull_rom(fraction_x)
    rows = [window.floor_index(row + k, height) * width for k in reach]
    columns = [window.floor_index(column + k, width) for k in reach]
    # Materialized: fused into the filter, they would be computed for every channel.
    weights_y, weights_x, rows, columns = vector.materialize(
        (weights_y, weights_x, rows, columns)
    )

    def texel(r: Array, c: Array) -> Array:
        return texels.at[r + c].get(mode="promise_in_bounds")

    total = jnp.zeros((height, width, 4), jnp.float32)
    for r, weight_y in zip(rows, weights_y, strict=True):
        line = jnp.zeros((height, width, 4), jnp.float32)
        for c, weight_x in zip(columns, weights_x, strict=True):
            line = line + weight_x[..., None] * texel(r, c)
        total = total + weight_y[..., None] * line
    middle = -reach[0]
    if config.dering:
        inner = [
            texel(r, c)
            for r in rows[middle : middle + 2]
            for c in columns[middle : middle + 2]
        ]
        low, high = inner[0], inner[0]
        for other in inner[1:]:
            low, high = jnp.minimum(low, other), jnp.maximum(high, other)
        total = jnp.clip(total, low, high)
    exact = image.reshape(-1, 3).at[rows[middle] + columns[middle]]
    total, exact = vector.materialize((total, exact.get(mode="promise_in_bounds")))
    filtered = _in_range(vector.unstack(total[..., :3]), config)
    return filtered, colors.sanitize_vec(vector.unstack(exact))


def _in_range(value: Vec3, config: Config) -> Vec3:
    """Limits what Catmull-Rom's negative lobes overshot to the averaging space."""
    top = colors.MAX_RADIANCE
    if config.weighting == "tonemap":
        top = top / (1.0 + top)
    return Vec3(*(jnp.clip(c, 0.0, top) for c in (value.x, value.y, value.z)))


def _linear(f: Float[Array, "h w"]) -> list[Float[Array, "h w"]]:
    """Returns the weights of the texels at ⌊p⌋ and ⌊p⌋ + 1, f = p − ⌊p⌋."""
    return [1.0 - f, f]


def _catmull_rom(f: Float[Array, "h w"]) -> list[Float[Array, "h w"]]:
    """Returns the weights of the texels ⌊p⌋ − 1 … ⌊p⌋ + 2, cubic, interpolating.

    Written as Horner forms whose value at f = 0 is exactly 0, 1, 0, 0.
    """
    return [
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    ]


def _filter_current(bordered: Vec3, jitter: Float[Array, " 2"], config: Config) -> Vec3:
    """Returns c: the pixel's own sample, or UE4's Gaussian over the 3×3 samples.

    The sample of the neighbour at offset o lies o + jitter from this pixel's centre;
    exp(−2.29 |o + jitter|²) is a product of a row's and a column's weight.
    """
    own = Vec3(*(p[1:-1, 1:-1] for p in (bordered.x, bordered.y, bordered.z)))
    if config.current_filter == "none":
        return own
    offsets = jnp.arange(-1, 2, dtype=jnp.float32)
    weights_x = jnp.exp(-GAUSSIAN_FALLOFF * (offsets + jitter[0]) ** 2)
    weights_y = jnp.exp(-GAUSSIAN_FALLOFF * (offsets + jitter[1]) ** 2)

    def gaussian(plane: Array) -> Array:
        nine = window.neighbours(plane)
        rows = [sum(weights_x[c] * nine[r][c] for c in range(3)) for r in range(3)]
        return jnp.asarray(sum(weights_y[r] * rows[r] for r in range(3)))

    if config.weighting == "luma":
        weight = vector.materialize(_luma_weight(bordered))
        total = gaussian(weight)
    else:
        weight = jnp.float32(1.0)
        total = jnp.sum(weights_x) * jnp.sum(weights_y)
    return Vec3(
        gaussian(weight * bordered.x) / total,
        gaussian(weight * bordered.y) / total,
        gaussian(weight * bordered.z) / total,
    )


def _luma_weight(color: Vec3) -> Float[Array, "..."]:
    """Returns UE4's weight 1/(4 + luma) against fireflies; its luma is r + 2g + b."""
    return 1.0 / (4.0 + color.x + 2.0 * color.y + color.z)


def _rectify(
    history: Vec3, sample: Vec3, bordered: Vec3, params: Params, config: Config
) -> tuple[Vec3, Vec3]:
    """Limits the history to what the current 3×3 neighbourhood makes plausible.

    Returns:
        (rectified history, current sample, limited to the box if so configured).
    """
    if config.rectify == "none":
        return history, sample
    to_box, from_box = (
        (colors.ycocg_vec, colors.rgb_vec)
        if config.space == "ycocg"
        else (_unchanged, _unchanged)
    )
    planes = to_box(bordered)
    if config.space == "ycocg":
        planes = vector.materialize(planes)
    h, c = to_box(history), to_box(sample)
    gamma = params.variance_gamma if config.rectify == "variance_clip" else None
    box = rectification.box(planes, config.neighbourhood, gamma)
    if config.rectify == "clamp":
        h = rectification.clamp(h, box)
    else:
        h = rectification.clip(h, box)
    if config.clamp_current:
        sample = _in_range(from_box(rectification.clamp(c, box)), config)
    # A box in YCoCg reaches beyond the RGB cube.
    return _in_range(from_box(h), config), sample


def _unchanged(value: Vec3) -> Vec3:
    return value


def _current_weight(
    speed: Float[Array, "h w"],
    frames: Float[Array, "h w"],
    params: Params,
    config: Config,
) -> Float[Array, "h w"]:
    """Returns a, the current sample's weight before any weighting by luma."""
    if config.blend == "accumulate":
        return 1.0 / (frames + 1.0)
    share = jnp.minimum(speed / jnp.maximum(params.motion_px, 1e-6), 1.0)
    rest, moving = params.current_weight, params.current_weight_moving
    return rest + (moving - rest) * share


def _next_count(
    frames: Float[Array, "h w"], limit: Float[Array, ""]
) -> Float[Array, "h w"]:
    """Returns the frames that the blended colour counts as.

    One more, up to the limit. A traced colour may count as more than the limit; that
    credit runs out by one a frame, since every reprojection blurs it.
    """
    more = jnp.minimum(frames + 1.0, limit)
    return jnp.where(frames > limit, jnp.maximum(frames - 1.0, limit), more)


def _blend(history: Vec3, sample: Vec3, a: Float[Array, "h w"], config: Config) -> Vec3:
    """Returns h + a (c − h), which is exactly h where both are equal."""
    if config.weighting == "luma":
        w_sample = a * _luma_weight(sample)
        w_history = (1.0 - a) * _luma_weight(history)
        a = w_sample / (w_sample + w_history)
    return history + (sample - history) * a
