import gc
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import embree, errors, types
from ataa_jax.embree import library
from tests import tiny
from tests.oracles import intersect as oracle

BACKENDS = ("packet", "run")
EPS = np.finfo(np.float32).eps
INF = np.float32(np.inf)
# A packet that lands on an instance carries its ray into the group's space and back
# in float32: a few roundings of coordinates about as large as the distance.
MOVED = 16 * EPS


@pytest.fixture(params=BACKENDS)
def backend(request):
    return request.param


def rays(count, spread=3.0, seed=0):
    rng = np.random.default_rng(seed)
    origin = rng.normal(size=(count, 3)) * spread
    direction = rng.normal(size=(count, 3)) * rng.uniform(0.1, 10, size=(count, 1))
    return origin.astype(np.float32), direction.astype(np.float32)


def down(x, z, height=1.0):
    """Rays straight down from `height` above the points (x, z)."""
    x, z = (np.asarray(v, np.float32).reshape(-1) for v in (x, z))
    origin = np.stack([x, np.full_like(x, height), z], axis=-1)
    return origin, np.tile(np.float32([0, -1, 0]), (x.size, 1))


def everything(count):
    return np.ones(count, bool)


def soup(count=150, seed=3):
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-3, 3, size=(count, 1, 3))
    position = centre + rng.normal(size=(count, 3, 3))
    return tiny.scene([tiny.Part(position.astype(np.float32))])


def garden(groups=1):
    """Opaque and masked parts; parts 2 and 3 move if there are groups for them."""
    leaf = tiny.quad(3.0, (0.0, 0.0, 1.0))
    leaf.material = 1
    lattice = tiny.quad(2.0, (0.5, 0.2, -1.5))
    lattice.material = 1
    ball = tiny.sphere()
    box = tiny.cube(1.5, (2.0, 0.0, 0.0))
    if groups > 1:
        ball.group, lattice.group = 1, groups - 1
    return tiny.scene(
        [tiny.floor(20, -1.5), box, ball, lattice, leaf],
        [tiny.Material(), tiny.Material(alpha_masked=True, texture=0)],
        [tiny.checker()],
    )


# --- nearest hits --------------------------------------------------------------


def test_distance_to_a_plane_is_in_units_of_the_direction(backend):
    tracer = embree.build(tiny.scene([tiny.floor(20, -2.0)]), backend=backend)
    origin, direction = down([0.1, 2.3, -4.0], [0.3, 1.0, 2.0], height=1.0)
    for length in (0.25, 1.0, 8.0):  # powers of two: exact
        hits = tracer.intersect_numpy(
            tiny.still(), origin, direction * np.float32(length)
        )
        np.testing.assert_array_equal(hits.distance, np.full(3, 3 / length))


def test_hits_of_random_triangles_are_those_of_brute_force(backend):
    scene = soup()
    position = np.asarray(scene.geometry.position)
    origin, direction = rays(3000)
    tracer = embree.build(scene, backend=backend)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    distance, triangle, weights = oracle.nearest(position, origin, direction)
    np.testing.assert_array_equal(hits.triangle, triangle)
    hit = triangle >= 0
    assert 0.3 < hit.mean() < 0.9
    # float32 against float64; coordinates are up to 10, distances as small as 0.01.
    np.testing.assert_allclose(hits.distance[hit], distance[hit], rtol=1e-4)
    np.testing.assert_allclose(hits.barycentric[hit], weights[hit], atol=1e-4)


def test_barycentric_weights_give_the_hit_point(backend):
    scene = garden()
    tracer = embree.build(scene, backend=backend)
    origin, direction = rays(2000)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    hit = hits.triangle >= 0
    p0, p1, p2 = np.moveaxis(
        np.asarray(scene.geometry.position)[hits.triangle[hit]], 1, 0
    )
    b1, b2 = hits.barycentric[hit, :1], hits.barycentric[hit, 1:]
    along = origin[hit] + hits.distance[hit, None] * direction[hit]
    point = p0 * (1 - b1 - b2) + p1 * b1 + p2 * b2
    # Coordinates up to 20, a handful of float32 roundings on either side.
    np.testing.assert_allclose(along, point, atol=20 * 16 * EPS)


