"""Light that reaches a point through transparent surfaces.

`embree.Tracer.clear` holds the surfaces that something shows through, apart from the
solid ones. A shadow ray that meets any of them before its light is walked from layer
to layer, and each takes its share; all others cost one occlusion test.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import compact, embree, vector
from ataa_jax.surface import Surface, lifted
from ataa_jax.types import Hits
from ataa_jax.vector import Vec3

# our choice: layers behind the 64th let everything through unchanged.
MAX_LAYERS = 64
CHUNK = 4096  # our choice: few of a picture's rays pass through anything

# (directions, hits) → the share that the surfaces let through, and the surfaces.
Share = Callable[[Vec3, Hits], tuple[Vec3, Surface]]


def passed(
    clear: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    origin: Vec3,
    direction: Vec3,
    far: Float[Array, " n"],
    active: Bool[Array, " n"],
    share: Share,
    *,
    tile: tuple[int, int] | None = None,
) -> tuple[Vec3, Int[Array, ""]]:
    """Returns the product of all layers' shares along each ray, and the rays cast.

    Args:
        clear: the transparent surfaces.
        world_from_group: where the rigid groups stand.
        origin: world.
        direction: world, any length.
        far: where the rays end, in units of the direction's length.
        active: rays to walk; 1 for the others.
        share: what a layer lets through.
        tile: as `embree.intersect` takes it.
    """
    n = far.shape[0]
    met = embree.occluded(
        clear,
        world_from_group,
        vector.stack(origin),
        vector.stack(direction),
        far,
        active,
        tile=tile,
    )

    def work(
        index: Int[Array, " c"], used: Bool[Array, " c"], carry: tuple[Vec3, Array]
    ) -> tuple[Vec3, Array]:
        whole, rays = carry
        rows = jnp.minimum(index, n - 1)
        start, toward, end = jax.tree.map(lambda x: x[rows], (origin, direction, far))

        def go_on(step: tuple) -> Bool[Array, ""]:
            return (step[0] < MAX_LAYERS) & jnp.any(step[1])

        def layer(step: tuple) -> tuple:
            count, alive, start, travelled, product, rays = step
            rays = rays + jnp.sum(alive, dtype=jnp.int32)
            hits = next_layer(
                clear, world_from_group, start, toward, travelled, end, alive
            )
            alive = hits.triangle >= 0
            own, surface = share(toward, hits)
            product = product * vector.select(alive, own, 1.0)
            travelled = jnp.where(alive, hits.distance, travelled)
            return count + 1, alive, lifted(surface, -1.0), travelled, product, rays

        ones = Vec3(*(jnp.ones(rows.shape, jnp.float32),) * 3)
        zeros = jnp.zeros(rows.shape, jnp.float32)
        first = (jnp.zeros((), jnp.int32), used, start, zeros, ones, rays)
        *_, product, rays = jax.lax.while_loop(go_on, layer, first)
        whole = jax.tree.map(
            lambda x, part: x.at[index].set(part, mode="drop"), whole, product
        )
        return whole, rays

    rays = jnp.sum(active, dtype=jnp.int32)
    everything = jax.tree.map(jnp.ones_like, origin)
    return compact.for_each_chunk(met, CHUNK, work, (everything, rays))


def next_layer(
    clear: embree.Tracer,
    world_from_group: Float[Array, "g 3 4"],
    start: Vec3,
    direction: Vec3,
    travelled: Float[Array, " c"],
    far: Float[Array, " c"],
    alive: Bool[Array, " c"],
) -> Hits:
    """Finds the next layer of each ray.

    Args:
        clear: the transparent surfaces.
        world_from_group: where the rigid groups stand.
        start: just beyond the last layer, world.
        direction: world, any length.
        travelled: distance from the ray's origin to `start`.
        far: where the rays end.
        alive: rays still on their way; the others miss.

    Returns:
        Hits whose distances are from the ray's origin; a miss beyond `far`.
    """
    ray = vector.stack(vector.select(alive, direction, jnp.nan))
    found = embree.intersect(clear, world_from_group, vector.stack(start), ray)
    distance = travelled + found.distance
    hit = alive & (found.triangle >= 0) & (distance <= far)
    return Hits(
        distance=jnp.where(hit, distance, jnp.inf),
        triangle=jnp.where(hit, found.triangle, -1),
        barycentric=found.barycentric,
    )
