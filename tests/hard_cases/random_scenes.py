"""Random small scenes with everything that can be wrong in them, and what must hold.

All have the yard's shapes, so that one program draws them; see `studio`.
"""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np

from ataa_jax import camera as cameras
from ataa_jax import color as colors
from ataa_jax import pipeline, types
from tests import tiny
from tests.hard_cases import studio

SHAPES = ("soup", "slivers", "stacked", "lattice", "huge")


@dataclass(frozen=True)
class Knobs:
    """What a random scene is made of."""

    seed: int
    shape: str = "soup"
    scale: float = 1.0
    uv: float = 1.0
    spoiled: bool = False  # NaN normals and uv, triangles without area
    intensity: float = 3.0  # of the lights
    emission: float = 0.0
    fov_y: float = 0.9
    motion: float = 0.1  # of camera and group a frame, over the scale
    inside: bool = False  # the eye stands on a corner of a triangle


def scene(knobs: Knobs) -> types.Scene:
    """Returns the scene."""
    rng = np.random.default_rng(knobs.seed)
    base = studio.yard().scene
    count = base.geometry.material.shape[0]
    position = _positions(knobs.shape, count, rng) * knobs.scale
    uv = rng.normal(size=(count, 3, 2)) * knobs.uv
    normal = rng.normal(size=(count, 3, 3))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    if knobs.spoiled:
        normal[::5], normal[1::7] = np.nan, 0.0
        uv[::6], uv[1::8] = np.nan, uv[1::8, :1]
        position[::9, 2] = position[::9, 1]
    group = (rng.random(count) < 0.3).astype(np.int32)
    group[0] = 1  # the shapes ask for both groups
    geometry = types.Geometry(
        position=jnp.asarray(position, jnp.float32),
        normal=jnp.asarray(normal, jnp.float32),
        uv=jnp.asarray(uv, jnp.float32),
        material=jnp.asarray(rng.integers(0, 4, count), jnp.int32),
        object=jnp.asarray(np.arange(count) // 4, jnp.int32),
        group=jnp.asarray(group),
    )
    return replace(
        base,
        geometry=geometry,
        materials=_materials(base.materials, knobs, rng),
        lights=_lights(base.lights, position, knobs, rng),
        sky=replace(base.sky, zenith=base.sky.zenith * float(rng.choice([0.0, 1.0]))),
    )


def _positions(shape: str, count: int, rng: np.random.Generator) -> np.ndarray:
    if shape == "lattice":  # shared edges, planes through the eye, duplicates
        return rng.integers(-2, 3, (count, 3, 3)).astype(np.float64)
    if shape == "stacked":  # near-coplanar walls, some at one depth
        wall = np.array([[-2, -2, 0], [2, -2, 0], [0, 2, 0]], np.float64)
        depth = rng.choice([0.0, 1e-7, 1e-5, 0.1], count) * rng.integers(-9, 9, count)
        return wall + depth[:, None, None] * (0, 0, 1)
    centre = rng.uniform(-2, 2, (count, 1, 3))
    corners = rng.normal(size=(count, 3, 3)) * 0.7
    if shape == "slivers":
        corners = corners * (3.0, 1e-4, 1e-4)
    if shape == "huge":
        corners = corners * rng.choice([1e-3, 1.0, 1e4, 1e7], (count, 1, 1))
    return centre + corners


def _materials(
    base: types.Materials, knobs: Knobs, rng: np.random.Generator
) -> types.Materials:
    def floats(*shape: int, choices: tuple[float, ...]) -> jnp.ndarray:
        return jnp.asarray(rng.choice(choices, (4, *shape)), jnp.float32)

    return replace(
        base,
        base_color=floats(4, choices=(0.0, 0.4, 1.0)),
        metallic=floats(choices=(0.0, 0.5, 1.0)),
        roughness=floats(choices=(0.0, 0.06, 0.4, 1.0)),
        emissive=floats(3, choices=(0.0, knobs.emission)),
        mirror=jnp.asarray(rng.random(4) < 0.5),
        alpha_masked=jnp.asarray(rng.random(4) < 0.3),
        base_color_texture=jnp.asarray(rng.integers(-1, 4, 4), jnp.int32),
        normal_texture=jnp.asarray(rng.choice([-1, 1], 4), jnp.int32),
    )


def _lights(
    base: types.Lights, position: np.ndarray, knobs: Knobs, rng: np.random.Generator
) -> types.Lights:
    at = rng.uniform(-3, 3, (3, 3)) * knobs.scale
    at[1] = position[rng.integers(len(position)), 0]  # on a surface
    return replace(
        base,
        kind=jnp.asarray(rng.permutation(3), jnp.int32),
        position=jnp.asarray(at, jnp.float32),
        intensity=jnp.asarray(
            rng.choice([0.0, 1.0], (3, 3)) * knobs.intensity, jnp.float32
        ),
        range=jnp.asarray(rng.choice([np.inf, 5.0, 1e-3], 3), jnp.float32),
    )


def shots(knobs: Knobs, frames: int = 3) -> list[types.FrameInputs]:
    """Returns the frames' inputs: camera and group go on a random walk."""
    rng = np.random.default_rng(knobs.seed + 1)
    eye, target = rng.uniform(-3, 3, (2, 3)) * knobs.scale
    if knobs.inside:
        eye = np.asarray(scene(knobs).geometry.position, np.float64)[1, 0]
    poses, groups = [], []
    for _ in range(frames + 1):
        matrix = cameras.look_at(eye, target)
        poses.append(cameras.make(matrix, knobs.fov_y))
        size = rng.choice([1.0, 1.0, -1.0, 0.0, 3.0], 3)
        move = tuple(rng.normal(size=3) * knobs.motion * knobs.scale)
        groups.append(np.stack([tiny.still()[0], tiny.moved(move, rng.normal(), size)]))
        if knobs.motion:
            eye = eye + rng.normal(size=3) * knobs.motion * knobs.scale
            target = target + rng.normal(size=3) * knobs.motion * knobs.scale
    return [
        types.FrameInputs(
            camera=poses[k + 1],
            previous_camera=poses[k],
            world_from_group=jnp.asarray(groups[k + 1]),
            previous_world_from_group=jnp.asarray(groups[k]),
            jitter=jnp.asarray(rng.uniform(-0.5, 0.5, 2), jnp.float32),
            cut=jnp.asarray(False),
        )
        for k in range(frames)
    ]


def violations(output: pipeline.FrameOutput) -> dict[str, int]:
    """Counts, by the broken promise, the pixels of one frame that break it."""
    method = studio.methods(output)
    why = np.asarray(output.segmentation.why)
    composite, taa = np.asarray(output.composite), np.asarray(output.taa)
    radiance = (composite, taa, np.asarray(output.reprojected))
    lost = (types.WHY_OFF_SCREEN | types.WHY_DISOCCLUDED) & why
    fxaa, kept, traced = (method == code for code in range(3))
    clean = {
        name: np.asarray(colors.sanitize(image))
        for name, image in (("raw", output.raw), ("traced", output.traced))
    }
    unlike = sum(
        int(np.sum((composite != image).any(axis=-1) & where))
        for where, image in ((fxaa, clean["raw"]), (kept, taa))
    ) + _not_joined(composite, taa, clean["traced"], traced)
    score = np.asarray(output.segmentation.score)
    motion, depth = np.asarray(output.gbuffer.motion), np.asarray(output.gbuffer.depth)
    statistics = output.statistics
    return {
        "not finite": sum(int(np.sum(~np.isfinite(x))) for x in radiance),
        "out of range": sum(
            int(np.sum(~((x >= 0.0) & (x <= colors.MAX_RADIANCE)))) for x in radiance
        )
        + int(np.sum(~((np.asarray(output.image) >= 0) & (output.image <= 1.0)))),
        "no such method": int(np.sum(method > types.METHOD_ATAA)),
        "FXAA without a reason": int(np.sum(fxaa != (lost > 0))),
        "not its method's colour": unlike,
        "score": int(np.sum(~((score >= 0.0) & (score <= 1.0)))),
        "motion": int(np.sum(~(np.abs(motion) <= 4.0 * max(studio.SIZE)))),
        "depth": int(np.sum(~(depth > 0.0))),
        "outside its inputs' hull": _outside_hull(clean["raw"], taa, kept),
        "counts": abs(int(statistics.ataa_pixels) - int(traced.sum()))
        + abs(int(statistics.fxaa_pixels) - int(fxaa.sum())),
    }


def _not_joined(
    composite: np.ndarray, taa: np.ndarray, traced: np.ndarray, where: np.ndarray
) -> int:
    """Traced pixels that do not lie between TAA's result and their rays, tone-mapped.

    Two rays or more join a history of three frames at most: theirs are 2/5 or more.
    """
    shown, old, new = (
        np.asarray(colors.tonemap(jnp.asarray(image)), np.float64)
        for image in (composite, taa, traced)
    )
    slack = 4e-6  # the roundings of the way there and back
    whole, left = np.abs(new - old), np.abs(new - shown)
    between = left + np.abs(shown - old) <= whole + slack
    near = left <= whole * (3 / 5) + slack
    return int(np.sum(~(between & near).all(axis=-1) & where))


def _outside_hull(raw: np.ndarray, taa: np.ndarray, where: np.ndarray) -> int:
    """TAA's pixels outside the YCoCg box of the 3×3 samples, tone-mapped.

    The clipped history and the sample both lie in it, and so does what is between.
    """

    def boxed(image: np.ndarray) -> np.ndarray:
        return np.asarray(colors.ycocg(colors.tonemap(jnp.asarray(image))), np.float64)

    h, w = where.shape
    padded = np.pad(boxed(raw), ((1, 1), (1, 1), (0, 0)), mode="edge")
    nine = np.stack([padded[r : r + h, c : c + w] for r in range(3) for c in range(3)])
    found = boxed(taa)
    # The clip's floor of 1e-6, and the roundings of two changes of space; a colour
    # that left the RGB cube was brought back to its face (TAA's `_in_range`).
    slack = 4e-6
    outside = (found < nine.min(axis=0) - slack) | (found > nine.max(axis=0) + slack)
    on_face = (taa <= 0.0).any(axis=-1) | (taa >= 0.99 * colors.MAX_RADIANCE).any(-1)
    return int(np.sum(outside.any(axis=-1) & where & ~on_face))