def test_a_ball_of_triangles_is_hit_between_its_inner_and_outer_sphere(backend):
    tracer = embree.build(tiny.scene([tiny.sphere(32, 64)]), backend=backend)
    origin, direction = rays(4000, spread=1.0, seed=5)
    origin *= 3 / np.linalg.norm(origin, axis=-1, keepdims=True)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    nearest = np.linalg.norm(origin - np.sum(origin * unit, -1)[:, None] * unit, axis=1)
    ahead = np.sum(origin * unit, axis=-1) < 0
    inner = np.cos(np.pi / 64) ** 2  # sagitta of a triangle between 32 × 64 points
    assert (hits.triangle[ahead & (nearest < inner)] >= 0).all()
    assert (hits.triangle[~ahead | (nearest > 1 + 1e-6)] < 0).all()
    hit = hits.triangle >= 0
    radius = np.linalg.norm(
        origin[hit] + hits.distance[hit, None] * direction[hit], axis=-1
    )
    assert inner <= radius.min()
    assert radius.max() <= 1 + 1e-5  # float32 rounding of a distance near 3


def test_both_sides_of_a_triangle_are_hit(backend):
    tracer = embree.build(tiny.scene([tiny.quad()]), backend=backend)
    origin = np.float32([[0.1, 0.2, 1], [0.1, 0.2, -1]])
    hits = tracer.intersect_numpy(tiny.still(), origin, -origin * np.float32([0, 0, 1]))
    np.testing.assert_array_equal(hits.distance, [1, 1])


def test_a_miss_has_triangle_minus_one_and_distance_inf(backend):
    tracer = embree.build(tiny.scene([tiny.quad()]), backend=backend)
    hits = tracer.intersect_numpy(
        tiny.still(), np.float32([[0, 0, 1]]), np.float32([[0, 1, 0]])
    )
    assert hits.distance[0] == INF
    assert hits.triangle[0] == -1
    np.testing.assert_array_equal(hits.barycentric, [[0, 0]])


BROKEN = [np.nan, np.inf, -np.inf]


def test_rays_that_are_not_finite_or_have_no_direction_miss(backend):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = down(np.zeros(19), np.zeros(19))
    good = tracer.intersect_numpy(tiny.still(), origin, direction)
    for i, value in enumerate(BROKEN):
        for axis in range(3):
            origin[2 * axis + 6 * i if i < 2 else axis + 12, axis] = value
            direction[2 * axis + 1 + 6 * i if i < 2 else axis + 15, axis] = value
    direction[18] = 0
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    assert (good.triangle >= 0).all()
    assert (hits.triangle == -1).all()
    far = np.full(19, INF)
    blocked = tracer.occluded_numpy(
        tiny.still(), origin, direction, far, everything(19)
    )
    assert not blocked.any()


def test_a_broken_ray_leaves_its_packet_alone(backend):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = rays(160)
    whole = tracer.intersect_numpy(tiny.still(), origin, direction)
    direction[::5] = np.nan
    some = tracer.intersect_numpy(tiny.still(), origin, direction)
    keep = np.arange(160) % 5 != 0
    np.testing.assert_array_equal(some.distance[keep], whole.distance[keep])
    assert (some.triangle[~keep] == -1).all()


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 5000])
def test_any_number_of_rays_is_traced(backend, count):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = rays(5000)
    whole = tracer.intersect_numpy(tiny.still(), origin, direction)
    part = tracer.intersect_numpy(tiny.still(), origin[:count], direction[:count])
    np.testing.assert_array_equal(part.distance, whole.distance[:count])
    blocked = tracer.occluded_numpy(
        tiny.still(),
        origin[:count],
        direction[:count],
        np.full(count, INF),
        everything(count),
    )
    np.testing.assert_array_equal(blocked, whole.triangle[:count] >= 0)


@hypothesis.given(st.integers(1, 40), st.integers(1, 70), st.booleans())
@hypothesis.settings(max_examples=30)
def test_tiles_change_the_order_of_tracing_only(height, width, coherent):
    tracer = shared_tracer()
    origin, direction = rays(height * width, seed=height)
    plain = tracer.intersect_numpy(tiny.still(), origin, direction)
    tiled = tracer.intersect_numpy(
        tiny.still(), origin, direction, tile=(height, width), coherent=coherent
    )
    np.testing.assert_array_equal(tiled.distance, plain.distance)
    np.testing.assert_array_equal(tiled.triangle, plain.triangle)
    far = np.full(height * width, np.float32(2))
    active = np.arange(height * width) % 3 > 0
    blocked = tracer.occluded_numpy(
        tiny.still(),
        origin,
        direction,
        far,
        active,
        tile=(height, width),
        coherent=coherent,
    )
    np.testing.assert_array_equal(blocked, active & (plain.distance < far))


