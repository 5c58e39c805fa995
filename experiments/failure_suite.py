"""Does the mask find what the paper says temporal antialiasing fails on, and only that?

Each case of `ataa_jax.builtin.failures` isolates one failure of section 2. TAA alone
(tuned) and ATAA 8x by the paper's criteria, without a ray budget, run against 64
samples a pixel at 320×180. The *oracle mask* holds the pixels that TAA gets visibly
wrong: the largest channel of |TAA − reference|, in sRGB, is over 8/255. our choice: a
step of 1/255 is the limit of seeing, a single wrong pixel at an edge shows from about 3
% on, and 64 samples differ from 512 by less than that in every pixel of the hardest two
cases, (d) and (e).

*Recall* is the share of the oracle's pixels that a criterion marks, *precision* the
share of its pixels that the oracle holds, *error* the share of TAA's squared error that
lies in its pixels; *caught* says whether recall is at least 90 %. The mask is that of
the ATAA run, whose history is already mended: a pixel that was traced before may need
no mark now. Where the mask does not catch a failure, each criterion beyond the paper's
is added by itself, with the threshold lowered so that the paper's two ask for as much
as before; its rows tell of the whole mask and of its own bit. One row tells of the mask
of the tuned preset, whose weights were fitted to whole scenes.

    python experiments/failure_suite.py       # writes results/failure_suite.csv, .png
"""

import argparse
import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import figures
import numpy as np
from matplotlib import pyplot as plt
from PIL import Image

from ataa_jax import color as colors
from ataa_jax import files, metrics, pipeline, reference, sampling, types
from ataa_jax import world as worlds
from ataa_jax.builtin import failures
from ataa_jax.report import mask_overlay
from ataa_jax.report.picture import Sheet, fit

SIZE = (180, 320)
SAMPLES = 64
VISIBLE = 8.0 / 255.0
CAUGHT = 0.9  # recall of the mask that needs no further criterion
CRITERIA = {
    "off screen": types.WHY_OFF_SCREEN,
    "disoccluded": types.WHY_DISOCCLUDED,
    "held": types.WHY_HELD,
    "luminance": types.WHY_LUMINANCE,
    "depth": types.WHY_DEPTH,
}
OPTIONAL = {
    "normal": types.WHY_NORMAL,
    "object": types.WHY_OBJECT,
    "material": types.WHY_MATERIAL,
    "spread": types.WHY_SPREAD,
    "response": types.WHY_RESPONSE,
    "layers": types.WHY_LAYERS,
}
COLUMNS = (
    *("letter", "case", "criterion", "caught", "share", "recall", "precision"),
    *("error", "oracle_share", "fxaa_share", "ataa_share"),
    *("taa_mse", "taa_ssim", "ataa_mse", "ataa_ssim"),
)


@dataclass(frozen=True)
class Run:
    """The scored frames of one method: sRGB images, methods, why-bits."""

    images: np.ndarray  # (frames, h, w, 3) in [0, 1]
    method: np.ndarray  # (frames, h, w)
    why: np.ndarray  # (frames, h, w)


def render(
    case: failures.Case,
    shot: worlds.Sequence,
    config: pipeline.Config,
    params: pipeline.Params,
) -> Run:
    """Renders a case from its lead-in on."""
    jitter = sampling.halton_jitter(config.taa.jitter_length)
    state = pipeline.init(shot.size)
    images, methods, whys = [], [], []
    for index in range(-failures.LEAD_IN, max(case.frames) + 1):
        inputs = shot.inputs(index, jitter[(index + failures.LEAD_IN) % len(jitter)])
        cut = index in (-failures.LEAD_IN, case.cut)
        # Stage by stage: all but raster and raytrace compile once for all cases.
        output, state = pipeline.stages(
            state,
            pipeline.with_cut(inputs, cut),
            params,
            scene=shot.world.scene,
            tracer=shot.world.tracer,
            config=config,
        )
        if index in case.frames:
            images.append(np.asarray(output.image))
            methods.append(np.asarray(output.segmentation.mask) & 0xFFFF)
            whys.append(np.asarray(output.segmentation.why))
    return Run(np.stack(images), np.stack(methods), np.stack(whys))


