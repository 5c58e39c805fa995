"""Which effects a scene calls for, and why: the frame program holds exactly these."""

from dataclasses import dataclass

import numpy as np

from ataa_jax import shading
from ataa_jax.types import NO_TEXTURE, Scene


@dataclass(frozen=True)
class Effect:
    """One effect, whether it is compiled in, and the reason."""

    name: str
    on: bool
    reason: str


def look(scene: Scene) -> list[Effect]:
    """Looks at a scene once and lists every effect with its reason."""
    materials = scene.materials
    used = np.unique(np.asarray(scene.geometry.material))

    def textured(table: object, name: str, noun: str) -> Effect:
        count = int(np.sum(np.asarray(table)[used] != NO_TEXTURE))
        return Effect(name, count > 0, f"{count} of {used.size} materials have {noun}")

    emissive = int(np.sum(np.any(np.asarray(materials.emissive)[used] > 0, axis=-1)))
    masked = int(np.sum(np.asarray(materials.alpha_masked)[used]))
    blended = int(np.sum(np.asarray(materials.blended)[used]))
    mirrors = int(np.sum(np.asarray(materials.mirror)[used]))
    lights = int(scene.lights.kind.shape[0])
    sky = any(
        float(np.max(np.asarray(part))) > 0
        for part in (scene.sky.zenith, scene.sky.horizon, scene.sky.ground)
    )
    glow = textured(materials.emissive_texture, "emissive textures", "one")
    return [
        textured(materials.base_color_texture, "base colour textures", "one"),
        textured(
            materials.metallic_roughness_texture, "metallic-roughness textures", "one"
        ),
        textured(materials.normal_texture, "normal maps", "one"),
        Effect("emission", emissive > 0, f"{emissive} materials emit light"),
        Effect(glow.name, glow.on and emissive > 0, glow.reason),
        Effect("alpha mask", masked > 0, f"{masked} materials are cut by their alpha"),
        Effect(
            "transparency", blended > 0, f"{blended} materials let something through"
        ),
        Effect("reflections", mirrors > 0, f"{mirrors} materials are smooth mirrors"),
        Effect("shadows", lights > 0, f"{lights} lights, one shadow ray each"),
        Effect("sky", sky, "the sky is lit" if sky else "the scene has no sky"),
    ]


def required(scene: Scene) -> shading.Config:
    """Returns the shading configuration with exactly the effects that `look` lists."""
    on = {effect.name: effect.on for effect in look(scene)}
    return shading.Config(
        base_color_textures=on["base colour textures"],
        metallic_roughness_textures=on["metallic-roughness textures"],
        normal_maps=on["normal maps"],
        emission=on["emission"],
        emissive_textures=on["emissive textures"],
        transparency=on["transparency"],
        reflections=on["reflections"],
        shadows=on["shadows"],
        sky=on["sky"],
    )