_shared = []


def shared_tracer():
    if not _shared:
        _shared.append(embree.build(garden()))
    return _shared[0]


def test_an_empty_scene_is_missed(backend):
    nothing = tiny.scene([tiny.Part(np.zeros((0, 3, 3), np.float32))])
    tracer = embree.build(nothing, backend=backend)
    assert tracer.group_count == 1
    origin, direction = rays(20)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    assert (hits.triangle == -1).all()


# --- shadow rays ---------------------------------------------------------------


def test_occlusion_is_open_at_both_ends(backend):
    tracer = embree.build(tiny.scene([tiny.floor()]), backend=backend)
    origin, direction = down([0.3] * 6, [0.4] * 6, height=2.0)
    origin[4:, 1] = 0.0  # on the floor: that hit is at distance 0
    above = np.nextafter(np.float32(2), INF)
    distance = np.float32([2.0, above, INF, 1.0, INF, 1.0])
    blocked = tracer.occluded_numpy(
        tiny.still(), origin, direction, distance, everything(6)
    )
    np.testing.assert_array_equal(blocked, [False, True, True, False, False, False])
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    np.testing.assert_array_equal(hits.distance, [2, 2, 2, 2, INF, INF])


@pytest.mark.parametrize("distance", [0.0, -1.0, -np.inf, np.nan, 1e-45])
def test_no_length_no_occlusion(backend, distance):
    tracer = embree.build(tiny.scene([tiny.floor()]), backend=backend)
    origin, direction = down([0.0], [0.0])
    far = np.float32([distance])
    assert not tracer.occluded_numpy(
        tiny.still(), origin, direction, far, everything(1)
    ).any()


def test_occlusion_is_a_nearest_hit_within_the_distance(backend):
    tracer = embree.build(garden(), backend=backend)
    origin, direction = rays(6000)
    distance = np.random.default_rng(1).exponential(0.5, 6000).astype(np.float32)
    active = np.random.default_rng(2).random(6000) < 0.6
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    blocked = tracer.occluded_numpy(tiny.still(), origin, direction, distance, active)
    np.testing.assert_array_equal(blocked, active & (hits.distance < distance))
    assert 0.1 < blocked.mean() < 0.6


# --- alpha masks ---------------------------------------------------------------

WRAPS = (types.WRAP_REPEAT, types.WRAP_CLAMP, types.WRAP_MIRROR)


def alpha_oracle(alpha, uv, wrap_u, wrap_v):
    """Bilinear alpha at uv, one sample at a time, by padding the image with itself."""
    pads = {
        types.WRAP_REPEAT: "wrap",
        types.WRAP_CLAMP: "edge",
        types.WRAP_MIRROR: "symmetric",
    }
    height, width = alpha.shape
    pad_u, pad_v = 4 * width, 4 * height
    padded = np.pad(alpha / 255.0, ((0, 0), (pad_u, pad_u)), pads[wrap_u])
    padded = np.pad(padded, ((pad_v, pad_v), (0, 0)), pads[wrap_v])
    answer = []
    for u, v in uv.astype(np.float64):
        x, y = u * width - 0.5 + pad_u, v * height - 0.5 + pad_v
        i, j = int(np.floor(x)), int(np.floor(y))
        f, g = x - i, y - j
        quad = padded[j : j + 2, i : i + 2]
        answer.append([1 - g, g] @ quad @ [1 - f, f])
    return np.array(answer)


@pytest.mark.parametrize("wrap_u", WRAPS)
@pytest.mark.parametrize("wrap_v", WRAPS)
def test_holes_are_where_bilinear_alpha_is_below_the_cutoff(backend, wrap_u, wrap_v):
    rng = np.random.default_rng(7)
    image = rng.integers(0, 256, size=(5, 7, 4), dtype=np.uint8)
    sheet, floor = tiny.quad(2.0), tiny.quad(8.0, (0.0, 0.0, -1.0))
    sheet.uv = (sheet.uv - 0.5) * 5  # ±2.5: beyond the image on every side
    sheet.material = 1
    scene = tiny.scene(
        [sheet, floor],
        [
            tiny.Material(),
            tiny.Material(
                base_color=(1, 1, 1, 0.9),
                alpha_masked=True,
                alpha_cutoff=0.45,
                texture=1,
            ),
        ],
        [tiny.checker(), tiny.Texture(image, wrap_u, wrap_v)],
    )
    tracer = embree.build(scene, backend=backend)
    point = rng.uniform(-1, 1, size=(1500, 2)).astype(np.float32)
    origin = np.column_stack([point, np.ones(1500)]).astype(np.float32)
    direction = np.tile(np.float32([0, 0, -1]), (1500, 1))
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    uv = np.column_stack([point[:, 0], -point[:, 1]]) * 2.5
    alpha = alpha_oracle(image[..., 3], uv, wrap_u, wrap_v) * 0.9
    # float32 texel coordinates of up to 20 carry 1e-6, times a slope of up to 1.
    clear = np.abs(alpha - 0.45) > 1e-5
    assert clear.mean() > 0.99
    solid = hits.triangle < 2
    np.testing.assert_array_equal(solid[clear], alpha[clear] >= 0.45)
    blocked = tracer.occluded_numpy(
        tiny.still(), origin, direction, np.full(1500, 1.5), everything(1500)
    )
    np.testing.assert_array_equal(blocked, solid)


