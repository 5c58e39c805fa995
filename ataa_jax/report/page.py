"""The comparison page: one HTML file that holds all it shows and works offline.

Pictures are WebP, which keeps a page of 150 frames within a mailable size; masks and
reasons are exact. Nothing on the page is a time: it is a function of the input.
"""

import base64
import io
import json
from importlib import resources

import jinja2
import numpy as np
from PIL import Image

from ataa_jax import files, types
from ataa_jax.compare import REFERENCE, Comparison
from ataa_jax.methods import METHODS
from ataa_jax.report import crops, tables
from ataa_jax.report.palette import (
    MASK_ALPHA,
    MASK_COLORS,
    MASK_NAMES,
    REASONS,
    Reason,
    family,
    from_literature,
    samples,
)
from ataa_jax.report.strips import best_adaptive, label, strip

# our choice: what still opens at once and fits into a mail.
LIMIT_BYTES = 15_000_000
_QUALITIES = (90, 84, 76, 66, 54, 40)


def render(comparison: Comparison, limit_bytes: int = LIMIT_BYTES) -> str:
    """Returns the page.

    Args:
        comparison: images, masks, scores.
        limit_bytes: where the pictures would not fit, their quality is lowered, then
            frames are left out; the page says so.

    Returns:
        HTML with everything inlined.
    """
    environment = jinja2.Environment(
        loader=jinja2.BaseLoader(),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = environment.from_string(_part("page.html.j2"))
    sheet = _uri("png", files.png(strip(comparison)))
    quality, step = _fitting(comparison, limit_bytes - len(sheet))
    frames = range(0, len(comparison.images[REFERENCE]), step)
    return template.render(
        css=_part("page.css"),
        js=_part("page.js"),
        data=_json(_data(comparison, frames, quality)),
        comparison=comparison,
        facts=_facts(comparison),
        lede=_lede(comparison),
        columns=tables.COLUMNS,
        rows=_rows(comparison),
        options=[(name, label(name)) for name in _order(comparison)],
        mask_legend=[
            (MASK_NAMES[key], _css(color)) for key, color in MASK_COLORS.items()
        ],
        reason_legend=[(r.name, _css(r.color)) for r in _reasons(comparison)],
        strip=sheet,
        strip_size=strip(comparison).size,
        worst=label(crops.worst_case(comparison)),
        quality=quality,
        step=step,
        frame_count=len(frames),
        thin=not np.isnan(comparison.mean(REFERENCE, "thin_mse")),
    )


def _part(name: str) -> str:
    return (resources.files("ataa_jax.report") / name).read_text(encoding="utf-8")


def _order(comparison: Comparison) -> list[str]:
    """Returns the pictured methods in the table's order."""
    return [m for m in (*METHODS, REFERENCE) if m in comparison.images]


def _css(color: tuple[int, int, int]) -> str:
    return f"rgb({color[0]} {color[1]} {color[2]})"


def _facts(comparison: Comparison) -> list[tuple[str, str]]:
    options = comparison.options
    budget = options.budget
    return [
        ("Size", f"{comparison.size[1]} × {comparison.size[0]}"),
        ("Camera path", comparison.path),
        ("Frames", _frames(len(comparison.images[REFERENCE]), options.lead_in)),
        ("Reference", f"{options.reference_samples} samples a pixel"),
        (
            "Ray budget",
            f"{budget:g} a pixel" if np.isfinite(budget) else "none",
        ),
    ]


def _frames(count: int, lead_in: int) -> str:
    return f"{count}, after a lead-in of {lead_in}" if lead_in else f"{count}"


def _lede(comparison: Comparison) -> list[tuple[str, str, str]]:
    """Returns the few numbers to see first: label, SSIM, what it cost."""
    names = ["none", crops.worst_case(comparison), best_adaptive(comparison)]
    names += ["ssaa4", "ssaa8"]
    out = []
    for name in dict.fromkeys(names):
        if name is None or name not in comparison.images:
            continue
        rays = comparison.mean(name, "rays_per_pixel")
        cost = f"{rays:g} samples" if family(name) == "ssaa" else "1 sample"
        if name in comparison.masks:
            cost = f"1 sample + {rays:.2f} rays"
        value = comparison.mean(name, "ssim")
        out.append((label(name), "–" if np.isnan(value) else f"{value:.4f}", cost))
    return out


def _rows(comparison: Comparison) -> list[dict[str, object]]:
    best = {c.name: tables.best(comparison, c, float("inf")) for c in tables.COLUMNS}
    cheap = {c.name: tables.best(comparison, c, 1.0) for c in tables.COLUMNS}
    rows = []
    last = None
    for method in tables.methods(comparison):
        cells = [
            {
                "text": tables.shown(comparison, method, column),
                "best": method in best[column.name],
                "cheap": method in cheap[column.name],
            }
            for column in tables.COLUMNS
        ]
        group = family(method)
        rows.append(
            {
                "name": method,
                "label": label(method),
                "cells": cells,
                "first": last is not None and group != last,
            }
        )
        last = group
    return rows


def _data(comparison: Comparison, frames: range, quality: int) -> dict[str, object]:
    """Returns what the page's script reads."""
    order = _order(comparison)
    adaptive = best_adaptive(comparison)
    left = crops.worst_case(comparison)
    others = [m for m in reversed(order) if m not in (left, REFERENCE)]
    return {
        "width": comparison.size[1],
        "height": comparison.size[0],
        "frames": list(frames),
        "reference": REFERENCE,
        "left": left,
        "right": adaptive or (others[0] if others else REFERENCE),
        "methods": [
            {
                "name": name,
                "label": label(name),
                "family": family(name),
                "samples": samples(name),
                "dashed": from_literature(name),
                "cost": _cost(comparison, name),
            }
            for name in order
        ],
        "columns": [
            {"name": c.name, "heading": c.heading, "digits": c.shown, "scale": c.scale}
            for c in tables.COLUMNS
        ],
        "means": {
            name: _finite(tables.means(comparison, name))
            for name in tables.methods(comparison)
        },
        "series": _series(comparison),
        "images": {
            name: [
                _uri("webp", _webp(comparison.images[name][i], quality)) for i in frames
            ]
            for name in order
        },
        "maps": {
            name: [
                _uri("png", files.png(_map(mask[i], comparison.whys[name][i])))
                for i in frames
            ]
            for name, mask in comparison.masks.items()
        },
        "mask": [
            {"name": MASK_NAMES[k], "color": color, "alpha": MASK_ALPHA[k]}
            for k, color in sorted(MASK_COLORS.items())
        ],
        "reasons": [
            {"bits": r.bits, "name": r.name, "color": r.color, "alpha": r.alpha}
            for r in _reasons(comparison)
        ],
    }


def _cost(comparison: Comparison, method: str) -> float:
    """Returns samples a pixel, raster's one and the rays together."""
    rays = comparison.mean(method, "rays_per_pixel")
    if method == REFERENCE:
        return float(comparison.options.reference_samples)
    return rays if family(method) == "ssaa" else 1.0 + rays


def _series(comparison: Comparison) -> dict[str, dict[str, list[float | None]]]:
    out: dict[str, dict[str, list[float | None]]] = {}
    for name in tables.methods(comparison):
        scores = [s for s in comparison.scores if s.method == name]
        scores.sort(key=lambda s: s.frame)
        out[name] = {
            c.name: [_number(getattr(s, c.name)) for s in scores]
            for c in tables.COLUMNS
        }
    return out


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    return {name: _number(value) for name, value in values.items()}


def _number(value: float) -> float | None:
    """Returns a number for JSON, which knows neither NaN nor infinity."""
    return round(value, 8) if np.isfinite(value) else None


def _reasons(comparison: Comparison) -> list[Reason]:
    """Returns the reasons to name: of criteria beyond the paper's only what is seen."""
    seen = 0
    for images in comparison.whys.values():
        for why in images:
            seen |= int(np.bitwise_or.reduce(why, axis=None))
    return [r for r in REASONS if r.bits < types.WHY_NORMAL or r.bits & seen]


def _map(mask: np.ndarray, why: np.ndarray) -> np.ndarray:
    """Packs method (red) and why-bits (green low, blue high) into one exact picture."""
    low, high = why & 0xFF, why >> 8
    return np.stack([mask, low, high], axis=-1).astype(np.uint8)


def _fitting(comparison: Comparison, limit_bytes: int) -> tuple[int, int]:
    """Returns the WebP quality, and of how many frames one is kept, to fit a limit.

    Sizes are told from the middle frame, with a tenth to spare.
    """
    count = len(comparison.images[REFERENCE])
    middle = count // 2
    exact = sum(
        len(files.png(_map(masks[middle], comparison.whys[name][middle])))
        for name, masks in comparison.masks.items()
    )
    pictures = [comparison.images[name][middle] for name in _order(comparison)]
    a_frame = 0.0
    for quality in _QUALITIES:
        a_frame = exact + sum(len(_webp(picture, quality)) for picture in pictures)
        if a_frame * count * 1.1 * 4 / 3 < limit_bytes:
            return quality, 1
    kept = max(int(limit_bytes / (a_frame * 1.1 * 4 / 3)), 1)
    return _QUALITIES[-1], -(-count // kept)


def _webp(image: np.ndarray, quality: int) -> bytes:
    buffer = io.BytesIO()
    # Sharp chroma: at half resolution coloured edges would else look unlike the PNGs.
    Image.fromarray(image).save(
        buffer, "WEBP", quality=quality, method=3, use_sharp_yuv=True
    )
    return buffer.getvalue()


def _uri(kind: str, data: bytes) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _json(data: object) -> str:
    """Returns JSON that cannot end the script element it stands in."""
    text = json.dumps(data, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028")
