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
from ataa_jax.types import LIGHT_DIRECTIONAL, LIGHT_SPOT, Hits, Lights, Scene, Sky
from ataa_jax.vector import Vec3

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

    color: Vec3  # linear radiance toward the viewer; the sky on a miss
    surface: Surface
    shadow_rays: Int[Array, ""]


class _Material(eqx.Module):
    """The material evaluated at one point: `diffuse` and `f0` are linear colours."""

    diffuse: Vec3
    f0: Vec3
    alpha: Float[Array, " n"]  # GGX width: perceptual roughness squared
    roughness: Float[Array, " n"]
    emissive: Vec3 | None
    normal: Vec3


def radiance(
    scene: Scene,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    direction: Vec3,
    hits: Hits,
    steps: tuple[Vec3, Vec3] | None,
    mip_bias: Float[Array, ""] | float,
    *,
    config: Config,
    tile: tuple[int, int] | None = None,
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
        tile: image (height, width) where the rays are its pixels in row-major order;
            shadow rays of 4×4 pixels then travel together.

    Returns:
        Radiance and surfaces; shadow rays are cast for lit, facing hits only.
    """
    surface = vector.materialize(
        interpolate(scene.geometry, world_from_group, hits, direction, steps)
    )
    view = vector.materialize(-vector.normalize(direction))
    material = vector.materialize(_evaluate_material(scene, surface, mip_bias, config))
    color, shadow_rays = _direct(
        scene.lights, tracer, world_from_group, surface, material, view, tile, config
    )
    if config.sky:
        color = color + _ambient(scene.sky, material, view)
    if material.emissive is not None:
        # Materialized first: fused, an emission of 0 would still change a last bit.
        color = vector.materialize(color) + material.emissive
    background: Vec3 | float = 0.0
    if config.sky:
        background = sky_radiance(scene.sky, -view)
    color = vector.select(surface.hit, color, background)
    return Shaded(
        color=vector.materialize(color), surface=surface, shadow_rays=shadow_rays
    )


def sky_radiance(sky: Sky, unit: Vec3) -> Vec3:
    """Returns the sky's radiance along unit directions.

    A square root puts the gradient near the horizon, where real skies have it.
    """
    up = jnp.sqrt(jnp.clip(unit.y, 0.0, 1.0))
    down = jnp.clip(-2.0 * unit.y, 0.0, 1.0)
    zenith, horizon, ground = _sky_colors(sky)
    return horizon + (zenith - horizon) * up + (ground - horizon) * down


def _sky_colors(sky: Sky) -> tuple[Vec3, Vec3, Vec3]:
    zenith, horizon, ground = (
        vector.unstack(part) for part in (sky.zenith, sky.horizon, sky.ground)
    )
    return zenith, horizon, ground


def _evaluate_material(
    scene: Scene, surface: Surface, mip_bias: Float[Array, ""] | float, config: Config
) -> _Material:
    table, material = scene.materials, surface.material

    def fetch(texture_of_material: Int[Array, " m"], *, srgb: bool = False) -> Vec3:
        return texture.sample(
            scene.textures,
            texture_of_material[material],
            surface.uv,
            surface.uv_dx,
            surface.uv_dy,
            mip_bias,
            srgb=srgb,
        )

    base = Vec3(*vector.take(table.base_color, material)[:3])
    if config.base_color_textures:
        base = base * fetch(table.base_color_texture, srgb=True)
    metallic, roughness = table.metallic[material], table.roughness[material]
    if config.metallic_roughness_textures:
        packed = fetch(table.metallic_roughness_texture)
        roughness, metallic = roughness * packed.y, metallic * packed.z
    normal = surface.normal
    if config.normal_maps:
        normal = _normal_mapped(
            surface,
            fetch(table.normal_texture),
            table.normal_scale[material],
            table.normal_texture[material] >= 0,
        )
    emissive = None
    if config.emission:
        (emissive,) = vector.take3(table.emissive, material)
        if config.emissive_textures:
            emissive = emissive * fetch(table.emissive_texture, srgb=True)
    roughness = jnp.clip(roughness, _MIN_ROUGHNESS, 1.0)
    metallic = jnp.clip(metallic, 0.0, 1.0)
    return _Material(
        diffuse=base * (1.0 - metallic),
        f0=(base - 0.04) * metallic + 0.04,
        alpha=roughness * roughness,
        roughness=roughness,
        emissive=emissive,
        normal=normal,
    )


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


def _ambient(sky: Sky, material: _Material, view: Vec3) -> Vec3:
    """Returns the sky's light times its visibility, and that of the surroundings.

    The diffuse term takes the mean radiance of the hemisphere about the normal, linear
    between the mean of the upper sky and the ground; the specular term is Karis's
    mobile environment BRDF ("Physically based shading on mobile", 2014).
    """
    normal = material.normal
    cos_view = jnp.maximum(vector.dot(normal, view), 1e-4)
    zenith, horizon, ground = _sky_colors(sky)
    upper = (zenith + horizon) * 0.5
    irradiance = ground + (upper - ground) * (normal.y * 0.5 + 0.5)
    mirrored = vector.normalize(normal * (2.0 * cos_view) - view)
    blurred = sky_radiance(sky, mirrored)
    blurred = blurred + (irradiance - blurred) * material.roughness
    # Karis's fit: r = roughness · c0 + c1.
    r_x = 1.0 - material.roughness
    r_y = 0.0425 - 0.0275 * material.roughness
    r_z = 1.04 - 0.572 * material.roughness
    r_w = 0.022 * material.roughness - 0.04
    a004 = jnp.minimum(r_x * r_x, jnp.exp2(-9.28 * cos_view)) * r_x + r_y
    scale, bias = -1.04 * a004 + r_z, 1.04 * a004 + r_w
    specular = material.f0 * scale + bias
    reflected = material.diffuse * irradiance + specular * blurred
    return reflected * sky.visibility + material.diffuse * vector.unstack(sky.bounce)


def _direct(
    lights: Lights,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    surface: Surface,
    material: _Material,
    view: Vec3,
    tile: tuple[int, int] | None,
    config: Config,
) -> tuple[Vec3, Int[Array, ""]]:
    """Sums the punctual lights; a scan compiles the shadow ray once for all lights."""
    black = jax.tree.map(jnp.zeros_like, surface.position)
    count = lights.kind.shape[0]
    if count == 0:
        return black, jnp.zeros((), jnp.int32)
    lift = surface.geometric_normal * (surface.magnitude * _OFFSET)
    start = vector.materialize(vector.stack(surface.position + lift))

    def add(
        carry: tuple[Vec3, Int[Array, ""]], light: Lights
    ) -> tuple[tuple[Vec3, Int[Array, ""]], None]:
        total, rays = carry
        toward, distance, irradiance = vector.materialize(
            _incident(light, surface.position)
        )
        cos_light = vector.dot(material.normal, toward)
        cos_geometric = vector.dot(surface.geometric_normal, toward)
        lit = surface.hit & (cos_light > 0.0) & (cos_geometric > 0.0)
        lit = lit & (vector.largest(irradiance) > 0.0)
        if config.shadows:
            shadowed = embree.occluded(
                tracer,
                world_from_group,
                start,
                vector.stack(toward),
                distance,
                lit,
                tile=tile,
            )
            rays = rays + jnp.sum(lit, dtype=jnp.int32)
            lit = lit & ~shadowed
        reflected = _brdf(material, view, toward) * irradiance
        total = total + reflected * jnp.where(lit, cos_light, 0.0)
        return (total, rays), None

    carry = (black, jnp.zeros((), jnp.int32))
    if count == 1:
        carry, _ = add(carry, jax.tree.map(lambda x: x[0], lights))
    else:
        carry, _ = jax.lax.scan(add, carry, lights)
    return carry


def _incident(light: Lights, point: Vec3) -> tuple[Vec3, Float[Array, " n"], Vec3]:
    """Returns direction to one light, distance to it, and its normal irradiance."""
    travel = vector.unstack(light.direction)
    offset = vector.unstack(light.position) - point
    toward_point = vector.normalize(offset)
    squared = jnp.maximum(vector.dot(offset, offset), _MIN_SQUARED_DISTANCE)
    # KHR_lights_punctual: window = clamp(1 − (d/range)⁴, 0, 1), over d².
    window = jnp.clip(1.0 - (squared / (light.range * light.range)) ** 2, 0.0, 1.0)
    cos_angle = -vector.dot(toward_point, travel)
    width = jnp.maximum(light.cos_inner - light.cos_outer, 1e-3)
    cone = jnp.clip((cos_angle - light.cos_outer) / width, 0.0, 1.0)
    falloff = window / squared * jnp.where(light.kind == LIGHT_SPOT, cone * cone, 1.0)
    directional = light.kind == LIGHT_DIRECTIONAL
    toward = vector.select(directional, -travel, toward_point)
    distance = jnp.where(directional, jnp.inf, jnp.sqrt(squared))
    strength = jnp.where(directional, 1.0, falloff)
    return toward, distance, vector.unstack(light.intensity) * strength


def _brdf(material: _Material, view: Vec3, light: Vec3) -> Vec3:
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
    grazing = 1.0 - cos_hv
    grazing = grazing * grazing * (grazing * grazing) * grazing
    fresnel = material.f0 + (1.0 - material.f0) * grazing
    diffuse = material.diffuse * (1.0 - fresnel) * (1.0 / jnp.pi)
    return diffuse + fresnel * (distribution * visibility)
