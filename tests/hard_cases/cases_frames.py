"""Whole frames: cameras that jump, odd places and lights, random scenes."""

from dataclasses import replace
from functools import cache

import jax.numpy as jnp
import numpy as np

from ataa_jax import camera as cameras
from ataa_jax import pipeline, types
from tests import tiny
from tests.hard_cases import random_scenes, studio
from tests.hard_cases.case import Topic
from tests.hard_cases.random_scenes import Knobs
from tests.hard_cases.studio import apart, walk
from tests.oracles import intersect as oracle

TOPIC = Topic("whole frames")


def _pose(eye=(0.6, 1.9, 4.4), target=(0.1, 0.9, 0.0), roll=0.0, fov_y=0.9):
    matrix = cameras.look_at(np.array(eye), np.array(target))
    c, s = np.cos(roll), np.sin(roll)
    turn = np.eye(4)
    turn[:2, :2] = [[c, -s], [s, c]]
    return matrix @ turn, fov_y


JUMPS = {
    "teleport": _pose((300.0, 40.0, -900.0), (0.0, 0.0, 0.0)),
    "180° turn": _pose(target=(1.1, 2.9, 8.8)),
    "zoom × 10": _pose(fov_y=0.09),
    "zoom ÷ 3": _pose(fov_y=2.2),
    "roll 90°": _pose(roll=np.pi / 2),
    "roll 180°": _pose(roll=np.pi),
    "step back": _pose((0.9, 2.4, 6.9)),
    "through the wall": _pose((0.3, 0.6, 0.2), (0.1, 0.9, -4.0)),
    "a degree": _pose(target=(0.18, 0.9, 0.0)),
}


@cache
def _jump(name: str) -> tuple[list[pipeline.FrameOutput], tuple, tuple]:
    """Two frames, the second from elsewhere; and both poses."""
    first, second = _pose(), JUMPS[name]
    still = jnp.asarray(tiny.still(2))
    poses = [cameras.make(*first), cameras.make(*first), cameras.make(*second)]
    shots = [
        types.FrameInputs(
            camera=poses[k + 1], previous_camera=poses[k],
            world_from_group=still, previous_world_from_group=still,
            jitter=jnp.zeros(2), cut=jnp.asarray(False),
        )
        for k in range(2)
    ]  # fmt: skip
    return studio.run(studio.yard().scene, shots), first, second


def _expected_motion(output, then, now):
    """Motion of what is seen, in float64, and whether it was in front of the camera."""
    h, w = studio.SIZE
    y, x = np.indices(studio.SIZE) + 0.5
    # The program's own float32 cameras, so that only its arithmetic is measured.
    (then_pose, then_tan), (now_pose, now_tan) = (
        (np.asarray(eye.world_from_view, np.float64), float(eye.tan_half_fov_y))
        for eye in (cameras.make(*then), cameras.make(*now))
    )
    step = 2.0 * now_tan / h
    view = np.stack([(x - w / 2) * step, (h / 2 - y) * step, -np.ones_like(x)], axis=-1)
    direction = view @ now_pose[:3, :3].T
    depth = np.asarray(output.gbuffer.depth, np.float64)
    sky = np.isinf(depth)
    point = now_pose[:3, 3] + direction * np.where(sky, 1.0, depth)[..., None]
    offset = np.where(sky[..., None], direction, point - then_pose[:3, 3])
    seen = offset @ then_pose[:3, :3]
    front = seen[..., 2] < 0
    scale = 1.0 / (np.where(front, -seen[..., 2], 1.0) * 2.0 * then_tan / h)
    then_x = w / 2 + seen[..., 0] * scale
    then_y = h / 2 - seen[..., 1] * scale
    return np.stack([then_x - x, then_y - y], axis=-1), front


@TOPIC.case(
    "motion vectors are right after any jump of the camera, sky included",
    danger="points behind the previous camera mirrored into view; w ≈ 0; far teleports",
    quantity="largest error of a valid vector from float64, px, 9 jumps",
    bound=1.0 / 256.0,
    reason="1/256 px moves a bilinear weight by one step of 8 bits",
)
def jumps() -> float:
    worst = 0.0
    for name in JUMPS:
        (_, output), then, now = _jump(name)
        expected, _ = _expected_motion(output, then, now)
        valid = np.asarray(output.gbuffer.motion_valid)
        error = np.abs(np.asarray(output.gbuffer.motion) - expected).max(axis=-1)
        worst = max(worst, float(error[valid].max(initial=0.0)))
    return worst


