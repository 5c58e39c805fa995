"""Figures, tables and the comparison page: everything a `Comparison` is shown by.

index.html           the page: all methods and frames, works offline
scores.csv           means over the frames, one row a method
frames.csv           every score of every frame
strip.png hero.png   crops side by side
plots/               SSIM and shares over frames, quality against rays
frames/METHOD/       every frame as PNG
mask/METHOD/         masks over the greyscale frames; why/METHOD/: the reasons
timings.csv          the one file that is not a function of the input
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from ataa_jax import files
from ataa_jax.compare import Comparison
from ataa_jax.report import tables
from ataa_jax.report.crops import choose
from ataa_jax.report.picture import mask_overlay, why_overlay
from ataa_jax.report.strips import hero, strip
from ataa_jax.report.tables import table, terminal, write_timings

__all__ = [
    "choose",
    "hero",
    "mask_overlay",
    "strip",
    "table",
    "tables",
    "terminal",
    "why_overlay",
    "write",
    "write_frames",
    "write_timings",
]


def write(
    comparison: Comparison,
    folder: Path,
    progress: Callable[[str], None] = lambda text: None,
) -> None:
    """Writes everything above into a folder.

    Args:
        comparison: images, masks, scores and times.
        folder: where to; files of these names are replaced.
        progress: told what is being written.
    """
    # Here, for matplotlib and jinja2 take their time to import.
    from ataa_jax.report import page, plots

    progress("tables")
    tables.write(comparison, folder)
    tables.write_timings(
        comparison.stage_ms, comparison.peak_memory_bytes, folder / "timings.csv"
    )
    progress("frames")
    write_frames(comparison, folder)
    progress("figures")
    files.write_png(folder / "strip.png", strip(comparison))
    files.write_bytes(folder / "hero.png", hero(comparison))
    plots.write(comparison, folder / "plots")
    progress("page")
    files.write_text(folder / "index.html", page.render(comparison))


def write_frames(comparison: Comparison, folder: Path) -> None:
    """Writes every frame, mask and picture of reasons as PNG, on all cores."""

    def write(method: str, index: int) -> None:
        image, name = comparison.images[method][index], f"{method}/{index:04d}.png"
        files.write_png(folder / "frames" / name, image)
        if method in comparison.masks:
            mask, why = comparison.masks[method][index], comparison.whys[method][index]
            files.write_png(folder / "mask" / name, mask_overlay(image, mask))
            files.write_png(folder / "why" / name, why_overlay(image, why))

    with ThreadPoolExecutor() as pool:
        writing = [
            pool.submit(write, method, index)
            for method, images in comparison.images.items()
            for index in range(len(images))
        ]
        for each in writing:
            each.result()
