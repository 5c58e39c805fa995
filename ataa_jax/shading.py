"""Materials and lights to radiance: the same code for raster and for rays.

The paper runs "identical HLSL code" at raster samples and at ray hits (section 3);
here both call `radiance`. Lights are KHR_lights_punctual with one shadow ray each
(paper, section 4); the sky adds an ambient term scaled by one visibility.
"""

from collections.abc import Callable
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import compact, embree, layers, vector
from ataa_jax.material import Config, Material, brdf, evaluate, reflection
from ataa_jax.surface import Surface, interpolate, lifted
from ataa_jax.types import LIGHT_DIRECTIONAL, LIGHT_SPOT, Hits, Lights, Rays, Scene, Sky
from ataa_jax.vector import Vec3

MIN_SQUARED_DISTANCE = 2.0**-40  # light on the surface: large, but finite
# our choice: a shadow ray ends this share of its length before the light, as large as
# the share of the coordinates by which it leaves its surface (`surface.lifted`).
SHORT = 2.0**-16
# our choice: of more hits, so many are shaded at a time. Drawing the ship, a tenth of
# whose pixels are no sky, takes half of the time that it takes to shade all pixels;
# Sponza, which has none, as long as that. With 2^13 Sponza takes 40 % longer.
CHUNK = 1 << 15


class Mirror(eqx.Module):
    """What a mirror shows: color + weight · (radiance along direction) − sky's part."""

    smooth: Bool[Array, " n"]  # False: the surface is no mirror there
    direction: Vec3  # world, unit
    weight: Vec3  # Fresnel reflectance, times how mirror-like the surface is
    replaced: Vec3  # the sky's reflection, which `Shaded.color` holds


class Shaded(eqx.Module):
    """Radiance of a batch of rays, and what it was computed from."""

    color: Vec3  # linear radiance toward the viewer; the sky on a miss
    surface: Surface
    mirror: Mirror | None  # None: reflections are off
    opacity: Float[Array, " n"] | None  # None: the batch met solid surfaces
    transmittance: Vec3 | None  # of what lies behind
    rays: Rays  # shadow rays, and those through layers toward lights


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
    clear: bool = False,
) -> Shaded:
    """Shades what rays met: the surfaces alone, not what they mirror or let through.

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
        clear: the hits are on transparent surfaces: tell their opacity too.

    Returns:
        Radiance and surfaces; shadow rays are cast for lit, facing hits only.
    """
    shade = partial(
        _shade, scene, tracer, world_from_group, mip_bias, config=config, clear=clear
    )
    if hits.triangle.shape[0] <= CHUNK:
        shaded = shade(direction, hits, steps, tile=tile)
    else:
        shaded = _packed(shade, direction, hits, steps, tile)
    background: Vec3 | float = 0.0
    if config.sky:
        background = sky_radiance(scene.sky, vector.normalize(direction))
    color = vector.select(shaded.surface.hit, shaded.color, background)
    return eqx.tree_at(lambda s: s.color, shaded, vector.materialize(color))


def _packed(
    shade: Callable[..., Shaded],
    direction: Vec3,
    hits: Hits,
    steps: tuple[Vec3, Vec3] | None,
    tile: tuple[int, int] | None,
) -> Shaded:
    """Shades what hit something, packed together: sky costs nothing."""

    def work(
        row: tuple[Vec3, Hits, tuple[Vec3, Vec3] | None], used: Bool[Array, " c"]
    ) -> tuple[Shaded, Rays]:
        toward, met, step = row
        triangle = jnp.where(used, met.triangle, -1)
        met = eqx.tree_at(lambda h: h.triangle, met, triangle)
        part = shade(toward, met, step, tile=None)
        return eqx.tree_at(lambda s: s.rays, part, None), part.rays

    rows = direction, hits, steps
    shaded, rays = compact.map_chunks(hits.triangle >= 0, CHUNK, work, rows, tile)
    return eqx.tree_at(lambda s: s.rays, shaded, rays, is_leaf=lambda x: x is None)


