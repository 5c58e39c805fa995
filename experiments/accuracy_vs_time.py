"""What a step of accuracy costs in time: all methods, and Mitsuba 3, beside each other.

Every scene on a walk of typical motion and under a still camera. Two lightings: the
scene's *own*, and *one* directional light and nothing else (`competitor.one_light`),
which Mitsuba draws too; it is left out with a word where it is not installed. Scored
frames follow a lead-in; each renderer is scored against its own reference of 256
samples, averaged in its own space (experiments/mitsuba_agreement.py has how the two
agree). All methods take turns frame by frame in one process, so that other work on the
machine falls on all alike; a time is that of all of a frame's stages, compiled,
without copying or scoring; medians and quartiles. Mitsuba's is of `render` alone, with
the scene in place and its kernel compiled.

    python experiments/accuracy_vs_time.py                    # 640×360, every scene
    python experiments/accuracy_vs_time.py --size 1280x720 sponza
    python experiments/accuracy_vs_time.py --references       # only renders those
    python experiments/accuracy_vs_time.py --draw             # only reads the table

Writes results/accuracy_vs_time.csv (rows of what was measured anew are replaced),
accuracy_vs_time_read.csv, what it says in plain numbers, and two pictures.
"""

import argparse
import csv
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import matplotlib as mpl
import numpy as np
import scenes

from ataa_jax import color as colors
from ataa_jax import competitor, files, fxaa, methods, metrics, pipeline, reference
from ataa_jax import world as worlds
from ataa_jax.errors import InputError

mpl.use("Agg")
from matplotlib import pyplot as plt

RESULTS = Path(__file__).parent / "results"
REFERENCE_SAMPLES = 256
LEAD_IN = 8
MOTIONS, LIGHTINGS = ("walk", "still"), ("own", "one")
# Frames that are scored, by rows of the image; a reference of 1280×720 takes minutes.
SCORED = {"walk": {360: (0, 5, 10), 720: (0,)}, "still": {360: (8,), 720: (8,)}}
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
    *("ms", "ms_q1", "ms_q3"),
    *(f"{stage}_ms" for stage in STAGES),
)
READ = (
    *KEY,
    *("ssim_ataa8", "ataa8_ms", "ssaa_samples", "ssaa_ms", "ssaa_over_ataa8"),
    *("mitsuba_spp", "mitsuba_ms", "mitsuba_over_ataa8"),
    *("ssim_ssaa_at_ms", "ssim_mitsuba_at_ms", "ataa8_over_mitsuba8"),
    *("ssaa8_over_ataa8", "ssaa8_over_mitsuba8"),
)


