"""Segmentation weights fitted by optimistix, and whether they hold elsewhere.

    python experiments/fit_thresholds.py            # all of it
    python experiments/fit_thresholds.py held_out   # or parts, in any order

Walks of typical motion, 12 frames of 320×180 after 8 that are not scored, 0.5 sparse
rays a pixel, references of 64 samples. Parts:

- grid: every scene by itself over a grid of 729 parameters, 160×90;
- search: optimistix against the grid, three scenes;
- fitted: to all scenes; writes `data/fitted.toml`;
- held_out: leave one scene out;
- paths: other paths of fitted scenes;
- attribution: what each criterion is worth, missed failures and wasted rays;
- rank: how well the relaxed loss predicts the hard one;
- contrast: the response's contrast, all else as in `data/fitted.toml`;
- speed: how long either search takes on three sequences of 320×180.
"""

import csv
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scenes
from scipy.stats import spearmanr

from ataa_jax import cache, files, parameters, pipeline
from ataa_jax import fit as fits
from ataa_jax import world as worlds
from ataa_jax.fit import attribution as attribution_of
from ataa_jax.fit import optimize, relaxed, result, score, soft, space, yardsticks
from ataa_jax.stopwatch import Stopwatch

RESULTS = Path(__file__).parent / "results"
FITTED = Path(__file__).resolve().parents[1] / "data" / "fitted.toml"
SIZE, FRAMES, BUDGET = (180, 320), 12, 0.5
SMALL = (90, 160)  # of the grid and what stands beside it
GRID = "fit_grid.csv"
STEPS = 16  # our choice: of 34 the last half moved SSIM by under 0.00001
OPTIONS = fits.Options(budget=BUDGET)
# The relaxed fit alone: Nelder–Mead after it moves SSIM by under 0.0005, see `fitted`.
QUICK = replace(OPTIONS, steps=0)
# Paths of other kinds and speeds than what is fitted to.
PATHS = (("pan", "typical"), ("dolly", "typical"), ("walk", 0.03))
CONTRAST_SCENES = (worlds.BUILTIN, "sponza", "cesium_milk_truck")
GRID_SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
SEARCHED = (*space.weights(OPTIONS.terms), space.HOLD)


def recording(
    name: str,
    kind: str = "walk",
    motion: str | float = "typical",
    size: tuple[int, int] = SIZE,
) -> fits.Recording:
    """Records a scene along a path, or finds it in the cache."""
    shot = scenes.shot(scenes.load(name), kind, motion, size)
    made = fits.record(shot, frames=FRAMES)
    return replace(made, name=name if kind == "walk" else f"{name}:{kind}")


def write(name: str, head: tuple[str, ...], rows: list[tuple]) -> None:
    """Writes a table of results; SSIM needs five digits."""
    cells = [[f"{c:.5f}" if isinstance(c, float) else c for c in row] for row in rows]
    with (RESULTS / name).open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(head)
        writer.writerows(cells)


def say(text: str, done: int, total: int) -> None:
    print(f"  {text} ({done}/{total})", file=sys.stderr, flush=True)


def run(
    seen: list[fits.Recording],
    unseen: list[fits.Recording],
    options: fits.Options,
) -> fits.Fitted:
    kept = fits.checkpoints_of(seen, options, cache.folder() / "fit")
    return fits.fit(seen, options, held_out=unseen, checkpoints=kept, progress=say)


STANDING = (
    "scene", "taa", "random", "equal", "grid", "fitted", "oracle", "efficiency",
    "closed", "rays", "threshold", "carried", "carried_rays",
)  # fmt: skip


def row(s: fits.Standing, grid_ssim: float) -> tuple:
    return (
        s.scene, s.taa, s.random, s.equal, grid_ssim, s.fitted, s.oracle, s.efficiency,
        s.closed, s.rays, s.threshold, s.carried, s.carried_rays,
    )  # fmt: skip


def fitted(names: list[str]) -> None:
    """Fits to all scenes."""
    recorded = [recording(name) for name in names]
    found = run(recorded, [], OPTIONS)
    result.write(found, {}, FITTED)
    grids = [by_grid(made, names) for made in recorded]
    write("fit_all.csv", STANDING, list(map(row, found.standings, grids)))


def held_out(names: list[str]) -> None:
    """Leaves each scene out: fits to the others, and scores it."""
    recorded = {name: recording(name) for name in names}
    rows = []
    for left_out in names:
        others = [name for name in names if name != left_out]
        seen = [recorded[name] for name in others]
        unseen = [recorded[left_out]]
        found = run(seen, unseen, QUICK)
        own = found.params.segmentation
        weights = [
            float(getattr(own, f"{term}_weight")) for term in found.options.terms
        ]
        (standing,), grid_ssim = found.held_out, by_grid(recorded[left_out], others)
        rows.append((*row(standing, grid_ssim), *weights, int(own.hold)))
        print(*rows[-1], flush=True)
    head = (*STANDING, *(f"{term}_weight" for term in OPTIONS.terms), "hold")
    write("fit_held_out.csv", head, rows)


