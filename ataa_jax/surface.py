"""From hits to surfaces: what a vertex shader's outputs are after interpolation.

Symbols: a triangle has corners p0, p1, p2, edges e1 = p1 − p0 and e2 = p2 − p0, and
the unnormalized normal N = e1 × e2. A point p0 + b1 e1 + b2 e2 of its plane has

    b1 = (p − p0) · (e2 × N) / N²,    b2 = (p − p0) · (N × e1) / N²,

so the gradients of any interpolated attribute follow without differences of pixels.
"""

from functools import reduce

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import vector
from ataa_jax.types import Geometry, Hits
from ataa_jax.vector import Vec3

# A ray starts off its surface by this share of the largest coordinate on the way there:
# 2^8 ulp, the figure of Wächter and Binder (Ray Tracing Gems, chapter 6), without their
# absolute term, so that a scene scaled by 2^k casts the same rays.
OFFSET = 2.0**-16


class Uv(eqx.Module):
    """A texture coordinate, or its change by one pixel."""

    u: Float[Array, " n"]
    v: Float[Array, " n"]


class Surface(eqx.Module):
    """One shaded point per ray; finite everywhere, meaningless where `hit` is False."""

    hit: Bool[Array, " n"]
    position: Vec3  # world
    geometric_normal: Vec3  # world, unit, toward the viewer
    normal: Vec3  # world, unit, interpolated, on the geometric normal's side
    tangent: Vec3  # world, unit or zero: the direction of growing u
    bitangent: Vec3  # world, unit or zero: the direction of growing v
    uv: Uv
    uv_dx: Uv | None  # change by one pixel to the right
    uv_dy: Uv | None  # change by one pixel down
    # Largest |coordinate| that the position was rounded at, world: of the triangle's
    # corners and, in a moving group, of its displacement.
    magnitude: Float[Array, " n"]
    triangle: Int[Array, " n"]  # a valid index also where nothing was hit
    material: Int[Array, " n"]
    object: Int[Array, " n"]


def interpolate(
    geometry: Geometry,
    world_from_group: Float[Array, "g 3 4"],
    hits: Hits,
    direction: Vec3,
    steps: tuple[Vec3, Vec3] | None,
) -> Surface:
    """Interpolates the attributes of the triangles that rays met.

    Args:
        geometry: the triangles.
        world_from_group: where the rigid groups stand in this frame.
        hits: what the rays met.
        direction: the rays' world directions, any length.
        steps: change of `direction` by one pixel to the right and one down; the uv
            derivatives are those on the *plane of the hit triangle*, as the helper
            lanes of a rasterizer have them, so silhouettes do not disturb them. None:
            no derivatives.

    Returns:
        The surface points.
    """
    hit = hits.triangle >= 0
    triangle = jnp.where(hit, hits.triangle, 0)
    b1, b2 = hits.barycentric[:, 0], hits.barycentric[:, 1]
    b0 = 1.0 - b1 - b2
    p0, p1, p2 = vector.take3(geometry.position, triangle)
    n0, n1, n2 = vector.take3(geometry.normal, triangle)
    u0, v0, u1, v1, u2, v2 = vector.take(geometry.uv, triangle)
    normal = n0 * b0 + n1 * b1 + n2 * b2
    displacement = jnp.zeros_like(b0)
    if world_from_group.shape[0] > 1:
        group = geometry.group[triangle]
        world = vector.take_affine(world_from_group, group)
        p0, p1, p2 = world.transform(p0), world.transform(p1), world.transform(p2)
        normal = world.rotate_normal(normal)
        # R p + t may cancel: what is left has the rounding of t.
        displacement = vector.largest(world.origin)
    p0, p1, p2, normal = vector.materialize((p0, p1, p2, normal))
    e1, e2 = p1 - p0, p2 - p0
    plane = vector.cross(e1, e2)
    # The viewer's side: normals of either winding are turned toward the ray's origin.
    geometric = vector.normalize(plane)
    away = vector.dot(geometric, direction) > 0.0
    geometric = vector.select(away, -geometric, geometric)
    normal = vector.normalize(normal)
    normal = vector.select(vector.dot(normal, geometric) < 0.0, -normal, normal)
    normal = vector.select(vector.largest(normal) > 0.0, normal, geometric)

    du1, dv1, du2, dv2 = vector.materialize((u1 - u0, v1 - v0, u2 - u0, v2 - v0))
    uv_dx = uv_dy = None
    if steps is not None:
        uv_dx, uv_dy = _uv_steps(
            hits, direction, steps, e1, e2, plane, (du1, dv1, du2, dv2)
        )
    # dp/du and dp/dv from e = duv · (dp/du, dp/dv); only directions matter here.
    sign = jnp.sign(du1 * dv2 - du2 * dv1)
    largest = [displacement, *(vector.largest(p) for p in (p0, p1, p2))]
    return Surface(
        hit=hit,
        position=p0 + e1 * b1 + e2 * b2,
        geometric_normal=geometric,
        normal=normal,
        tangent=vector.normalize((e1 * dv2 - e2 * dv1) * sign),
        bitangent=vector.normalize((e2 * du1 - e1 * du2) * sign),
        uv=Uv(u0 + b1 * du1 + b2 * du2, v0 + b1 * dv1 + b2 * dv2),
        uv_dx=uv_dx,
        uv_dy=uv_dy,
        magnitude=reduce(jnp.maximum, largest),
        triangle=triangle,
        material=geometry.material[triangle],
        object=geometry.object[triangle],
    )