def truth(case: failures.Case, shot: worlds.Sequence) -> np.ndarray:
    """Returns the reference of the scored frames, sRGB (frames, h, w, 3)."""
    return np.stack(
        [
            np.asarray(colors.display(reference.reference(shot, index, SAMPLES).color))
            for index in case.frames
        ]
    )


@dataclass(frozen=True)
class Result:
    """One case: what was rendered, and what TAA gets wrong."""

    case: failures.Case
    exact: np.ndarray
    taa: Run
    ataa: Run
    added: dict[str, Run]  # ATAA with one criterion more
    tuned: Run  # ATAA by the tuned preset, whose weights are fitted

    @property
    def oracle(self) -> np.ndarray:
        """Returns where TAA is visibly wrong, (frames, h, w)."""
        return np.abs(self.taa.images - self.exact).max(axis=-1) > VISIBLE


def measure(case: failures.Case, size: tuple[int, int]) -> Result:
    """Renders a case by TAA, ATAA and, where that misses much, further criteria."""
    world = worlds.prepare(case.build(), size=size)
    shot = worlds.sequence(world, case.path, size)
    config, params = pipeline.preset("paper", world.scene, size, budget=float("inf"))
    result = Result(
        case=case,
        exact=truth(case, shot),
        taa=render(case, shot, replace(config, adaptive=False), params),
        ataa=render(case, shot, config, params),
        added={},
        tuned=render(
            case,
            shot,
            *pipeline.preset("tuned", world.scene, size, budget=float("inf")),
        ),
    )
    marked = result.ataa.method != types.METHOD_TAA
    if marked[result.oracle].mean() < CAUGHT:
        # A mean of three terms over 2/3 of the threshold of a mean of two.
        lower = pipeline.with_threshold(
            params, float(params.segmentation.threshold) * 2.0 / 3.0
        )
        for name in OPTIONAL:
            more = replace(config.segmentation, **{f"use_{name}": True})
            config_more = replace(config, segmentation=more)
            result.added[name] = render(case, shot, config_more, lower)
    return result


def rows(result: Result) -> Iterator[list[object]]:
    """Yields the table's rows of one case."""
    squared = ((result.taa.images - result.exact) ** 2).mean(axis=-1)
    oracle = result.oracle

    def scores(run: Run) -> tuple[float, float]:
        pairs = list(zip(run.images, result.exact, strict=True))
        return (
            float(np.mean([metrics.mean_squared_error(*pair) for pair in pairs])),
            float(np.mean([metrics.ssim(*pair) for pair in pairs])),
        )

    def row(name: str, marked: np.ndarray, run: Run) -> list[object]:
        both = (marked & oracle).sum()
        return [
            result.case.letter,
            result.case.name,
            name,
            "yes" if oracle.any() and both >= CAUGHT * oracle.sum() else "no",
            marked.mean(),
            both / oracle.sum() if oracle.any() else np.nan,
            both / marked.sum() if marked.any() else np.nan,
            squared[marked].sum() / squared.sum(),
            oracle.mean(),
            (run.method == types.METHOD_FXAA).mean(),
            (run.method == types.METHOD_ATAA).mean(),
            *scores(result.taa),
            *scores(run),
        ]

    whole = result.ataa.method != types.METHOD_TAA
    yield row("mask", whole, result.ataa)
    for name, bit in CRITERIA.items():
        yield row(name, (result.ataa.why & bit) != 0, result.ataa)
    yield row(
        "mask, tuned preset", result.tuned.method != types.METHOD_TAA, result.tuned
    )
    for name, run in result.added.items():
        yield row(f"mask with {name}", run.method != types.METHOD_TAA, run)
        yield row(name, (run.why & OPTIONAL[name]) != 0, run)