@TOPIC.case(
    "no pixel claims a past that was behind the camera or outside the view",
    danger="history of something else is blended in",
    quantity="pixels flagged valid whose past lay over 0.01 px outside, or unflagged "
    "and over 0.01 px inside, 9 jumps",
    bound=0,
    reason="the flag is a comparison; a hundredth of a pixel is its rounding",
)
def flags() -> float:
    wrong = 0
    h, w = studio.SIZE
    for name in JUMPS:
        (_, output), then, now = _jump(name)
        motion, front = _expected_motion(output, then, now)
        y, x = np.indices(studio.SIZE) + 0.5
        at_x, at_y = x + motion[..., 0], y + motion[..., 1]
        margin = np.minimum(np.minimum(at_x, w - at_x), np.minimum(at_y, h - at_y))
        valid = np.asarray(output.gbuffer.motion_valid)
        wrong += int(np.sum(valid & (~front | (margin < -0.01))))
        wrong += int(np.sum(~valid & front & (margin > 0.01)))
    return float(wrong)


@TOPIC.case(
    "a turn by 180° leaves the whole frame to FXAA",
    danger="the mirrored past of points behind the camera",
    quantity="share of FXAA pixels",
    bound=1.0,
    reason="nothing in view was in view",
    at_least=True,
)
def turned_round() -> float:
    (_, output), _, _ = _jump("180° turn")
    return float(np.mean(studio.methods(output) == types.METHOD_FXAA))


@TOPIC.case(
    "the sky stands still while the camera moves 1e4 units without turning",
    danger="infinity minus a position",
    quantity="largest motion of a sky pixel, px",
    bound=0,
    reason="a direction is projected by two cameras of one orientation",
)
def sky_stands() -> float:
    base = walk(2)[1]
    far = cameras.make(
        np.array(base.camera.world_from_view) + np.eye(4, k=3) * 1e4, 0.9
    )
    inputs = replace(base, previous_camera=far)
    state, _ = studio.frame(pipeline.init(studio.SIZE), studio.yard().scene, inputs)
    sky = np.isinf(np.asarray(state.gbuffer.depth))
    assert sky.any()
    return float(np.abs(np.asarray(state.gbuffer.motion)[sky]).max())


PLACES = {
    "inside the crate": ((0.3, 0.6, 0.2), (0.1, 0.9, -4.0)),
    "on the floor": ((1.0, 0.0, 3.0), (0.0, 0.0, 0.0)),
    "a hair above the floor": ((1.0, 1e-7, 3.0), (0.0, 0.0, 0.0)),
    "in the floor, looking up": ((1.0, 0.0, 2.0), (1.0, 5.0, 2.0)),
    "in the fence's plane": ((-3.0, 0.9, 1.2), (-1.4, 0.9, 1.2)),
    "a hair from the ball": ((1.5, 0.8, -0.1 + 1e-6), (1.5, 0.8, -0.8)),
    "on the ball": ((1.5, 0.8, -0.1), (1.5, 0.8, -0.8)),
}


def _promises_at_places(scene: types.Scene, **options) -> float:
    count = 0
    for eye, target in PLACES.values():
        pose = cameras.make(cameras.look_at(np.array(eye), np.array(target)), 0.9)
        shots = [replace(each, camera=pose, previous_camera=pose) for each in walk(2)]
        for output in studio.run(scene, shots, **options):
            count += sum(random_scenes.violations(output).values())
    return float(count)


@TOPIC.case(
    "a camera inside, on or in the plane of a surface sees numbers",
    danger="rays of length 0, in planes, from their own surface",
    quantity="broken promises, 7 places × 2 frames, see random_scenes.violations",
    bound=0,
    reason="every promise of a frame holds wherever the eye stands",
)
def odd_places() -> float:
    return _promises_at_places(studio.yard().scene)


@TOPIC.case(
    "a camera inside, on or in the plane of a mirror sees numbers",
    danger="reflection rays from the eye's own surface; all maps and effects compiled",
    quantity="broken promises, 7 places × 2 frames, see random_scenes.violations",
    bound=0,
    reason="every promise of a frame holds wherever the eye stands",
    hard=True,
)
def mirror_places() -> float:
    yard = studio.yard().scene
    mirrors = replace(
        yard.materials,
        roughness=yard.materials.roughness * 0.0,
        mirror=jnp.ones_like(yard.materials.mirror),
    )
    return _promises_at_places(replace(yard, materials=mirrors), full=True)


