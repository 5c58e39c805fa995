"""Raster and raytrace stages one ray at a time in float64, from their definitions.

A *sample* is one ray through an image position (x right, y down, px): the nearest
solid triangle by brute force, its material at the mip level that the pixel's footprint
on the triangle's own plane asks for, every light with a brute-force shadow ray.

Where float32 may decide otherwise a sample says so: `near` for what is visible (a
triangle's edge or a mask's border within `VISIBLE_REACH` of the ray), `near_color` for
that or a shadow's border or a light on the horizon.
"""

import math
from dataclasses import dataclass

import jax
import numpy as np

from ataa_jax import types
from tests.oracles import intersect, shading, texture

# How far, as a share of the scene's largest coordinate, float32 may shift a camera's
# ray: directions, transforms and Embree's own sums round a handful of times by 2^-24.
VISIBLE_REACH = 2.0**-20
# A shadow ray starts off its surface by 2^-16 of the triangle's largest coordinate
# (shading); here it starts on it, so borders may differ by that and by rounding.
SHADOW_REACH = 2.0**-15
# A cosine nearer to 0 than this may have the other sign in float32.
_COSINE_REACH = 1e-5
_STEP_PX = 2.0**-10  # footprints are differences over this far left, right, up, down

# Direct3D's standard multisample patterns, in 1/16 px from the centre (DESIGN).
PATTERNS = {
    2: [(4, 4), (-4, -4)],
    4: [(-2, -6), (6, -2), (-6, 2), (2, 6)],
    8: [(1, -3), (-1, 3), (5, 1), (-3, -5), (-5, 5), (-7, -1), (3, 7), (7, -7)],
}


@dataclass
class Hit:
    triangle: int
    distance: float  # in units of the ray direction's length
    weights: np.ndarray  # (3,), of the corners
    slack: float = 0.0  # how far rounding may shift a weight
    shift: float = 0.0  # and the point along its plane, scene units


@dataclass
class Sample:
    """What one ray brought home."""

    color: np.ndarray
    near: bool
    near_color: bool
    shadow_rays: int = 0
    shadows: int = 0  # shadow rays that met something
    depth: float = math.inf
    normal: np.ndarray | None = None  # interpolated, without the normal map
    hit: Hit | None = None


@dataclass
class Image:
    """The raster stage's output, and where it is not sure."""

    color: np.ndarray
    depth: np.ndarray
    motion: np.ndarray  # not bounded; NaN where the point was behind the camera
    motion_valid: np.ndarray
    normal: np.ndarray
    object: np.ndarray
    material: np.ndarray
    shadow_rays: np.ndarray  # of each pixel
    shadows: np.ndarray
    slack: np.ndarray  # `Hit.slack`, 0 on the sky
    shift: np.ndarray
    near: np.ndarray
    near_color: np.ndarray


class Frame:
    """One frame: the scene's records as float64 arrays, triangles in the world."""

    def __init__(self, scene: types.Scene, inputs: types.FrameInputs) -> None:
        # NumPy arrays throughout: single elements of JAX arrays are slow to read.
        scene, inputs = jax.tree.map(np.asarray, (scene, inputs))
        self.scene = scene
        self.camera, self.previous_camera = inputs.camera, inputs.previous_camera
        self.jitter = np.asarray(inputs.jitter, np.float64)
        geometry = scene.geometry
        self.group = np.asarray(geometry.group)
        self.material = np.asarray(geometry.material)
        self.object = np.asarray(geometry.object)
        self.normal = np.asarray(geometry.normal, np.float64)
        self.uv = np.asarray(geometry.uv, np.float64)
        local = np.asarray(geometry.position, np.float64)
        self.matrix = np.asarray(inputs.world_from_group, np.float64)
        previous = np.asarray(inputs.previous_world_from_group, np.float64)
        self.corner = _placed(local, self.matrix[self.group])
        self.previous_corner = _placed(local, previous[self.group])
        first, second = (self.corner[:, k] - self.corner[:, 0] for k in (1, 2))
        area = np.cross(first, second)
        self.plane = area / np.linalg.norm(area, axis=1, keepdims=True)
        longest = np.linalg.norm(self.corner - np.roll(self.corner, 1, 1), axis=2)
        self.altitude = np.linalg.norm(area, axis=1) / longest.max(axis=1)
        self.extent = float(np.abs(self.corner).max())
        count = len(np.asarray(scene.textures.level_count))
        self.levels = [texture.unpack(scene.textures, k) for k in range(count)]


