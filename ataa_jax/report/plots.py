"""Plots over frames, and quality against rays: the same bytes every time."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ataa_jax import files
from ataa_jax.compare import REFERENCE, Comparison
from ataa_jax.report import tables
from ataa_jax.report.palette import (
    MASK_COLORS,
    MASK_NAMES,
    family,
    from_literature,
    line_color,
    samples,
)
from ataa_jax.report.strips import best_adaptive, label

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e5e8",
    "grid.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "svg.hashsalt": "ataa_jax",
    "svg.fonttype": "path",
    "path.simplify": False,
}
_MARKERS = {1: "o", 2: "v", 4: "s", 8: "D", 16: "P"}


def write(comparison: Comparison, folder: Path) -> None:
    """Writes every plot as PNG and SVG into `folder`."""
    plots: dict[str, Callable[[Axes, Comparison], None]] = {
        "ssim": ssim_over_frames,
        "quality": quality_against_rays,
    }
    if best_adaptive(comparison):
        plots["shares"] = shares_over_frames
    for name, draw in plots.items():
        for suffix in ("png", "svg"):
            data = render(draw, comparison, suffix)
            files.write_bytes(folder / f"{name}.{suffix}", data)


def render(
    draw: Callable[[Axes, Comparison], None], comparison: Comparison, suffix: str
) -> bytes:
    """Draws one plot; no date, version or random identifier gets into the file."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(6.4, 3.8), dpi=150, layout="constrained")
        draw(figure.subplots(), comparison)
        buffer = io.BytesIO()
        nameless: dict[str, None] = (
            {"Software": None} if suffix == "png" else {"Date": None, "Creator": None}
        )
        figure.savefig(buffer, format=suffix, metadata=nameless)
    return buffer.getvalue()


def ssim_over_frames(axes: Axes, comparison: Comparison) -> None:
    """Draws SSIM of every method over the frames."""
    for method in tables.methods(comparison):
        if method == REFERENCE:
            continue
        scores = [s for s in comparison.scores if s.method == method]
        scores.sort(key=lambda s: s.frame)
        axes.plot(
            [s.frame + 1 for s in scores],
            [s.ssim for s in scores],
            color=line_color(method),
            linestyle="--" if from_literature(method) else "-",
            linewidth=1.2,
            marker=_MARKERS.get(samples(method), "o"),
            markersize=3.5,
            label=label(method),
        )
    axes.set_xlabel("frame")
    axes.set_ylabel("SSIM against the reference")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.legend(fontsize=7.5, loc="center left", bbox_to_anchor=(1.0, 0.5))


def shares_over_frames(axes: Axes, comparison: Comparison) -> None:
    """Draws which share of the pixels each of the three techniques got."""
    name = best_adaptive(comparison)
    masks = comparison.masks[name] if name else []
    frames = np.arange(1, len(masks) + 1)
    for value, color in MASK_COLORS.items():
        if MASK_NAMES[value] == "TAA":
            continue
        axes.plot(
            frames,
            [100.0 * float(np.mean(mask == value)) for mask in masks],
            color=np.array(color) / 255.0 * 0.86,
            marker="o",
            markersize=3.5,
            linewidth=1.2,
            label=MASK_NAMES[value],
        )
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("frame")
    axes.set_ylabel("share of the pixels, %")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_title(f"{label(name or '')}: all other pixels are TAA", fontsize=9)
    axes.legend()


def quality_against_rays(axes: Axes, comparison: Comparison) -> None:
    """Draws mean 1 − SSIM against rays a pixel: lower and further left is better."""
    points: dict[str, list[tuple[float, float]]] = {}
    for method in tables.methods(comparison):
        values = tables.means(comparison, method)
        if method == REFERENCE or np.isnan(values["ssim"]):
            continue
        # What takes no sparse rays has one sample a pixel, as raster does: ATAA's rays
        # come on top of it.
        rays = values["rays_per_pixel"]
        cost = rays if family(method) == "ssaa" else 1.0 + rays
        points.setdefault(family(method), []).append((cost, values["one_minus_ssim"]))
        axes.plot(
            cost,
            values["one_minus_ssim"],
            marker=_MARKERS.get(samples(method), "o"),
            markersize=6,
            color=line_color(method),
            markerfacecolor="white" if from_literature(method) else line_color(method),
            linestyle="none",
            label=label(method),
        )
    if len(points.get("ssaa", [])) > 1:
        axes.plot(*zip(*sorted(points["ssaa"]), strict=True), color="#2b8a6b", lw=0.8)
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
    axes.set_xlabel("samples a pixel, raster and rays together")
    axes.set_ylabel("1 − SSIM")
    axes.set_ylim(bottom=0.0)
    axes.legend(fontsize=7.5, loc="center left", bbox_to_anchor=(1.0, 0.5))