def paths(names: list[str]) -> None:
    """Other camera paths of the scenes that were fitted to."""
    recorded = [recording(name) for name in names]
    others = [recording(n, *path) for n in GRID_SCENES if n in names for path in PATHS]
    found = run(recorded, others, QUICK)
    grids = [by_grid(made, names) for made in others]
    write("fit_paths.csv", STANDING, list(map(row, found.held_out, grids)))


def rank(names: list[str], draws: int = 40) -> None:
    """Draws parameters at random; compares the relaxed loss's order with the hard."""
    rng = np.random.default_rng(0)
    rows = []
    for name in names:
        made = recording(name)
        config = space.switched(made.config.segmentation, OPTIONS.terms)
        take = fits.Take.of(made).under(config)
        quantities = space.weights(OPTIONS.terms)
        base = space.place(made.params, (space.HOLD,), jnp.zeros(1))
        first = score.at_budget(take, base, BUDGET)
        at = space.with_threshold(base, jnp.float32(first.threshold), config)
        pixels = relaxed.gather((take,), (at,), OPTIONS.terms)
        soft, hard = [], []
        for _ in range(draws):
            u = jnp.asarray(rng.uniform(size=len(quantities)), jnp.float32)
            own = space.place(base, quantities, u)
            hard.append(1.0 - score.at_budget(take, own, BUDGET).ssim)
            soft.append(relaxed.at_budget(own, pixels, OPTIONS.terms, BUDGET))
            rows.append((name, soft[-1], hard[-1]))
        correlation, _ = spearmanr(soft, hard)
        print(name, correlation, flush=True)
    write("fit_rank.csv", ("scene", "relaxed", "hard"), rows)


