"""The fit as a whole: recordings in, parameters and their evidence out.

1. yardsticks on every sequence; 2. a relaxed fit of the weights, from equal ones;
3. Nelder–Mead on the closed loop over weights, reset and hold, from the better of the
relaxed fit with and without a hold; 4. the lowest of the thresholds that spend the
budget on one sequence each, so that none leaves rays unspent: a frame that would ask
for more is held to the budget; 5. the same contenders on what was held out.
"""

import hashlib
import importlib.metadata
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import cache, pipeline, segmentation
from ataa_jax.errors import InputError
from ataa_jax.fit import captured, optimize, score, soft, space, yardsticks
from ataa_jax.fit.checkpoint import NOWHERE, Checkpoints
from ataa_jax.fit.recording import Captured, Recording
from ataa_jax.fit.replay import Take, replayable
from ataa_jax.metrics import SSIM_MIN_SIZE

Progress = Callable[[str, int, int], None]
# Gains under this are rounding: SSIM's float32 sums agree to about 1e-6.
_NO_GAIN = 1e-5


@dataclass(frozen=True)
class Options:
    """What to fit, and how hard to try."""

    budget: float = pipeline.BUDGET  # rays a pixel
    # our choice: the paper's two, and the one that told most on held-out scenes.
    terms: tuple[str, ...] = ("luminance", "depth", "response")
    quantities: tuple[str, ...] = ("segmentation.reset_px", "segmentation.hold")
    reading: Literal["sum", "either"] = "sum"
    solver: Literal["lm", "bfgs", "none"] = "lm"  # of the relaxed fit
    starts: int = 1  # of the relaxed fit
    steps: int = 8  # of Nelder–Mead; 0: none
    seed: int = 0


@dataclass(frozen=True)
class Standing:
    """All contenders on one sequence, at the same rays a pixel."""

    scene: str
    taa: float  # SSIM of plain TAA
    random: float
    equal: float  # the paper's equal weights
    fitted: float
    oracle: float
    rays: float  # of the fitted weights
    threshold: float  # theirs, solved for this sequence
    carried: float  # the file untouched: its threshold, and its budget a frame
    carried_rays: float
    captured: Captured | None = None  # what it is made of, unless it was rendered

    @property
    def efficiency(self) -> float:
        """Share of the oracle's gain over TAA."""
        return yardsticks.efficiency(self.fitted, self.taa, self.oracle)

    @property
    def closed(self) -> float:
        """Share of the way from equal weights to the oracle."""
        return yardsticks.closed(self.fitted, self.equal, self.oracle)


@dataclass(frozen=True)
class Fitted:
    """What was found, and how it stands."""

    params: pipeline.Params
    config: segmentation.Config
    options: Options
    size: tuple[int, int]
    frames: int
    evaluations: int  # of the closed loop
    relaxed_evaluations: int  # of the relaxed loss: values, gradients, columns
    standings: list[Standing]
    held_out: list[Standing] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def check(recordings: Sequence[Recording], options: Options) -> None:
    """Refuses what cannot be fitted, before any work.

    Raises:
        InputError: no recordings, of different sizes or rays a pixel, too small for
            SSIM, a reference of another size, a budget that no mask can spend, terms
            that captures have no buffers for, or the width of a clip that has none.
    """
    if not recordings:
        raise InputError("a fit needs at least one scene")
    first = recordings[0]
    samples = first.config.raytrace.samples
    score.check_budget(options.budget, samples)
    check_size(first.size)
    for each in recordings:
        if each.size != first.size or each.config.raytrace.samples != samples:
            raise InputError(
                "recordings of one fit share size and rays a traced pixel; "
                f"{_extent(each)} where {_extent(first)}"
            )
        shape = tuple(each.frames.truth.shape)
        if shape != tuple(each.frames.color.shape):
            raise InputError(
                f"the reference of {each.name} is of shape {shape}, its frames of "
                f"{tuple(each.frames.color.shape)}; render it at the same size"
            )
        rectify = each.config.taa.rectify
        if space.CLIP.name in options.quantities and rectify != "variance_clip":
            raise InputError(
                f"'{space.CLIP.name}' is the width of TAA's variance clip, and "
                f"{each.name} is rectified by '{rectify}'"
            )
    if any(each.captured for each in recordings):
        captured.check_terms(options.terms)


def _extent(recording: Recording) -> str:
    height, width = recording.size
    rays = recording.config.raytrace.samples
    return f"{recording.name} has {width}x{height} and {rays} rays"


def check_size(size: tuple[int, int]) -> None:
    """Refuses images that SSIM is not defined for.

    Raises:
        InputError: fewer than 11 pixels a side.
    """
    if min(size) < SSIM_MIN_SIZE:
        raise InputError(
            f"SSIM needs at least {SSIM_MIN_SIZE} pixels a side; give larger images "
            f"than {size[1]}x{size[0]}, by --size where they are rendered"
        )


def check_options(options: Options) -> None:
    """Refuses terms and quantities that do not exist.

    Raises:
        InputError: an unknown or repeated name.
    """
    space.switched(segmentation.Config(), options.terms)
    space.named(options.quantities)
    for names in (options.terms, options.quantities):
        if len(set(names)) != len(names):
            raise InputError(f"a name is given twice in {', '.join(names)}")


