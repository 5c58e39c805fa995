"""Which effects a scene calls for, and why: the frame program holds exactly these.

`look` lists every effect with its reason, once a scene. A scene without an effect is
one whose tables do not ask for it: `without` clears them, so that leaving an effect
out needs no code of its own in any stage, and costs nothing there.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ataa_jax import shading
from ataa_jax.errors import InputError
from ataa_jax.types import NO_TEXTURE, Rays, Scene

CAMERA_MOTION, OBJECT_MOTION = "camera-motion", "object-motion"

# Effect → the switch of `shading.Config` that compiles it in.
_SWITCHES = {
    "base-textures": "base_color_textures",
    "metallic-roughness-textures": "metallic_roughness_textures",
    "normal-maps": "normal_maps",
    "emission": "emission",
    "emissive-textures": "emissive_textures",
    "transparency": "transparency",
    "reflections": "reflections",
    "shadows": "shadows",
    "sky": "sky",
}
NAMES = (*_SWITCHES, "alpha-mask", CAMERA_MOTION, OBJECT_MOTION)


@dataclass(frozen=True)
class Effect:
    """One effect, whether the scene calls for it, and the reason."""

    name: str
    on: bool
    reason: str


@dataclass(frozen=True)
class Selection:
    """The effects that the frame program is compiled for."""

    shading: shading.Config
    camera_motion: bool = True
    object_motion: bool = True


@dataclass(frozen=True)
class Wish:
    """What a user asked for; see `parse`."""

    everything: bool = False  # also what the scene does not call for
    only: frozenset[str] | None = None  # None: what the scene calls for
    left_out: frozenset[str] = frozenset()

    def keeps(self, name: str) -> bool:
        """Returns whether an effect that the scene calls for stays on."""
        chosen = self.only is None or self.everything or name in self.only
        return chosen and name not in self.left_out


def look(scene: Scene) -> list[Effect]:
    """Looks at a scene once and lists what it calls for; motion is a sequence's."""
    materials = scene.materials
    used = np.unique(np.asarray(scene.geometry.material))

    def textured(name: str, table: object) -> Effect:
        count = int(np.sum(np.asarray(table)[used] != NO_TEXTURE))
        return Effect(name, count > 0, f"{count} of {used.size} materials have one")

    def flagged(name: str, flags: object, what: str) -> Effect:
        count = int(np.sum(np.asarray(flags)[used]))
        return Effect(name, count > 0, f"{count} of {used.size} materials {what}")

    emissive = np.any(np.asarray(materials.emissive) > 0, axis=-1)
    emission = flagged("emission", emissive, "emit light")
    glow = textured("emissive-textures", materials.emissive_texture)
    lights = scene.lights.kind.shape[0]
    casting = int(np.sum(np.asarray(scene.lights.casts)))
    sky = any(
        float(np.max(np.asarray(part))) > 0
        for part in (scene.sky.zenith, scene.sky.horizon, scene.sky.ground)
    )
    return [
        textured("base-textures", materials.base_color_texture),
        textured("metallic-roughness-textures", materials.metallic_roughness_texture),
        textured("normal-maps", materials.normal_texture),
        emission,
        Effect(glow.name, glow.on and emission.on, glow.reason),
        flagged("alpha-mask", materials.alpha_masked, "are cut by their alpha"),
        flagged("transparency", materials.blended, "let something through"),
        flagged("reflections", materials.mirror, "are smooth as a mirror"),
        Effect("shadows", casting > 0, f"{casting} of {lights} lights cast them"),
        Effect("sky", sky, "the sky is lit" if sky else "the scene has no sky"),
    ]


def look_at_motion(objects: bool) -> list[Effect]:
    """Lists motion; that of the camera is for the path to say."""
    return [
        Effect(CAMERA_MOTION, True, "on every path but a still one"),
        Effect(
            OBJECT_MOTION,
            objects,
            "an animation plays" if objects else "nothing is animated",
        ),
    ]


