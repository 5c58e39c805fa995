"""Writes the README's tables from the CSV files under experiments/results.

python experiments/readme_tables.py
"""

import csv
import re
from collections.abc import Callable
from pathlib import Path

RESULTS = Path(__file__).parent / "results"
README = Path(__file__).parents[1] / "README.md"
NAMES = {
    "builtin": "built-in",
    "sponza": "Sponza",
    "modern_house": "modern house",
    "dutch_ship": "Dutch ship",
    "littlest_tokyo": "Littlest Tokyo",
    "cesium_milk_truck": "milk truck",
}
METHODS = {
    "none": "No AA",
    "fxaa": "FXAA",
    "taa_ue4": "TAA, literature",
    "taa": "TAA, tuned",
    "ataa2": "ATAA 2x",
    "ataa4": "ATAA 4x",
    "ataa8": "ATAA 8x",
    "ataa2_paper": "ATAA 2x, paper's criteria",
    "ataa4_paper": "ATAA 4x, paper's criteria",
    "ataa8_paper": "ATAA 8x, paper's criteria",
    "ataa8_ue4": "ATAA 8x on literature's TAA",
    "ssaa4": "SSAA 4x",
    "ssaa8": "SSAA 8x",
}


def read(name: str) -> list[dict[str, str]]:
    """Returns a results file's rows."""
    with (RESULTS / name).open(newline="") as stream:
        return list(csv.DictReader(stream))


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """Returns a table; all columns but the first are right-aligned."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def percent(text: str) -> str:
    """Returns a share as per cent, or a dash."""
    value = float(text)
    return "–" if value != value else f"{100 * value:.0f} %"


def ratio(text: str) -> str:
    """Returns a ratio, or a dash."""
    value = float(text)
    return "–" if value != value else f"{value:.2f}"


def quality() -> str:
    """SSIM by method and scene, then what ATAA removes."""
    cells = {(row["scene"], row["method"]): row for row in read("quality.csv")}
    scenes = [name for name in NAMES if (name, "taa") in cells]

    def text_of(
        scene: str, method: str, column: str, text: Callable[[str], str]
    ) -> str:
        row = cells.get((scene, method))
        return "–" if row is None else text(row[column])

    def digits(text: str) -> str:
        return f"{float(text):.4f}"

    rows = [
        [label, *(text_of(scene, method, "ssim", digits) for scene in scenes)]
        for method, label in METHODS.items()
        if any((scene, method) in cells for scene in scenes)
    ]
    for label, method, column, text in (
        ("*removed* by ATAA 8x", "ataa8", "taa_error_removed", percent),
        ("… by the paper's criteria", "ataa8_paper", "taa_error_removed", percent),
        ("… on literature's TAA", "ataa8_ue4", "taa_error_removed", percent),
        ("*thin*, ATAA 8x", "ataa8", "thin_mse_ratio", ratio),
        ("… by the paper's criteria", "ataa8_paper", "thin_mse_ratio", ratio),
        ("… on literature's TAA", "ataa8_ue4", "thin_mse_ratio", ratio),
        ("pixels that thin features cross", "ataa8", "thin_share", percent),
        ("rays a pixel, ATAA 8x", "ataa8", "rays_per_pixel", ratio),
    ):
        if any((scene, method) in cells for scene in scenes):
            found = (text_of(scene, method, column, text) for scene in scenes)
            rows.append([label, *found])
    return markdown(["SSIM", *(NAMES[scene] for scene in scenes)], rows)


def shares() -> str:
    """FXAA's and the tracer's shares in typical and rapid motion."""
    rows = [
        [
            f"{NAMES[row['scene']]}, {row['motion']}",
            f"{100 * float(row['fxaa_share']):.1f} %",
            f"{100 * float(row['ataa_share']):.1f} %",
            f"{float(row['rays_per_pixel']):.2f}",
            f"{float(row['rays_per_pixel_without_budget']):.2f}",
        ]
        for row in read("shares.csv")
    ]
    return markdown(
        ["motion", "FXAA pixels", "traced", "rays a pixel", "… without a budget"], rows
    )


def still() -> str:
    """SSIM of a still camera over the frames."""
    table = read("still.csv")
    counts = [key for key in table[0] if key.startswith("ssim_")]
    rows = [
        [f"{NAMES[row['scene']]}: {row['method']}", *(row[key] for key in counts)]
        for row in table
    ]
    head = ["still camera", *(f"{key.removeprefix('ssim_')} frames" for key in counts)]
    return markdown(head, rows)


def failures() -> str:
    """The failure suite: what the mask catches, and the error left."""
    rows = [
        [
            f"({row['letter']}) {row['case']}",
            percent(row["recall"]),
            percent(row["precision"]),
            f"{100 * float(row['fxaa_share']):.1f} %",
            f"{100 * float(row['ataa_share']):.1f} %",
            ratio(str(float(row["ataa_mse"]) / float(row["taa_mse"]))),
        ]
        for row in read("failure_suite.csv")
        if row["criterion"] == "mask"
    ]
    head = ["failure", "recall", "precision", "FXAA", "traced", "error left"]
    return markdown(head, rows)


def hard() -> str:
    """Hard cases by topic."""
    table = read("hard_cases.csv")
    rows = []
    for topic in dict.fromkeys(row["topic"] for row in table):
        own = [row for row in table if row["topic"] == topic]
        held = sum(row["verdict"] == "holds" for row in own)
        rows.append([topic, str(len(own)), str(held)])
    rows.append(["*all*", *(str(sum(int(row[k]) for row in rows)) for k in (1, 2))])
    return markdown(["hard cases", "rows", "hold"], rows)


def fit() -> str:
    """Weights fitted to five scenes, on the sixth."""
    rows = [
        [
            NAMES[row["scene"]],
            *(
                f"{float(row[key]):.4f}"
                for key in ("taa", "random", "equal", "grid", "fitted", "oracle")
            ),
            percent(row["closed"]),
            f"{float(row['carried']):.4f} at {float(row['carried_rays']):.2f}",
        ]
        for row in read("fit_held_out.csv")
    ]
    head = ["SSIM, held out", "TAA", "random", "equal weights", "grid", "fitted"]
    return markdown([*head, "oracle", "closed", "carried over"], rows)


def cost() -> str:
    """What an SSIM costs by each way, in motion, under one directional light."""
    rows = []
    for name in NAMES:
        if (found := _costs(name, "walk", "640x360")) is None:
            continue
        clock, processor = found
        rows.append(
            [
                NAMES[name],
                f"{float(clock['ssim_ataa8']):.4f}",
                f"{float(clock['ataa8_ms']):.0f} ms",
                *(
                    _both(clock, processor, way, count)
                    for way, count in (("ssaa", "samples"), ("mitsuba", "spp"))
                ),
                f"{ratio(clock['ataa8_over_mitsuba8'])}",
                f"{ratio(clock['ssaa8_over_mitsuba8'])}",
            ]
        )
    head = ["one light, moving", "SSIM of ATAA 8x", "its time", "SSAA needs"]
    head += ["Mitsuba 3 needs", "ATAA 8x over Mitsuba 8 spp", "SSAA 8x over it"]
    return markdown(head, rows)


def other_costs() -> str:
    """The same in short, by the clock: with the camera at rest and larger images."""
    ways = {
        "at rest, 640×360": ("still", "640x360"),
        "at rest, 1280×720": ("still", "1280x720"),
        "moving, 1280×720": ("walk", "1280x720"),
    }
    rows = []
    for name in NAMES:
        cells: list[str] = []
        for motion, size in ways.values():
            if (found := _costs(name, motion, size)) is None:
                cells += ["–", "–", "–"]
                continue
            clock, _ = found
            ssim, ms = float(clock["ssim_ataa8"]), float(clock["ataa8_ms"])
            cells.append(f"{ssim:.4f}, {ms:.0f} ms")
            for other in ("ssaa", "mitsuba"):
                times = clock[f"{other}_over_ataa8"]
                cells.append(f"{ratio(times)}×" if times else "–")
        rows.append([NAMES[name], *cells])
    head = ["one light"]
    for way in ways:
        head += [f"{way}: ATAA 8x", "SSAA", "Mitsuba 3"]
    return markdown(head, rows)


def _costs(
    scene: str, motion: str, size: str
) -> tuple[dict[str, str], dict[str, str]] | None:
    """Returns what was read by the clock and by the processor's; None: not measured."""
    own = {
        row["time"]: row
        for row in read("accuracy_vs_time_read.csv")
        if (row["scene"], row["motion"], row["light"], row["size"])
        == (scene, motion, "one", size)
    }
    return (own["clock"], own["processor"]) if own else None


def _both(
    clock: dict[str, str], processor: dict[str, str], way: str, count: str
) -> str:
    """Returns samples, ms and the ratio to ATAA 8x, by the clock (by the processor)."""
    if not clock[f"{way}_{count}"]:
        return "–"
    samples, ms = float(clock[f"{way}_{count}"]), float(clock[f"{way}_ms"])
    ratios = [ratio(row[f"{way}_over_ataa8"]) for row in (clock, processor)]
    return f"{samples:.1f}, {ms:.0f} ms: {ratios[0]}× ({ratios[1]}×)"


def main() -> None:
    """Replaces what stands between the markers."""
    text = README.read_text("utf-8")
    for name, table in (
        ("quality", quality()),
        ("shares", shares()),
        ("still", still()),
        ("failures", failures()),
        ("fit", fit()),
        ("hard", hard()),
        ("cost", cost()),
        ("other costs", other_costs()),
    ):
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        pattern = re.escape(begin) + ".*?" + re.escape(end)
        replacement = f"{begin}\n{table}\n{end}"
        text = re.sub(pattern, lambda _: replacement, text, flags=re.DOTALL)  # noqa: B023
    README.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
