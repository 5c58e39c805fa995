"""Light and viewpoint for scenes that bring none, by stated and measured rules.

*Visible points* are what a camera sees through a 64×36 grid of rays. Every rule below
is a measurement on them, and what it decided is told to the user:

- no camera: one that frames the scene's bulk from its front, a little from above;
- no light: a sun, the one of sixteen directions that lights most visible points;
- no light, and no sun reaches 20 % of them: an interior, where point lights are placed
  in the open space before the camera, three quarters of the way to the ceiling;
- the sky's ambient light is attenuated by the share of sky that visible points see;
- what hides the rest of the sky reflects as much light as visible surfaces do on the
  mean: that, times the hidden share, is a constant ambient radiance (one bounce).
"""

from dataclasses import dataclass

import numpy as np

from ataa_jax import camera as cameras
from ataa_jax import types
from ataa_jax.embree import Tracer
from ataa_jax.scene import CameraSource, LightSource, SceneSource, SkySource

_GRID = (36, 64)
_INDOOR_SUN_SHARE = 0.2  # under this share of lit visible points it is an interior
_SKY_RAYS = 32  # cosine-distributed rays a visible point

# our choice: a clear afternoon. An irradiance of 4 from the sun against about 0.9 from
# the sky is the 4 to 5 : 1 of measured clear skies at 40° elevation.
_SUN = (4.0, 3.72, 3.28)
_SUN_ELEVATIONS = (40.0, 60.0)  # degrees
_SKY = SkySource(
    zenith=(0.16, 0.27, 0.52), horizon=(0.55, 0.63, 0.72), ground=(0.12, 0.11, 0.10)
)


@dataclass(frozen=True)
class VisiblePoints:
    """What a camera sees: surface points (p, 3), unit normals toward it, depths."""

    position: np.ndarray
    normal: np.ndarray
    depth: np.ndarray
    direction: np.ndarray  # (36·64, 3), of every grid ray, hit or not
    hit: np.ndarray  # (36·64,) bool


def look(
    tracer: Tracer, scene: types.Scene, transforms: np.ndarray, camera: CameraSource
) -> VisiblePoints:
    """Casts the grid of rays of one camera."""
    origin, direction = _grid_rays(camera)
    hits = tracer.intersect_numpy(transforms, origin, direction)
    triangle = np.asarray(hits.triangle)
    hit = triangle >= 0
    distance = np.asarray(hits.distance)[hit]
    corners = np.asarray(scene.geometry.position)[triangle[hit]]
    matrix = transforms[np.asarray(scene.geometry.group)[triangle[hit]]]
    corners = np.einsum("nij,nkj->nki", matrix[:, :, :3], corners)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    facing = np.sum(normal * direction[hit], axis=1, keepdims=True) < 0
    normal = np.where(facing, normal, -normal)
    position = origin[hit] + distance[:, None] * direction[hit]
    # Off the surface by what float32 loses at this distance from the origin.
    scale = np.abs(position).max(initial=0.0) + np.abs(distance).max(initial=0.0)
    position = position + normal * (1e-4 * scale)
    return VisiblePoints(position.astype(np.float32), normal, distance, direction, hit)