def lifted(surface: Surface, side: float = 1.0) -> Vec3:
    """Returns where rays leave the surface: on the viewer's side, or (−1) beyond it."""
    return surface.position + surface.geometric_normal * (
        surface.magnitude * (OFFSET * side)
    )


def previous_position(
    geometry: Geometry,
    previous_world_from_group: Float[Array, "g 3 4"],
    hits: Hits,
    surface: Surface,
) -> Vec3:
    """Returns where the same material points were one frame before, world."""
    if previous_world_from_group.shape[0] == 1:
        return surface.position
    b1, b2 = hits.barycentric[:, 0], hits.barycentric[:, 1]
    p0, p1, p2 = vector.take3(geometry.position, surface.triangle)
    group = geometry.group[surface.triangle]
    world = vector.take_affine(previous_world_from_group, group)
    return world.transform(p0 + (p1 - p0) * b1 + (p2 - p0) * b2)


def _uv_steps(
    hits: Hits,
    direction: Vec3,
    steps: tuple[Vec3, Vec3],
    e1: Vec3,
    e2: Vec3,
    plane: Vec3,
    differences: tuple[Array, Array, Array, Array],
) -> tuple[Uv, Uv]:
    """Returns the change of uv by one pixel to the right and one down."""
    du1, dv1, du2, dv2 = differences
    squared = vector.dot(plane, plane)
    inverse = 1.0 / jnp.where(squared > 0.0, squared, 1.0)
    gradient1 = vector.cross(e2, plane) * inverse
    gradient2 = vector.cross(plane, e1) * inverse
    distance = jnp.where(hits.triangle >= 0, hits.distance, 1.0)
    along = vector.dot(plane, direction)
    along = jnp.where(jnp.abs(along) > 0.0, along, 1.0)

    def change(step: Vec3) -> Uv:
        # p = o + t d stays on the plane: dp = t (dd − d (N·dd)/(N·d)).
        slope = vector.dot(plane, step) / along
        moved = (step - direction * slope) * distance
        db1, db2 = vector.dot(moved, gradient1), vector.dot(moved, gradient2)
        return Uv(db1 * du1 + db2 * du2, db1 * dv1 + db2 * dv2)

    return change(steps[0]), change(steps[1])
