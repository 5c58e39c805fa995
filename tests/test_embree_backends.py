"""The two backends agree, and neither lets rays through cracks."""

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

from ataa_jax import embree, errors
from ataa_jax.embree import library
from tests import tiny
from tests.tracing import (
    BACKENDS,
    EPS,
    INF,
    MOVED,
    everything,
    garden,
    pose,
    rays,
    soup,
)


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


@pytest.mark.parametrize("lanes", library.NATIVE_RAYS)
@pytest.mark.parametrize("tile", [None, (37, 101)])
def test_hits_do_not_depend_on_the_width_of_a_packet(lanes, tile, monkeypatch):
    scene = soup()
    origin, direction = rays(37 * 101, seed=12)
    run = embree.build(scene, backend="run").intersect_numpy(
        tiny.still(), origin, direction, tile=tile
    )
    monkeypatch.setattr(library.Device, "lanes", lambda _: lanes)
    # A thread limit of its own keeps the tracer from being one that was built before.
    packets = embree.build(scene, device_config=f"threads={lanes}")
    hits = packets.intersect_numpy(tiny.still(), origin, direction, tile=tile)
    np.testing.assert_array_equal(hits.distance, run.distance)
    assert (hits.triangle == run.triangle).mean() > 0.999
    far = np.full(len(origin), 3.0, np.float32)
    far[::7] = np.inf
    active = np.arange(len(origin)) % 5 > 0
    asked = (tiny.still(), origin, direction, far, active)
    blocked = packets.occluded_numpy(*asked, tile=tile)
    np.testing.assert_array_equal(blocked, active & (run.distance < far))
    assert 0.1 < blocked.mean() < 0.9


def test_a_packet_is_as_wide_as_the_processors_vectors():
    clib = library.load()
    assert clib is not None
    narrow, own = library.Device(clib, "isa=sse4.2"), library.Device(clib, "")
    assert narrow.lanes() == 4
    assert own.lanes() >= narrow.lanes()


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
        embree.build(garden(), device_config="threads=2")  # no other test's tracer


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
