"""Materials at a point: their textures, and what they reflect.

glTF 2.0's metallic-roughness model (glTF specification, appendix B): Lambert plus GGX
with Smith's height-correlated visibility (Heitz 2014) and Schlick's Fresnel term.
"""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import texture, vector
from ataa_jax.scene import MIRROR_ROUGHNESS
from ataa_jax.surface import Surface
from ataa_jax.types import Materials, Scene
from ataa_jax.vector import Vec3

# Perceptual roughness below this makes GGX's peak exceed what float32 and eight
# samples resolve (Filament's documentation, 4.8.3.1, gives 0.045 for float32).
MIN_ROUGHNESS = 0.045

# our choice: below this roughness a surface is a mirror and no less; between it and
# MIRROR_ROUGHNESS the reflection ray fades into the sky's blurred reflection.
_FULL = 0.05


@dataclass(frozen=True)
class Config:
    """The effects that are compiled in; what is off costs nothing.

    `ataa_jax.effects.required` fills this in from a scene.
    """

    base_color_textures: bool = True
    metallic_roughness_textures: bool = True
    normal_maps: bool = True
    emission: bool = True
    emissive_textures: bool = True
    transparency: bool = True
    reflections: bool = True
    shadows: bool = True
    sky: bool = True


class Material(eqx.Module):
    """The material evaluated at one point: `diffuse` and `f0` are linear colours."""

    diffuse: Vec3
    f0: Vec3
    alpha: Float[Array, " n"]  # GGX width: perceptual roughness squared
    roughness: Float[Array, " n"]
    emissive: Vec3 | None
    normal: Vec3
    mirror: Float[Array, " n"] | None  # 1: a mirror; 0: not at all
    opacity: Float[Array, " n"] | None
    transmittance: Vec3 | None


class _Row(eqx.Module):
    """One line of `types.Materials` per element."""

    base_color: Vec3
    alpha: Float[Array, " n"]
    emissive: Vec3
    metallic: Float[Array, " n"]
    roughness: Float[Array, " n"]
    normal_scale: Float[Array, " n"]
    transmission: Float[Array, " n"]
    mirror: Float[Array, " n"]  # 1: true
    base_color_texture: Int[Array, " n"]
    metallic_roughness_texture: Int[Array, " n"]
    normal_texture: Int[Array, " n"]
    emissive_texture: Int[Array, " n"]


def _rows(table: Materials, material: Int[Array, " n"]) -> _Row:
    """Gathers the materials in two passes, one a type: every gather is a program."""
    single = (
        *(table.metallic, table.roughness, table.normal_scale, table.transmission),
        table.mirror.astype(jnp.float32),
    )
    numbers = [table.base_color, table.emissive, jnp.stack(single, axis=1)]
    r, g, b, alpha, e_r, e_g, e_b, *rest = vector.take(
        jnp.concatenate(numbers, axis=1), material
    )
    textures = (
        *(table.base_color_texture, table.metallic_roughness_texture),
        *(table.normal_texture, table.emissive_texture),
    )
    ids = vector.take(jnp.stack(textures, axis=1), material)
    return _Row(Vec3(r, g, b), alpha, Vec3(e_r, e_g, e_b), *rest, *ids)


def evaluate(
    scene: Scene,
    surface: Surface,
    view: Vec3,
    mip_bias: Float[Array, ""] | float,
    config: Config,
    *,
    clear: bool = False,
) -> Material:
    """Evaluates the materials of a batch of points.

    Args:
        scene: materials and textures.
        surface: the points.
        view: unit, toward the viewer.
        mip_bias: added to the level of detail where the surface has derivatives.
        config: the effects to compile.
        clear: the points are on transparent surfaces: tell opacity and transmittance.
    """
    row = _rows(scene.materials, surface.material)

    def fetch(texture_id: Int[Array, " n"], *, srgb: bool = False) -> Vec3:
        return texture.sample(
            scene.textures,
            texture_id,
            surface.uv,
            surface.uv_dx,
            surface.uv_dy,
            mip_bias,
            srgb=srgb,
        )

    base = row.base_color
    if config.base_color_textures:
        base = base * fetch(row.base_color_texture, srgb=True)
    metallic, roughness = row.metallic, row.roughness
    if config.metallic_roughness_textures:
        packed = fetch(row.metallic_roughness_texture)
        roughness, metallic = roughness * packed.y, metallic * packed.z
    normal = surface.normal
    if config.normal_maps:
        normal = _normal_mapped(
            surface,
            fetch(row.normal_texture),
            row.normal_scale,
            row.normal_texture >= 0,
        )
    emissive = None
    if config.emission:
        emissive = row.emissive
        if config.emissive_textures:
            emissive = emissive * fetch(row.emissive_texture, srgb=True)
    mirror = None
    if config.reflections:
        fade = (MIRROR_ROUGHNESS - roughness) * (1.0 / (MIRROR_ROUGHNESS - _FULL))
        mirror = jnp.where(row.mirror > 0.0, jnp.clip(fade, 0.0, 1.0), 0.0)
    roughness = jnp.clip(roughness, MIN_ROUGHNESS, 1.0)
    metallic = jnp.clip(metallic, 0.0, 1.0)
    diffuse = base * (1.0 - metallic)
    opacity = transmittance = None
    if clear:
        opacity = row.alpha
        if config.base_color_textures:
            opacity = opacity * texture.sample_alpha(
                scene.textures,
                row.base_color_texture,
                surface.uv,
                surface.uv_dx,
                surface.uv_dy,
                mip_bias,
            )
        share = row.transmission
        cos_view = jnp.clip(vector.dot(surface.normal, view), 0.0, 1.0)
        passed = share * (1.0 - schlick(0.04, cos_view))
        transmittance = (1.0 - opacity) + diffuse * (opacity * passed)
        diffuse = diffuse * (1.0 - share)
    return Material(
        diffuse=diffuse,
        f0=(base - 0.04) * metallic + 0.04,
        alpha=roughness * roughness,
        roughness=roughness,
        emissive=emissive,
        normal=normal,
        mirror=mirror,
        opacity=opacity,
        transmittance=transmittance,
    )