@pytest.mark.parametrize(("cutoff", "hit"), [(128 / 255, True), (128.1 / 255, False)])
def test_alpha_at_the_cutoff_is_solid(backend, cutoff, hit):
    image = np.full((2, 2, 4), 128, np.uint8)
    sheet = tiny.quad()
    scene = tiny.scene(
        [sheet],
        [tiny.Material(alpha_masked=True, alpha_cutoff=cutoff, texture=0)],
        [tiny.Texture(image)],
    )
    tracer = embree.build(scene, backend=backend)
    hits = tracer.intersect_numpy(
        tiny.still(), np.float32([[0, 0, 1]]), np.float32([[0, 0, -1]])
    )
    assert (hits.triangle[0] >= 0) == hit


@pytest.mark.parametrize(("alpha", "hit"), [(0.5, True), (0.49, False)])
def test_a_mask_without_texture_is_solid_or_absent(backend, alpha, hit):
    material = tiny.Material(base_color=(1, 1, 1, alpha), alpha_masked=True)
    tracer = embree.build(tiny.scene([tiny.quad()], [material]), backend=backend)
    hits = tracer.intersect_numpy(
        tiny.still(), np.float32([[0, 0, 1]]), np.float32([[0, 0, -1]])
    )
    assert (hits.triangle[0] >= 0) == hit


def test_alpha_of_an_opaque_material_is_ignored(backend):
    sheet = tiny.quad()
    tracer = embree.build(
        tiny.scene([sheet], [tiny.Material(texture=0)], [tiny.checker()]),
        backend=backend,
    )
    origin = np.float32([[0.2, 0.3, 1], [-0.3, 0.4, 1], [0.7, 0.1, 1]])
    hits = tracer.intersect_numpy(
        tiny.still(), origin, np.tile(np.float32([0, 0, -1]), (3, 1))
    )
    assert (hits.triangle >= 0).all()


def test_a_ray_passes_a_hundred_holes(backend):
    layers = 100
    sheets = [tiny.quad(4.0, (0.0, 0.0, -0.03 * i)) for i in range(layers)]
    for sheet in sheets:
        sheet.material = 1
    wall = tiny.quad(40.0, (0.0, 0.0, -4.0))
    hole = np.zeros((2, 2, 4), np.uint8)
    scene = tiny.scene(
        [*sheets, wall],
        [tiny.Material(), tiny.Material(alpha_masked=True, texture=0)],
        [tiny.Texture(hole)],
    )
    tracer = embree.build(scene, backend=backend)
    origin = np.random.default_rng(0).uniform(-1, 1, size=(64, 3)).astype(np.float32)
    origin[:, 2] = 1
    direction = np.tile(np.float32([0.05, 0.02, -1]), (64, 1))
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    assert (hits.triangle >= 2 * layers).all()
    # One ray: one rounding. Restarted a hundred times, each start rounds its point.
    tolerance = {"packet": 4 * EPS, "run": 400 * EPS}[backend]
    np.testing.assert_allclose(hits.distance, np.full(64, 5.0), rtol=tolerance)
    blocked = tracer.occluded_numpy(
        tiny.still(), origin, direction, np.full(64, 4.9), everything(64)
    )
    assert not blocked.any()


# --- moving groups -------------------------------------------------------------


def pose(seed, groups=3):
    rng = np.random.default_rng(seed)
    matrices = tiny.still(groups)
    for group in range(1, groups):
        matrices[group] = tiny.moved(
            tuple(rng.normal(size=3)), rng.uniform(-3, 3), tuple(rng.uniform(0.5, 2, 3))
        )
    return matrices


