"""Materials and lights to radiance: the same code for raster and for rays.

The paper runs "identical HLSL code" at raster samples and at ray hits (section 3);
here both call `radiance`. The material is glTF 2.0's metallic-roughness model (glTF
specification, appendix B): Lambert plus GGX with Smith's height-correlated visibility
(Heitz 2014) and Schlick's Fresnel term; lights are KHR_lights_punctual with one shadow
ray each (paper, section 4); the sky adds an ambient term scaled by one visibility.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import embree, texture, vector
from ataa_jax.surface import Surface, interpolate
from ataa_jax.types import LIGHT_DIRECTIONAL, LIGHT_SPOT, Lights, Scene, Sky

# Perceptual roughness below this makes GGX's peak exceed what float32 and eight
# samples resolve (Filament's documentation, 4.8.3.1, gives 0.045 for float32).
_MIN_ROUGHNESS = 0.045

# A shadow ray starts off its surface by this share of the triangle's largest
# coordinate: 2^8 ulp, the figure of Wächter and Binder (Ray Tracing Gems, chapter 6),
# without their absolute term, so that a scene scaled by 2^k casts the same shadows.
_OFFSET = 2.0**-16

_MIN_SQUARED_DISTANCE = 2.0**-40  # light on the surface: large, but finite


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
    shadows: bool = True
    sky: bool = True


class Shaded(eqx.Module):
    """Radiance of a batch of rays, and what it was computed from."""

    color: Float[Array, "n 3"]  # linear radiance toward the viewer; the sky on a miss
    surface: Surface
    shadow_rays: Int[Array, ""]


class _Material(eqx.Module):
    """The material evaluated at one point: `diffuse` and `f0` in linear colour."""

    diffuse: Float[Array, "3 n"]
    f0: Float[Array, "3 n"]
    alpha: Float[Array, " n"]  # GGX width: perceptual roughness squared
    roughness: Float[Array, " n"]
    emissive: Float[Array, "3 n"]
    normal: Float[Array, "3 n"]


def radiance(
    scene: Scene,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    direction: Float[Array, "n 3"],
    hits: embree.Hits,
    steps: tuple[Float[Array, " 3"], Float[Array, " 3"]] | None,
    mip_bias: Float[Array, ""] | float,
    *,
    config: Config,
) -> Shaded:
    """Shades what rays met.

    Args:
        scene: geometry, materials, textures, lights and sky.
        tracer: casts the shadow rays.
        world_from_group: where the rigid groups stand in this frame.
        direction: the rays' world directions, any length.
        hits: what the rays met.
        steps: change of `direction` by a pixel to the right and one down, for the
            mip level; None: level 0 (paper, section 3: "we treat them as infinite to
            force the highest resolution of textures").
        mip_bias: added to the level of detail where there is one.
        config: the effects to compile.

    Returns:
        Radiance and surfaces; shadow rays are cast for lit, facing hits only.
    """
    ray = direction.T
    surface = interpolate(scene.geometry, world_from_group, hits, ray, steps)
    view = -vector.normalize(ray)
    material = _evaluate_material(scene, surface, mip_bias, config)
    color = material.emissive
    if config.sky:
        color = color + _ambient(scene.sky, material, view)
    direct, shadow_rays = _direct(
        scene.lights, tracer, world_from_group, surface, material, view, config
    )
    color = jnp.where(surface.hit, color + direct, 0.0)
    if config.sky:
        background = sky_radiance(scene.sky, -view)
        color = jnp.where(surface.hit, color, background)
    return Shaded(color=color.T, surface=surface, shadow_rays=shadow_rays)


def sky_radiance(sky: Sky, unit: Float[Array, "3 n"]) -> Float[Array, "3 n"]:
    """Returns the sky's radiance along unit directions: linear in the height."""
    up = jnp.clip(unit[1], 0.0, 1.0)
    down = jnp.clip(-unit[1], 0.0, 1.0)
    # A square root puts the gradient near the horizon, where real skies have it.
    up = jnp.sqrt(up)
    down = jnp.minimum(down * 8.0, 1.0)
    horizon = sky.horizon[:, None]
    return (
        horizon
        + (sky.zenith[:, None] - horizon) * up
        + (sky.ground[:, None] - horizon) * down
    )


def _evaluate_material(
    scene: Scene, surface: Surface, mip_bias: Float[Array, ""] | float, config: Config
) -> _Material:
    table, material = scene.materials, surface.material

    def fetch(textures_of_materials: Int[Array, " m"]) -> Float[Array, "3 n"]:
        return texture.sample(
            scene.textures,
            textures_of_materials[material],
            surface.uv,
            surface.uv_dx,
            surface.uv_dy,
            mip_bias,
        ).T

    base = table.base_color[material].T[:3]
    if config.base_color_textures:
        base = base * fetch(table.base_color_texture)
    metallic, roughness = table.metallic[material], table.roughness[material]
    if config.metallic_roughness_textures:
        packed = fetch(table.metallic_roughness_texture)
        roughness, metallic = roughness * packed[1], metallic * packed[2]
    normal = surface.normal
    if config.normal_maps:
        normal = _normal_mapped(
            surface,
            fetch(table.normal_texture),
            table.normal_scale[material],
            table.normal_texture[material] >= 0,
        )
    emissive = jnp.zeros_like(base)
    if config.emission:
        emissive = table.emissive[material].T
        if config.emissive_textures:
            emissive = emissive * fetch(table.emissive_texture)
    roughness = jnp.clip(roughness, _MIN_ROUGHNESS, 1.0)
    metallic = jnp.clip(metallic, 0.0, 1.0)
    return _Material(
        diffuse=base * (1.0 - metallic),
        f0=0.04 + (base - 0.04) * metallic,
        alpha=roughness * roughness,
        roughness=roughness,
        emissive=emissive,
        normal=normal,
    )


def _normal_mapped(
    surface: Surface,
    texel: Float[Array, "3 n"],
    scale: Float[Array, " n"],
    present: Bool[Array, " n"],
) -> Float[Array, "3 n"]:
    """Bends the interpolated normal by a tangent-space map (glTF: +Y is up in v).

    glTF's green points against growing v (its v runs down the image), hence the sign.
    """
    x = (texel[0] * 2.0 - 1.0) * scale
    y = (texel[1] * 2.0 - 1.0) * scale
    z = texel[2] * 2.0 - 1.0
    bent = vector.normalize(
        surface.tangent * x - surface.bitangent * y + surface.normal * z
    )
    facing = vector.dot(bent, surface.geometric_normal) > 0.0
    return jnp.where(present & facing, bent, surface.normal)


def _ambient(
    sky: Sky, material: _Material, view: Float[Array, "3 n"]
) -> Float[Array, "3 n"]:
    """Returns the sky's light reflected without occlusion, times its visibility.

    The diffuse term takes the sky along the normal blended toward the mean of the
    hemisphere; the specular term is Karis's mobile environment BRDF ("Physically based
    shading on mobile", 2014).
    """
    normal = material.normal
    cos_view = jnp.maximum(vector.dot(normal, view), 1e-4)
    height = normal[1] * 0.5 + 0.5
    middle = sky.horizon[:, None]
    above, below = sky.zenith[:, None], sky.ground[:, None]
    upper = 0.5 * (above + middle)
    irradiance = below + (upper - below) * height
    mirrored = 2.0 * cos_view * normal - view
    blurred = sky_radiance(sky, vector.normalize(mirrored))
    blurred = blurred + (irradiance - blurred) * material.roughness
    c0 = jnp.array([-1.0, -0.0275, -0.572, 0.022], jnp.float32)
    c1 = jnp.array([1.0, 0.0425, 1.04, -0.04], jnp.float32)
    r = [material.roughness * c0[i] + c1[i] for i in range(4)]
    a004 = jnp.minimum(r[0] * r[0], jnp.exp2(-9.28 * cos_view)) * r[0] + r[1]
    specular = material.f0 * (-1.04 * a004 + r[2]) + (1.04 * a004 + r[3])
    reflected = material.diffuse * irradiance + specular * blurred
    return reflected * sky.visibility


def _direct(
    lights: Lights,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    surface: Surface,
    material: _Material,
    view: Float[Array, "3 n"],
    config: Config,
) -> tuple[Float[Array, "3 n"], Int[Array, ""]]:
    """Sums the punctual lights; a scan compiles the shadow ray once for all lights."""
    zero = jnp.zeros_like(surface.position)
    count = lights.kind.shape[0]
    if count == 0:
        return zero, jnp.zeros((), jnp.int32)
    origin = surface.position + surface.geometric_normal * (surface.magnitude * _OFFSET)

    def add(
        carry: tuple[Float[Array, "3 n"], Int[Array, ""]], light: Lights
    ) -> tuple[tuple[Float[Array, "3 n"], Int[Array, ""]], None]:
        total, rays = carry
        toward, distance, irradiance = _incident(light, origin)
        cos_light = vector.dot(material.normal, toward)
        cos_geometric = vector.dot(surface.geometric_normal, toward)
        lit = surface.hit & (cos_light > 0.0) & (cos_geometric > 0.0)
        lit = lit & (jnp.max(irradiance, axis=0) > 0.0)
        if config.shadows:
            shadowed = embree.occluded(
                tracer, world_from_group, origin.T, toward.T, distance, lit
            )
            rays = rays + jnp.sum(lit, dtype=jnp.int32)
            lit = lit & ~shadowed
        reflected = _brdf(material, view, toward) * jnp.maximum(cos_light, 0.0)
        total = total + jnp.where(lit, reflected * irradiance, 0.0)
        return (total, rays), None

    carry = (zero, jnp.zeros((), jnp.int32))
    if count == 1:
        carry, _ = add(carry, jax.tree.map(lambda x: x[0], lights))
    else:
        carry, _ = jax.lax.scan(add, carry, lights)
    return carry


def _incident(
    light: Lights, point: Float[Array, "3 n"]
) -> tuple[Float[Array, "3 n"], Float[Array, " n"], Float[Array, "3 n"]]:
    """Returns direction to one light, distance to it, and its normal irradiance."""
    offset = light.position[:, None] - point
    toward_point = vector.normalize(offset)
    squared = jnp.maximum(vector.dot(offset, offset), _MIN_SQUARED_DISTANCE)
    # KHR_lights_punctual: window = clamp(1 − (d/range)⁴, 0, 1), over d².
    window = jnp.clip(1.0 - (squared / (light.range * light.range)) ** 2, 0.0, 1.0)
    cos_angle = -vector.dot(
        jnp.broadcast_to(light.direction[:, None], point.shape), toward_point
    )
    width = jnp.maximum(light.cos_inner - light.cos_outer, 1e-3)
    cone = jnp.clip((cos_angle - light.cos_outer) / width, 0.0, 1.0)
    falloff = window / squared * jnp.where(light.kind == LIGHT_SPOT, cone * cone, 1.0)
    directional = light.kind == LIGHT_DIRECTIONAL
    toward = jnp.where(directional, -light.direction[:, None], toward_point)
    distance = jnp.where(directional, jnp.inf, jnp.sqrt(squared))
    strength = jnp.where(directional, 1.0, falloff)
    return toward, distance, light.intensity[:, None] * strength


def _brdf(
    material: _Material, view: Float[Array, "3 n"], light: Float[Array, "3 n"]
) -> Float[Array, "3 n"]:
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
    bend = cos_half * cos_half * (a2 - 1.0) + 1.0
    distribution = a2 / (jnp.pi * bend * bend)
    visibility = 0.5 / (
        cos_light * jnp.sqrt(cos_view * cos_view * (1.0 - a2) + a2)
        + cos_view * jnp.sqrt(cos_light * cos_light * (1.0 - a2) + a2)
    )
    fresnel = material.f0 + (1.0 - material.f0) * (1.0 - cos_hv) ** 5
    diffuse = material.diffuse * (1.0 - fresnel) / jnp.pi
    return diffuse + fresnel * (distribution * visibility)