def _shade(
    scene: Scene,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    mip_bias: Float[Array, ""] | float,
    direction: Vec3,
    hits: Hits,
    steps: tuple[Vec3, Vec3] | None,
    *,
    config: Config,
    tile: tuple[int, int] | None,
    clear: bool,
) -> Shaded:
    """Shades as `radiance` does; the colour of a miss means nothing."""
    surface = vector.materialize(
        interpolate(scene.geometry, world_from_group, hits, direction, steps)
    )
    view = vector.materialize(-vector.normalize(direction))
    material = vector.materialize(
        evaluate(scene, surface, view, mip_bias, config, clear=clear)
    )
    color, rays = _direct(
        scene, tracer, world_from_group, surface, material, view, tile, config
    )
    mirror = None
    if config.sky or config.reflections:
        # Materialized, and the sky's specular part too: fused into the sums, a last bit
        # of the colour would depend on whether reflections are compiled.
        mirrored, reflectance = vector.materialize(reflection(material, view))
        specular = jax.tree.map(jnp.zeros_like, color)
        if config.sky:
            diffuse, specular = _ambient(scene.sky, material, mirrored, reflectance)
            specular = vector.materialize(specular)
            color = color + (diffuse + specular)
        if config.reflections:
            mirror = vector.materialize(
                _mirror(surface, material, mirrored, reflectance, specular)
            )
    if material.emissive is not None:
        # Materialized first: fused, an emission of 0 would still change a last bit.
        color = vector.materialize(color) + material.emissive
    return Shaded(
        color=vector.materialize(color),
        surface=surface,
        mirror=mirror,
        opacity=material.opacity,
        transmittance=material.transmittance,
        rays=rays,
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


def transmittance(
    scene: Scene,
    world_from_group: Float[Array, "g 3 4"],
    direction: Vec3,
    hits: Hits,
    *,
    config: Config,
) -> tuple[Vec3, Surface]:
    """Returns what share of light transparent surfaces let through, and the surfaces.

    glTF's BLEND lets 1 − α through, of any colour; KHR_materials_transmission lets the
    base colour's share of what enters through, too. Read at mip level 0: a light has
    no pixels. Thin surfaces: nothing is refracted.
    """
    surface = vector.materialize(
        interpolate(scene.geometry, world_from_group, hits, direction, None)
    )
    view = -vector.normalize(direction)
    material = evaluate(scene, surface, view, 0.0, config, clear=True)
    assert material.transmittance is not None
    return material.transmittance, surface


def _mirror(
    surface: Surface,
    material: Material,
    direction: Vec3,
    reflectance: Vec3,
    sky_specular: Vec3,
) -> Mirror:
    """Returns what a reflection ray has to be cast for."""
    assert material.mirror is not None
    # A bent normal may send the ray into its own surface: there the sky stands in.
    out = vector.dot(direction, surface.geometric_normal) > 0.0
    smooth = surface.hit & out & (material.mirror > 0.0)
    share = jnp.where(smooth, material.mirror, 0.0)
    return Mirror(
        smooth=smooth,
        direction=direction,
        weight=reflectance * share,
        replaced=sky_specular * share,
    )


def _ambient(
    sky: Sky, material: Material, mirrored: Vec3, reflectance: Vec3
) -> tuple[Vec3, Vec3]:
    """Returns diffuse and specular reflection of the sky times its visibility.

    What hides the rest of the sky sends its own light, which is added to the diffuse
    part. The diffuse term takes the mean radiance of the hemisphere about the normal,
    linear between the mean of the upper sky and the ground; the specular term the
    mirrored sky, blurred toward that mean by roughness.
    """
    normal = material.normal
    zenith, horizon, ground = _sky_colors(sky)
    upper = (zenith + horizon) * 0.5
    irradiance = ground + (upper - ground) * (normal.y * 0.5 + 0.5)
    blurred = sky_radiance(sky, mirrored)
    blurred = blurred + (irradiance - blurred) * material.roughness
    diffuse = material.diffuse * irradiance * sky.visibility
    bounce = material.diffuse * vector.unstack(sky.bounce)
    return diffuse + bounce, reflectance * blurred * sky.visibility


def _direct(
    scene: Scene,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    surface: Surface,
    material: Material,
    view: Vec3,
    tile: tuple[int, int] | None,
    config: Config,
) -> tuple[Vec3, Rays]:
    """Sums the punctual lights; a scan compiles the shadow ray once for all lights."""
    lights = scene.lights
    black = jax.tree.map(jnp.zeros_like, surface.position)
    zero = jnp.zeros((), jnp.int32)
    count = lights.kind.shape[0]
    if count == 0:
        return black, no_rays(lights)
    start = vector.materialize(lifted(surface))
    start_array = vector.stack(start)

    def add(
        carry: tuple[Vec3, Int[Array, ""]], light: Lights
    ) -> tuple[tuple[Vec3, Int[Array, ""]], Int[Array, ""]]:
        total, layer_rays = carry
        shadow_rays = zero
        toward, irradiance = vector.materialize(_incident(light, surface.position))
        cos_light = vector.dot(material.normal, toward)
        cos_geometric = vector.dot(surface.geometric_normal, toward)
        lit = surface.hit & (cos_light > 0.0) & (cos_geometric > 0.0)
        lit = lit & (vector.largest(irradiance) > 0.0)
        if config.shadows:
            tested = lit & light.casts
            way, far = _shadow_ray(light, start, toward)
            shadowed = embree.occluded(
                tracer,
                world_from_group,
                start_array,
                vector.stack(way),
                far,
                tested,
                tile=tile,
            )
            shadow_rays = jnp.sum(tested, dtype=jnp.int32)
            lit = lit & ~shadowed
            clear = clear_of(tracer, config)
            if clear is not None:
                passed, rays = _through_layers(
                    scene, clear, world_from_group, start, way, far,
                    lit & light.casts, tile, config,
                )  # fmt: skip
                irradiance = irradiance * passed
                layer_rays = layer_rays + rays
        reflected = brdf(material, view, toward) * irradiance
        total = total + reflected * jnp.where(lit, cos_light, 0.0)
        return (total, layer_rays), shadow_rays

    carry = (black, zero)
    if count == 1:
        carry, shadow_rays = add(carry, jax.tree.map(lambda x: x[0], lights))
        shadow_rays = shadow_rays[None]
    else:
        carry, shadow_rays = jax.lax.scan(add, carry, lights)
    return carry[0], Rays(shadow=shadow_rays, reflection=zero, layer=carry[1])


def clear_of(tracer: embree.Tracer, config: Config) -> embree.Tracer | None:
    """Returns what traces transparent surfaces; None where they are not seen."""
    return tracer.clear if config.transparency else None


def no_rays(lights: Lights | None) -> Rays:
    """Returns a count of no rays at all; None: of no lights either."""
    zero = jnp.zeros((), jnp.int32)
    shape = (0,) if lights is None else lights.kind.shape
    return Rays(shadow=jnp.zeros(shape, jnp.int32), reflection=zero, layer=zero)


def _through_layers(
    scene: Scene,
    clear: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    start: Vec3,
    way: Vec3,
    far: Float[Array, " n"],
    lit: Bool[Array, " n"],
    tile: tuple[int, int] | None,
    config: Config,
) -> tuple[Vec3, Int[Array, ""]]:
    """Returns the share of a light that transparent surfaces let through, and rays."""

    def share(direction: Vec3, hits: Hits) -> tuple[Vec3, Surface]:
        return transmittance(scene, world_from_group, direction, hits, config=config)

    return layers.passed(
        clear, world_from_group, start, way, far, lit, share, tile=tile
    )


def _shadow_ray(
    light: Lights, start: Vec3, toward: Vec3
) -> tuple[Vec3, Float[Array, " n"]]:
    """Returns direction and length, in its units, of the ray from `start` to a light.

    It leads from where it leaves the surface to the light itself and stops short of
    it: parallel to `toward`, it would end beyond a lamp on a ceiling, in its shadow.
    """
    directional = jnp.broadcast_to(light.kind == LIGHT_DIRECTIONAL, start.x.shape)
    aim = vector.unstack(light.position) - start
    return vector.select(directional, toward, aim), jnp.where(
        directional, jnp.inf, jnp.float32(1.0 - SHORT)
    )


def _incident(light: Lights, point: Vec3) -> tuple[Vec3, Vec3]:
    """Returns direction to one light, and its normal irradiance."""
    travel = vector.unstack(light.direction)
    offset = vector.unstack(light.position) - point
    toward_point = vector.normalize(offset)
    squared = jnp.maximum(vector.dot(offset, offset), MIN_SQUARED_DISTANCE)
    # KHR_lights_punctual: window = clamp(1 − (d/range)⁴, 0, 1), over d².
    window = jnp.clip(1.0 - (squared / (light.range * light.range)) ** 2, 0.0, 1.0)
    cos_angle = -vector.dot(toward_point, travel)
    width = jnp.maximum(light.cos_inner - light.cos_outer, 1e-3)
    cone = jnp.clip((cos_angle - light.cos_outer) / width, 0.0, 1.0)
    falloff = window / squared * jnp.where(light.kind == LIGHT_SPOT, cone * cone, 1.0)
    directional = light.kind == LIGHT_DIRECTIONAL
    toward = vector.select(directional, -travel, toward_point)
    strength = jnp.where(directional, 1.0, falloff)
    return toward, vector.unstack(light.intensity) * strength