def baked(scene, matrices):
    """The same scene with every triangle carried to where its group is."""
    geometry = scene.geometry
    matrix = matrices[np.asarray(geometry.group)].astype(np.float64)
    position = np.einsum(
        "tij,tkj->tki", matrix[:, :, :3], np.asarray(geometry.position)
    )
    position += matrix[:, None, :, 3]
    return types.Scene(
        geometry=types.Geometry(
            position=jnp.asarray(position, jnp.float32),
            normal=geometry.normal,
            uv=geometry.uv,
            material=geometry.material,
            object=geometry.object,
            group=jnp.zeros_like(geometry.group),
        ),
        materials=scene.materials,
        textures=scene.textures,
        lights=scene.lights,
        sky=scene.sky,
    )


@pytest.mark.parametrize("seed", range(3))
def test_moving_a_group_moves_its_triangles(backend, seed):
    scene, matrices = garden(groups=3), pose(seed)
    tracer = embree.build(scene, backend=backend)
    assert tracer.group_count == 3
    origin, direction = rays(4000)
    hits = tracer.intersect_numpy(matrices, origin, direction)
    still = embree.build(baked(scene, matrices))
    there = still.intersect_numpy(tiny.still(), origin, direction)
    same = hits.triangle == there.triangle
    # Rays that graze an edge, or the rim of a hole, may fall on either side of it.
    assert same.mean() > 0.999
    hit = same & (hits.triangle >= 0)
    groups = np.asarray(scene.geometry.group)[hits.triangle[hit]]
    assert set(np.unique(groups)) == {0, 1, 2}
    # Baked corners are rounded to float32, as are transformed rays: at coordinates
    # of up to 20, seen at grazing angles, from distances as small as 0.01.
    np.testing.assert_allclose(
        hits.distance[hit], there.distance[hit], rtol=1e-4, atol=1e-5
    )


def test_groups_come_back_to_the_same_bits(backend):
    tracer = embree.build(garden(groups=3), backend=backend)
    origin, direction = rays(1000)
    first = tracer.intersect_numpy(pose(0), origin, direction)
    for seed in range(1, 20):  # more poses than are kept
        tracer.intersect_numpy(pose(seed), origin, direction)
    again = tracer.intersect_numpy(pose(0), origin, direction)
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_scene_at_rest_is_the_scene_without_groups(backend):
    origin, direction = rays(2000)
    moving = embree.build(garden(groups=3), backend=backend)
    static = embree.build(garden(), backend=backend)
    a = moving.intersect_numpy(tiny.still(3), origin, direction)
    b = static.intersect_numpy(tiny.still(), origin, direction)
    # The identity carries a ray exactly. One that `run` restarts behind a hole is
    # restarted in the hole's own group only: a few roundings more or less.
    tolerance = {"packet": 0, "run": 4 * EPS}[backend]
    np.testing.assert_allclose(a.distance, b.distance, rtol=tolerance)


@pytest.mark.parametrize("scale", [1e-6, 1e6, (1.0, 1e-6, 1e4)])
def test_tiny_and_huge_groups_are_hit(backend, scale):
    stub = tiny.quad()
    stub.group = 1
    tracer = embree.build(tiny.scene([tiny.floor(1, 50), stub]), backend=backend)
    matrices = tiny.still(2)
    matrices[1] = tiny.moved(scale=scale)
    width, height, _ = np.broadcast_to(np.float32(scale), 3) * np.float32(0.25)
    origin = np.float32([[width, height, 3]])
    direction = np.float32([[0, 0, -1]])
    hits = tracer.intersect_numpy(matrices, origin, direction)
    # As large as the coordinates are in the group's space, from there or from here.
    np.testing.assert_allclose(hits.distance, [3], rtol=MOVED)


@pytest.mark.parametrize("scale", [0.0, (1.0, 0.0, 1.0), 1e-30, 1e30, np.nan, np.inf])
def test_a_group_without_an_inverse_is_not_there(backend, scale):
    tracer = embree.build(garden(groups=2), backend=backend)
    matrices = tiny.still(2)
    with np.errstate(invalid="ignore"):
        matrices[1] = tiny.moved(scale=scale)
    origin, direction = rays(3000)
    hits = tracer.intersect_numpy(matrices, origin, direction)
    group = np.asarray(garden(groups=2).geometry.group)
    assert (hits.triangle >= 0).any()
    assert (group[hits.triangle[hits.triangle >= 0]] == 0).all()


