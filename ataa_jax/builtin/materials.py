"""The materials of the built-in scene, by name."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ataa_jax.builtin import images, leaves
from ataa_jax.scene import MaterialSource, TextureSource
from ataa_jax.types import WRAP_CLAMP, WRAP_REPEAT

Pair = tuple[np.ndarray, np.ndarray]


@dataclass
class Palette:
    """Materials and textures in the order in which they were added."""

    materials: list[MaterialSource] = field(default_factory=list)
    textures: list[TextureSource] = field(default_factory=list)

    def index(self, name: str) -> int:
        """Returns the index of a material."""
        return [m.name for m in self.materials].index(name)

    def image(self, image: np.ndarray, *, srgb: bool, clamp: bool = False) -> int:
        """Adds a texture and returns its index."""
        wrap = WRAP_CLAMP if clamp else WRAP_REPEAT
        self.textures.append(TextureSource(images.texels(image), srgb, wrap, wrap))
        return len(self.textures) - 1

    def plain(
        self, name: str, color: images.Color, roughness: float, metallic: float = 0.0
    ) -> None:
        """Adds a material of one linear colour."""
        self.materials.append(
            MaterialSource(
                name=name,
                base_color=(*color, 1.0),
                roughness=roughness,
                metallic=metallic,
            )
        )

    def textured(
        self, name: str, pair: Pair, roughness: float, normal_scale: float = 1.0
    ) -> None:
        """Adds a material with a colour texture and a normal map."""
        self.materials.append(
            MaterialSource(
                name=name,
                metallic=0.0,
                roughness=roughness,
                normal_scale=normal_scale,
                base_color_texture=self.image(pair[0], srgb=True),
                normal_texture=self.image(pair[1], srgb=False),
            )
        )

    def cut(self, name: str, image: np.ndarray, *, clamp: bool = True) -> None:
        """Adds a material that is cut out by its texture's alpha, on both sides."""
        self.materials.append(
            MaterialSource(
                name=name,
                metallic=0.0,
                roughness=0.75,
                alpha_mode="MASK",
                alpha_cutoff=0.45,
                double_sided=True,
                base_color_texture=self.image(image, srgb=True, clamp=clamp),
            )
        )

    def change(
        self, name: str, edit: Callable[[MaterialSource], MaterialSource]
    ) -> None:
        """Replaces one material by an edited copy."""
        i = self.index(name)
        self.materials[i] = edit(self.materials[i])


def build() -> Palette:
    """Makes every material of the scene."""
    p = Palette()
    p.textured("lawn", images.grass(), 0.95)
    p.textured("gravel", images.gravel(), 0.95)
    p.textured("brick", images.brick(), 0.9)
    p.textured("render", images.plaster(), 0.9)
    p.textured("paving", images.paving(), 0.8)
    p.textured(
        "cladding", images.boards((0.36, 0.19, 0.09), (0.80, 0.54, 0.32), 20), 0.7
    )
    p.textured("deck", images.boards((0.36, 0.29, 0.23), (0.74, 0.63, 0.52), 30), 0.75)
    _plain(p)
    _cloth_and_glass(p)
    _leaves(p)
    return p


