"""What a step of accuracy costs in time: all methods, and Mitsuba 3, beside each other.

Every scene on a walk of typical motion and under a still camera. Two lightings: the
scene's *own*, and *one* directional light and nothing else (`competitor.one_light`),
which Mitsuba draws too; it is left out with a word where it is not installed. Scored
frames follow a lead-in; each renderer is scored against its own reference of 256
samples, averaged in its own space. That both draw the same picture, at an SSIM of 0.99
or more, has to be measured first, by experiments/mitsuba_agreement.py.

All methods take turns frame by frame in one process, so that other work on the machine
falls on all alike; a time is that of all of a frame's stages, compiled, without copying
or scoring; medians and quartiles. Mitsuba's is of `render` alone, with the scene in
place and its kernel compiled.

    python experiments/accuracy_vs_time.py                    # 640×360, every scene
    python experiments/accuracy_vs_time.py --size 1280x720 sponza
    python experiments/accuracy_vs_time.py --references       # only renders those

Beside the clock stands the processor time of all threads, which other work on the
machine does not lengthen. Writes results/accuracy_vs_time.csv; rows of what was
measured anew are replaced. `accuracy_read.py` then says and draws what it tells.
"""

import argparse
import csv
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import scenes

from ataa_jax import color as colors
from ataa_jax import (
    competitor,
    files,
    fxaa,
    memory,
    methods,
    metrics,
    pipeline,
    reference,
)
from ataa_jax import world as worlds
from ataa_jax.errors import InputError
from ataa_jax.stopwatch import Lap, Stopwatch

RESULTS = Path(__file__).parent / "results"
REFERENCE_SAMPLES = 256
LEAD_IN = 8
MOTIONS, LIGHTINGS = ("walk", "still"), ("own", "one")
# Frames that are scored, by rows of the image; a reference of 1280×720 takes minutes.
SCORED = {"walk": {360: (8,), 720: (0,)}, "still": {360: (8,), 720: (8,)}}
BUDGETS = (0.12, 0.24, pipeline.BUDGET)
SSAA = (2, 4, 8, 16, 32)
MITSUBA = (1, 2, 4, 8, 16, 32)
REPEATS = 3  # of what has no history, a scored frame
STAGES = (
    *("raster", "taa", "segmentation", "raytrace", "resolve", "fxaa", "supersample"),
)
KEY = ("scene", "motion", "light", "size")
COLUMNS = (
    *KEY,
    *("method", "budget", "rays_per_pixel", "ssim", "psnr", "flip", "flicker"),
    *("ms", "ms_q1", "ms_q3", "processor_ms"),
    *(f"{stage}_ms" for stage in STAGES),
)


@dataclass
class Entry:
    """One method at one setting: its scores and times."""

    method: str
    budget: float | None = None
    images: dict[int, np.ndarray] = field(default_factory=dict)  # a frame, as shown
    laps: list[Lap] = field(default_factory=list)  # whole frames
    stage_ms: dict[str, list[float]] = field(default_factory=dict)
    scores: list[tuple[float, float, float, float]] = field(default_factory=list)
    rays: float | None = None

    def row(self) -> list[str]:
        """Returns its cells of the table, behind the key."""
        clock, processor = np.array(self.laps).T
        low, middle, high = np.percentile(clock, (25, 50, 75))
        means = np.array(self.scores).mean(axis=0)
        stages = (self.stage_ms.get(stage) for stage in STAGES)
        numbers = [
            *(self.budget, self.rays, *means, middle, low, high, np.median(processor)),
            *(float(np.median(each)) if each else None for each in stages),
        ]
        return [self.method, *("" if n is None else f"{n:.5g}" for n in numbers)]


def runners(shot: worlds.Sequence) -> list[tuple[Entry, methods.Runner]]:
    """Returns what draws the package's methods."""
    options = methods.Options(lead_in=LEAD_IN)
    plain = methods.runner("none", shot, options)
    found = [(Entry("none"), plain)]
    for preset in (12, 39):
        each: Any = methods.runner("fxaa", shot, options)
        each.config = replace(each.config, fxaa=fxaa.Config(preset=preset))
        found.append((Entry(f"fxaa{preset}"), each))
    found += [
        (Entry(name), methods.runner(name, shot, options))
        for name in ("taa_ue4", "taa")
    ]
    for samples in (2, 4, 8):
        for budget in BUDGETS:
            name = f"ataa{samples}"
            each = methods.runner(name, shot, replace(options, budget=budget))
            found.append((Entry(name, budget), each))
    for samples in SSAA:
        name = f"ssaa{samples}"
        found.append((Entry(name), methods.runner(name, shot, options)))
    return found


def run(
    entry: Entry, runner: methods.Runner, frame: int, drawer: methods.Drawer
) -> None:
    """Draws a frame and notes its stages' times, but for the first, which compile."""
    runner.times.clear()
    entry.images = (
        {frame - 1: entry.images[frame - 1]} if frame - 1 in entry.images else {}
    )
    entry.images[frame] = runner.run(frame, drawer)
    entry.rays = runner.shares.get("rays_per_pixel")
    if frame > -LEAD_IN // 2:
        laps = {stage: each[-1] for stage, each in runner.times.items()}
        entry.laps.append(Lap(*np.sum(list(laps.values()), axis=0)))
        for stage, lap in laps.items():
            entry.stage_ms.setdefault(stage, []).append(lap.clock_ms)


def truth(shot: worlds.Sequence, frame: int) -> np.ndarray:
    """Returns the package's own reference, as shown."""
    found = reference.reference(shot, frame, REFERENCE_SAMPLES)
    return np.asarray(colors.display(found.color))