def test_group_zero_is_the_world(backend):
    origin, direction = rays(500)
    for groups in (1, 2):
        tracer = embree.build(garden(groups=groups), backend=backend)
        matrices = tiny.still(groups)
        expected = tracer.intersect_numpy(matrices, origin, direction)
        matrices[0] = np.nan
        hits = tracer.intersect_numpy(matrices, origin, direction)
        np.testing.assert_array_equal(hits.distance, expected.distance)
        assert np.isnan(matrices[0]).all()  # the caller's array is its own


def test_threads_that_move_groups_do_not_meet():
    tracer = embree.build(garden(groups=3))
    origin, direction = rays(3000)
    poses = [pose(seed) for seed in range(12)]
    alone = [tracer.intersect_numpy(p, origin, direction) for p in poses]
    gate = threading.Barrier(4)

    def trace(worker):
        gate.wait(timeout=60)
        order = np.random.default_rng(worker).permutation(12)
        return {i: tracer.intersect_numpy(poses[i], origin, direction) for i in order}

    with ThreadPoolExecutor(4) as pool:
        for results in pool.map(trace, range(4)):
            for i, hits in results.items():
                np.testing.assert_array_equal(hits.distance, alone[i].distance)
                np.testing.assert_array_equal(hits.triangle, alone[i].triangle)


# --- the two backends ----------------------------------------------------------


def both(scene, matrices, count=20000, seed=11):
    origin, direction = rays(count, seed=seed)
    packet, run = (
        embree.build(scene, backend=b).intersect_numpy(matrices, origin, direction)
        for b in BACKENDS
    )
    return packet, run


@pytest.mark.parametrize("make", [soup, lambda: tiny.scene([tiny.sphere(64, 128)])])
def test_backends_agree_exactly_on_opaque_still_scenes(make):
    packet, run = both(make(), tiny.still())
    np.testing.assert_array_equal(packet.distance, run.distance)
    # Where two triangles are hit at one distance, either may be named.
    assert (packet.triangle == run.triangle).mean() > 0.999


@hypothesis.given(st.integers(0, 2**32 - 1))
@hypothesis.settings(max_examples=40)
def test_backends_agree_where_everything_is_degenerate(seed):
    # Small integers: slivers, points, shared edges, rays in planes and from corners.
    rng = np.random.default_rng(seed)
    position = rng.integers(-2, 3, size=(12, 3, 3)).astype(np.float32)
    origin = rng.integers(-3, 4, size=(200, 3)).astype(np.float32)
    direction = rng.integers(-2, 3, size=(200, 3)).astype(np.float32)
    scene = tiny.scene([tiny.Part(position)])
    packet, run = (
        embree.build(scene, backend=b).intersect_numpy(
            tiny.still(), origin, direction, coherent=seed % 2 == 0
        )
        for b in BACKENDS
    )
    # Rays that begin on a surface are restarted by `run`, 8 ulps further on.
    np.testing.assert_allclose(packet.distance, run.distance, rtol=16 * EPS)
    assert not np.isnan(packet.distance).any()
    assert (packet.distance > 0).all()


def test_backends_agree_on_holes_and_moving_groups():
    for matrices in (tiny.still(3), pose(0), pose(1)):
        packet, run = both(garden(groups=3), matrices)
        same = packet.triangle == run.triangle
        # Embree inverts the matrix and carries the ray in float32, the other way in
        # float64: rays that graze a silhouette or a hole's rim may differ.
        assert same.mean() > 0.9995
        hit = same & (packet.triangle >= 0)
        # Relative to the distance or, near the origin, to the coordinates it is the
        # difference of (up to 10, in directions about 5 long).
        np.testing.assert_allclose(
            packet.distance[hit], run.distance[hit], rtol=MOVED * 8, atol=MOVED * 2
        )


def test_auto_takes_packets_where_they_can_be_had(monkeypatch):
    assert embree.build(garden()).backend == "packet"
    monkeypatch.setattr(library, "load", lambda: None)
    assert embree.build(garden()).backend == "run"
    with pytest.raises(errors.InputError, match="choose backend 'run'"):
        embree.build(garden(), backend="packet")


def test_a_missing_symbol_is_noticed(monkeypatch):
    monkeypatch.setitem(library._SIGNATURES, "rtcNoSuchFunction", (None, []))
    assert library.load.__wrapped__() is None


