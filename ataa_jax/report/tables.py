"""The scores as tables: CSV with fixed digits, and the terminal's.

Times are a table of their own, in a file of their own: all else is a function of the
input.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.table import Table

from ataa_jax import files
from ataa_jax.compare import REFERENCE, Comparison
from ataa_jax.methods import METHODS
from ataa_jax.report.palette import family
from ataa_jax.report.strips import label


class Column(NamedTuple):
    """One score: field, heading, digits in files and on screens, and what is good."""

    name: str
    heading: str
    digits: int
    shown: int
    best: int  # +1: the larger the better; −1: the smaller; 0: neither
    scale: float = 1.0  # what a shown value is multiplied by


COLUMNS: tuple[Column, ...] = (
    Column("ssim", "SSIM", 6, 4, 1),
    Column("psnr", "PSNR dB", 4, 2, 1),
    Column("flip", "FLIP", 6, 4, -1),
    # Neither: blur lowers it below the reference's own.
    Column("flicker", "Flicker ×10³", 8, 3, 0, 1e3),
    Column("border_mse", "Border MSE ×10³", 8, 3, -1, 1e3),
    Column("thin_mse", "Thin MSE ×10³", 8, 3, -1, 1e3),
    Column("fxaa_share", "FXAA %", 6, 2, 0, 100.0),
    Column("taa_share", "TAA %", 6, 2, 0, 100.0),
    Column("ataa_share", "ATAA %", 6, 2, 0, 100.0),
    Column("rays_per_pixel", "Rays/px", 6, 3, 0),
    Column("overflow_share", "Over budget %", 6, 2, 0, 100.0),
)
HEADER = ("method", "label", *(c.name for c in COLUMNS), "one_minus_ssim")


def methods(comparison: Comparison) -> list[str]:
    """Returns the methods with scores, in the table's order, the reference last."""
    present = {score.method for score in comparison.scores}
    order = [*METHODS, REFERENCE]
    return [m for m in order if m in present] + sorted(present - set(order))


def means(comparison: Comparison, method: str) -> dict[str, float]:
    """Returns every score's mean over the frames, and 1 − SSIM."""
    values = {c.name: comparison.mean(method, c.name) for c in COLUMNS}
    values["one_minus_ssim"] = 1.0 - values["ssim"]
    return values


def table(comparison: Comparison) -> list[tuple[str, ...]]:
    """Returns the rows of `scores.csv`, one a method, as text with fixed digits."""
    rows = []
    for method in methods(comparison):
        values = means(comparison, method)
        cells = [files.decimals(values[c.name], c.digits) for c in COLUMNS]
        last = files.decimals(values["one_minus_ssim"], 6)
        rows.append((method, label(method), *cells, last))
    return rows


def frame_table(comparison: Comparison) -> list[tuple[str, ...]]:
    """Returns the rows of `frames.csv`, one a method and frame."""
    order = {name: i for i, name in enumerate(methods(comparison))}
    scores = sorted(comparison.scores, key=lambda s: (order[s.method], s.frame))
    return [
        (
            score.method,
            str(score.frame),
            *(files.decimals(getattr(score, c.name), c.digits) for c in COLUMNS),
        )
        for score in scores
    ]


def write(comparison: Comparison, folder: Path) -> None:
    """Writes `scores.csv` and `frames.csv`, functions of the input."""
    files.write_csv(folder / "scores.csv", HEADER, table(comparison))
    header = ("method", "frame", *(c.name for c in COLUMNS))
    files.write_csv(folder / "frames.csv", header, frame_table(comparison))


def write_timings(
    stage_ms: dict[str, dict[str, list[float]]], peak_memory_bytes: int, file: Path
) -> None:
    """Writes the measured times, apart from all results.

    Args:
        stage_ms: method → stage → milliseconds of each frame.
        peak_memory_bytes: of the process that ran all methods.
        file: CSV; quantity, method and stage, median and quartiles.
    """
    rows = []
    for method, stages in stage_ms.items():
        total = 0.0
        for stage, times in stages.items():
            if times:
                quartiles = np.percentile(times, (50, 25, 75))
                total += float(quartiles[0])
                cells = (files.decimals(float(q), 3) for q in quartiles)
                rows.append((method, stage, *cells, str(len(times)), "ms"))
        text = files.decimals(total, 3)
        rows.append((method, "total of medians", text, "", "", "", "ms"))
    memory = files.decimals(peak_memory_bytes / 2**20, 1)
    rows.append(("", "peak memory", memory, "", "", "", "MiB"))
    header = ("method", "stage", "median", "quartile_1", "quartile_3", "count", "unit")
    files.write_csv(file, header, rows)


def best(comparison: Comparison, column: Column, at_most_rays: float) -> set[str]:
    """Returns the methods with a column's best value as shown, ties included.

    Args:
        comparison: the scores.
        column: which.
        at_most_rays: only methods of at most this many rays a pixel take part.
    """
    if not column.best:
        return set()
    values = {}
    for method in methods(comparison):
        value = comparison.mean(method, column.name) * column.scale
        cheap = comparison.mean(method, "rays_per_pixel") <= at_most_rays
        if method != REFERENCE and cheap and not np.isnan(value):
            values[method] = round(value, column.shown) * column.best
    top = max(values.values(), default=0.0)
    return {method for method, value in values.items() if value == top}


def shown(comparison: Comparison, method: str, column: Column) -> str:
    """Returns a value as tables for people show it; a dash where it means nothing."""
    value = comparison.mean(method, column.name)
    adaptive = method in comparison.masks
    if np.isnan(value) or (value == 0.0 and column.best == 0 and not adaptive):
        return "–"
    if method == REFERENCE and column.name != "flicker":
        return "–"
    if np.isinf(value):
        return "∞"
    return files.decimals(value * column.scale, column.shown)


def terminal(comparison: Comparison) -> Table:
    """Returns the scores, with times beside them, for the terminal."""
    out = Table(box=None, pad_edge=False, header_style="dim", row_styles=["", ""])
    out.add_column("Method", no_wrap=True)
    # Few and short columns: they fit into 80 characters.
    heads = {
        "ssim": "SSIM",
        "psnr": "PSNR",
        "flip": "FLIP",
        "flicker": "Flicker",
        "ataa_share": "ATAA %",
        "rays_per_pixel": "Rays",
    }
    columns = [c for c in COLUMNS if c.name in heads]
    for column in columns:
        out.add_column(heads[column.name], justify="right", no_wrap=True)
    out.add_column("ms", justify="right", no_wrap=True)
    winners = {c.name: best(comparison, c, float("inf")) for c in columns}
    cheap = {c.name: best(comparison, c, 1.0) for c in columns}
    last = ""
    for method in methods(comparison):
        cells = []
        for column in columns:
            text = shown(comparison, method, column)
            if method in winners[column.name]:
                text = f"[bold]{text}[/bold]"
            if method in cheap[column.name]:
                text = f"[green]{text}[/green]"
            cells.append(text)
        ms = comparison.milliseconds(method)
        if last and family(method) != last:
            out.add_section()
        last = family(method)
        out.add_row(label(method), *cells, f"{ms:.0f}" if ms else "–")
    return out
