"""Closes the loop over a recording: TAA → mask → composite → history, on arrays alone.

`pipeline.antialias` with the tracer replaced by the recorded traced colour, the same
stages otherwise; frames by `lax.scan`. Who chooses the pixels is open: the
segmentation's criteria, an oracle, chance.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt

from ataa_jax import color as colors
from ataa_jax import fxaa, pipeline, raytrace, resolve, segmentation, taa
from ataa_jax.fit.recording import Recorded, Recording
from ataa_jax.types import METHOD_ATAA, METHOD_FXAA, Segmentation, State


class Played(eqx.Module):
    """What a replay leaves of each frame, stacked along a leading axis."""

    image: Float[Array, "h w 3"]  # sRGB
    method: UInt[Array, "h w"]  # METHOD_*
    traced_pixels: Int[Array, ""]


# (state, frame, TAA's output, parameters, extra operands) → the pixels' methods.
Chooser = Callable[
    [State, Recorded, taa.TaaOutput, pipeline.Params, object], Segmentation
]


def by_criteria(
    config: segmentation.Config, budget_of: pipeline.Config | None = None
) -> Chooser:
    """Returns the segmentation stage itself as chooser.

    Args:
        config: of the stage.
        budget_of: says how many pixels the budget pays for; None: no budget.
    """
    return partial(_by_criteria, config=config, budget_of=budget_of)


def _by_criteria(
    state: State,
    recorded: Recorded,
    blended: taa.TaaOutput,
    params: pipeline.Params,
    extra: object,
    *,
    config: segmentation.Config,
    budget_of: pipeline.Config | None,
) -> Segmentation:
    del extra
    given = (
        *(state, recorded.color, recorded.gbuffer, blended.reprojected),
        params.segmentation,
    )
    if budget_of is None:
        return segmentation.segmentation(*given, config=config, blended=blended.color)
    limit = pipeline.max_pixels(params.budget, budget_of)
    return segmentation.segment(*given, limit, config=config, blended=blended.color)[0]


def step(
    state: State,
    recorded: Recorded,
    params: pipeline.Params,
    extra: object = None,
    *,
    config: pipeline.Config,
    choose: Chooser,
    shown: bool = True,
) -> tuple[State, Played]:
    """Replays one frame; a budget is the chooser's affair.

    Args:
        state: what the frame before left.
        recorded: the frame.
        params: numbers.
        extra: operands of the chooser.
        config: the stages' choices.
        choose: says each pixel's method.
        shown: False leaves out FXAA and the display image, for counts alone.
    """
    after, _, method, composite = composed(
        state, recorded, params, extra, config=config, choose=choose
    )
    image = jnp.zeros((0, 0, 3), jnp.float32)
    if shown:
        image = fxaa.fxaa_sparse(
            colors.display(composite),
            method == METHOD_FXAA,
            params.fxaa,
            config=config.fxaa,
        )
    played = Played(
        image=image,
        method=method if shown else jnp.zeros((0, 0), jnp.uint32),
        traced_pixels=jnp.sum(method == METHOD_ATAA, dtype=jnp.int32),
    )
    return after, played


def composed(
    state: State,
    recorded: Recorded,
    params: pipeline.Params,
    extra: object = None,
    *,
    config: pipeline.Config,
    choose: Chooser,
) -> tuple[State, taa.TaaOutput, UInt[Array, "h w"], Float[Array, "h w 3"]]:
    """Replays one frame as far as the history goes; arguments as `step`'s.

    Returns:
        State after the frame, TAA's output, METHOD_* and the linear composite.
    """
    valid = state.history.valid & ~recorded.cut
    state = eqx.tree_at(lambda s: s.history.valid, state, valid)
    blended = taa.taa(
        state.history,
        recorded.color,
        recorded.gbuffer,
        recorded.jitter,
        params.taa,
        config=config.taa,
    )
    segmented = choose(state, recorded, blended, params, extra)
    method, _ = segmentation.unpack_mask(segmented.mask)
    resolved = resolve.resolve(
        segmented,
        recorded.color,
        recorded.gbuffer,
        blended,
        recorded.traced,
        params.resolve,
        samples=config.raytrace.samples,
        average=config.raytrace.average,
        config=config.resolve,
    )
    after = State(history=resolved.history, classification=resolved.classification)
    return after, blended, method, resolved.composite


def traced_pixel(
    recorded: Recorded, blended: taa.TaaOutput, config: pipeline.Config
) -> Float[Array, "h w 3"]:
    """Returns what each pixel shows if it is traced, linear."""
    rays = config.raytrace
    return resolve.traced_pixel(
        blended, recorded.traced, rays.samples,
        average=rays.average, config=config.resolve,
    )  # fmt: skip


@partial(jax.jit, static_argnames=("config", "choose", "shown"))
def play(
    frames: Recorded,
    params: pipeline.Params,
    extra: object = None,
    *,
    config: pipeline.Config,
    choose: Chooser,
    shown: bool = True,
) -> Played:
    """Replays a whole sequence from no history; `extra` has a leading frame axis."""
    body = partial(_scanned, params=params, config=config, choose=choose, shown=shown)
    start = pipeline.init(config.raster.size, config.resolve.history)
    _, played = jax.lax.scan(body, start, (frames, extra))
    return played


def _scanned(
    state: State,
    operands: tuple[Recorded, object],
    *,
    params: pipeline.Params,
    config: pipeline.Config,
    choose: Chooser,
    shown: bool,
) -> tuple[State, Played]:
    recorded, extra = operands
    return step(
        state, recorded, params, extra, config=config, choose=choose, shown=shown
    )


def replayable(config: pipeline.Config) -> pipeline.Config:
    """Returns the configuration with all that a replay does not read set to defaults.

    Sequences of different scenes then share one compiled program.
    """
    return pipeline.Config(
        raster=replace(pipeline.Config().raster, size=config.raster.size),
        taa=config.taa,
        segmentation=config.segmentation,
        raytrace=raytrace.Config(
            samples=config.raytrace.samples, average=config.raytrace.average
        ),
        resolve=config.resolve,
        fxaa=config.fxaa,
    )


class Take(eqx.Module):
    """A recording's arrays, and what of it is static."""

    frames: Recorded
    lead_in: int = eqx.field(static=True)
    samples: int = eqx.field(static=True)
    config: pipeline.Config = eqx.field(static=True)

    @classmethod
    def of(cls, recording: Recording) -> "Take":
        """Returns the recording, ready to be an operand of a compiled program."""
        return cls(
            frames=recording.frames,
            lead_in=recording.lead_in,
            samples=recording.config.raytrace.samples,
            config=replayable(recording.config),
        )

    def under(self, config: segmentation.Config) -> "Take":
        """Returns the same recording under another `segmentation.Config`."""
        return Take(
            frames=self.frames,
            lead_in=self.lead_in,
            samples=self.samples,
            config=replace(self.config, segmentation=config),
        )