def _plain(p: Palette) -> None:
    p.plain("roof", (0.10, 0.105, 0.11), 0.7)
    p.plain("fascia", (0.82, 0.82, 0.80), 0.6)
    p.plain("frame", (0.022, 0.024, 0.027), 0.45)
    p.plain("steel", (0.62, 0.63, 0.65), 0.32, metallic=1.0)
    p.plain("cable", (0.012, 0.012, 0.013), 0.6)
    p.plain("rope", (0.42, 0.36, 0.26), 0.9)
    p.plain("bark", (0.13, 0.095, 0.07), 0.95)
    p.plain("pole", (0.19, 0.14, 0.105), 0.9)
    p.plain("slats", (0.43, 0.42, 0.38), 0.65)
    p.plain("terracotta", (0.52, 0.20, 0.105), 0.75)
    p.plain("glazed blue", (0.05, 0.13, 0.27), 0.15)
    p.plain("soil", (0.045, 0.032, 0.024), 1.0)
    p.plain("hull", (0.055, 0.085, 0.16), 0.25)
    p.plain("boot top", (0.42, 0.05, 0.04), 0.4)
    p.plain("gelcoat", (0.80, 0.79, 0.75), 0.3)
    p.plain("varnish", (0.29, 0.145, 0.07), 0.25)
    p.plain("red", (0.60, 0.045, 0.03), 0.35)
    p.plain("yellow", (0.80, 0.46, 0.04), 0.4)
    p.plain("rubber", (0.02, 0.02, 0.02), 0.8)
    p.plain("linen", (0.58, 0.52, 0.43), 0.95)
    p.plain("interior", (0.33, 0.27, 0.21), 0.9)
    p.plain("hill far", (0.22, 0.30, 0.36), 1.0)
    p.plain("hill near", (0.10, 0.155, 0.12), 1.0)
    p.plain("lily", (0.085, 0.20, 0.05), 0.5)
    p.plain("stone", (0.34, 0.33, 0.31), 0.9)
    p.plain("lamp", (0.9, 0.8, 0.6), 0.5)
    p.change("lamp", lambda m: replace(m, emissive=(6.0, 4.2, 2.2)))


def _cloth_and_glass(p: Palette) -> None:
    def textured(name: str, image: np.ndarray, roughness: float) -> None:
        texture = p.image(image, srgb=True)
        material = MaterialSource(
            name=name, metallic=0.0, roughness=roughness, base_color_texture=texture
        )
        p.materials.append(material)

    textured("awning", images.stripes((0.93, 0.90, 0.84), (0.10, 0.29, 0.38)), 0.9)
    textured("sail", images.sailcloth(), 0.85)
    textured("glass", images.pane(), 0.06)
    textured("pennant", images.stripes((0.80, 0.10, 0.08), (0.95, 0.93, 0.90)), 0.9)
    p.plain("wheel yellow", (0.80, 0.46, 0.04), 0.45)
    p.plain("wheel white", (0.80, 0.79, 0.75), 0.45)
    for name in ("awning", "sail", "pennant", "linen", "wheel yellow", "wheel white"):
        p.change(name, lambda m: replace(m, double_sided=True))
    p.materials.append(
        MaterialSource(
            name="water",
            base_color=(0.012, 0.035, 0.045, 1.0),
            metallic=0.0,
            roughness=0.09,
            normal_scale=0.55,
            normal_texture=p.image(images.ripples(), srgb=False),
        )
    )


def _leaves(p: Palette) -> None:
    tree = leaves.foliage((0.12, 0.21, 0.06), (0.43, 0.54, 0.20), 40, 190)
    p.cut("leaf tree", tree)
    birch = leaves.foliage((0.24, 0.32, 0.08), (0.60, 0.66, 0.26), 41, 150)
    p.cut("leaf birch", birch)
    p.cut("leaf hedge", leaves.foliage((0.10, 0.18, 0.05), (0.34, 0.45, 0.16), 42, 230))
    p.cut("leaf blade", leaves.blade((0.12, 0.30, 0.12), (0.42, 0.60, 0.26)))
    p.cut("leaf tuft", leaves.tuft((0.18, 0.28, 0.08), (0.50, 0.58, 0.24), 43))
    p.cut("leaf reed", leaves.tuft((0.24, 0.32, 0.12), (0.66, 0.64, 0.36), 44, 26))
    flower = leaves.foliage((0.45, 0.16, 0.30), (0.95, 0.55, 0.65), 45, 150)
    p.cut("leaf flower", flower)
    lavender = leaves.tuft((0.30, 0.36, 0.24), (0.68, 0.52, 0.86), 47, 60)
    p.cut("leaf lavender", lavender)
    line = leaves.treeline((0.16, 0.23, 0.16), (0.42, 0.50, 0.32), 46)
    p.cut("leaf far trees", line, clamp=False)
