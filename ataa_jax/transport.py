"""From a ray to its radiance: the solid surface, what it mirrors, what lies before it.

The raster stage and the tracer both call `trace`: the paper's "identical HLSL code"
(section 3). `shading.radiance` gives the light that a surface sends by itself; here
one reflection ray is added where the surface is a mirror, and transparent surfaces
nearer than the solid one are composited over it. With layers 1 … K nearest first, of
colour c, opacity α and transmittance τ (glTF's BLEND: τ = 1 − α),

    L = Σ_k (Π_{j<k} τ_j) α_k c_k + (Π_j τ_j) L_solid,

which is back-to-front compositing written from the front.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import compact, embree, layers, shading, vector
from ataa_jax.shading import Config, Shaded
from ataa_jax.surface import Surface, lifted
from ataa_jax.types import Hits, Rays, Scene
from ataa_jax.vector import Vec3

# our choice: a layer that lets less than half through is what the G-buffer shows.
_SHOWN = 0.5


class Second(eqx.Module):
    """Of all surfaces that a ray shows beside `Traced.shown`, the one it shows most."""

    hits: Hits
    # Its weight in the composite (see the module), the largest channel's; 0: none.
    share: Float[Array, " n"]


class Traced(eqx.Module):
    """What a batch of rays from one point saw."""

    color: Vec3  # linear radiance
    surface: Surface  # of the solid hits
    solid: Hits
    shown: Hits  # for the G-buffer: the first that is opaque, or nearly
    rays: Rays
    second: Second | None = None  # where it is asked for and there may be layers


def trace(
    scene: Scene,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    eye: Vec3,
    direction: Vec3,
    steps: tuple[Vec3, Vec3] | None,
    mip_bias: Float[Array, ""] | float,
    *,
    config: Config,
    tile: tuple[int, int] | None = None,
    second: bool = False,
) -> Traced:
    """Traces and shades rays that start at one point.

    Args:
        scene: geometry, materials, textures, lights and sky.
        tracer: solid surfaces, and the clear ones beside them.
        world_from_group: where the rigid groups stand.
        eye: the point, world.
        direction: world, any length; NaN: no ray.
        steps: see `shading.radiance`.
        mip_bias: added to the level of detail where there is one.
        config: the effects to compile.
        tile: image (height, width) where the rays are its pixels in row-major order.
        second: also tell of the surface that is seen with the one shown.

    Returns:
        Radiance, hits and counts.
    """
    origin = jax.tree.map(lambda e, d: jnp.broadcast_to(e, d.shape), eye, direction)
    hits = embree.intersect(
        tracer,
        world_from_group,
        vector.stack(origin),
        vector.stack(direction),
        tile=tile,
    )
    shaded = shading.radiance(
        scene, tracer, world_from_group, direction, hits, steps, mip_bias,
        config=config, tile=tile,
    )  # fmt: skip
    layered = shading.clear_of(tracer, config) is not None
    if not layered and not config.reflections:
        return Traced(shaded.color, shaded.surface, hits, hits, shaded.rays)
    color, shown, beside, rays = _go_on(
        scene, tracer, world_from_group, origin, direction, steps, mip_bias,
        hits, shaded, config=config, tile=tile, second=second and layered,
    )  # fmt: skip
    return Traced(color, shaded.surface, hits, shown, rays, beside)


class _Ray(eqx.Module):
    """Rays on their way through layers, some of them with a reflection still to see."""

    solid: Vec3  # radiance of the solid surface
    color: Vec3  # gathered from the layers so far
    passed: Vec3  # share of what lies behind that still gets through
    start: Vec3  # just beyond the last layer, world
    travelled: Float[Array, " c"]  # from the eye to `start`
    walking: Bool[Array, " c"]  # there may be another layer
    mirrored: Bool[Array, " c"]  # the last surface's reflection comes first
    weight: Vec3  # of that reflection
    reflected: Vec3  # its direction, world
    mirror_start: Vec3
    shown: Hits
    found: Bool[Array, " c"]  # `shown` is a layer
    second: Second | None  # of the layers


def _go_on(
    scene: Scene,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    origin: Vec3,
    direction: Vec3,
    steps: tuple[Vec3, Vec3] | None,
    mip_bias: Float[Array, ""] | float,
    hits: Hits,
    shaded: Shaded,
    *,
    config: Config,
    tile: tuple[int, int] | None,
    second: bool,
) -> tuple[Vec3, Hits, Second | None, Rays]:
    """Follows the rays that met a mirror, or a layer before their solid hit.

    One loop takes both turn by turn, so that the shading code is compiled once more
    and not three times. A reflection ray sees solid surfaces only, and mirrors
    nothing itself.
    """
    n = hits.triangle.shape[0]
    nothing = jnp.zeros((n,), jnp.bool_)
    rays, met, smooth = shaded.rays, nothing, nothing
    clear = shading.clear_of(tracer, config)
    if clear is not None:
        active = jnp.isfinite(direction.x)
        arrays = vector.stack(origin), vector.stack(direction), hits.distance
        met = embree.occluded(clear, world_from_group, *arrays, active, tile=tile)
        tested = jnp.sum(active, dtype=jnp.int32)
        rays = eqx.tree_at(lambda r: r.layer, rays, rays.layer + tested)
    if shaded.mirror is not None:
        smooth = shaded.mirror.smooth
    rowwise = eqx.tree_at(lambda s: s.rays, shaded, None)

    def work(index: Int[Array, " c"], used: Bool[Array, " c"], carry: tuple) -> tuple:
        *gathered, rays = carry
        rows = jnp.minimum(index, n - 1)
        eye, toward, solid, layered, own = jax.tree.map(
            lambda x: x[rows], (origin, direction, hits, met, rowwise)
        )
        ray = _first(eye, solid, own, layered & used, used, second)

        def unfinished(state: tuple) -> Bool[Array, ""]:
            count, ray, _ = state
            # Every layer may be a mirror, and so may the solid surface.
            bounded = count < 2 * layers.MAX_LAYERS + 1
            return bounded & jnp.any(ray.walking | ray.mirrored)

        def turn(state: tuple) -> tuple:
            count, ray, rays = state
            ray, cast = _turn(
                scene, tracer, world_from_group, toward, solid.distance, steps,
                mip_bias, ray, config,
            )  # fmt: skip
            return count + 1, ray, jax.tree.map(jnp.add, rays, cast)

        start = (jnp.zeros((), jnp.int32), ray, rays)
        _, ray, rays = jax.lax.while_loop(unfinished, turn, start)
        color = ray.color + ray.passed * ray.solid
        result = [color, ray.shown, _or_solid(ray, solid)]
        gathered = jax.tree.map(
            lambda x, y: x.at[index].set(y, mode="drop"), gathered, result
        )
        return *gathered, rays

    beside = _no_second(n) if second else None
    return compact.for_each_chunk(
        met | smooth, layers.CHUNK, work, (shaded.color, hits, beside, rays)
    )


def _first(
    eye: Vec3,
    solid: Hits,
    shaded: Shaded,
    layered: Bool[Array, " c"],
    used: Bool[Array, " c"],
    second: bool,
) -> _Ray:
    """Returns the rays as they stand at the solid surface, before any layer."""
    black = jax.tree.map(jnp.zeros_like, shaded.color)
    nowhere = jnp.zeros(layered.shape, jnp.bool_)
    own, mirrored, weight, reflected = shaded.color, nowhere, black, black
    if shaded.mirror is not None:
        mirrored = shaded.mirror.smooth & used
        own = own - vector.select(mirrored, shaded.mirror.replaced, 0.0)
        weight, reflected = shaded.mirror.weight, shaded.mirror.direction
    return _Ray(
        solid=own,
        color=black,
        passed=jax.tree.map(jnp.ones_like, black),
        start=eye,
        travelled=jnp.zeros(layered.shape, jnp.float32),
        walking=layered,
        mirrored=mirrored,
        weight=weight,
        reflected=reflected,
        mirror_start=lifted(shaded.surface),
        shown=solid,
        found=nowhere,
        second=_no_second(layered.shape[0]) if second else None,
    )


def _turn(
    scene: Scene,
    tracer: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    toward: Vec3,
    far: Float[Array, " c"],
    steps: tuple[Vec3, Vec3] | None,
    mip_bias: Float[Array, ""] | float,
    ray: _Ray,
    config: Config,
) -> tuple[_Ray, Rays]:
    """Sees each ray's reflection where it has one left, else its next layer."""
    mirrored, walking = ray.mirrored, ray.walking & ~ray.mirrored
    clear = shading.clear_of(tracer, config)
    direction = vector.select(mirrored, ray.reflected, toward)
    hits = _miss(far.shape[0])
    if clear is not None:
        hits = layers.next_layer(
            clear, world_from_group, ray.start, toward, ray.travelled, far,
            walking,
        )  # fmt: skip
    layer = hits.triangle >= 0
    if config.reflections:
        seen = embree.intersect(
            tracer,
            world_from_group,
            vector.stack(ray.mirror_start),
            vector.stack(vector.select(mirrored, ray.reflected, jnp.nan)),
        )
        hits = _select(mirrored, seen, hits)
    if steps is not None:  # in a mirror mip level 0, as rays read
        right, down = (vector.select(mirrored, 0.0, step) for step in steps)
        steps = right, down
    shaded = shading.radiance(
        scene, tracer, world_from_group, direction, hits, steps, mip_bias,
        config=config, clear=clear is not None,
    )  # fmt: skip
    if config.reflections:
        light = vector.select(mirrored, shaded.color * ray.weight, 0.0)
        # Before any layer the reflection is the solid surface's.
        behind = ray.travelled > 0.0
        ray = eqx.tree_at(
            lambda r: (r.solid, r.color, r.mirrored),
            ray,
            (
                ray.solid + vector.select(behind, 0.0, light),
                ray.color + vector.select(behind, light, 0.0),
                jnp.zeros_like(mirrored),
            ),
        )
    if clear is not None:
        ray = _composited(ray, shaded, hits, layer, ray.walking & mirrored)
    cast = Rays(
        shadow=shaded.rays.shadow,
        reflection=jnp.sum(mirrored, dtype=jnp.int32),
        layer=shaded.rays.layer + jnp.sum(walking, dtype=jnp.int32),
    )
    return ray, cast