def fit(
    recordings: Sequence[Recording],
    options: Options,
    *,
    held_out: Sequence[Recording] = (),
    checkpoints: Checkpoints = NOWHERE,
    progress: Progress = lambda text, done, total: None,
) -> Fitted:
    """Fits to recordings, and tells how it stands on them and on others.

    Args:
        recordings: the sequences to fit to, all of one size.
        options: what and how.
        held_out: sequences that the fit does not see.
        checkpoints: see `checkpoints_of`.
        progress: told of every step.

    Raises:
        InputError: see `check`, and unknown terms or quantities.
    """
    check([*recordings, *held_out], options)
    check_options(options)
    start = recordings[0].params
    config = space.switched(recordings[0].config.segmentation, options.terms)
    config = replace(config, reading=options.reading)
    quantities = (*space.weights(options.terms), *space.named(options.quantities))
    takes = tuple(Take.of(each) for each in recordings)
    on = tuple(take.under(config) for take in takes)
    all_given = (*recordings, *held_out)
    notes = captured.notes(all_given)
    params, evaluations = start, (0, 0)

    progress("yardsticks", 0, 1)
    bases = [_yardsticks(take, start, options) for take in takes]
    if all(base["oracle"] - base["taa"] < _NO_GAIN for base in bases):
        notes.append(
            "TAA is as good as tracing can make it on these scenes: nothing was fitted"
        )
    else:
        params, evaluations = _search(
            on, start, options, quantities, checkpoints, progress
        )
    own = [score.at_budget(take, params, options.budget) for take in on]
    spent = [each.rays for each in own]
    if max(abs(rays / options.budget - 1.0) for rays in spent) > 0.05:
        notes.append(
            f"no threshold spends {options.budget:g} rays a pixel everywhere: the "
            f"sequences' own spend {min(spent):.3f} to {max(spent):.3f}"
        )
    lowest = min(each.threshold for each in own)
    params = space.with_threshold(params, jnp.float32(lowest), config)
    params = pipeline.with_budget(params, options.budget)
    unseen = [Take.of(each) for each in held_out]
    bases += [_yardsticks(take, start, options) for take in unseen]
    on += tuple(take.under(config) for take in unseen)
    own += [score.at_budget(take, params, options.budget) for take in on[len(own) :]]
    standings = []
    for each, base, take, solved in zip(all_given, bases, on, own, strict=True):
        standings.append(_standing(each, base, take, params, solved))
        progress(f"scores on {each.name}", len(standings), len(all_given))
    return Fitted(
        params=params,
        config=config,
        options=options,
        size=recordings[0].size,
        frames=len(recordings[0].truth),
        evaluations=evaluations[0],
        relaxed_evaluations=evaluations[1],
        standings=standings[: len(recordings)],
        held_out=standings[len(recordings) :],
        notes=notes,
    )


def _search(
    takes: tuple[Take, ...],
    start: pipeline.Params,
    options: Options,
    quantities: tuple[space.Quantity, ...],
    checkpoints: Checkpoints,
    progress: Progress,
) -> tuple[pipeline.Params, tuple[int, int]]:
    """Returns parameters, and evaluations of the closed loop and the relaxed loss."""
    params, hard, relaxed = start, 0, 0
    holds = space.HOLD in quantities
    if options.solver != "none" and len(options.terms) > 1:
        base = space.place(start, (space.HOLD,), jnp.zeros(1)) if holds else start
        found = soft.fit(
            takes,
            base,
            options.terms,
            options.budget,
            solver=options.solver,
            starts=options.starts,
            seed=options.seed,
            checkpoints=checkpoints,
            progress=progress,
        )
        params = found.params
        hard, relaxed = found.hard_evaluations, found.evaluations
    if options.steps and quantities:
        closed = optimize.nelder_mead(
            score.compiled(quantities),
            space.coordinates(params, quantities),
            (takes, params, jnp.float32(options.budget)),
            steps=options.steps,
            checkpoints=checkpoints,
            progress=progress,
        )
        hard += closed.evaluations
        params = space.place(params, quantities, space.free(jnp.asarray(closed.x)))
    return params, (hard, relaxed)


def _yardsticks(
    take: Take, params: pipeline.Params, options: Options
) -> dict[str, float]:
    budget = options.budget
    return {
        "taa": yardsticks.taa_alone(take, params).ssim,
        "random": yardsticks.random(take, params, budget, options.seed).ssim,
        "equal": score.at_budget(take, params, budget).ssim,
        "oracle": yardsticks.oracle(take, params, budget).ssim,
    }


def _standing(
    recording: Recording,
    base: dict[str, float],
    take: Take,
    params: pipeline.Params,
    own: score.Result,
) -> Standing:
    untouched = score.as_is(take, params, capped=True)
    return Standing(
        scene=recording.name,
        **base,
        fitted=own.ssim,
        rays=own.rays,
        threshold=own.threshold,
        carried=untouched.ssim,
        carried_rays=untouched.rays,
        captured=recording.captured,
    )


def checkpoints_of(
    recordings: Sequence[Recording], options: Options, folder: Path
) -> Checkpoints:
    """Returns where the fit of just these arrays and options keeps its state."""
    digest = hashlib.blake2b(digest_size=16)
    for each in recordings:
        for leaf in jax.tree.leaves((each.frames, each.params)):
            digest.update(np.ascontiguousarray(leaf).view(np.uint8).data)
        digest.update(f"{each.lead_in} {replayable(each.config)}".encode())
    key = f"{digest.hexdigest()} {options} {versions()} {cache.package_hash()}"
    return Checkpoints(folder=folder, key=key)


def versions() -> dict[str, str]:
    """Returns the versions that decide a fit's numbers."""
    names = ("ataa-jax", "jax", "optimistix", "scikit-image", "embreex", "numpy")
    return {name: importlib.metadata.version(name) for name in names}