def attribution(names: list[str]) -> None:
    """What each criterion is worth alone, and what is lost without it."""
    rows, pictures = [], {}
    for name in names:
        made = recording(name)
        plain = fits.Take.of(made)
        params = parameters.load(FITTED, made.params)
        terms = OPTIONS.terms
        cases: dict[str, tuple[tuple[str, ...], pipeline.Params]] = {
            "paper, equal weights": (space.PAPER_TERMS, made.params),
            "fitted": (terms, params),
            **{f"{term} alone": ((term,), params) for term in terms},
            **{
                f"without {term}": (tuple(t for t in terms if t != term), params)
                for term in terms
            },
        }
        for label, (on, own) in cases.items():
            take = plain.under(space.switched(plain.config.segmentation, on))
            found = score.at_budget(take, own, BUDGET)
            at = space.with_threshold(
                own, jnp.float32(found.threshold), take.config.segmentation
            )
            bought = attribution_of.bought(take, at, on)
            rows.append(
                (name, label, found.ssim, bought.removed_per_ray, bought.missed,
                 bought.wasted, found.rays)
            )  # fmt: skip
            print(*rows[-1], flush=True)
            if name == worlds.BUILTIN and label in ("paper, equal weights", "fitted"):
                pictures[label] = attribution_of.picture(take, at, on, FRAMES // 2)
    head = (
        "scene", "criteria", "ssim", "removed_per_ray", "missed", "wasted", "rays",
    )  # fmt: skip
    write("fit_attribution.csv", head, rows)
    both = np.concatenate([pictures["paper, equal weights"], pictures["fitted"]], 1)
    files.write_png(RESULTS / "fit_attribution.png", both)


def contrast(names: list[str]) -> None:
    """How much the response should heed the picture's contrast; 1,000: not at all."""
    rows = []
    for name in (n for n in CONTRAST_SCENES if n in names):
        made = recording(name)
        plain, params = fits.Take.of(made), parameters.load(FITTED, made.params)
        take = plain.under(space.switched(plain.config.segmentation, OPTIONS.terms))
        for value in (1e3, 0.12, 0.06, 0.03, 0.015):
            own = eqx.tree_at(
                lambda p: p.segmentation.response_contrast, params, jnp.float32(value)
            )
            found = score.at_budget(take, own, BUDGET)
            rows.append((name, f"{value:g}", found.ssim, found.threshold))
            print(*rows[-1], flush=True)
    write("fit_contrast.csv", ("scene", "contrast", "ssim", "threshold"), rows)


def begin(
    names: Sequence[str], size: tuple[int, int]
) -> tuple[tuple[fits.Take, ...], pipeline.Params]:
    """Returns recordings under the fit's own terms, and where the fit starts.

    The start is the paper's weights, without hold.
    """
    recorded = [recording(name, size=size) for name in names]
    config = space.switched(recorded[0].config.segmentation, OPTIONS.terms)
    takes = tuple(fits.Take.of(each).under(config) for each in recorded)
    return takes, space.place(recorded[0].params, (space.HOLD,), jnp.zeros(1))


def grid(names: list[str]) -> None:
    """Scores each scene by itself at every point of a grid over the fit's bounds."""
    rows: list[tuple] = []
    for name in names:
        takes, start = begin([name], SMALL)
        points = yardsticks.grid(takes, start, SEARCHED, BUDGET, progress=say)
        rows += [(name, *map(float, point), ssim) for point, (ssim,) in points]
    write(GRID, ("scene", *(q.name for q in SEARCHED), "ssim"), rows)


def best_of_grid(names: Sequence[str]) -> tuple[list[float], float, int]:
    """Returns the grid's best point for these scenes, its mean SSIM, its points."""
    scores: dict[tuple[float, ...], dict[str, float]] = {}
    with (RESULTS / GRID).open(newline="") as stream:
        for name, *cells in list(csv.reader(stream))[1:]:
            *point, ssim = map(float, cells)
            scores.setdefault(tuple(point), {})[name] = ssim
    means = {
        point: float(np.mean([by_scene[name] for name in names]))
        for point, by_scene in scores.items()
    }
    best = max(means, key=lambda point: means[point])
    return list(best), means[best], len(means)


def by_grid(made: fits.Recording, names: Sequence[str]) -> float:
    """Returns the SSIM of a recording under the grid's best point for these scenes."""
    point, _, _ = best_of_grid(names)
    config = space.switched(made.config.segmentation, OPTIONS.terms)
    params = space.place(made.params, SEARCHED, jnp.asarray(point))
    return score.at_budget(fits.Take.of(made).under(config), params, BUDGET).ssim


def alone_by_nelder_mead(
    takes: tuple[fits.Take, ...], start: pipeline.Params
) -> optimize.Found:
    """Runs Nelder–Mead in closed loop, from a simplex half as wide as the bounds."""
    return optimize.nelder_mead(
        score.compiled(SEARCHED),
        space.coordinates(start, SEARCHED),
        (takes, start, jnp.float32(BUDGET)),
        steps=STEPS,
        reach=0.5,
        tolerance=2e-6,
        progress=say,
    )


def search(names: list[str]) -> None:
    """The relaxed fit, and Nelder–Mead alone, beside the grid's best point."""
    among = [name for name in GRID_SCENES if name in names]
    takes, start = begin(among, SMALL)
    found = soft.fit(takes, start, OPTIONS.terms, BUDGET)
    at = map(float, space.coordinates(found.params, SEARCHED))
    own = ("relaxed fit", *at, found.hard_ssim, found.hard_evaluations)
    rows: list[tuple] = [(*own, found.evaluations)]
    alone = alone_by_nelder_mead(takes, start)
    at = map(float, space.free(jnp.asarray(alone.x)))
    rows.append(("Nelder–Mead", *at, 1.0 - alone.value, alone.evaluations, 0))
    point, ssim, points = best_of_grid(among)
    rows.append(("grid", *point, ssim, points, 0))
    head = ("by", *(q.name for q in SEARCHED), "ssim", "evaluations", "relaxed")
    write("fit_search.csv", head, rows)
    print(*rows, sep="\n", flush=True)


def speed(names: list[str]) -> None:
    """The time of either search, its compiling included, its recordings there."""
    takes, start = begin([name for name in GRID_SCENES if name in names], SIZE)
    watch = Stopwatch()
    found = soft.fit(takes, start, OPTIONS.terms, BUDGET)
    relaxed_lap = watch.lap()
    watch.start()
    alone = alone_by_nelder_mead(takes, start)
    counted = (
        ("relaxed fit", found.hard_evaluations, found.evaluations, found.hard_ssim,
         relaxed_lap),
        ("Nelder–Mead", alone.evaluations, 0, 1.0 - alone.value, watch.lap()),
    )  # fmt: skip
    head = ("by", "sequences", "frames", "evaluations", "relaxed", "ssim", "seconds")
    rows = [
        (by, len(takes), FRAMES, *counts, 1e-3 * lap.clock_ms, 1e-3 * lap.processor_ms)
        for by, *counts, lap in counted
    ]
    write("fit_speed.csv", (*head, "processor_s"), rows)


PARTS = {
    "grid": grid,
    "search": search,
    "fitted": fitted,
    "held_out": held_out,
    "paths": paths,
    "attribution": attribution,
    "rank": rank,
    "contrast": contrast,
    "speed": speed,
}


def main() -> None:
    """Runs the parts asked for, or all."""
    names = scenes.available()
    for part in sys.argv[1:] or PARTS:
        PARTS[part](names)
        jax.clear_caches()  # a process has room for so many programs


if __name__ == "__main__":
    main()
