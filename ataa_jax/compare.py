"""Every method on the same sequence against the same reference: images and scores.

Nothing here writes files; `report` does. Timings are kept apart from scores, so that
all else is a function of the input.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import astuple, dataclass, field
from functools import partial

import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax import memory, metrics, pipeline, reference
from ataa_jax.capture.record import Capture
from ataa_jax.errors import InputError
from ataa_jax.journal import Journal
from ataa_jax.methods import (
    Drawer,
    Options,
    Runner,
    Source,
    check_methods,
    effects_of,
    runner,
    scene_of,
    warming,
)

REFERENCE = "reference"


@dataclass(frozen=True)
class Score:
    """One method on one frame; shares are of the frame's pixels."""

    method: str
    frame: int
    ssim: float
    psnr: float
    flip: float
    flicker: float
    border_mse: float  # of the outer five pixels, which SSIM leaves out
    thin_mse: float  # of pixels that wires, ropes, slats and leaves cross
    fxaa_share: float = 0.0
    taa_share: float = 0.0
    ataa_share: float = 0.0
    rays_per_pixel: float = 0.0  # sparse primary rays over all pixels
    overflow_share: float = 0.0  # asked for rays beyond the budget


@dataclass
class Comparison:
    """All that a report shows."""

    scene: str
    path: str
    size: tuple[int, int]
    options: Options
    notes: list[str]
    scores: list[Score] = field(default_factory=list)
    # sRGB uint8 (h, w, 3) a frame, by method and `reference`.
    images: dict[str, list[np.ndarray]] = field(default_factory=dict)
    # uint8 (h, w) METHOD_* a frame, and uint8 WHY_* bits, by ATAA method.
    masks: dict[str, list[np.ndarray]] = field(default_factory=dict)
    whys: dict[str, list[np.ndarray]] = field(default_factory=dict)
    stage_ms: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    peak_memory_bytes: int = 0

    def mean(self, method: str, column: str) -> float:
        """Returns a score's mean over the frames, leaving out NaN."""
        values = [
            getattr(score, column) for score in self.scores if score.method == method
        ]
        finite = [value for value in values if not np.isnan(value)]
        return float(np.mean(finite)) if finite else float("nan")

    def milliseconds(self, method: str, stage: str | None = None) -> float:
        """Returns the median time a frame of one stage, or the sum over all stages."""
        stages = self.stage_ms.get(method, {})
        if stage is not None:
            return float(np.median(stages[stage])) if stages.get(stage) else 0.0
        return float(sum(np.median(times) for times in stages.values() if times))


def notes(shot: Source) -> list[str]:
    """Returns what was supplied or found, in sentences."""
    return list(shot.notes if isinstance(shot, Capture) else shot.world.notes)


def compare(
    shot: Source,
    options: Options,
    progress: Callable[[str, int, int], None] = lambda text, done, total: None,
    journal: Journal | None = None,
) -> Comparison:
    """Runs the methods over the sequence and scores them against the reference.

    Args:
        shot: the world along a path, or a capture.
        options: methods, frames, reference, budget.
        journal: frames that it holds are not rendered again; their times are not told.
        progress: told what is done, and how many of how many steps.

    Returns:
        Images, masks, scores and times.

    Raises:
        InputError: an unknown method.
    """
    check_methods(options.methods)
    captured = isinstance(shot, Capture)
    result = Comparison(
        scene=shot.name if captured else shot.world.name,
        path="captured" if captured else shot.path.name,
        size=shot.size,
        options=options,
        notes=notes(shot),
    )
    runners = [runner(name, shot, options) for name in options.methods]
    total = options.frames * options.reference_samples + options.lead_in
    done = 0

    def step(text: str) -> None:
        nonlocal done
        done += 1
        progress(text, done, total)

    drawer = Drawer(shot)
    previous: dict[str, np.ndarray] = {}
    begin = -options.lead_in
    if journal is not None and journal.step is not None:
        with suppress(KeyError):
            previous = _go_on(journal, result, runners)
            begin = journal.step + 1
            done = options.lead_in + min(begin, 0)  # a step a lead-in frame,
            done += max(begin, 0) * options.reference_samples  # one a sample after
    with warming(runners, shot):
        for index in range(begin, options.frames):
            drawer.start(index)
            if index == 0:  # times are of the frames that are scored
                for each in runners:
                    each.ready()
                    each.times.clear()
            images = {}
            for each in runners:
                if index >= 0 or each.temporal:
                    images[each.name] = each.run(index, drawer)
            if index < 0:
                step(f"lead-in frame {index}")
                previous = images
                _commit(journal, index, result, runners, images)
                continue
            told = partial(step, f"frame {index + 1} of {options.frames}")
            seen = truth(shot, index, options, told)
            images[REFERENCE] = np.asarray(colors.display(seen.color))
            thin = np.asarray(seen.thin)
            _score(result, runners, images, previous, index, thin, drawer)
            previous = images
            _commit(journal, index, result, runners, images)
    for each in runners:
        result.stage_ms[each.name] = each.steady()
    result.peak_memory_bytes = memory.peak()
    return result