@TOPIC.case(
    "lights of intensity 0 cost no shadow ray and give no light",
    danger="0 · inf; rays cast for nothing",
    quantity="shadow rays, and pixels that are not the sky's light alone",
    bound=0,
    reason="what sends nothing need not be asked",
)
def dark_lights() -> float:
    yard = studio.yard().scene
    dark = replace(yard.lights, intensity=yard.lights.intensity * 0.0)
    none = replace(yard.lights, kind=yard.lights.kind * 0, intensity=dark.intensity)
    one, two = (
        studio.run(replace(yard, lights=lights), walk(1))[0] for lights in (dark, none)
    )
    rays = int(jnp.sum(one.statistics.raster_rays.shadow))
    return float(rays + np.sum(np.asarray(one.raw != two.raw)))


BALL = slice(14, 104)  # the yard's triangles: floor, crate, ball, fence


@TOPIC.case(
    "a smooth ball is lit up to its facets' terminator and no further",
    danger="interpolated normals that face the light on facets that do not, and the "
    "other way; shadow rays along the surface",
    quantity="pixels lit on facets turned away, or dark where facet and normal face "
    "the light, 8 lights",
    bound=0,
    reason="the ball is convex and alone: it casts no shadow on what faces the light",
)
def terminator() -> float:
    yard = studio.yard().scene
    geometry, rng = yard.geometry, np.random.default_rng(8)
    alone = np.zeros_like(np.asarray(geometry.position))  # the others have no area
    alone[BALL] = np.asarray(geometry.position)[BALL]
    dark = replace(
        yard,
        geometry=replace(geometry, position=jnp.asarray(alone)),
        sky=replace(yard.sky, visibility=jnp.float32(0.0), bounce=jnp.zeros(3)),
    )
    eye, target = np.array([2.4, 1.2, 1.3]), np.array([1.5, 0.8, -0.8])
    pose = cameras.make(cameras.look_at(eye, target), 0.9)
    inputs = replace(walk(1)[0], camera=pose, previous_camera=pose, jitter=jnp.zeros(2))
    wrong = 0
    for _ in range(8):
        toward = rng.normal(size=3)
        toward /= np.linalg.norm(toward)
        lights = replace(
            yard.lights,
            kind=jnp.zeros(3, jnp.int32),
            direction=jnp.asarray(np.tile(-toward, (3, 1)), jnp.float32),
            intensity=jnp.asarray(np.float32([[3] * 3, [0] * 3, [0] * 3])),
        )
        output = studio.run(replace(dark, lights=lights), [inputs])[0]
        facet, hit = _facets(output, alone)
        lit = np.asarray(output.raw).max(axis=-1) > 0.0
        on_facet = facet @ toward
        on_normal = np.asarray(output.gbuffer.normal, np.float64) @ toward
        wrong += int(np.sum(hit & lit & (on_facet < -1e-5)))
        wrong += int(np.sum(hit & ~lit & (on_facet > 1e-5) & (on_normal > 1e-5)))
    return float(wrong)


def _facets(output: pipeline.FrameOutput, position: np.ndarray):
    """The facets' own outward normals at each pixel, and which pixels show one."""
    h, w = studio.SIZE
    y, x = np.indices(studio.SIZE) + 0.5
    eye, target = np.array([2.4, 1.2, 1.3]), np.array([1.5, 0.8, -0.8])
    pose, step = cameras.look_at(eye, target), 2.0 * np.tan(0.45) / h
    view = np.stack([(x - w / 2) * step, (h / 2 - y) * step, -np.ones_like(x)], -1)
    direction = (view @ pose[:3, :3].T).reshape(-1, 3)
    origin = np.broadcast_to(eye, direction.shape)
    _, triangle, _ = oracle.nearest(position[BALL], origin, direction)
    normal = tiny.flat_normal(position[BALL].astype(np.float64))
    outward = np.sum(normal * (position[BALL].mean(axis=1) - target), axis=1) > 0
    normal = np.where(outward[:, None], normal, -normal)
    hit = (triangle >= 0).reshape(studio.SIZE)
    hit &= np.isfinite(np.asarray(output.gbuffer.depth))
    return normal[triangle].reshape(h, w, 3), hit