def schlick(f0: Vec3 | float, cosine: Float[Array, " n"]) -> Vec3 | Array:
    """Returns Schlick's Fresnel reflectance."""
    grazing = 1.0 - cosine
    return f0 + (1.0 - f0) * (grazing * grazing * (grazing * grazing) * grazing)


def _normal_mapped(
    surface: Surface,
    texel: Vec3,
    scale: Float[Array, " n"],
    present: Bool[Array, " n"],
) -> Vec3:
    """Bends the interpolated normal by a tangent-space map.

    glTF's green grows against v (its v runs down the image), hence the sign.
    """
    x = (texel.x * 2.0 - 1.0) * scale
    y = (texel.y * 2.0 - 1.0) * scale
    z = texel.z * 2.0 - 1.0
    bent = vector.normalize(
        surface.tangent * x - surface.bitangent * y + surface.normal * z
    )
    facing = vector.dot(bent, surface.geometric_normal) > 0.0
    return vector.select(present & facing, bent, surface.normal)


def reflection(material: Material, view: Vec3) -> tuple[Vec3, Vec3]:
    """Returns the mirrored view and the reflectance of a uniform environment.

    The mirrored view is unit within 2e-4: |2(n·v)n − v| = 1, but for the clamp of n·v.
    The reflectance is Karis's fit of the environment BRDF ("Physically based shading
    on mobile", 2014).
    """
    normal = material.normal
    cos_view = vector.materialize(jnp.maximum(vector.dot(normal, view), 1e-4))
    mirrored = normal * (2.0 * cos_view) - view
    # r = roughness · c0 + c1
    r_x = 1.0 - material.roughness
    r_y = 0.0425 - 0.0275 * material.roughness
    r_z = 1.04 - 0.572 * material.roughness
    r_w = 0.022 * material.roughness - 0.04
    a004 = jnp.minimum(r_x * r_x, jnp.exp2(-9.28 * cos_view)) * r_x + r_y
    scale, bias = -1.04 * a004 + r_z, 1.04 * a004 + r_w
    return mirrored, material.f0 * scale + bias


def brdf(material: Material, view: Vec3, light: Vec3) -> Vec3:
    """Evaluates Lambert plus GGX (glTF specification, appendix B.3).

    D = α² / (π ((n·h)² (α² − 1) + 1)²), V = ½ / (n·l √((n·v)²(1−α²)+α²) + n·v √(…)).
    """
    normal = material.normal
    half = vector.normalize(view + light)
    cos_light = jnp.maximum(vector.dot(normal, light), 1e-4)
    cos_view = jnp.maximum(vector.dot(normal, view), 1e-4)
    cos_half = jnp.clip(vector.dot(normal, half), 0.0, 1.0)
    cos_hv = jnp.clip(vector.dot(view, half), 0.0, 1.0)
    a2 = material.alpha * material.alpha
    # (n·h)² (α² − 1) + 1 with 1 − (n·h)² as |n × h|²: near the peak of a smooth
    # surface the difference would lose a tenth of its value to cancellation.
    across = vector.cross(normal, half)
    bend = vector.dot(across, across) + cos_half * cos_half * a2
    bend = jnp.where(bend > 0.0, bend, 1.0)  # light and view opposite: no half vector
    distribution = a2 / (jnp.pi * bend * bend)
    visibility = 0.5 / (
        cos_light * jnp.sqrt(cos_view * cos_view * (1.0 - a2) + a2)
        + cos_view * jnp.sqrt(cos_light * cos_light * (1.0 - a2) + a2)
    )
    fresnel = schlick(material.f0, cos_hv)
    diffuse = material.diffuse * (1.0 - fresnel) * (1.0 / jnp.pi)
    return diffuse + fresnel * (distribution * visibility)