def draw(
    scene: types.Scene,
    inputs: types.FrameInputs,
    size: tuple[int, int],
    mip_bias: float | None,
) -> Image:
    """Draws a frame as the raster stage does; mip_bias None: level 0 everywhere."""
    frame = Frame(scene, inputs)
    image = Image(
        color=np.zeros((*size, 3)),
        depth=np.full(size, np.inf),
        motion=np.full((*size, 2), np.nan),
        motion_valid=np.zeros(size, bool),
        normal=np.zeros((*size, 3)),
        object=np.full(size, -1),
        material=np.full(size, -1),
        shadow_rays=np.zeros(size, int),
        shadows=np.zeros(size, int),
        slack=np.zeros(size),
        shift=np.zeros(size),
        near=np.zeros(size, bool),
        near_color=np.zeros(size, bool),
    )
    for at in np.ndindex(*size):
        centre = np.array([at[1] + 0.5, at[0] + 0.5])
        sample = trace(frame, size, centre + frame.jitter, mip_bias)
        image.color[at] = sample.color
        image.depth[at] = sample.depth
        image.shadow_rays[at] = sample.shadow_rays
        image.shadows[at] = sample.shadows
        image.near[at] = sample.near
        image.near_color[at] = sample.near_color
        if sample.hit is not None:
            image.normal[at] = sample.normal
            image.slack[at], image.shift[at] = sample.hit.slack, sample.hit.shift
            image.object[at] = frame.object[sample.hit.triangle]
            image.material[at] = frame.material[sample.hit.triangle]
        motion = _motion(frame, size, centre + frame.jitter, sample.hit)
        if motion is not None:
            image.motion[at] = motion
            # Where the pixel's history is read: from its centre, without the jitter.
            x, y = centre + motion
            image.motion_valid[at] = 0 <= x <= size[1] and 0 <= y <= size[0]
    return image