def required(scene: Scene) -> shading.Config:
    """Returns the shading configuration with exactly the effects that `look` lists."""
    on = {effect.name: effect.on for effect in look(scene)}
    return shading.Config(**{switch: on[name] for name, switch in _SWITCHES.items()})


def everything() -> shading.Config:
    """Returns the shading configuration with every effect compiled in."""
    return shading.Config(**dict.fromkeys(_SWITCHES.values(), True))


def parse(text: str) -> Wish:
    """Reads ``all``, or names with commas; ``no-NAME`` leaves one out.

    Names alone are a subset: nothing else stays on. With ``no-NAME`` only, the rest
    of what the scene calls for stays.

    Raises:
        InputError: a name is unknown.
    """
    parts = [part.strip().lower() for part in text.split(",") if part.strip()]
    out = {part.removeprefix("no-") for part in parts if part.startswith("no-")}
    asked = {part for part in parts if not part.startswith("no-")}
    for name in (asked - {"all"}) | out:
        if name not in NAMES:
            raise InputError(
                f"--effects: there is no effect '{name}'; known are all, "
                f"{', '.join(NAMES)}, and no- before a name to leave it out"
            )
    if not parts:
        raise InputError(
            "--effects names no effect; give all, or some of " + ", ".join(NAMES)
        )
    return Wish(
        everything="all" in asked,
        only=frozenset(asked - {"all"}) if asked else None,
        left_out=frozenset(out),
    )


def refusals(wish: Wish, looked: Iterable[Effect]) -> list[str]:
    """Says which of the effects asked for by name the scene cannot have."""
    return [
        f"effect {effect.name} was asked for, but the scene has none: {effect.reason}"
        for effect in looked
        if wish.only is not None and effect.name in wish.only and not effect.on
    ]


def without(scene: Scene, wish: Wish) -> Scene:
    """Returns the scene with the tables of unwanted effects cleared.

    Surfaces that let something through become opaque, cut-outs become whole.
    """
    for name, (where, empty) in _TABLES.items():
        if not wish.keeps(name):
            cleared = tuple(jnp.full_like(table, empty) for table in where(scene))
            scene = eqx.tree_at(where, scene, cleared)
    return scene


_Where = Callable[[Scene], tuple]
_TABLES: dict[str, tuple[_Where, float | bool | int]] = {
    "base-textures": (lambda s: (s.materials.base_color_texture,), NO_TEXTURE),
    "metallic-roughness-textures": (
        lambda s: (s.materials.metallic_roughness_texture,),
        NO_TEXTURE,
    ),
    "normal-maps": (lambda s: (s.materials.normal_texture,), NO_TEXTURE),
    "emission": (lambda s: (s.materials.emissive,), 0.0),
    "emissive-textures": (lambda s: (s.materials.emissive_texture,), NO_TEXTURE),
    "alpha-mask": (lambda s: (s.materials.alpha_masked,), False),
    "transparency": (lambda s: (s.materials.blended,), False),
    "reflections": (lambda s: (s.materials.mirror,), False),
    "shadows": (lambda s: (s.lights.casts,), False),
    "sky": (
        lambda s: (s.sky.zenith, s.sky.horizon, s.sky.ground, s.sky.bounce),
        0.0,
    ),
}


def costs(rays: Rays, pixels: int) -> dict[str, str]:
    """Tells the rays that effects cost, by name, from the counts of a frame."""
    shadow = [int(count) / pixels for count in np.asarray(rays.shadow)]
    by_light = " + ".join(f"{count:.2f}" for count in shadow)
    return {
        "shadows": f"{by_light} rays a pixel" if shadow else "",
        "reflections": f"{int(rays.reflection) / pixels:.2f} rays a pixel",
        "transparency": f"{int(rays.layer) / pixels:.2f} rays a pixel",
    }