class Rival:
    """Mitsuba on a sequence, at each of its sample counts."""

    def __init__(self, shot: worlds.Sequence) -> None:
        self.drawer = competitor.Competitor(shot)
        self.entries = [Entry(f"mitsuba{spp}") for spp in MITSUBA]

    def draw(self, frame: int, spp: int, seed: int = 0) -> np.ndarray:
        """Returns an image as it is shown."""
        linear = self.drawer.render(frame, spp, seed)
        return np.asarray(colors.display(jax.numpy.asarray(linear)))

    def run(self, frame: int, before: bool) -> None:
        """Draws a frame at every count, and the one before for flicker."""
        for entry, spp in zip(self.entries, MITSUBA, strict=True):
            entry.images, entry.rays = {}, float(spp)
            if before:
                entry.images[frame - 1] = self.draw(frame - 1, spp, frame + 1)
        for entry, spp in zip(self.entries, MITSUBA, strict=True):
            entry.images[frame] = self.draw(frame, spp, frame + 2)  # compiles
        for _ in range(REPEATS):
            for entry, spp in zip(self.entries, MITSUBA, strict=True):
                watch = Stopwatch()
                self.drawer.render(frame, spp, frame + 2)
                entry.laps.append(watch.lap())


def score(
    entries: Iterable[Entry],
    frame: int,
    true: np.ndarray,
    moved: tuple[np.ndarray, np.ndarray],
) -> None:
    """Scores a frame of every entry."""
    for entry in entries:
        image, change = entry.images[frame], float("nan")
        if frame - 1 in entry.images:
            change = metrics.flicker(image, entry.images[frame - 1], *moved)
        entry.scores.append(
            (
                metrics.ssim(image, true),
                metrics.psnr(image, true),
                metrics.flip(image, true),
                change,
            )
        )


def agreed(name: str) -> bool:
    """Returns whether Mitsuba was found to draw the same picture of a scene."""
    file = RESULTS / "mitsuba_agreement.csv"
    if not file.is_file():
        return False
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    return any(row["scene"] == name and row["agrees"] == "yes" for row in rows)


def measure(shot: worlds.Sequence, motion: str, *, rival: bool) -> list[Entry]:
    """Returns all methods' scores and times on one sequence."""
    scored = SCORED[motion][shot.size[0]]
    drawn, drawer = runners(shot), methods.Drawer(shot)
    competing = Rival(shot) if rival else None
    config, params = pipeline.preset(
        "ue4", shot.world.scene, shot.size, selection=shot.effects
    )
    for frame in range(-LEAD_IN, max(scored) + 1):
        drawer.start(frame)
        near = frame in scored or frame + 1 in scored
        for entry, runner in drawn:
            if runner.temporal or near:
                run(entry, runner, frame, drawer)
        if frame not in scored:
            continue
        for _ in range(REPEATS - 1):
            for entry, runner in drawn:
                if not runner.temporal:
                    drawer.start(frame)
                    run(entry, runner, frame, drawer)
        raw, _, _ = drawer.draw(config.raster, params.raster, None)
        moved = (np.asarray(raw.gbuffer.motion), np.asarray(raw.gbuffer.motion_valid))
        score((entry for entry, _ in drawn), frame, truth(shot, frame), moved)
        if competing is not None:
            competing.run(frame, before=True)
            true = competing.draw(frame, REFERENCE_SAMPLES, 1000)
            score(competing.entries, frame, true, moved)
    found = [entry for entry, _ in drawn]
    return found if competing is None else found + competing.entries


def main() -> None:
    """Measures what is asked for, and reads the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="SCENE")
    parser.add_argument("--size", default="640x360", choices=("640x360", "1280x720"))
    parser.add_argument("--motion", choices=MOTIONS, action="append")
    parser.add_argument("--light", choices=LIGHTINGS, action="append")
    parser.add_argument("--references", action="store_true")
    given = parser.parse_args()
    width, height = (int(part) for part in given.size.split("x"))
    memory.suit((height, width))
    file = RESULTS / "accuracy_vs_time.csv"
    for name in given.names or scenes.available():
        loaded = scenes.load(name)
        for light in given.light or LIGHTINGS:
            world = competitor.one_light(loaded) if light == "one" else loaded
            for motion in given.motion or MOTIONS:
                shot = scenes.shot(world, motion, size=(height, width))
                key = (name, motion, light, given.size)
                if given.references:
                    for frame in SCORED[motion][height]:
                        truth(shot, frame)
                    continue
                rival = light == "one" and agreed(name)
                if light == "one" and not rival:
                    print(
                        f"without Mitsuba: whether it draws {name} alike is to be "
                        "measured first, by experiments/mitsuba_agreement.py",
                        file=sys.stderr,
                    )
                try:
                    found = measure(shot, motion, rival=rival)
                except InputError as problem:
                    if not rival:
                        raise
                    print(f"without Mitsuba: {problem}", file=sys.stderr)
                    found = measure(shot, motion, rival=False)
                kept = []
                if file.is_file():
                    with file.open(encoding="utf-8", newline="") as stream:
                        kept = [
                            r
                            for r in list(csv.reader(stream))[1:]
                            if tuple(r[:4]) != key
                        ]
                rows = [*kept, *([*key, *entry.row()] for entry in found)]
                files.write_csv(file, COLUMNS, rows)
                print(*key, "measured", flush=True)
                jax.clear_caches()


if __name__ == "__main__":
    main()
