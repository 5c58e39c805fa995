"""What `accuracy_vs_time.csv` says: at equal quality, at equal time, and in pictures.

    python experiments/accuracy_read.py

Writes results/accuracy_vs_time_read.csv, and draws error against time and where a
frame's time goes. Every figure is read twice: by the clock, and by the processor time
of all threads. Between the sample counts of a brute-force method lies a line in the
logarithms of samples, time and 1 − SSIM.
"""

import csv
import itertools
from collections.abc import Callable
from pathlib import Path

import figures
import numpy as np
from accuracy_vs_time import KEY, MITSUBA, SSAA, STAGES
from matplotlib import pyplot as plt
from matplotlib import ticker

from ataa_jax import files, pipeline

RESULTS = Path(__file__).parent / "results"
CLOCKS = {"clock": "ms", "processor": "processor_ms"}
READ = (
    *(*KEY, "time"),
    *("ssim_ataa8", "ataa8_ms", "ssaa_samples", "ssaa_ms", "ssaa_over_ataa8"),
    *("mitsuba_spp", "mitsuba_ms", "mitsuba_over_ataa8"),
    *("ssim_ssaa_at_ms", "ssim_mitsuba_at_ms", "ataa8_over_mitsuba8"),
    *("ssaa8_over_ataa8", "ssaa8_over_mitsuba8"),
)


def read(rows: list[dict[str, str]]) -> list[list[str]]:
    """Returns what the table says: at equal quality, and at equal time."""
    found = []
    keys = dict.fromkeys(tuple(row[k] for k in KEY) for row in rows)
    for key, (clock, column) in itertools.product(keys, CLOCKS.items()):
        own = [row for row in rows if tuple(row[k] for k in KEY) == key]
        at = {
            (r["method"], r["budget"]): (float(r["ssim"]), float(r[column]))
            for r in own
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
        found.append([*key, clock, *("" if c is None else f"{c:.5g}" for c in cells)])
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
        axis.xaxis.set_major_locator(ticker.LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter(ticker.StrMethodFormatter("{x:g}"))
        axis.xaxis.set_minor_formatter(ticker.NullFormatter())
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].legend(fontsize=7)
    figure.suptitle(f"{motion}, {light} light, {size}, 2 CPU cores", fontsize=10)
    figure.tight_layout()
    figures.save(figure, file)


def draw_stages(rows: list[dict[str, str]], size: str, file: Path) -> None:
    """Draws where a frame's time goes, a bar a method, a panel a scene."""
    own = [
        r for r in rows if (r["motion"], r["light"], r["size"]) == ("walk", "one", size)
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
    figures.save(figure, file)


def main() -> None:
    """Reads the table; writes and prints what it says, and draws it."""
    with (RESULTS / "accuracy_vs_time.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    told = read(rows)
    files.write_csv(RESULTS / "accuracy_vs_time_read.csv", READ, told)
    for cells in told:
        print("; ".join(f"{k} {v}" for k, v in zip(READ, cells, strict=True) if v))
    for motion, file in (("walk", "accuracy_vs_time"), ("still", "accuracy_at_rest")):
        draw(rows, motion, "one", "640x360", RESULTS / f"{file}.png")
        draw(rows, motion, "one", "1280x720", RESULTS / f"{file}_720.png")
    draw_stages(rows, "640x360", RESULTS / "accuracy_vs_time_stages.png")


if __name__ == "__main__":
    main()