def _room(clearance: float, intensity: float) -> types.Scene:
    """Floor and ceiling, and a lamp `clearance` under the ceiling."""
    yard = studio.yard().scene
    count = yard.geometry.material.shape[0]
    position = np.zeros((count, 3, 3), np.float32)  # the others have no area
    position[:2] = tiny.floor(12.0).position
    position[2:4] = tiny.floor(12.0, 3.0).position
    zeros = jnp.zeros(count, jnp.int32)
    geometry = replace(
        yard.geometry,
        position=jnp.asarray(position),
        normal=jnp.asarray(np.broadcast_to(np.float32([0, 1, 0]), position.shape)),
        material=zeros,
        object=jnp.asarray(np.arange(count) // 2, jnp.int32),
        group=zeros.at[-1].set(1),
    )
    lamp = np.float32([[0.3, 3.0 - clearance, 0.2]] * 3)
    lights = replace(
        yard.lights,
        kind=jnp.full(3, types.LIGHT_POINT, jnp.int32),
        position=jnp.asarray(lamp),
        intensity=jnp.asarray(np.float32([[intensity] * 3, [0] * 3, [0] * 3])),
        range=jnp.full(3, np.inf, jnp.float32),
    )
    return replace(yard, geometry=geometry, lights=lights)


@TOPIC.case(
    "a lamp on a ceiling, or a hair under it, lights the floor",
    danger="the shadow ray starts lifted, ends beyond the lamp, and meets the ceiling",
    quantity="share of the floor's pixels that it lights, 0 to 1e-3 units under it",
    bound=1.0,
    reason="between lamp and floor there is nothing",
    at_least=True,
)
def lamp_on_ceiling() -> float:
    pose = cameras.make(
        cameras.look_at(np.array([4.0, 1.5, 4.0]), np.array([0.0, 0.5, 0.0])), 0.9
    )
    inputs = replace(walk(1)[0], camera=pose, previous_camera=pose)
    least = 1.0
    for clearance in (0.0, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
        dark, lit = (
            studio.run(_room(clearance, intensity), [inputs])[0]
            for intensity in (0.0, 100.0)
        )
        floor = np.asarray(lit.gbuffer.object) == 0
        brighter = np.asarray(lit.raw).sum(axis=-1) > np.asarray(dark.raw).sum(axis=-1)
        least = min(least, float(np.mean(brighter[floor])))
    return least


@TOPIC.case(
    "lights of 1e6 and roughness 0 leave every promise of a frame whole",
    danger="radiance beyond float32, highlights of a few pixels",
    quantity="broken promises of 3 frames",
    bound=0,
    reason="what is too bright is limited to the largest half float",
)
def bright_lights() -> float:
    yard = studio.yard().scene
    bright = replace(
        yard,
        lights=replace(yard.lights, intensity=yard.lights.intensity * 1e6),
        materials=replace(yard.materials, roughness=yard.materials.roughness * 0.0),
    )
    outputs = studio.run(bright, walk(3))
    return float(sum(sum(random_scenes.violations(o).values()) for o in outputs))


@TOPIC.case(
    "a frame is the same by packets and by the fallback, but for edges",
    danger="two ways to Embree that drift apart through the history",
    quantity="share of pixels of the fourth frame shown over 1/255 apart",
    bound=0.02,
    # A ray carried into the crate's space in float32 or float64 may change sides at an
    # edge or a hole's rim; such a sample's colour lives on in the history.
    reason="rays that graze an edge or a hole's rim: measured per ray under 0.05 %, "
    "times 4 frames and a pixel's 3×3",
)
def other_backend() -> float:
    packet = studio.run(studio.yard().scene, walk())[-1]
    run = studio.run(studio.yard().scene, walk(), backend="run")[-1]
    return float(np.mean(apart(packet, run) > 1.0 / 255.0))


RANDOM = (
    Knobs(0),
    Knobs(1, "slivers", spoiled=True),
    Knobs(2, "stacked", motion=0.0),
    Knobs(3, "lattice", inside=True),
    Knobs(4, "huge", uv=1e6),
    Knobs(5, "soup", scale=1e-4, intensity=1e6, emission=1e4),
    Knobs(6, "lattice", scale=1e5, spoiled=True, fov_y=2.9),
    Knobs(7, "stacked", fov_y=0.01, motion=3.0, intensity=0.0),
)


def broken(knobs: Knobs, *, full: bool = False) -> dict[str, int]:
    """Renders three frames of a random scene; returns the promises that broke."""
    shots = random_scenes.shots(knobs)
    outputs = studio.run(random_scenes.scene(knobs), shots, full=full)
    counts = [random_scenes.violations(output) for output in outputs]
    total = {name: sum(each[name] for each in counts) for name in counts[0]}
    return {name: count for name, count in total.items() if count}


@TOPIC.case(
    "random scenes keep every promise of a frame",
    danger="what nobody thought of",
    quantity="pixels with a broken promise, 8 scenes × 3 frames: finite, in range, "
    "mask valid, each method its colour, TAA in the hull of its samples",
    bound=0,
    reason="they hold by construction, whatever the scene",
)
def random_frames() -> float:
    return float(sum(sum(broken(knobs).values()) for knobs in RANDOM))
