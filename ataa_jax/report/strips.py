"""The strips: enlarged crops of every method, as in the paper's Figure 3."""

import io

import numpy as np
from PIL import Image

from ataa_jax.compare import REFERENCE, Comparison
from ataa_jax.methods import METHODS
from ataa_jax.report import crops as windows
from ataa_jax.report.crops import Crop
from ataa_jax.report.palette import MASK_COLORS, MASK_NAMES
from ataa_jax.report.picture import (
    SOFT,
    Sheet,
    enlarge,
    fit,
    mask_overlay,
    traced_cutout,
)

# Rows from top to bottom, those that were rendered; `mask` is the best ATAA's.
ROWS = (
    *("none", "fxaa", "taa_ue4", "taa", "mask"),
    *("ataa2", "ataa4", "ataa8", "ssaa4", "ssaa8", REFERENCE),
)
ZOOM = 4
HERO_LIMIT_BYTES = 500_000
_MARGIN, _GAP, _LABEL = 24, 8, 132


def label(method: str) -> str:
    """Returns a method's label, `Reference` for the reference."""
    return "Reference" if method == REFERENCE else METHODS.get(method, method)


def best_adaptive(comparison: Comparison) -> str | None:
    """Returns the ATAA method of most samples, the tuned preset first; None: none."""
    for name in ("ataa8", "ataa4", "ataa2", *comparison.masks):
        if name in comparison.masks:
            return name
    return None


def strip(comparison: Comparison, frame: int = -1) -> Image.Image:
    """Returns the figure: the whole frame above, below it a row of crops a method.

    Args:
        comparison: images, masks, scores.
        frame: index of the frame; the last by default.
    """
    frame = range(len(comparison.images[REFERENCE]))[frame]
    chosen = windows.choose(comparison, frame)
    rows = [
        name
        for name in ROWS
        if name in comparison.images or (name == "mask" and comparison.masks)
    ]
    cell_w, cell_h = chosen[0].width * ZOOM, chosen[0].height * ZOOM
    content = max(_LABEL + len(chosen) * (cell_w + _GAP) - _GAP, 640)
    picture_w = (content - _GAP) // 2
    picture_h = round(picture_w * comparison.size[0] / comparison.size[1])
    top = _MARGIN + 48 + picture_h + 34
    row_h = cell_h + 24
    sheet = Sheet(content + 2 * _MARGIN, top + len(rows) * row_h + _MARGIN - 8)

    sheet.text(_MARGIN, _MARGIN - 4, comparison.scene, size=17, bold=True)
    sheet.text(
        _MARGIN,
        _MARGIN + 20,
        f"{comparison.size[1]} × {comparison.size[0]}, path {comparison.path}, "
        f"frame {frame + 1} of {len(comparison.images[REFERENCE])}; crops where "
        f"{label(windows.worst_case(comparison))} errs most, enlarged {ZOOM}×",
        color=SOFT,
    )
    _pictures(sheet, comparison, frame, chosen, picture_w)
    for number, name in enumerate(rows):
        _row(sheet, comparison, frame, chosen, name, top + number * row_h)
    return sheet.image


def _pictures(
    sheet: Sheet,
    comparison: Comparison,
    frame: int,
    chosen: list[Crop],
    width: int,
) -> None:
    """Draws the whole frame twice: result with the traced part cut out, and mask."""
    y = _MARGIN + 48
    adaptive = best_adaptive(comparison)
    name = adaptive or windows.worst_case(comparison)
    image = comparison.images[name][frame]
    left, right, caption = image, comparison.images[REFERENCE][frame], "Reference"
    if adaptive:
        method = comparison.masks[adaptive][frame]
        left = traced_cutout(image, method)
        right, caption = mask_overlay(image, method), ""
    scale = width / comparison.size[1]
    for x, part in ((_MARGIN, left), (_MARGIN + width + _GAP, right)):
        picture = fit(part, width)
        sheet.paste(picture, x, y)
        for crop in chosen:
            x0, y0 = x + crop.column * scale, y + crop.row * scale
            box = (x0, y0, x0 + crop.width * scale, y0 + crop.height * scale)
            sheet.frame(box, crop.name)
    below = y + round(comparison.size[0] * scale) + 7
    text = f"{label(name)}; right of the line only the traced pixels"
    sheet.text(_MARGIN, below, text if adaptive else label(name), size=11, color=SOFT)
    x = _MARGIN + width + _GAP
    if caption:
        sheet.text(x, below, caption, size=11, color=SOFT)
    elif adaptive:
        method = comparison.masks[adaptive][frame]
        sheet.legend(
            x,
            below,
            [
                (f"{MASK_NAMES[key]} {100 * np.mean(method == key):.1f} %", color)
                for key, color in MASK_COLORS.items()
            ],
        )