def focus_distance(points: VisiblePoints, fallback: float) -> float:
    """Returns the median depth of what the middle of the image shows."""
    rows, columns = _GRID
    middle = np.zeros(_GRID, bool)
    middle[rows // 4 : 3 * rows // 4, columns // 4 : 3 * columns // 4] = True
    depths = points.depth[middle.reshape(-1)[points.hit]]
    if depths.size == 0:
        depths = points.depth
    return float(np.median(depths)) if depths.size else fallback


def framing_camera(source: SceneSource) -> CameraSource:
    """Frames the scene's bulk: the box of its area's 2nd to 98th percentile."""
    centre, radius = _bulk(source)
    fov_y = np.radians(45.0)
    back = np.array([0.55, 0.28, 1.0])
    back = back / np.linalg.norm(back)
    distance = 0.86 * radius / np.sin(fov_y / 2.0)
    matrix = cameras.look_at(centre + back * distance, centre)
    return CameraSource("framing", matrix, float(fov_y))


def sky_visibility(
    tracer: Tracer, transforms: np.ndarray, points: VisiblePoints
) -> float:
    """Returns the cosine-weighted share of sky that visible points see."""
    count = len(points.position)
    if count == 0:
        return 1.0
    generator = np.random.default_rng(0)
    free = 0
    for _ in range(_SKY_RAYS):
        # Lambert: a unit normal plus a uniform unit vector is cosine-distributed.
        ball = generator.standard_normal((count, 3))
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        direction = points.normal + 0.999 * ball
        far = np.full(count, np.inf, np.float32)
        up = direction[:, 1] > 0
        blocked = tracer.occluded_numpy(
            transforms, points.position, direction.astype(np.float32), far, up
        )
        free += np.sum(up & ~blocked)
    # A facing-up plane in the open sees all of it; walls see half at most.
    return float(free / (count * _SKY_RAYS))


def supply(
    source: SceneSource,
    tracer: Tracer,
    transforms: np.ndarray,
    points: VisiblePoints,
    camera: CameraSource,
) -> tuple[list[LightSource], SkySource, list[str]]:
    """Supplies lights and sky where the scene has none.

    Returns:
        Lights, sky, and what was decided, one sentence each.
    """
    notes: list[str] = []
    lights = source.lights
    sky = source.sky
    strength = 1.0
    if not lights:
        sun, share = best_sun(tracer, transforms, points, camera)
        if share >= _INDOOR_SUN_SHARE:
            lights = [sun]
            notes.append(
                f"no light in the scene: a sun was supplied, direction "
                f"{_text(sun.direction)}; it reaches {share:.0%} of what is seen"
            )
        else:
            lights = _indoor_lights(tracer, transforms, points, camera)
            notes.append(
                f"no light in the scene, and the sun reaches only {share:.0%} of what "
                f"the camera sees: {len(lights)} point lights were placed"
            )
            notes += [
                f"  {light.name} at {_text(light.position)}, "
                f"{max(light.intensity):.3g} cd"
                for light in lights
            ]
    elif sky is None:
        suns = [max(x.intensity) for x in lights if x.kind == types.LIGHT_DIRECTIONAL]
        # The supplied sky keeps its ratio to the brightest authored sun.
        strength = max(suns) / max(_SUN) if suns else 1.0
    if sky is None:
        sky = SkySource(
            zenith=_times(_SKY.zenith, strength),
            horizon=_times(_SKY.horizon, strength),
            ground=_times(_SKY.ground, strength),
        )
        notes.append("no sky in the scene: a clear one was supplied")
    return lights, sky, notes


def best_sun(
    tracer: Tracer,
    transforms: np.ndarray,
    points: VisiblePoints,
    camera: CameraSource,
) -> tuple[LightSource, float]:
    """Returns the sun that lights most of what a camera sees.

    Eight azimuths about the view at two elevations are tried; ties go to the earlier.

    Args:
        tracer: of the scene.
        transforms: where the rigid groups stand, float32 (groups, 3, 4).
        points: what the camera sees.
        camera: the azimuths are counted from its back.

    Returns:
        The sun, before exposure, and the share of the points that it lights.
    """
    best, best_share = None, -1.0
    back = camera.world_from_view[:3, 2]
    base = np.arctan2(back[0], back[2])
    for elevation in _SUN_ELEVATIONS:
        for turn in (-40, 40, -75, 75, -120, 120, -160, 160):
            azimuth, height = base + np.radians(turn), np.radians(elevation)
            toward = np.array(
                [
                    np.sin(azimuth) * np.cos(height),
                    np.sin(height),
                    np.cos(azimuth) * np.cos(height),
                ]
            )
            facing = points.normal @ toward > 0
            direction = np.broadcast_to(toward, points.position.shape)
            blocked = tracer.occluded_numpy(
                transforms,
                points.position,
                np.ascontiguousarray(direction, np.float32),
                np.full(len(facing), np.inf, np.float32),
                facing,
            )
            share = float(np.mean(facing & ~blocked)) if len(facing) else 1.0
            if share > best_share + 0.02:
                x, y, z = (float(-value) for value in toward)
                best = LightSource(
                    types.LIGHT_DIRECTIONAL, _SUN, direction=(x, y, z), name="sun"
                )
                best_share = share
    assert best is not None
    return best, best_share


def _indoor_lights(
    tracer: Tracer,
    transforms: np.ndarray,
    points: VisiblePoints,
    camera: CameraSource,
) -> list[LightSource]:
    """Places three lights in the left, middle and right third of the view.

    Each hangs over 60 % of the way to the median hit of its third, at three quarters
    of the height between floor and ceiling there, and gives an irradiance of π at half
    the median depth, so that a white surface there has radiance 1.
    """
    columns = np.arange(points.hit.size) % _GRID[1]
    eye = camera.world_from_view[:3, 3]
    depth = np.full(points.hit.size, np.nan)
    depth[points.hit] = points.depth
    lights = []
    for index, name in enumerate(("left", "middle", "right")):
        third = (columns * 3 // _GRID[1] == index) & points.hit
        if not third.any():
            continue
        distance = float(np.median(depth[third]))
        direction = points.direction[third].mean(axis=0)
        anchor = eye + 0.6 * distance * direction
        floor, ceiling = (
            _first_hit(tracer, transforms, anchor, (0.0, sign, 0.0), distance)
            for sign in (-1.0, 1.0)
        )
        anchor[1] += 0.75 * (ceiling + floor) - floor
        power = float(np.pi) * (0.5 * distance) ** 2
        lights.append(
            LightSource(
                types.LIGHT_POINT,
                (power, 0.9 * power, 0.75 * power),
                position=(float(anchor[0]), float(anchor[1]), float(anchor[2])),
                name=f"{name} lamp",
            )
        )
    return lights


def _first_hit(
    tracer: Tracer,
    transforms: np.ndarray,
    origin: np.ndarray,
    direction: tuple[float, float, float],
    limit: float,
) -> float:
    hits = tracer.intersect_numpy(
        transforms,
        np.asarray(origin, np.float32)[None],
        np.asarray(direction, np.float32)[None],
    )
    return min(float(np.asarray(hits.distance)[0]), limit)


def _grid_rays(camera: CameraSource) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = _GRID
    x = (np.arange(columns) + 0.5) / columns * 2.0 - 1.0
    y = 1.0 - (np.arange(rows) + 0.5) / rows * 2.0
    half = np.tan(camera.fov_y / 2.0)
    x, y = np.meshgrid(x * half * columns / rows, y * half)
    view = np.stack([x, y, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    direction = view @ camera.world_from_view[:3, :3].T
    origin = np.broadcast_to(camera.world_from_view[:3, 3], direction.shape)
    return (
        np.ascontiguousarray(origin, np.float32),
        np.ascontiguousarray(direction, np.float32),
    )


def _bulk(source: SceneSource) -> tuple[np.ndarray, float]:
    """Centre and radius of the box that holds the middle 96 % of the surface area."""
    transforms = source.transforms(0.0)
    centres, areas = [], []
    for mesh in source.meshes:
        matrix = transforms[mesh.group]
        corners = (mesh.position @ matrix[:, :3].T + matrix[:, 3])[mesh.triangles]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        centres.append(corners.mean(axis=1))
        areas.append(np.linalg.norm(cross, axis=1))
    centre, area = np.concatenate(centres), np.concatenate(areas)
    low, high = np.empty(3), np.empty(3)
    for axis in range(3):
        order = np.argsort(centre[:, axis])
        share = np.cumsum(area[order]) / max(area.sum(), 1e-30)
        low[axis] = centre[order[np.searchsorted(share, 0.02)], axis]
        high[axis] = centre[
            order[min(np.searchsorted(share, 0.98), len(order) - 1)], axis
        ]
    radius = float(np.linalg.norm(high - low)) / 2.0
    return (low + high) / 2.0, max(radius, 1e-6)


def _times(
    color: tuple[float, float, float], factor: float
) -> tuple[float, float, float]:
    r, g, b = color
    return r * factor, g * factor, b * factor


def _text(vector: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in vector) + ")"