def _commit(
    journal: Journal | None,
    index: int,
    result: Comparison,
    runners: list[Runner],
    images: dict[str, np.ndarray],
) -> None:
    """Notes a frame that is done: its pictures, all scores, what the next one reads."""
    if journal is None:
        return
    shown = {}
    if index >= 0:
        pictures = {"images": result.images, "masks": result.masks, "whys": result.whys}
        shown = {
            f"{kind}/{name}": frames[index]
            for kind, each in pictures.items()
            for name, frames in each.items()
        }
    latest = [each.state for each in runners], images
    facts = [list(astuple(score)) for score in result.scores]
    journal.commit(index, latest, {"scores": facts, "names": list(images)}, shown)


def _go_on(
    journal: Journal, result: Comparison, runners: list[Runner]
) -> dict[str, np.ndarray]:
    """Fills in the frames that are done; returns the images of the last.

    Raises:
        KeyError: the journal lacks one of them.
    """
    assert journal.step is not None
    image = np.empty((*result.size, 3), np.float32)
    like = (
        [each.state for each in runners],
        dict.fromkeys(journal.facts["names"], image),
    )
    states, previous = journal.latest(like)
    shown = [journal.kept(index) for index in range(journal.step + 1)]
    for frame in shown:
        for name, picture in frame.items():
            kind, _, method = name.partition("/")
            getattr(result, kind).setdefault(method, []).append(picture)
    result.scores = [Score(*values) for values in journal.facts["scores"]]
    for each, state in zip(runners, states, strict=True):
        each.state = state
    return previous


def truth(
    shot: Source,
    frame: int,
    options: Options,
    progress: Callable[[], None] = lambda: None,
) -> reference.Supersampled:
    """Renders or reads the reference of a frame; a capture knows no thin features."""
    if not isinstance(shot, Capture):
        return reference.reference(
            shot,
            frame,
            options.reference_samples,
            average=options.average,
            progress=progress,
        )
    color = shot.reference(frame)
    if color is None:
        raise InputError(
            f"capture {shot.folder} has no reference to score against; capture one, or "
            "use 'ataa run'"
        )
    for _ in range(options.reference_samples):
        progress()
    return reference.Supersampled(
        color=jnp.asarray(color), thin=jnp.zeros(shot.size, jnp.float32)
    )


def _score(
    result: Comparison,
    runners: list[Runner],
    images: dict[str, np.ndarray],
    previous: dict[str, np.ndarray],
    frame: int,
    thin: np.ndarray,
    drawer: Drawer,
) -> None:
    """Scores one frame of every method, and the reference's own flicker."""
    truth = images[REFERENCE]
    # Crossed: some of the reference's samples met a thin feature, and some did not.
    crossed = (thin > 0.0) & (thin < 1.0)
    shot = drawer.shot
    config, params = pipeline.preset(
        "ue4", scene_of(shot), result.size, selection=effects_of(shot)
    )
    centred, _, _ = drawer.draw(config.raster, params.raster, None)
    motion = np.asarray(centred.gbuffer.motion)
    valid = np.asarray(centred.gbuffer.motion_valid)
    shares = {each.name: each.shares for each in runners}
    for name, image in images.items():
        change = float("nan")
        if name in previous:
            change = metrics.flicker(image, previous[name], motion, valid)
        result.scores.append(
            Score(
                method=name,
                frame=frame,
                ssim=metrics.ssim(image, truth),
                psnr=metrics.psnr(image, truth),
                flip=metrics.flip(image, truth),
                flicker=change,
                border_mse=metrics.border_error(image, truth),
                thin_mse=metrics.mean_squared_error(image, truth, crossed),
                **shares.get(name, {}),
            )
        )
        result.images.setdefault(name, []).append(
            np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
        )
    for each in runners:
        if each.method is not None and each.why is not None:
            result.masks.setdefault(each.name, []).append(each.method)
            result.whys.setdefault(each.name, []).append(each.why)