def _row(
    sheet: Sheet,
    comparison: Comparison,
    frame: int,
    chosen: list[Crop],
    name: str,
    y: int,
) -> None:
    """Draws one method: label, crops, and the score beneath each."""
    adaptive = best_adaptive(comparison)
    image = comparison.images[adaptive if name == "mask" else name][frame]  # type: ignore[index]
    if name == "mask" and adaptive:
        image = mask_overlay(image, comparison.masks[adaptive][frame])
        sheet.text(_MARGIN, y, "ATAA mask", size=13, bold=True)
        sheet.text(_MARGIN, y + 19, f"of {label(adaptive)}", size=11, color=SOFT)
    else:
        sheet.text(_MARGIN, y, label(name), size=13, bold=True)
        for line, text in enumerate(_facts(comparison, name, frame)):
            sheet.text(_MARGIN, y + 20 + 16 * line, text, size=11, color=SOFT)
    for number, crop in enumerate(chosen):
        x = _MARGIN + _LABEL + number * (crop.width * ZOOM + _GAP)
        sheet.paste(enlarge(crop.of(image), ZOOM), x, y)
        sheet.tag(x, y, crop.name)
        if name not in ("mask", REFERENCE):
            truth = comparison.images[REFERENCE][frame]
            measure, value = windows.score(crop.of(image), crop.of(truth))
            text = f"{measure} {value:.3f}" if measure == "SSIM" else f"MSE {value:.5f}"
            bottom = y + crop.height * ZOOM + 4
            sheet.text(x, bottom, text, size=11, color=SOFT)


def _facts(comparison: Comparison, name: str, frame: int) -> list[str]:
    """Returns the lines beneath a method's label: its score, and what it cost."""
    if name == REFERENCE:
        return [f"{comparison.options.reference_samples} samples a pixel"]
    found = [s for s in comparison.scores if (s.method, s.frame) == (name, frame)]
    if not found:
        return []
    lines = [f"SSIM {found[0].ssim:.3f}"]
    if found[0].rays_per_pixel > 0:
        lines.append(f"{found[0].rays_per_pixel:.2f} rays a pixel")
    return lines


def hero(comparison: Comparison, frame: int = -1) -> bytes:
    """Returns a wide PNG of five panels: no AA, TAA, ATAA, reference, mask.

    Each shows the whole frame and one crop, where TAA errs most. It stays under
    HERO_LIMIT_BYTES; where needed, colours are reduced to a palette.
    """
    frame = range(len(comparison.images[REFERENCE]))[frame]
    adaptive = best_adaptive(comparison)
    names = [
        name
        for name in ("none", windows.worst_case(comparison), adaptive, REFERENCE)
        if name in comparison.images
    ]
    panels = [
        (label(name), _facts(comparison, name, frame), comparison.images[name][frame])
        for name in dict.fromkeys(names)
    ]
    if adaptive:
        method = comparison.masks[adaptive][frame]
        shares = f"{100 * np.mean(method == 2):.1f} % traced"
        overlay = mask_overlay(comparison.images[adaptive][frame], method)
        panels.append(("ATAA mask", [shares], overlay))
    sheet = _hero_sheet(comparison, frame, panels)
    data = _png(sheet)
    if len(data) > HERO_LIMIT_BYTES:
        data = _png(sheet.quantize(256, dither=Image.Dither.FLOYDSTEINBERG))
    return data


def _hero_sheet(
    comparison: Comparison,
    frame: int,
    panels: list[tuple[str, list[str], np.ndarray]],
) -> Image.Image:
    (crop,) = windows.choose(comparison, frame, count=1, size=(48, 64))
    width = 256
    zoom = max(width // crop.width, 1)
    picture_h = round(width * comparison.size[0] / comparison.size[1])
    margin = 16
    sheet = Sheet(
        2 * margin + len(panels) * (width + _GAP) - _GAP,
        2 * margin + 24 + crop.height * zoom + _GAP + picture_h + 4,
    )
    scale = width / comparison.size[1]
    for number, (title, facts, image) in enumerate(panels):
        x, y = margin + number * (width + _GAP), margin
        end = x + sheet.text(x, y, title, size=14, bold=True)
        sheet.text(end + 10, y + 2, ", ".join(facts), size=11, color=SOFT)
        y += 24
        sheet.paste(enlarge(crop.of(image), zoom), x, y)
        y += crop.height * zoom + _GAP
        sheet.paste(fit(image, width), x, y)
        x0, y0 = x + crop.column * scale, y + crop.row * scale
        box = (x0, y0, x0 + crop.width * scale, y0 + crop.height * scale)
        sheet.frame(box, "")
    return sheet.image


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "PNG", optimize=True)
    return buffer.getvalue()