def test_results_do_not_depend_on_the_instruction_set():
    origin, direction = rays(3000)
    plain, narrow = (
        embree.build(soup(), device_config=config).intersect_numpy(
            tiny.still(), origin, direction
        )
        for config in ("", "isa=sse2,threads=1")
    )
    # Wider instruction sets fuse multiply and add: one rounding less.
    np.testing.assert_array_equal(plain.triangle, narrow.triangle)
    hit = plain.triangle >= 0
    np.testing.assert_allclose(plain.distance[hit], narrow.distance[hit], rtol=1e-4)


def test_an_error_of_embree_is_raised(monkeypatch):
    monkeypatch.setattr(library, "FORMAT_FLOAT3", 0xBAD)
    with pytest.raises(RuntimeError, match="974 triangles: invalid"):
        embree.build(garden())


def test_results_do_not_depend_on_the_number_of_threads(backend):
    tracer = embree.build(garden(groups=3), backend=backend)
    origin, direction = rays(20000)
    far = np.full(20000, np.float32(3))
    results = []
    try:
        for count in (1, 2, 7):
            embree.set_threads(count)
            assert embree.threads() == count
            hits = tracer.intersect_numpy(pose(0), origin, direction)
            blocked = tracer.occluded_numpy(
                pose(0), origin, direction, far, everything(20000)
            )
            results.append((*hits, blocked))
    finally:
        embree.set_threads(None)
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_threads_are_at_least_one():
    with pytest.raises(ValueError, match="at least 1"):
        embree.set_threads(0)


# --- cracks --------------------------------------------------------------------


def aimed(position, where, count, seed=1):
    rng = np.random.default_rng(seed)
    triangle, corner = (
        rng.integers(len(position), size=count),
        rng.integers(3, size=count),
    )
    a, b = position[triangle, corner], position[triangle, (corner + 1) % 3]
    share = rng.uniform(0.01, 0.99, size=(count, 1)).astype(np.float32)
    target = a if where == "vertex" else a + (b - a) * share
    origin = rng.uniform(-0.5, 0.5, size=(count, 3)).astype(np.float32)
    return origin, target - origin


@pytest.mark.parametrize("where", ["edge", "vertex"])
@pytest.mark.parametrize("part", [tiny.sphere(64, 128), tiny.cube(2.0)])
def test_no_ray_leaves_a_closed_mesh(backend, where, part):
    tracer = embree.build(tiny.scene([part]), backend=backend)
    origin, direction = aimed(part.position, where, 200_000)
    hits = tracer.intersect_numpy(tiny.still(), origin, direction, coherent=False)
    assert (hits.triangle < 0).sum() == 0


def test_shadow_rays_leave_a_closed_mesh_at_vertices_only():
    part = tiny.sphere(64, 128)
    tracer = embree.build(tiny.scene([part]))
    leaks = {}
    for where in ("edge", "vertex"):
        origin, direction = aimed(part.position, where, 200_000)
        blocked = tracer.occluded_numpy(
            tiny.still(), origin, direction, np.full(200_000, INF), everything(200_000)
        )
        leaks[where] = (~blocked).sum()
    assert leaks["edge"] == 0
    assert leaks["vertex"] < 0.02 * 200_000  # aimed at vertices, 0.9 % slip through


def test_a_second_look_does_not_change_what_is_hit_first(backend):
    # A miss is traced again a few ulps aside; that must not fatten a silhouette.
    tracer = embree.build(tiny.scene([tiny.quad(2.0)]), backend=backend)
    aside = np.float32([0.9999, 0.99999, 1.00001, 1.0001])
    origin = np.stack([aside, 0 * aside, 1 + 0 * aside], axis=-1)
    direction = np.tile(np.float32([0, 0, -1]), (4, 1))
    hits = tracer.intersect_numpy(tiny.still(), origin, direction)
    np.testing.assert_array_equal(hits.triangle >= 0, [True, True, False, False])


# --- JAX -----------------------------------------------------------------------