def traced(
    scene: types.Scene, inputs: types.FrameInputs, size: tuple[int, int], samples: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns every pixel's traced colour, its shadow rays, and where it is not sure.

    Samples are averaged after the tone map x / (1 + max(r, g, b)).
    """
    frame = Frame(scene, inputs)
    color, near = np.zeros((*size, 3)), np.zeros(size, bool)
    shadow_rays = np.zeros(size, int)
    for at in np.ndindex(*size):
        centre = np.array([at[1] + 0.5, at[0] + 0.5])
        mapped = np.zeros(3)
        for offset in PATTERNS[samples]:
            sample = trace(frame, size, centre + np.array(offset) / 16, None)
            mapped += sample.color / (1 + sample.color.max()) / samples
            near[at] |= sample.near_color
            shadow_rays[at] += sample.shadow_rays
        color[at] = mapped / (1 - mapped.max())
    return color, shadow_rays, near


def trace(
    frame: Frame, size: tuple[int, int], at_px: np.ndarray, mip_bias: float | None
) -> Sample:
    """Follows the ray through one image position."""
    eye = np.asarray(frame.camera.world_from_view, np.float64)[:3, 3]
    direction = _direction(frame.camera, size, at_px)
    reach = VISIBLE_REACH * max(frame.extent, float(np.abs(eye).max()))
    hit, near = _meet(frame, eye, direction, math.inf, reach)
    view = -direction / np.linalg.norm(direction)
    if hit is None:
        return Sample(shading.sky(frame.scene.sky, -view), near, near)
    footprint = None
    if mip_bias is not None:
        footprint = _footprint(frame, size, at_px, hit.triangle)
    corners = frame.corner[hit.triangle]
    point = hit.weights @ corners
    facing, normal, doubtful = _normals(frame, hit, view)
    material = _Material(frame, hit, footprint, mip_bias or 0.0)
    bent = material.bend(frame, hit, normal)
    cosine = float(bent @ facing)
    doubtful |= material.mapped and abs(cosine) < _COSINE_REACH
    if not material.mapped or cosine <= 0:
        bent = normal
    surface = (material.base, material.metallic, material.roughness, bent, view)
    color = material.emissive + shading.ambient(frame.scene.sky, *surface)
    rays = shadows = 0
    for index in range(len(np.asarray(frame.scene.lights.kind))):
        toward, limit, strength = shading.incident(frame.scene.lights, index, point)
        cosines = (float(bent @ toward), float(facing @ toward))
        if strength.max() <= 0:
            continue
        doubtful |= min(map(abs, cosines)) < _COSINE_REACH
        if min(cosines) <= 0:
            continue
        rays += 1
        reach = SHADOW_REACH * frame.extent
        blocker, close = _meet(frame, point, toward, limit, reach, hit.triangle)
        doubtful |= close
        shadows += blocker is not None
        if blocker is None:
            color = color + strength * shading.reflect(*surface, toward)
    # Directions have z = −1 in the view, so distance along them is depth along −z.
    depth = -float((_view_from_world(frame.camera) @ [*point, 1.0])[2])
    return Sample(color, near, near or doubtful, rays, shadows, depth, normal, hit)


def _meet(
    frame: Frame,
    origin: np.ndarray,
    direction: np.ndarray,
    limit: float,
    reach: float,
    own: int = -1,
) -> tuple[Hit | None, bool]:
    """Finds the nearest solid triangle before `limit`, but never the triangle `own`.

    Also says whether a shift of the ray by `reach` could have changed the answer.
    """
    _, u, v = (
        part[0]
        for part in intersect.all_pairs(frame.corner, origin[None], direction[None])
    )
    along = frame.plane @ direction
    ahead = np.sum((frame.corner[:, 0] - origin) * frame.plane, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ahead / along
        # The ray's shift grows on a slanted plane, and counts against the altitude.
        slack = reach * np.linalg.norm(direction) / np.abs(along) / frame.altitude
    inside = np.minimum(np.minimum(u, v), 1 - u - v)
    possible = (along != 0) & (distance > 1e-9) & (distance < limit)
    possible &= inside > -slack
    near = False
    candidates = np.flatnonzero(possible).tolist()
    for i in sorted(candidates, key=lambda i: distance[i]):
        if i == own:
            continue
        weights = np.array([1 - u[i] - v[i], u[i], v[i]])
        solid, sure = _solid(frame, i, weights, float(slack[i]))
        near |= inside[i] <= slack[i] or not sure or distance[i] < reach
        if inside[i] >= 0 and solid:
            shift = float(slack[i] * frame.altitude[i])
            hit = Hit(i, float(distance[i]), weights, float(slack[i]), shift)
            return hit, bool(near)
    return None, bool(near)


def _solid(
    frame: Frame, triangle: int, weights: np.ndarray, slack: float
) -> tuple[bool, bool]:
    """Says whether a point is not a hole of its mask, and whether that is sure."""
    table, m = frame.scene.materials, frame.material[triangle]
    if not bool(table.alpha_masked[m]):
        return True, True
    base, cutoff = float(table.base_color[m, 3]), float(table.alpha_cutoff[m])
    k = int(table.base_color_texture[m])
    if k < 0:
        return base >= cutoff, True
    image = frame.levels[k][0]
    u, v = weights @ frame.uv[triangle]
    found = base * texture.alpha(image, u, v, _wrap(frame, k))
    # Alpha changes by at most 1 a texel in each direction.
    texels = np.ptp(frame.uv[triangle], axis=0) @ [image.shape[1], image.shape[0]]
    return found >= cutoff, abs(found - cutoff) > 2 * slack * texels


def _normals(
    frame: Frame, hit: Hit, view: np.ndarray
) -> tuple[np.ndarray, np.ndarray, bool]:
    """Returns the plane's normal toward the viewer, the interpolated one, and doubt."""
    facing = frame.plane[hit.triangle]
    facing = facing if facing @ view > 0 else -facing
    linear = frame.matrix[frame.group[hit.triangle]][:, :3]
    normal = np.linalg.inv(linear).T @ (hit.weights @ frame.normal[hit.triangle])
    normal = normal / np.linalg.norm(normal)
    cosine = float(normal @ facing)
    return facing, normal if cosine >= 0 else -normal, abs(cosine) < _COSINE_REACH


class _Material:
    """A glTF material at one point."""

    def __init__(
        self,
        frame: Frame,
        hit: Hit,
        footprint: tuple[np.ndarray, np.ndarray] | None,
        mip_bias: float,
    ) -> None:
        table = frame.scene.materials
        m = frame.material[hit.triangle]
        u, v = hit.weights @ frame.uv[hit.triangle]

        def fetch(ids: object, srgb: bool) -> np.ndarray:
            k = int(np.asarray(ids)[m])
            if k == types.NO_TEXTURE:
                return np.ones(3)
            levels, detail = frame.levels[k], 0.0
            if footprint is not None:
                size = levels[0].shape[:2]
                detail = texture.level_of_detail(size, *footprint) + mip_bias
            return texture.trilinear(levels, u, v, _wrap(frame, k), srgb, detail)

        base = np.asarray(table.base_color[m], np.float64)[:3]
        self.base = base * fetch(table.base_color_texture, True)
        _, green, blue = fetch(table.metallic_roughness_texture, False)
        roughness = float(table.roughness[m]) * green
        self.roughness = min(max(roughness, 0.045), 1.0)
        self.metallic = min(max(float(table.metallic[m]) * blue, 0.0), 1.0)
        emissive = np.asarray(table.emissive[m], np.float64)
        self.emissive = emissive * fetch(table.emissive_texture, True)
        self.mapped = int(table.normal_texture[m]) != types.NO_TEXTURE
        self.tangent_space = 2 * fetch(table.normal_texture, False) - 1
        self.tangent_space[:2] *= float(table.normal_scale[m])

    def bend(self, frame: Frame, hit: Hit, normal: np.ndarray) -> np.ndarray:
        """Returns the map's normal: red along +u, green against +v (glTF)."""
        corner, uv = frame.corner[hit.triangle], frame.uv[hit.triangle]
        edges = (corner[1:] - corner[0]).T  # (3, 2)
        steps = (uv[1:] - uv[0]).T  # (2, 2): edges = [dp/du dp/dv] · steps
        if np.linalg.det(steps) == 0:
            return normal
        along_u, along_v = (edges @ np.linalg.inv(steps)).T
        bent = (
            self.tangent_space[0] * along_u / np.linalg.norm(along_u)
            - self.tangent_space[1] * along_v / np.linalg.norm(along_v)
            + self.tangent_space[2] * normal
        )
        return bent / np.linalg.norm(bent)


def _footprint(
    frame: Frame, size: tuple[int, int], at_px: np.ndarray, triangle: int
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the change of uv by a pixel right and down, on the triangle's plane.

    Rays a little aside are met with the plane, inside the triangle or not.
    """
    eye = np.asarray(frame.camera.world_from_view, np.float64)[:3, 3]
    corner, uv = frame.corner[triangle], frame.uv[triangle]

    def at(x: float, y: float) -> np.ndarray:
        direction = _direction(frame.camera, size, at_px + np.array([x, y]))
        system = np.stack([corner[1] - corner[0], corner[2] - corner[0], -direction], 1)
        b1, b2, _ = np.linalg.solve(system, eye - corner[0])
        return np.array([1 - b1 - b2, b1, b2]) @ uv

    h = _STEP_PX
    return (at(h, 0) - at(-h, 0)) / (2 * h), (at(0, h) - at(0, -h)) / (2 * h)


def _motion(
    frame: Frame, size: tuple[int, int], at_px: np.ndarray, hit: Hit | None
) -> np.ndarray | None:
    """Returns previous − current position, or None where it was behind the camera.

    The current position is the sample's own; the sky is a point at infinity.
    """
    if hit is None:
        point = np.append(_direction(frame.camera, size, at_px), 0.0)
    else:
        point = np.append(hit.weights @ frame.previous_corner[hit.triangle], 1.0)
    x, y, z, _ = _view_from_world(frame.previous_camera) @ point
    if z >= 0:
        return None
    height, width = size
    tangent = float(frame.previous_camera.tan_half_fov_y)
    then_x = (1 + x / -z / (tangent * width / height)) / 2 * width
    then_y = (1 - y / -z / tangent) / 2 * height
    return np.array([then_x, then_y]) - at_px


def _direction(
    camera: types.Camera, size: tuple[int, int], at_px: np.ndarray
) -> np.ndarray:
    """Returns the world direction through an image position, −1 along the view's z."""
    height, width = size
    tangent = float(camera.tan_half_fov_y)
    right = (2 * at_px[0] / width - 1) * tangent * width / height
    up = (1 - 2 * at_px[1] / height) * tangent
    matrix = np.asarray(camera.world_from_view, np.float64)
    return matrix[:3, :3] @ [right, up, -1.0]


def _view_from_world(camera: types.Camera) -> np.ndarray:
    return np.linalg.inv(np.asarray(camera.world_from_view, np.float64))


def _placed(local: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Moves triangles (t, 3, 3) by a matrix each (t, 3, 4)."""
    return np.einsum("tij,tcj->tci", matrix[:, :, :3], local) + matrix[:, None, :, 3]


def _wrap(frame: Frame, k: int) -> tuple[int, int]:
    textures = frame.scene.textures
    return int(textures.wrap_u[k]), int(textures.wrap_v[k])
