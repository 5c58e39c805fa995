"""Colours and names that every figure shares: the mask's of Figure 2, one a family."""

from typing import NamedTuple

from ataa_jax import types

Rgb = tuple[int, int, int]

# Paper: Figure 2 shows FXAA pixels red, TAA pixels blue and ATAA pixels yellow.
MASK_COLORS: dict[int, Rgb] = {
    types.METHOD_FXAA: (226, 48, 48),
    types.METHOD_TAA: (40, 92, 222),
    types.METHOD_ATAA: (255, 212, 0),
}
# our choice: the blue that covers nearly all of a frame is laid on thinner.
MASK_ALPHA: dict[int, float] = {
    types.METHOD_FXAA: 0.8,
    types.METHOD_TAA: 0.4,
    types.METHOD_ATAA: 0.85,
}
MASK_NAMES: dict[int, str] = {
    types.METHOD_FXAA: "FXAA",
    types.METHOD_TAA: "TAA",
    types.METHOD_ATAA: "ATAA",
}


class Reason(NamedTuple):
    """One cause of a pixel's method: the bits that must all be set, word and colour."""

    bits: int
    name: str
    color: Rgb
    alpha: float = 0.85


# A pixel shows the first reason that applies to it.
REASONS: tuple[Reason, ...] = (
    # our choice: thin, as it may cover a third of a frame.
    Reason(types.WHY_OVER_BUDGET, "over the ray budget", (190, 80, 190), alpha=0.45),
    Reason(types.WHY_OFF_SCREEN, "no previous position", (226, 48, 48)),
    Reason(types.WHY_DISOCCLUDED, "disoccluded", (245, 130, 32)),
    Reason(
        types.WHY_LUMINANCE | types.WHY_DEPTH, "luminance and depth", (255, 255, 255)
    ),
    Reason(types.WHY_LUMINANCE, "luminance", (255, 212, 0)),
    Reason(types.WHY_DEPTH, "depth", (38, 198, 190)),
    Reason(types.WHY_SPREAD, "luminance varies", (255, 170, 90)),
    Reason(types.WHY_RESPONSE, "TAA left its history", (250, 235, 60)),
    Reason(types.WHY_LAYERS, "layers move apart", (240, 120, 180)),
    Reason(types.WHY_NORMAL, "normals", (120, 220, 90)),
    Reason(types.WHY_OBJECT, "objects", (90, 200, 250)),
    Reason(types.WHY_MATERIAL, "materials", (200, 120, 60)),
    Reason(types.WHY_HELD, "held from earlier frames", (150, 110, 230)),
)

_FAMILY_COLORS = {
    "none": "#7a828c",
    "fxaa": "#d23b3b",
    "taa": "#2f66cf",
    "ataa": "#c08a00",
    "ssaa": "#2b8a6b",
    "reference": "#15181c",
}


def family(method: str) -> str:
    """Returns the family of a method's name: none, fxaa, taa, ataa, ssaa, reference."""
    return method.partition("_")[0].rstrip("0123456789")


def samples(method: str) -> int:
    """Returns the samples in a method's name, 1 where it has none."""
    digits = "".join(c for c in method.partition("_")[0] if c.isdigit())
    return int(digits) if digits else 1


def line_color(method: str) -> str:
    """Returns the colour of a method's line, by family."""
    return _FAMILY_COLORS.get(family(method), "#7a828c")


def from_literature(method: str) -> bool:
    """Tells whether a method runs on the paper's or UE4's constants (drawn dashed)."""
    return "_" in method