def main() -> None:
    """Measures every case and writes table, plot and contact sheet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", default="".join(c.letter for c in failures.CASES))
    parser.add_argument("--height", type=int, default=SIZE[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    size = (options.height, options.height * 16 // 9)
    table, results = [], []
    for letter in options.cases:
        result = measure(failures.case(letter), size)
        results.append(result)
        for row in rows(result):
            table.append(row)
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in row), flush=True)
    options.out.mkdir(exist_ok=True)
    with (options.out / "failure_suite.csv").open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for row in table:
            head, numbers = row[:4], [float(str(value)) for value in row[4:]]
            writer.writerow([*head, *(f"{value:.5g}" for value in numbers)])
    plot(table, options.out / "failure_suite.png")
    sheet(results, options.out / "failure_suite_sheet.png")


def plot(table: list[list[object]], file: Path) -> None:
    """Draws recall of the mask, by criterion, and TAA's and ATAA's error."""
    letters = list(dict.fromkeys(row[0] for row in table))
    names = [f"({row[0]}) {row[1]}" for row in table if row[2] == "mask"]
    y = np.arange(len(letters))
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), sharey=True)
    bars = ("mask", *CRITERIA)
    palette = ("#15181c", "#d23b3b", "#f58220", "#966ee6", "#e0b400", "#26c6be")
    for k, (name, color) in enumerate(zip(bars, palette, strict=True)):
        found = [float(str(row[5])) for row in table if row[2] == name]
        left.barh(y + 0.13 * (k - 2.5), found, 0.12, label=name, color=color)
    left.set(
        yticks=y,
        yticklabels=names,
        xlim=(0, 1),
        xlabel="share of the pixels TAA gets visibly wrong that are marked",
    )
    left.invert_yaxis()
    left.legend(fontsize=8, loc="upper center", ncols=6, bbox_to_anchor=(0.5, 1.1))
    for column, name, color in ((11, "TAA", "#2f66cf"), (13, "ATAA 8x", "#c08a00")):
        error = [float(str(row[column])) for row in table if row[2] == "mask"]
        right.plot(error, y, "o", label=name, color=color)
    right.set(xscale="log", xlabel="mean squared error, sRGB")
    right.grid(axis="y", alpha=0.3)
    right.legend(fontsize=8)
    figure.tight_layout()
    figures.save(figure, file, dpi=110)


def sheet(results: list[Result], file: Path) -> None:
    """Draws per case the reference (under its name), TAA, ATAA and both masks."""
    width, gap, head = 192, 4, 16
    height = width * 9 // 16
    columns = ("reference", "TAA", "ATAA 8x", "mask", "TAA visibly wrong")
    page = Sheet(
        len(columns) * (width + gap) - gap, len(results) * (height + head + gap)
    )
    for number, result in enumerate(results):
        top = number * (height + head + gap)
        k = len(result.case.frames) // 2
        shown = [
            np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
            for image in (
                result.exact[k],
                result.taa.images[k],
                result.ataa.images[k],
            )
        ]
        wrong = np.where(result.oracle[k, ..., None], (255, 255, 255), (24, 26, 30))
        pictures = (
            *shown,
            mask_overlay(shown[0], result.ataa.method[k]),
            np.broadcast_to(wrong, shown[0].shape).astype(np.uint8),
        )
        for column, picture in enumerate(pictures):
            x = column * (width + gap)
            text = columns[column]
            if column == 0:
                text = f"({result.case.letter}) {result.case.name}"
            page.text(x, top + 1, text, size=11, bold=column == 0)
            page.paste(fit(picture, width), x, top + head)
    files.write_bytes(file, _small_png(page))


def _small_png(page: Sheet) -> bytes:
    """Returns a PNG under 500 kB: red and green of five bits, blue of three."""
    # Fewer levels pack better than a palette, which would change hues.
    dropped = np.array([3, 3, 5], np.uint8)
    half = np.uint8(1) << (dropped - 1)
    coarse = (np.asarray(page.image) >> dropped << dropped) | half
    buffer = io.BytesIO()
    Image.fromarray(coarse.astype(np.uint8)).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


if __name__ == "__main__":
    main()