@dataclass
class Entry:
    """One method at one setting: its scores and times."""

    method: str
    budget: float | None = None
    images: dict[int, np.ndarray] = field(default_factory=dict)  # a frame, as shown
    frame_ms: list[float] = field(default_factory=list)
    stage_ms: dict[str, list[float]] = field(default_factory=dict)
    scores: list[tuple[float, float, float, float]] = field(default_factory=list)
    rays: float | None = None

    def row(self) -> list[str]:
        """Returns its cells of the table, behind the key."""
        low, middle, high = np.percentile(self.frame_ms, (25, 50, 75))
        means = np.array(self.scores).mean(axis=0)
        stages = (self.stage_ms.get(stage) for stage in STAGES)
        numbers = [
            *(self.budget, self.rays, *means, middle, low, high),
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
        times = {stage: ms[-1] for stage, ms in runner.times.items()}
        entry.frame_ms.append(sum(times.values()))
        for stage, ms in times.items():
            entry.stage_ms.setdefault(stage, []).append(ms)


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
                start = time.perf_counter()
                self.drawer.render(frame, spp, frame + 2)
                entry.frame_ms.append(1e3 * (time.perf_counter() - start))


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


def read(rows: list[dict[str, str]]) -> list[list[str]]:
    """Returns what the table says: at equal quality, and at equal time."""
    found = []
    for key in dict.fromkeys(tuple(row[k] for k in KEY) for row in rows):
        own = [row for row in rows if tuple(row[k] for k in KEY) == key]
        at = {
            (r["method"], r["budget"]): (float(r["ssim"]), float(r["ms"])) for r in own
        }
        ssim, ms = at["ataa8", f"{pipeline.BUDGET:.5g}"]
        cells: list[float | None] = [ssim, ms]
        times: list[float | None] = []
        for kind, counts in (("ssaa", SSAA), ("mitsuba", MITSUBA)):
            points = [
                (n, *at[f"{kind}{n}", ""]) for n in counts if (f"{kind}{n}", "") in at
            ]
            there = _at_quality(points, ssim)
            cells += [*there, there[1] / ms if there[1] else None]
            times.append(_at_time(points, ms))
        ssaa8, mitsuba8 = at["ssaa8", ""][1], at.get(("mitsuba8", ""), (0.0, 0.0))[1]
        cells += [*times, ms / mitsuba8 if mitsuba8 else None, ssaa8 / ms]
        cells.append(ssaa8 / mitsuba8 if mitsuba8 else None)
        found.append([*key, *("" if c is None else f"{c:.5g}" for c in cells)])
    return found


def _at_quality(
    points: list[tuple[int, float, float]], ssim: float
) -> tuple[float | None, float | None]:
    """Returns samples and ms at which a brute-force method reaches an SSIM.

    Interpolated in the logarithms of samples, ms and 1 − SSIM; None outside the points.
    """
    if not points or not points[0][1] <= ssim <= points[-1][1]:
        return None, None
    samples, reached, ms = (np.array(part) for part in zip(*points, strict=True))
    x, at = -np.log(1.0 - np.maximum.accumulate(reached)), -np.log(1.0 - ssim)
    of_samples, of_ms = (np.interp(at, x, np.log(y)) for y in (samples, ms))
    return float(np.exp(of_samples)), float(np.exp(of_ms))


def _at_time(points: list[tuple[int, float, float]], ms: float) -> float | None:
    """Returns the SSIM a brute-force method reaches in a time; None outside."""
    if not points or not points[0][2] <= ms <= points[-1][2]:
        return None
    _, reached, times = (np.array(part) for part in zip(*points, strict=True))
    left = np.interp(np.log(ms), np.log(times), np.log(1.0 - reached))
    return float(1.0 - np.exp(left))


FAMILIES: dict[str, tuple[str, Callable[[str], bool]]] = {
    "SSAA 2–32x": ("#2f66cf", lambda m: m.startswith("ssaa")),
    "Mitsuba 3, 1–32 spp": ("#8a4fbf", lambda m: m.startswith("mitsuba")),
    "ATAA 8x, 0.12–0.48 rays": ("#2a9d4a", lambda m: m == "ataa8"),
    "ATAA 4x": ("#7fbf5f", lambda m: m == "ataa4"),
    "ATAA 2x": ("#b9d98f", lambda m: m == "ataa2"),
    "TAA, tuned": ("#d23b3b", lambda m: m == "taa"),
    "TAA, literature": ("#e58a3c", lambda m: m == "taa_ue4"),
    "FXAA 12, 39": ("#c9a227", lambda m: m.startswith("fxaa")),
    "no AA": ("#555555", lambda m: m == "none"),
}


def draw(
    rows: list[dict[str, str]], motion: str, light: str, size: str, file: Path
) -> None:
    """Draws error against time, a panel a scene."""
    own = [
        r for r in rows if (r["motion"], r["light"], r["size"]) == (motion, light, size)
    ]
    names = list(dict.fromkeys(row["scene"] for row in own))
    if not names:
        return
    figure, axes = plt.subplots(2, 3, figsize=(13, 7.6), squeeze=False)
    for axis, name in zip(axes.flat, names, strict=False):
        for label, (color, belongs) in FAMILIES.items():
            points = [
                (float(r["ms"]), 1.0 - float(r["ssim"]))
                for r in own
                if r["scene"] == name and belongs(r["method"])
            ]
            if points:
                axis.loglog(
                    *zip(*points, strict=True), "o-", ms=4, c=color, label=label
                )
        axis.set(title=name, xlabel="ms a frame", ylabel="1 − SSIM")
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].legend(fontsize=7)
    figure.suptitle(f"{motion}, {light} light, {size}, 2 CPU cores", fontsize=10)
    figure.tight_layout()
    figure.savefig(file, dpi=80, metadata={"Software": None})
    plt.close(figure)


def draw_stages(rows: list[dict[str, str]], size: str, file: Path) -> None:
    """Draws where a frame's time goes, a bar a method, a panel a scene."""
    own = [
        r for r in rows if (r["motion"], r["light"], r["size"]) == ("walk", "own", size)
    ]
    names = list(dict.fromkeys(row["scene"] for row in own))
    if not names:
        return
    full = f"{pipeline.BUDGET:.5g}"
    shown = ("none", "fxaa39", "taa", "ataa2", "ataa4", "ataa8", "ssaa8")
    figure, axes = plt.subplots(2, 3, figsize=(13, 7), squeeze=False)
    for axis, name in zip(axes.flat, names, strict=False):
        bars = {
            r["method"]: r
            for r in own
            if r["scene"] == name and r["budget"] in ("", full)
        }
        left = np.zeros(len(shown))
        for stage in STAGES:
            wide = np.array([float(bars[m][f"{stage}_ms"] or 0.0) for m in shown])
            axis.barh(shown, wide, left=left, label=stage)
            left += wide
        axis.invert_yaxis()
        axis.set(title=name, xlabel="ms a frame")
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(file, dpi=80, metadata={"Software": None})
    plt.close(figure)


def report(file: Path) -> None:
    """Writes and prints what the table says, and draws it."""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    told = read(rows)
    files.write_csv(RESULTS / "accuracy_vs_time_read.csv", READ, told)
    for cells in told:
        print("; ".join(f"{k} {v}" for k, v in zip(READ, cells, strict=True) if v))
    draw(rows, "walk", "one", "640x360", RESULTS / "accuracy_vs_time.png")
    draw_stages(rows, "640x360", RESULTS / "accuracy_vs_time_stages.png")


def main() -> None:
    """Measures what is asked for, and reads the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="SCENE")
    parser.add_argument("--size", default="640x360", choices=("640x360", "1280x720"))
    parser.add_argument("--motion", choices=MOTIONS, action="append")
    parser.add_argument("--light", choices=LIGHTINGS, action="append")
    parser.add_argument("--references", action="store_true")
    parser.add_argument("--draw", action="store_true")
    given = parser.parse_args()
    width, height = (int(part) for part in given.size.split("x"))
    file = RESULTS / "accuracy_vs_time.csv"
    for name in () if given.draw else given.names or scenes.available():
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
                rival = light == "one"
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
    if file.is_file() and not given.references:
        report(file)


if __name__ == "__main__":
    main()