def _composited(
    ray: _Ray,
    shaded: Shaded,
    hits: Hits,
    layer: Bool[Array, " c"],
    waiting: Bool[Array, " c"],
) -> _Ray:
    """Puts one layer over what lies behind; see the module's docstring."""
    assert shaded.opacity is not None
    assert shaded.transmittance is not None
    weight = ray.passed * jnp.where(layer, shaded.opacity, 0.0)
    share = vector.select(layer, shaded.transmittance, 1.0)
    own = vector.select(layer, shaded.color, 0.0)
    mirrored, mirror_weight, reflected = ray.mirrored, ray.weight, ray.reflected
    if shaded.mirror is not None:
        mirrored = layer & shaded.mirror.smooth
        own = own - vector.select(mirrored, shaded.mirror.replaced, 0.0)
        mirror_weight = shaded.mirror.weight * weight
        reflected = shaded.mirror.direction
    shows = layer & ~ray.found & (vector.largest(share) < _SHOWN)
    return _Ray(
        solid=ray.solid,
        color=ray.color + own * weight,
        passed=ray.passed * share,
        start=vector.select(layer, lifted(shaded.surface, -1.0), ray.start),
        travelled=jnp.where(layer, hits.distance, ray.travelled),
        walking=layer | waiting,
        mirrored=mirrored,
        weight=mirror_weight,
        reflected=reflected,
        mirror_start=lifted(shaded.surface),
        shown=_select(shows, hits, ray.shown),
        found=ray.found | shows,
        second=_heavier(
            ray.second, hits, jnp.where(shows, 0.0, vector.largest(weight))
        ),
    )


def _or_solid(ray: _Ray, solid: Hits) -> Second | None:
    """Returns the second surface, now that the solid one's share is known as well."""
    return _heavier(
        ray.second, solid, jnp.where(ray.found, vector.largest(ray.passed), 0.0)
    )


def _heavier(
    second: Second | None, hits: Hits, share: Float[Array, " c"]
) -> Second | None:
    """Returns the second surfaces, or others where those have a larger share."""
    if second is None:
        return None
    more = share > second.share
    return Second(_select(more, hits, second.hits), jnp.maximum(share, second.share))


def _no_second(n: int) -> Second:
    return Second(_miss(n), jnp.zeros((n,), jnp.float32))


def _miss(n: int) -> Hits:
    return Hits(
        distance=jnp.full((n,), jnp.inf, jnp.float32),
        triangle=jnp.full((n,), -1, jnp.int32),
        barycentric=jnp.zeros((n, 2), jnp.float32),
    )


def _select(condition: Bool[Array, " c"], a: Hits, b: Hits) -> Hits:
    return Hits(
        distance=jnp.where(condition, a.distance, b.distance),
        triangle=jnp.where(condition, a.triangle, b.triangle),
        barycentric=jnp.where(condition[:, None], a.barycentric, b.barycentric),
    )
