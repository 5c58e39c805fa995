"""Rays: offsets of secondary rays, cracks, degenerate triangles, layers.

*Magnitude* is the largest coordinate of a triangle; a ray leaves its surface at 2⁻¹⁶ of
it along the normal (`surface.lifted`).
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import embree, layers, types, vector
from ataa_jax.surface import interpolate, lifted
from tests import tiny
from tests.hard_cases.case import Topic
from tests.oracles import intersect as oracle

TOPIC = Topic("rays")

RAYS = 16_384
OFFSET = 2.0**-16  # of the magnitude


@partial(jax.jit, static_argnames="side")
def _leave(scene, matrices, distance, triangle, weights, direction, side=1.0):
    hits = types.Hits(distance=distance, triangle=triangle, barycentric=weights)
    surface = interpolate(
        scene.geometry, matrices, hits, vector.unstack(direction), None
    )
    normal = vector.stack(surface.geometric_normal)
    return vector.stack(lifted(surface, side)), vector.stack(surface.position), normal


def _shot(scene, matrices, origin, direction, side=1.0):
    """Traces rays; returns (hit, where rays leave, position, normal toward the ray)."""
    tracer = embree.build(scene)
    hits = tracer.intersect_numpy(matrices, origin, direction)
    start, position, normal = _leave(
        scene, jnp.asarray(matrices), *map(jnp.asarray, hits), jnp.asarray(direction),
        side=side,
    )  # fmt: skip
    arrays = (np.asarray(part) for part in (start, position, normal))
    return hits.triangle >= 0, *arrays


def _blocked(scene, matrices, start, toward, distance=np.inf):
    far = np.full(len(start), distance, np.float32)
    return embree.build(scene).occluded_numpy(
        matrices, start, toward.astype(np.float32), far, np.ones(len(start), bool)
    )


def _unit(rng, count):
    direction = rng.normal(size=(count, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def _at_sphere(centre, radius, rng):
    """Rays from around a sphere at points of it."""
    origin = centre + 3.0 * radius * _unit(rng, RAYS)
    target = centre + 0.98 * radius * _unit(rng, RAYS)
    return origin.astype(np.float32), (target - origin).astype(np.float32)


def _acne(scene, matrices, origin, direction, rng) -> int:
    """On a convex body every blocked ray to a light above the facet is wrong."""
    hit, start, _, normal = _shot(scene, matrices, origin, direction)
    # Half of the lights graze the facet: 1e-4 to 1e-1 above its plane.
    toward = _unit(rng, RAYS)
    tangent = toward - normal * np.sum(toward * normal, axis=1, keepdims=True)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    grazing = tangent + normal * 10.0 ** rng.uniform(-4, -1, (RAYS, 1))
    toward = np.where(rng.random((RAYS, 1)) < 0.5, grazing, toward)
    facing = hit & (np.sum(toward * normal, axis=1) > 1e-5)
    return int(np.sum(_blocked(scene, matrices, start, toward) & facing))


def _ball(centre=(0.0, 0.0, 0.0), radius=1.0) -> types.Scene:
    part = tiny.sphere(16, 32, radius)
    position = part.position.astype(np.float64) + np.asarray(centre)
    return tiny.scene([tiny.Part(position.astype(np.float32))])


@TOPIC.case(
    "a ball does not shade itself at any scale",
    danger="shadow acne: a ray meets the facet that it leaves",
    quantity="self-shadowed points of radii 1e-6 to 1e6, lights from 0.006° up",
    bound=0,
    reason="a convex body hides no light that stands over the facet",
)
def acne_by_scale() -> float:
    rng = np.random.default_rng(0)
    count = 0
    for radius in (1e-6, 1e-3, 1.0, 1e3, 1e6):
        rays = _at_sphere(np.zeros(3), radius, rng)
        count += _acne(_ball(radius=radius), tiny.still(), *rays, rng)
    return float(count)


@TOPIC.case(
    "a ball far from the origin does not shade itself",
    danger="at 1000 radii from the origin positions are rounded to 6e-5 radii",
    quantity="self-shadowed points at 1 to 1000 radii from the origin",
    bound=0,
    reason="the offset grows with the coordinates: 256 steps of float32",
)
def acne_far_away() -> float:
    rng = np.random.default_rng(1)
    count = 0
    for far in (1.0, 10.0, 100.0, 1000.0):
        centre = np.array([far, -0.7 * far, 0.4 * far])
        rays = _at_sphere(centre, 1.0, rng)
        count += _acne(_ball(centre), tiny.still(), *rays, rng)
    return float(count)


@TOPIC.case(
    "a moving group that passes the origin does not shade itself",
    danger="R p + t cancels: small world coordinates with the error of large ones",
    quantity="self-shadowed points, the group's own origin 1 to 1000 radii away",
    bound=0,
    reason="the offset must follow the largest number that was rounded on the way",
)
def acne_of_groups() -> float:
    rng = np.random.default_rng(2)
    count = 0
    for far in (1.0, 10.0, 100.0, 1000.0):
        own = np.array([far, -0.7 * far, 0.4 * far])
        part = tiny.sphere(16, 32)
        part.position = (part.position + own).astype(np.float32)
        part.group = 1
        matrices = tiny.still(2)
        matrices[1] = tiny.moved(turn=0.6)
        matrices[1, :, 3] = -(matrices[1, :, :3].astype(np.float64) @ own)
        scene = tiny.scene([part])
        count += _acne(scene, matrices, *_at_sphere(np.zeros(3), 1.0, rng), rng)
    return float(count)


@TOPIC.case(
    "light leaks only through gaps thinner than the offset",
    danger="the lifted start lies beyond a cover close above the surface",
    quantity="widest gap that lets light through, over the magnitude",
    bound=OFFSET,
    reason="2⁻¹⁶ of the magnitude: 1.5 mm in a scene of 100 m",
)
def thin_gaps() -> float:
    widest = 0.0
    for scale in (1e-3, 1.0, 1e4):
        for power in np.arange(-20.0, -11.9, 0.5):
            gap = 2.0**power
            floor, cover = tiny.floor(2.0), tiny.floor(2.0, gap)
            parts = [tiny.Part(p.position * np.float32(scale)) for p in (floor, cover)]
            scene = tiny.scene(parts)
            rng = np.random.default_rng(3)
            # Seen from within the gap.
            target = rng.uniform(-0.9, 0.9, (RAYS, 3)) * (1, 0, 1) * scale
            origin = (target * 0.5 + (0, 0.5 * gap * scale, 0)).astype(np.float32)
            direction = (target - origin).astype(np.float32)
            hit, start, _, normal = _shot(scene, tiny.still(), origin, direction)
            up = np.broadcast_to(np.array([0.1, 1.0, 0.2]), start.shape)
            lower = hit & (normal[:, 1] > 0.5)
            if np.any(lower & ~_blocked(scene, tiny.still(), start, up)):
                widest = max(widest, gap)
    return widest


@TOPIC.case(
    "no light comes round the corner of a closed box",
    danger="near an edge the lifted start lies outside",
    quantity="furthest point from the next wall that a light outside reaches, over the "
    "magnitude; 98,304 seen inside",
    bound=2.0**-24,
    reason="half a float32 step: a point rounded onto both walls starts on both",
)
def closed_box() -> float:
    scene = tiny.scene([tiny.cube(2.0)])
    rng = np.random.default_rng(4)
    furthest = 0.0
    for close in (0.0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3):  # to the edge x = z = 1
        target = np.stack(
            [1.0 - close * rng.random(RAYS), rng.uniform(-0.9, 0.9, RAYS),
             np.ones(RAYS)], axis=1,
        )  # fmt: skip
        origin = rng.uniform(-0.5, 0.5, (RAYS, 3)).astype(np.float32)
        direction = (target - origin).astype(np.float32)
        hit, start, _, normal = _shot(scene, tiny.still(), origin, direction)
        toward = _unit(rng, RAYS)
        facing = hit & (np.sum(toward * normal, axis=1) > 0)
        leaks = facing & ~_blocked(scene, tiny.still(), start, toward)
        to_next = 1.0 - np.where(np.abs(normal) > 0.5, 0.0, np.abs(start)).max(axis=1)
        furthest = max(furthest, float(to_next[leaks].max(initial=0.0)))
    return furthest


def _aimed(position, where, count, seed=1):
    """Rays from inside at edges or vertices."""
    rng = np.random.default_rng(seed)
    which = rng.integers(len(position), size=count)
    corner = rng.integers(3, size=count)
    a, b = position[which, corner], position[which, (corner + 1) % 3]
    share = rng.uniform(0.01, 0.99, (count, 1)).astype(np.float32)
    target = a if where == "vertex" else a + (b - a) * share
    origin = rng.uniform(-0.5, 0.5, (count, 3)).astype(np.float32)
    return origin, target - origin


@TOPIC.case(
    "a million rays at the edges and vertices of a closed ball do not leave it",
    danger="cracks between triangles (Embree's issue 181)",
    quantity="rays that leave, of 500,000 at edges and 500,000 at vertices",
    bound=0,
    reason="a missed ray is traced once more, turned by 16 ulps",
    hard=True,
)
def cracks() -> float:
    part = tiny.sphere(64, 128)
    tracer = embree.build(tiny.scene([part]))
    lost = 0
    for where in ("edge", "vertex"):
        rays = _aimed(part.position, where, 500_000)
        hits = tracer.intersect_numpy(tiny.still(), *rays, coherent=False)
        lost += int(np.sum(hits.triangle < 0))
    return float(lost)


@TOPIC.case(
    "half a million shadow rays at edges of a closed ball do not leave it",
    danger="light leaks through the edges of a mesh",
    quantity="rays that leave, of 500,000 at edges",
    bound=0,
    reason="Embree's robust mode; at vertices up to 2 % do leave, which is stated",
    hard=True,
)
def shadow_cracks() -> float:
    part = tiny.sphere(64, 128)
    tracer = embree.build(tiny.scene([part]))
    rays = _aimed(part.position, "edge", 500_000)
    far = np.full(500_000, np.inf, np.float32)
    blocked = tracer.occluded_numpy(
        tiny.still(), *rays, far, np.ones(500_000, bool), coherent=False
    )
    return float(np.sum(~blocked))


@TOPIC.case(
    "slivers, duplicates, specks and a plane of 1e9 units are hit as they should",
    danger="a determinant that under- or overflows; a NaN distance",
    quantity="rays, away from edges, that differ from float64 brute force by 1e-4",
    bound=0,
    # Barycentric weights are quotients of float32 sums: 1e-3 from an edge they decide,
    # and a distance is good to some steps over the cosine.
    reason="only rays within 1e-3 of an edge in barycentric terms may fall either way",
)
def odd_triangles() -> float:
    rng = np.random.default_rng(5)
    corner = rng.uniform(-2, 2, (60, 1, 3))
    soup = corner + rng.normal(size=(60, 3, 3)) * rng.choice([1e-3, 0.3, 2], (60, 1, 1))
    sliver = corner[:20] + rng.normal(size=(20, 3, 3)) * (3.0, 1e-4, 1e-4)
    # Two corners together, three on a line, all three together: no area.
    flat = np.repeat(corner[:6], 3, axis=1)
    flat[2:4, 2] += 1.0
    flat[4:, 1] += 1.0
    flat[4:, 2] += 2.0
    plane = np.array([[[-1e9, -3, -1e9], [1e9, -3, -1e9], [0, -3, 1e9]]])
    position = np.concatenate([soup, soup[:10], sliver, flat, plane]).astype(np.float32)
    origin = rng.uniform(-3, 3, (4000, 3)).astype(np.float32) + np.float32([0, 1, 0])
    direction = _unit(rng, 4000).astype(np.float32)
    scene = tiny.scene([tiny.Part(position)])
    hits = embree.build(scene).intersect_numpy(tiny.still(), origin, direction)
    every, u, v = oracle.all_pairs(position, origin, direction)
    distance = every.min(axis=1)
    edge = np.minimum(np.minimum(np.abs(u), np.abs(v)), np.abs(1 - u - v))
    # A ray is doubtful if it passes by an edge of any triangle on its way.
    doubtful = ((edge < 1e-3) & (u > -0.01) & (v > -0.01) & (u + v < 1.01)).any(axis=1)
    with np.errstate(invalid="ignore"):
        close = np.abs(hits.distance - distance) <= 1e-4 * np.maximum(distance, 1.0)
    agree = close | (np.isinf(distance) & np.isinf(hits.distance))
    return float(np.sum(~agree & ~doubtful))


@TOPIC.case(
    "layers further apart than the offset are all seen, at any angle and scale",
    danger="the walk steps over the next pane, or meets the same one again",
    quantity="rays through 4 panes that count another number, gaps of 2⁻¹⁵ and more",
    bound=0,
    reason="a step of 2⁻¹⁶ of the magnitude along the normal, and half a pane's room",
)
def close_layers() -> float:
    rng = np.random.default_rng(6)
    wrong = 0
    for scale in (1e-3, 1.0, 1e4):
        for gap in (2.0**-15, 2.0**-9):
            depths = [-gap * k * scale for k in range(4)]
            parts = [tiny.quad(2.0 * scale, (0.0, 0.0, z)) for z in depths]
            pane = tiny.Material(base_color=(1, 1, 1, 0.5), blended=True)
            scene = tiny.scene(parts, [pane])
            clear = embree.build(scene).clear
            assert clear is not None
            direction = _unit(rng, RAYS)
            direction[:, 2] = -np.abs(direction[:, 2]) - 0.02  # up to 89° off
            target = rng.uniform(-0.4, 0.4, (RAYS, 3)) * (1, 1, 0) * scale
            origin = target - direction * 0.3 * scale
            wrong += int(np.sum(_panes(scene, clear, origin, direction) != 4))
    return float(wrong)


@TOPIC.case(
    "a pane behind a wall is not seen, but for the walk's own steps",
    danger="each step shortens the measured way, until the pane seems before the wall",
    quantity="widest gap between wall and pane behind 8 panes that shows it, over the "
    "magnitude",
    bound=8 * OFFSET,
    reason="eight steps of 2⁻¹⁶ of the magnitude",
)
def pane_behind_wall() -> float:
    rng = np.random.default_rng(7)
    direction = _unit(rng, RAYS)
    direction[:, 2] = -np.abs(direction[:, 2]) - 0.5
    target = rng.uniform(-0.2, 0.2, (RAYS, 3)) * (1, 1, 0)
    origin = target - direction * 0.3
    widest = 0.0
    for power in np.arange(-15.0, -10.0):
        gap = 2.0**power
        wall = -9 * 2.0**-6
        depths = [*(-(2.0**-6) * k for k in range(8)), wall - gap]
        pane = tiny.Material(base_color=(1, 1, 1, 0.5), blended=True)
        scene = tiny.scene([tiny.quad(2.0, (0.0, 0.0, z)) for z in depths], [pane])
        clear = embree.build(scene).clear
        far = (wall - origin[:, 2]) / direction[:, 2]
        if np.any(_panes(scene, clear, origin, direction, far) > 8):
            widest = gap
    return widest


def _panes(scene, clear, origin, direction, far=np.inf) -> np.ndarray:
    """Walks rays through layers as `layers.passed` does, and counts them."""
    matrices = jnp.asarray(tiny.still())
    toward = jnp.asarray(direction, jnp.float32)
    start = jnp.asarray(origin, jnp.float32)
    travelled = jnp.zeros(RAYS, jnp.float32)
    far = jnp.asarray(np.broadcast_to(far, RAYS), jnp.float32)
    alive, count = jnp.ones(RAYS, bool), np.zeros(RAYS, int)
    for _ in range(10):
        hits = layers.next_layer(
            clear, matrices, vector.unstack(start), vector.unstack(toward),
            travelled, far, alive,
        )  # fmt: skip
        alive = hits.triangle >= 0
        if not jnp.any(alive):
            break
        count += np.asarray(alive)
        travelled = jnp.where(alive, hits.distance, travelled)
        onward, _, _ = _leave(
            scene, matrices, hits.distance, hits.triangle, hits.barycentric, toward,
            side=-1.0,
        )  # fmt: skip
        start = jnp.where(alive[:, None], onward, start)
    return count


TOPIC.covered(
    "no ray leaves a closed mesh at edges or vertices, both ways to Embree",
    danger="cracks between triangles",
    test="test_embree_backends.py::test_no_ray_leaves_a_closed_mesh",
    bound="0 of 200,000 rays miss",
    reason="one ray through a crack is a hole in the image",
)
TOPIC.covered(
    "shadow rays leave a closed mesh at vertices only, under 2 %",
    danger="cracks between triangles",
    test="test_embree_backends.py::"
    "test_shadow_rays_leave_a_closed_mesh_at_vertices_only",
    bound="0 of 200,000 unblocked at edges, < 0.02 · 200,000 at vertices",
    reason="aimed at vertices, 0.9 % slip through",
)
TOPIC.covered(
    "directions with components of 0, rays in planes and from corners agree",
    danger="0 · inf in a box test",
    test="test_embree_backends.py::test_backends_agree_where_everything_is_degenerate",
    bound="distances rtol 16 · 2⁻²³, > 0 and not NaN",
    reason="the fallback restarts rays that begin on a surface, 8 ulps further on",
)
TOPIC.covered(
    "triangles without area or not finite are left out and counted",
    danger="a NaN in the hierarchy's boxes loses its neighbours",
    test="test_scene.py::"
    "test_triangles_without_area_or_not_finite_are_left_out_and_counted",
    bound="1 of 4 left, bit-equal; 3 in the note; an error if none is left",
    reason="what is whole passes unchanged, what is lost is told",
)
TOPIC.covered(
    "rays that are not finite or have no direction miss",
    danger="a NaN ray spoils its packet",
    test="test_embree.py::test_rays_that_are_not_finite_or_have_no_direction_miss",
    bound="19 of 19 rays miss, 0 of 19 are blocked",
    reason="such a ray has no point that could be hit",
)
TOPIC.covered(
    "64 layers composite as 64 layers",
    danger="rounding adds up; the loop's limit",
    test="test_transport.py::test_sixty_four_layers_deep",
    bound="atol 5e-6, rtol 1e-7",
    reason="64 roundings of 6e-8 each, on values of order 1",
)
TOPIC.covered(
    "a ray passes a hundred holes of an alpha mask",
    danger="a limit of filtered hits",
    test="test_embree_masks.py::test_a_ray_passes_a_hundred_holes",
    bound="64 of 64 rays reach the wall; distance rtol 4 · 2⁻²³, fallback 400 · 2⁻²³",
    reason="one ray rounds once; restarted a hundred times, each start rounds its "
    "point",
)
