"""Weights fitted on an engine's frames: do they hold on another path of the scene?

    ATAA_BPY=…/bin/python python experiments/capture_fit.py captures

Captures of the built-in scene by Blender's Cycles (`blender_capture.py`) along two
camera paths at 320×180: 4 frames of lead-in, 12 that are scored, images of 8 samples in
the place of rays, references of 32 samples. Those that `captures` lacks are rendered,
by the Python that `ATAA_BPY` names, which has bpy 4.5.3. Each is checked, fitted to at
0.5 rays a pixel, and the weights found are scored on the other.

`results/capture_fit.csv` holds SSIM, every contender's threshold solved for the budget
on the sequence it is scored on: TAA; pixels drawn at random; the paper's two criteria
and then all three, weighted equally; the shipped weights (`data/fitted.toml`, fitted to
this package's own frames); the capture's; the oracle. `closed` is the way from the
paper's equal weights to the oracle; `carried` the file untouched. Both paths start at
the scene's first camera, so that part of what they see is the same.
"""

import argparse
import csv
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

from ataa_jax import cache, capture, parameters, segmentation
from ataa_jax import fit as fits
from ataa_jax.capture import check
from ataa_jax.fit import score, space

HERE = Path(__file__).parent
FITTED = HERE.parent / "data" / "fitted.toml"
PATHS = ("walk", "pan")
SIZE, LEAD_IN, FRAMES, BUDGET = "320x180", 4, 12, 0.5
OPTIONS = fits.Options(budget=BUDGET)
HEAD = (
    "fitted_on", "scored_on", "taa", "random", "equal", "equal_three", "shipped",
    "fitted", "oracle", "closed", "rays", "threshold", "carried", "carried_rays",
    "luminance_weight", "depth_weight", "response_weight", "hold", "reset_px",
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the captures")
    folder = parser.parse_args().folder
    recorded = [recording(folder / kind, kind) for kind in PATHS]
    others = {each.name: unfitted(each) for each in recorded}
    rows = []
    for seen in recorded:
        unseen = [each for each in recorded if each is not seen]
        kept = fits.checkpoints_of([seen], OPTIONS, cache.folder() / "fit")
        found = fits.fit(
            [seen], OPTIONS, held_out=unseen, checkpoints=kept, progress=say
        )
        for standing in (*found.standings, *found.held_out):
            rows.append(row(found, standing, others[standing.scene]))
            print(*rows[-1], flush=True)
    with (HERE / "results" / "capture_fit.csv").open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(HEAD)
        writer.writerows(rows)


def say(text: str, done: int, total: int) -> None:
    print(f"  {text} ({done}/{total})", file=sys.stderr, flush=True)


def recording(place: Path, kind: str) -> fits.Recording:
    """Reads a capture, checked; renders it where it is not there."""
    if not (place / "capture.toml").is_file():
        render(place, kind)
    report = check.check(capture.load(place))
    check.refuse(report)
    for finding in report.findings:
        print(f"{kind}: {finding.severity}: {finding.sentence}", file=sys.stderr)
    made = fits.record_capture(report.capture.after(LEAD_IN), frames=FRAMES)
    return replace(made, name=kind)


def render(place: Path, kind: str) -> None:
    """Renders the built-in scene along a path in Blender."""
    place.parent.mkdir(parents=True, exist_ok=True)
    scene = place.with_suffix(".npz")
    export = [sys.executable, HERE / "blender_export.py", "builtin", kind, scene]
    export += ["--frames", LEAD_IN + FRAMES, "--size", SIZE]
    draw = [os.environ["ATAA_BPY"], HERE / "blender_capture.py", "--world", scene]
    draw += ["--out", place, "--samples", "8", "--reference-samples", "32"]
    for words in (export, draw):
        subprocess.run([str(word) for word in words], check=True)


def unfitted(made: fits.Recording) -> tuple[float, float]:
    """Returns SSIM of all three terms weighted equally, and of the shipped weights."""
    plain = fits.Take.of(made)
    three = space.switched(plain.config.segmentation, OPTIONS.terms)
    table = parameters.read(FITTED)
    shipped = parameters.override(made.params, table, FITTED.name)
    choices = parameters.choices(table, segmentation.Config(), FITTED.name)
    return (
        score.at_budget(plain.under(three), made.params, BUDGET).ssim,
        score.at_budget(plain.under(choices), shipped, BUDGET).ssim,
    )


def row(
    found: fits.Fitted, s: fits.Standing, others: tuple[float, float]
) -> tuple[str | int, ...]:
    own = found.params.segmentation
    numbers = (
        s.taa, s.random, s.equal, *others, s.fitted, s.oracle, s.closed, s.rays,
        s.threshold, s.carried, s.carried_rays, own.luminance_weight, own.depth_weight,
        own.response_weight,
    )  # fmt: skip
    return (
        found.standings[0].scene,
        s.scene,
        *(f"{float(number):.5f}" for number in numbers),
        int(own.hold),
        f"{float(own.reset_px):.3f}",
    )


if __name__ == "__main__":
    main()