def test_jit_eager_and_host_give_the_same_bits(backend):
    tracer = embree.build(garden(groups=3), backend=backend)
    origin, direction = rays(1000)
    arrays = [jnp.asarray(a) for a in (pose(0), origin, direction)]
    host = tracer.intersect_numpy(pose(0), origin, direction)
    eager = embree.intersect(tracer, *arrays)
    jitted = jax.jit(embree.intersect, static_argnums=0)(tracer, *arrays)
    for hits in (eager, jitted):
        np.testing.assert_array_equal(hits.distance, host.distance)
        np.testing.assert_array_equal(hits.triangle, host.triangle)
        np.testing.assert_array_equal(hits.barycentric, host.barycentric)
        assert hits.triangle.dtype == jnp.int32
    distance, active = np.full(1000, np.float32(2)), np.arange(1000) % 2 == 0
    expected = tracer.occluded_numpy(pose(0), origin, direction, distance, active)
    blocked = jax.jit(embree.occluded, static_argnums=0)(
        tracer, *arrays, jnp.asarray(distance), jnp.asarray(active)
    )
    np.testing.assert_array_equal(blocked, expected)


def test_tiles_and_hints_pass_through_jit():
    tracer = shared_tracer()
    origin, direction = (jnp.asarray(a) for a in rays(12 * 10))
    still = jnp.asarray(tiny.still())
    plain = embree.intersect(tracer, still, origin, direction)
    tiled = jax.jit(
        lambda o, d: embree.intersect(
            tracer, still, o, d, tile=(12, 10), coherent=False
        )
    )(origin, direction)
    np.testing.assert_array_equal(plain.distance, tiled.distance)


def test_vmap_over_poses_traces_each():
    tracer = embree.build(garden(groups=3))
    origin, direction = rays(300)
    poses = np.stack([pose(seed) for seed in range(4)])

    def distance(matrices):
        return embree.intersect(
            tracer, matrices, jnp.asarray(origin), jnp.asarray(direction)
        ).distance

    together = jax.jit(jax.vmap(distance))(jnp.asarray(poses))
    for matrices, row in zip(poses, together, strict=True):
        np.testing.assert_array_equal(
            row, tracer.intersect_numpy(matrices, origin, direction).distance
        )


def test_no_gradient_flows_through_tracing():
    tracer = shared_tracer()
    origin, direction = (jnp.asarray(a) for a in rays(64))
    still = jnp.asarray(tiny.still())

    def total(origin):
        hits = embree.intersect(tracer, still, origin, direction)
        blocked = embree.occluded(
            tracer, still, origin, direction, hits.distance * 2, hits.triangle >= 0
        )
        near = jnp.where(blocked, hits.distance, 0.0)
        return jnp.sum(jnp.where(jnp.isfinite(near), near, 0.0)) + jnp.sum(origin)

    np.testing.assert_array_equal(jax.grad(total)(origin), np.ones((64, 3)))


def test_dispatch_is_synchronous():
    assert not jax.config.read("jax_cpu_enable_async_dispatch")


def test_a_tracer_compares_and_hashes_by_identity():
    a, b = embree.build(garden()), embree.build(garden())
    assert a == a
    assert a != b
    assert len({a, b, a}) == 2


def test_a_collected_tracer_frees_embree():
    tracer = embree.build(garden(groups=3))
    origin, direction = rays(100)
    tracer.intersect_numpy(pose(0), origin, direction)
    freed = []
    weakref.finalize(tracer._way._device, freed.append, "device")
    for scene in (*tracer._way._groups, *tracer._way._placed.values()):
        weakref.finalize(scene, freed.append, "scene")
    del tracer, scene
    gc.collect()
    assert sorted(freed) == ["device", "scene", "scene", "scene", "scene"]


# --- what is refused -----------------------------------------------------------


def test_mistakes_are_named():
    tracer = embree.build(garden(groups=3))
    origin, direction = rays(10)
    with pytest.raises(errors.InputError, match=r"needs \(3, 3, 4\)"):
        tracer.intersect_numpy(tiny.still(2), origin, direction)
    with pytest.raises(errors.InputError, match="both must be"):
        tracer.intersect_numpy(tiny.still(3), origin, direction[:5])
    with pytest.raises(errors.InputError, match="image of 12 pixels"):
        tracer.intersect_numpy(tiny.still(3), origin, direction, tile=(3, 4))
    with pytest.raises(errors.InputError, match="as many distances"):
        tracer.occluded_numpy(
            tiny.still(3), origin, direction, np.ones(9), everything(10)
        )
    with pytest.raises(errors.InputError, match="choose one of auto, packet, run"):
        embree.build(garden(), backend="gpu")


def test_ids_out_of_range_are_named():
    part = tiny.quad()
    part.material = 3
    with pytest.raises(errors.InputError, match="the scene has 1"):
        embree.build(tiny.scene([part]))
    part = tiny.quad()
    part.group = -1
    with pytest.raises(errors.InputError, match="is negative"):
        embree.build(tiny.scene([part]))
