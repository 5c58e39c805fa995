"""From hits to surfaces: what a vertex shader's outputs are after interpolation.

Symbols: a triangle has corners p0, p1, p2, edges e1 = p1 − p0 and e2 = p2 − p0, and
the unnormalized normal N = e1 × e2. A point p0 + b1 e1 + b2 e2 of its plane has

    b1 = (p − p0) · (e2 × N) / N²,    b2 = (p − p0) · (N × e1) / N²,

so the gradients of any interpolated attribute follow without differences of pixels.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ataa_jax import vector
from ataa_jax.types import Geometry, Hits


class Surface(eqx.Module):
    """One shaded point per ray; finite everywhere, meaningless where `hit` is False."""

    hit: Bool[Array, " n"]
    position: Float[Array, "3 n"]  # world
    geometric_normal: Float[Array, "3 n"]  # world, unit, toward the viewer
    normal: Float[Array, "3 n"]  # world, unit, interpolated, toward the viewer
    tangent: Float[Array, "3 n"]  # world, unit or zero: the direction of growing u
    bitangent: Float[Array, "3 n"]  # world, unit or zero: the direction of growing v
    uv: Float[Array, "n 2"]
    uv_dx: Float[Array, "n 2"] | None  # change of uv by one pixel to the right
    uv_dy: Float[Array, "n 2"] | None  # change of uv by one pixel down
    magnitude: Float[Array, " n"]  # largest |coordinate| of the triangle, world
    triangle: Int[Array, " n"]  # a valid index also where nothing was hit
    material: Int[Array, " n"]
    object: Int[Array, " n"]


def interpolate(
    geometry: Geometry,
    world_from_group: Float[Array, "g 3 4"],
    hits: Hits,
    direction: Float[Array, "3 n"],
    steps: tuple[Float[Array, " 3"], Float[Array, " 3"]] | None,
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
    corners = jnp.moveaxis(geometry.position[triangle], 0, -1)  # corner, xyz, n
    normals = jnp.moveaxis(geometry.normal[triangle], 0, -1)
    uvs = geometry.uv[triangle]  # n, corner, uv
    normal = b0 * normals[0] + b1 * normals[1] + b2 * normals[2]
    p0, p1, p2 = corners[0], corners[1], corners[2]
    if world_from_group.shape[0] > 1:
        matrix = jnp.moveaxis(world_from_group[geometry.group[triangle]], 0, -1)
        p0, p1, p2 = (vector.transform(matrix, p) for p in (p0, p1, p2))
        normal = _rotate_normal(matrix, normal)
    e1, e2 = p1 - p0, p2 - p0
    position = p0 + b1 * e1 + b2 * e2
    plane = vector.cross(e1, e2)
    # The viewer's side: normals of either winding are turned toward the ray's origin.
    geometric = vector.normalize(plane)
    geometric = jnp.where(vector.dot(geometric, direction) > 0.0, -geometric, geometric)
    normal = vector.normalize(normal)
    normal = jnp.where(vector.dot(normal, geometric) < 0.0, -normal, normal)
    usable = jnp.any(normal != 0.0, axis=0)
    normal = jnp.where(usable, normal, geometric)

    uv = b0[:, None] * uvs[:, 0] + b1[:, None] * uvs[:, 1] + b2[:, None] * uvs[:, 2]
    duv1, duv2 = uvs[:, 1] - uvs[:, 0], uvs[:, 2] - uvs[:, 0]
    uv_dx = uv_dy = None
    if steps is not None:
        squared = vector.dot(plane, plane)
        inverse = 1.0 / jnp.where(squared > 0.0, squared, 1.0)
        gradient1 = vector.cross(e2, plane) * inverse
        gradient2 = vector.cross(plane, e1) * inverse
        distance = jnp.where(hit, hits.distance, 1.0)
        along = vector.dot(plane, direction)
        along = jnp.where(jnp.abs(along) > 0.0, along, 1.0)

        def uv_step(step: Float[Array, " 3"]) -> Float[Array, "n 2"]:
            # p = o + t d stays on the plane: dp = t (dd − d (N·dd)/(N·d)).
            slope = (plane[0] * step[0] + plane[1] * step[1] + plane[2] * step[2]) / (
                along
            )
            moved = distance * (step[:, None] - direction * slope)
            db1 = vector.dot(moved, gradient1)
            db2 = vector.dot(moved, gradient2)
            return db1[:, None] * duv1 + db2[:, None] * duv2

        uv_dx, uv_dy = uv_step(steps[0]), uv_step(steps[1])

    # dp/du and dp/dv from e = duv · (dp/du, dp/dv); only directions matter here.
    determinant = duv1[:, 0] * duv2[:, 1] - duv2[:, 0] * duv1[:, 1]
    sign = jnp.sign(determinant)
    tangent = vector.normalize((e1 * duv2[:, 1] - e2 * duv1[:, 1]) * sign)
    bitangent = vector.normalize((e2 * duv1[:, 0] - e1 * duv2[:, 0]) * sign)
    magnitude = jnp.max(jnp.abs(jnp.concatenate([p0, p1, p2])), axis=0)
    return Surface(
        hit=hit,
        position=position,
        geometric_normal=geometric,
        normal=normal,
        tangent=tangent,
        bitangent=bitangent,
        uv=uv,
        uv_dx=uv_dx,
        uv_dy=uv_dy,
        magnitude=magnitude,
        triangle=triangle,
        material=geometry.material[triangle],
        object=geometry.object[triangle],
    )


def previous_position(
    geometry: Geometry,
    previous_world_from_group: Float[Array, "g 3 4"],
    hits: Hits,
    surface: Surface,
) -> Float[Array, "3 n"]:
    """Returns where the same material points were one frame before, world."""
    if previous_world_from_group.shape[0] == 1:
        return surface.position
    b1, b2 = hits.barycentric[:, 0], hits.barycentric[:, 1]
    corners = jnp.moveaxis(geometry.position[surface.triangle], 0, -1)
    matrix = jnp.moveaxis(
        previous_world_from_group[geometry.group[surface.triangle]], 0, -1
    )
    p0, p1, p2 = (vector.transform(matrix, corners[i]) for i in range(3))
    return p0 + b1 * (p1 - p0) + b2 * (p2 - p0)


def _rotate_normal(
    matrix: Float[Array, "3 4 n"], normal: Float[Array, "3 n"]
) -> Float[Array, "3 n"]:
    """Transforms normals by the cofactor matrix, the inverse transpose up to scale."""
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    return (
        vector.cross(b, c) * normal[0]
        + vector.cross(c, a) * normal[1]
        + vector.cross(a, b) * normal[2]
    )
