"""Segmentation weights fitted by optimistix, and whether they hold elsewhere.

    python experiments/fit_thresholds.py            # all of it
    python experiments/fit_thresholds.py held_out   # or parts, in any order

Walks of typical motion, 12 frames of 320×180 after 8 that are not scored, 0.5 sparse
rays a pixel, references of 64 samples. Parts:

- fitted: to all scenes; writes `data/fitted.toml`;
- held_out: leave one scene out; and other paths of fitted scenes;
- attribution: what each criterion is worth, missed failures and wasted rays;
- rank: how well the relaxed loss predicts the hard one;
- contrast: the response's contrast, all else as in `data/fitted.toml`;
- grid: optimistix against a grid search of the same parameters, 160×90;
- speed: how long the relaxed fit takes on three sequences.
"""

import csv
import sys
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scenes
from scipy.stats import spearmanr

from ataa_jax import cache, files, parameters, pipeline
from ataa_jax import fit as fits
from ataa_jax import world as worlds
from ataa_jax.fit import attribution as attribution_of
from ataa_jax.fit import optimize, relaxed, result, score, soft, space, yardsticks
from ataa_jax.stopwatch import Lap, Stopwatch

RESULTS = Path(__file__).parent / "results"
FITTED = Path(__file__).resolve().parents[1] / "data" / "fitted.toml"
SIZE, FRAMES, BUDGET = (180, 320), 12, 0.5
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
    "scene", "taa", "random", "equal", "fitted", "oracle", "efficiency", "closed",
    "rays", "threshold", "carried", "carried_rays",
)  # fmt: skip


def row(s: fits.Standing) -> tuple:
    return (
        s.scene, s.taa, s.random, s.equal, s.fitted, s.oracle, s.efficiency, s.closed,
        s.rays, s.threshold, s.carried, s.carried_rays,
    )  # fmt: skip


def fitted(names: list[str]) -> None:
    """Fits to all scenes."""
    found = run([recording(name) for name in names], [], OPTIONS)
    result.write(found, {}, FITTED)
    write("fit_all.csv", STANDING, [row(s) for s in found.standings])


def held_out(names: list[str]) -> None:
    """Leaves each scene out; then other paths of the scenes that were fitted to."""
    recorded = {name: recording(name) for name in names}
    rows = []
    for left_out in names:
        seen = [recorded[name] for name in names if name != left_out]
        unseen = [recorded[left_out]]
        found = run(seen, unseen, QUICK)
        own = found.params.segmentation
        weights = [
            float(getattr(own, f"{term}_weight")) for term in found.options.terms
        ]
        rows.append((*row(found.held_out[0]), *weights, int(own.hold)))
        print(*rows[-1], flush=True)
    head = (*STANDING, *(f"{term}_weight" for term in OPTIONS.terms), "hold")
    write("fit_held_out.csv", head, rows)


def paths(names: list[str]) -> None:
    """Other camera paths of the scenes that were fitted to."""
    recorded = [recording(name) for name in names]
    others = [recording(n, *path) for n in GRID_SCENES if n in names for path in PATHS]
    found = run(recorded, others, QUICK)
    write("fit_paths.csv", STANDING, [row(s) for s in found.held_out])


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


def search(
    names: list[str], size: tuple[int, int]
) -> tuple[tuple[fits.Take, ...], pipeline.Params, soft.SoftFit, Lap]:
    """Runs the relaxed fit on three recordings; returns these, the start, it, its time.

    The start is the fit's own: the paper's weights, without hold.
    """
    recorded = [recording(n, size=size) for n in GRID_SCENES if n in names]
    config = space.switched(recorded[0].config.segmentation, OPTIONS.terms)
    takes = tuple(fits.Take.of(each).under(config) for each in recorded)
    start = space.place(recorded[0].params, (space.HOLD,), jnp.zeros(1))
    watch = Stopwatch()
    found = soft.fit(takes, start, OPTIONS.terms, BUDGET)
    return takes, start, found, watch.lap()


def grid(names: list[str]) -> None:
    """The relaxed fit, and Nelder–Mead alone, against a grid over the same bounds."""
    takes, start, found, _ = search(names, (90, 160))
    at = map(float, space.coordinates(found.params, SEARCHED))
    own = ("relaxed fit", *at, found.hard_ssim, found.hard_evaluations)
    rows: list[tuple] = [(*own, found.evaluations)]
    alone = optimize.nelder_mead(
        score.compiled(SEARCHED),
        space.coordinates(start, SEARCHED),
        (takes, start, jnp.float32(BUDGET)),
        steps=24,
        progress=say,
    )
    at = map(float, space.free(jnp.asarray(alone.x)))
    rows.append(("Nelder–Mead", *at, 1.0 - alone.value, alone.evaluations, 0))
    points = yardsticks.grid(takes, start, SEARCHED, BUDGET, progress=say)
    rows += [("grid", *map(float, point), ssim, 1, 0) for point, ssim in points]
    head = ("by", *(q.name for q in SEARCHED), "ssim", "evaluations", "relaxed")
    write("fit_grid.csv", head, rows)
    print(*rows[:2], max(ssim for _, ssim in points), len(points), flush=True)


def speed(names: list[str]) -> None:
    """The time of the relaxed fit, its compiling included, its recordings there."""
    _, _, found, lap = search(names, SIZE)
    clock, processor = 1e-3 * lap.clock_ms, 1e-3 * lap.processor_ms
    counts = (found.hard_evaluations, found.evaluations, found.hard_ssim)
    head = ("sequences", "frames", "evaluations", "relaxed", "ssim", "seconds")
    row = (len(GRID_SCENES), FRAMES, *counts, clock, processor)
    write("fit_speed.csv", (*head, "processor_s"), [row])


PARTS = {
    "fitted": fitted,
    "held_out": held_out,
    "paths": paths,
    "attribution": attribution,
    "rank": rank,
    "contrast": contrast,
    "grid": grid,
    "speed": speed,
}


def main() -> None:
    """Runs the parts asked for, or all."""
    names = scenes.available()
    for part in sys.argv[1:] or PARTS:
        PARTS[part](names)


if __name__ == "__main__":
    main()
