"""Textures and shading: odd sizes, wild coordinates, peaks of the BRDF, lights at 0."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax import material, scene, shading, surface, texture, types, vector
from ataa_jax.surface import Uv
from ataa_jax.vector import Vec3
from tests import tiny
from tests.hard_cases.case import Topic
from tests.oracles import texture as oracle

TOPIC = Topic("textures and shading")

SHAPES = ((1, 1), (3, 5), (7, 13), (1, 8192), (8192, 1))
POINTS = 256


def _packed(wrap: int = types.WRAP_REPEAT) -> tuple[types.Textures, list[np.ndarray]]:
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 256, (*shape, 4), np.uint8) for shape in SHAPES]
    sources = [
        scene.TextureSource(image, srgb=False, wrap_u=wrap, wrap_v=wrap)
        for image in images
    ]
    return scene._pack_textures(sources), images


@partial(jax.jit, static_argnames="mips")
def _sample(textures, ids, uv, step, mips=True):
    u, v = (jnp.asarray(part, jnp.float32) for part in (uv[:, 0], uv[:, 1]))
    dx = dy = None
    if mips:
        dx, dy = Uv(step, step * 0.5), Uv(-step, step)
    found = texture.sample(textures, ids, Uv(u, v), dx, dy, 0.0, srgb=False)
    return jnp.stack([found.x, found.y, found.z], axis=-1)


def _lookup(uv, step=None, wrap=types.WRAP_REPEAT):
    textures, images = _packed(wrap)
    ids = np.arange(len(uv)) % len(SHAPES)
    steps = np.zeros(len(uv), np.float32) if step is None else np.float32(step)
    found = _sample(
        textures, jnp.asarray(ids, jnp.int32), jnp.asarray(uv, jnp.float32),
        jnp.asarray(steps), mips=step is not None,
    )  # fmt: skip
    return np.asarray(found), ids, images


@TOPIC.case(
    "textures of 1×1, of odd sizes, 8192×1 and 1×8192 read as defined",
    danger="a neighbour beyond the only texel; lost bits at 8192 texels",
    quantity="largest difference from the loop in float64, three wrap modes",
    # u · 8192 has steps of 2^-10 near its end, half of which the weight errs by, times
    # a texel's whole range, twice for the wrap's own rounding.
    bound=2.0**-10,
    reason="a position among 8192 texels has float32 steps of 2⁻¹⁰ texel",
)
def odd_sizes() -> float:
    rng = np.random.default_rng(1)
    uv = rng.uniform(-2.0, 3.0, (POINTS, 2)).astype(np.float32)
    uv[:20] = np.repeat([[0, 0], [1, 1], [0.5, 1], [-1, 2]], 5, axis=0)
    worst = 0.0
    for wrap in (types.WRAP_REPEAT, types.WRAP_CLAMP, types.WRAP_MIRROR):
        found, ids, images = _lookup(uv, wrap=wrap)
        # The fraction is taken in float32, where it is exact; the oracle gets it.
        expected = [
            oracle.bilinear(images[k], float(u), float(v), (wrap, wrap), False)
            for k, (u, v) in zip(ids, uv, strict=True)
        ]
        worst = max(worst, float(np.abs(found - expected).max()))
    return worst


@TOPIC.case(
    "coordinates of 1e6 read where float32 says they are",
    danger="u − ⌊u⌋ of large u; integers that overflow",
    quantity="largest difference from the loop in float64 at the same float32 uv",
    bound=2e-5,
    reason="float32 holds 1e6 in steps of 1/16, and their fraction is exact",
)
def large_coordinates() -> float:
    rng = np.random.default_rng(2)
    uv = (rng.uniform(-1, 1, (POINTS, 2)) * 1e6).astype(np.float32)
    found, ids, images = _lookup(uv)
    wrap = (types.WRAP_REPEAT, types.WRAP_REPEAT)
    expected = [
        oracle.bilinear(images[k], float(u), float(v), wrap, False)
        for k, (u, v) in zip(ids, uv, strict=True)
    ]
    return float(np.abs(found - expected).max())


WILD = np.float32([np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45, 3e9, 0.0])


@TOPIC.case(
    "coordinates and derivatives that are no numbers read some texel",
    danger="a level or an index of NaN reads beyond the table",
    quantity="lookups that are not in [0, 1], 64 pairs × textures",
    bound=0,
    reason="indices are promised to lie in bounds: outside is undefined",
)
def wild_coordinates() -> float:
    u, step = (part.reshape(-1) for part in np.meshgrid(WILD, WILD))
    u, step = np.repeat(u, len(SHAPES)), np.repeat(step, len(SHAPES))
    found, _, _ = _lookup(np.stack([u, u[::-1]], axis=1), step)
    return float(np.sum(~((found >= 0.0) & (found <= 1.0))))


_level = jax.jit(texture.level_of_detail)


@TOPIC.case(
    "a level of detail is in the pyramid whatever the derivatives",
    danger="NaN passes a clip, and becomes some integer",
    quantity="levels outside [0, last], 64 pairs of derivatives × textures",
    bound=0,
    reason="the level indexes a table without a check",
)
def levels_in_range() -> float:
    textures, _ = _packed()
    a, b = (part.reshape(-1) for part in np.meshgrid(WILD, WILD))
    wrong = 0
    for index in range(len(SHAPES)):
        ids = jnp.full(a.size, index, jnp.int32)
        dx, dy = (Uv(jnp.asarray(p), jnp.asarray(p[::-1].copy())) for p in (a, b))
        level = np.asarray(_level(textures, ids, dx, dy, 0.0))
        last = int(textures.level_count[index]) - 1
        wrong += int(np.sum(~((level >= 0.0) & (level <= last))))
    return float(wrong)


@partial(jax.jit)
def _surface(position, normal, uv, direction):
    geometry = types.Geometry(
        position=position, normal=normal, uv=uv,
        material=jnp.zeros(position.shape[0], jnp.int32),
        object=jnp.zeros(position.shape[0], jnp.int32),
        group=jnp.zeros(position.shape[0], jnp.int32),
    )  # fmt: skip
    count = position.shape[0]
    hits = types.Hits(
        distance=jnp.full(count, 2.0, jnp.float32),
        triangle=jnp.arange(count, dtype=jnp.int32),
        barycentric=jnp.full((count, 2), 0.3, jnp.float32),
    )
    steps = tuple(
        Vec3(*(jnp.float32(c) for c in v)) for v in ((0.01, 0, 0), (0, -0.01, 0))
    )
    matrices = jnp.asarray(tiny.still())
    unit = vector.unstack(direction)
    return surface.interpolate(geometry, matrices, hits, unit, steps)


@TOPIC.case(
    "degenerate uv and NaN normals leave a surface finite, its normal unit",
    danger="a tangent frame of 0/0; NaN normals from a file",
    quantity="fields that are not finite or normals off unit length by 1e-5",
    bound=0,
    reason="one NaN here is a NaN pixel, and FXAA's whole neighbourhood",
)
def degenerate_surfaces() -> float:
    rng = np.random.default_rng(3)
    count = 512
    position = rng.normal(size=(count, 3, 3))
    uv = rng.normal(size=(count, 3, 2))
    uv[0::4] = uv[0::4, :1]  # all corners one point
    uv[1::4, 2] = 2 * uv[1::4, 1] - uv[1::4, 0]  # on a line
    normal = rng.normal(size=(count, 3, 3))
    normal[::3] = np.nan
    normal[1::3] = 0.0
    normal[2::9] = np.inf
    direction = rng.normal(size=(count, 3))
    found = _surface(
        *(jnp.asarray(part, jnp.float32) for part in (position, normal, uv, direction))
    )
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(found)]
    wrong = sum(int(np.sum(~np.isfinite(a))) for a in arrays)
    unit = np.linalg.norm(np.asarray(vector.stack(found.normal)), axis=-1)
    return float(wrong + np.sum(~(np.abs(unit - 1.0) < 1e-5)))


@TOPIC.case(
    "triangles of 1e-4 to 1e8 units have the mip level of their uv density",
    danger="the square of N = e1 × e2 leaves float32: its root is the fourth power of "
    "an edge",
    quantity="largest error of log2 of the uv step",
    bound=0.01,
    reason="a hundredth of a level is a hundredth of two levels' difference",
)
def derivatives_by_scale() -> float:
    rng = np.random.default_rng(4)
    worst = 0.0
    base = rng.normal(size=(64, 3, 3))
    uv = rng.normal(size=(64, 3, 2))
    normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (64, 3, 3))
    direction = rng.normal(size=(64, 3)) * 0.2 - (0, 0, 1)

    def steps(scale):
        found = _surface(
            *(
                jnp.asarray(p, jnp.float32)
                for p in (base * scale, normal, uv, direction)
            )
        )
        assert found.uv_dx is not None
        return np.hypot(np.asarray(found.uv_dx.u), np.asarray(found.uv_dx.v))

    expected = steps(1.0)
    # The distance stays 2: uv per unit falls as the triangle grows.
    for scale in (1e-4, 1e-2, 1e2, 1e4, 1e6, 1e8):
        with np.errstate(divide="ignore", invalid="ignore"):
            error = np.abs(np.log2(steps(scale) * scale / expected))
        worst = max(worst, float(np.where(np.isfinite(error), error, np.inf).max()))
    return worst


def _glossy(count: int, roughness: float) -> material.Material:
    def full(value):
        return jnp.full(count, value, jnp.float32)

    normal = Vec3(full(0.0), full(0.0), full(1.0))
    rough = max(roughness, material.MIN_ROUGHNESS)
    return material.Material(
        diffuse=Vec3(*(full(0.5),) * 3), f0=Vec3(*(full(0.04),) * 3),
        alpha=full(rough * rough), roughness=full(rough), emissive=None,
        normal=normal, mirror=None, opacity=None, transmittance=None,
    )  # fmt: skip


def _brdf64(rough: float, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    """The same formulas in float64, the peak by |n × h|²."""
    half = view + light
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    cl, cv = np.maximum(light[:, 2], 1e-4), np.maximum(view[:, 2], 1e-4)
    a2 = rough**4
    sine = half[:, 0] ** 2 + half[:, 1] ** 2
    peak = a2 / (np.pi * (sine + half[:, 2] ** 2 * a2) ** 2)
    visible = 0.5 / (
        cl * np.sqrt(cv * cv * (1 - a2) + a2) + cv * np.sqrt(cl * cl * (1 - a2) + a2)
    )
    fresnel = 0.04 + 0.96 * (1 - np.sum(view * half, axis=1)) ** 5
    return 0.5 * (1 - fresnel) / np.pi + fresnel * peak * visible


def _around(rng, count, cosines) -> np.ndarray:
    cosine = rng.choice(cosines, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(angle), sine * np.sin(angle), cosine], axis=1)


@TOPIC.case(
    "a mirror-smooth highlight keeps its peak",
    danger="1 − (n·h)² cancels: α² = 4e-6 against steps of 6e-8",
    quantity="largest relative error near the peak at roughness 0, from float64",
    # The half vector is rounded by 2^-24 a component, which at an angle of α moves
    # sin² by 2 · 2^-24 / α, three components; the denominator is squared.
    bound=12 * 2.0**-24 / 0.045**2,
    reason="12 · 2⁻²⁴ / α: the half vector's rounding, at the least roughness of 0.045",
)
def smooth_peak() -> float:
    rng = np.random.default_rng(5)
    view = _around(rng, 4096, [0.1, 0.5, 0.9])
    half = _around(rng, 4096, np.cos([0.0, 1e-4, 5e-4, 1e-3, 2e-3]))
    light = 2 * half * np.sum(view * half, axis=1, keepdims=True) - view
    keep = light[:, 2] > 0.05
    view, light = view[keep].astype(np.float32), light[keep].astype(np.float32)
    found = material.brdf(
        _glossy(len(view), 0.0),
        *(vector.unstack(jnp.asarray(p)) for p in (view, light)),
    )
    wide = [p.astype(np.float64) for p in (view, light)]
    wide = [p / np.linalg.norm(p, axis=1, keepdims=True) for p in wide]
    return float(np.abs(np.asarray(found.x) / _brdf64(0.045, *wide) - 1).max())


@TOPIC.case(
    "highlights stay finite at roughness 0 and at grazing angles",
    danger="0/0 where view, light and surface are in line",
    quantity="values that are not finite or negative, cosines from 0 to 1",
    bound=0,
    reason="reflectance is a positive number",
)
def grazing() -> float:
    rng = np.random.default_rng(6)
    wrong = 0
    for roughness in (0.0, 0.5, 1.0):
        view, light = (
            _around(rng, 4096, [0.0, 1e-9, 1e-4, 0.5, 1.0]).astype(np.float32)
            for _ in range(2)
        )
        light[:512] = -view[:512]  # no half vector
        light[512:1024] = view[512:1024]
        found = material.brdf(
            _glossy(4096, roughness),
            *(vector.unstack(jnp.asarray(p)) for p in (view, light)),
        )
        value = np.asarray(found.x)
        wrong += int(np.sum(~(np.isfinite(value) & (value >= 0.0))))
    return float(wrong)


@TOPIC.case(
    "a light of 1e6 cd on the surface, at a mirror, is finite until it is displayed",
    danger="1/d² at d = 0 times the peak overflows to inf, and inf · 0 is NaN",
    quantity="values that are not finite, lights 0 to 1e-3 units away",
    bound=0,
    reason="the largest product: 1e6 · 2⁴⁰ · the BRDF's peak is below 3e38",
)
def light_on_surface() -> float:
    distance = np.repeat([0.0, 1e-30, 1e-20, 1e-9, 1e-6, 1e-3], 64)
    rng = np.random.default_rng(7)
    view = _around(rng, distance.size, [1e-4, 0.5, 1.0]).astype(np.float32)
    offset = _around(rng, distance.size, [0.0, 0.5, 1.0]) * distance[:, None]
    lights = scene.pack_lights(
        [scene.LightSource(kind, (1e6,) * 3, range=r)
         for kind in (types.LIGHT_POINT, types.LIGHT_SPOT)
         for r in (np.inf, 1e-3, 0.0)]
    )  # fmt: skip

    @jax.jit
    def reflected(light):
        toward, irradiance = shading._incident(
            light, vector.unstack(jnp.asarray(-offset, jnp.float32))
        )
        value = material.brdf(
            _glossy(distance.size, 0.0), vector.unstack(jnp.asarray(view)), toward
        )
        # As shading sums: times the cosine, which may be 0.
        sent = vector.stack(value * irradiance * jnp.maximum(toward.z, 0.0))
        return sent, colors.display(sent)

    return float(
        sum(
            int(np.sum(~np.isfinite(np.asarray(image))))
            for index in range(lights.kind.shape[0])
            for image in reflected(jax.tree.map(lambda x, i=index: x[i], lights))
        )
    )


TOPIC.covered(
    "bad normals become flat and bad uv zero when a scene is packed",
    danger="NaN of a file reaches the shading",
    test="test_scene.py::test_bad_normals_become_flat_and_bad_uv_zero",
    bound="normals atol 1e-7, rtol 1e-7; uv bit-equal",
    reason="one rounding of float32 in the length",
)
TOPIC.covered(
    "lookups of small and odd textures equal the loop",
    danger="border rules",
    test="test_texture.py::test_bilinear_lookup_equals_the_loop_oracle",
    bound="atol 2e-5, rtol 1e-7",
    reason="float32 uv near 3.5 lose 2⁻²², times 8 texels, times a texel's full range",
)
TOPIC.covered(
    "constant images stay constant down to one texel",
    danger="mip levels of odd sizes weigh their texels unevenly",
    test="test_scene.py::test_constant_images_stay_constant_down_to_one_texel",
    bound="every level bit-equal, the last 1×1",
    reason="the mean of equal codes is that code",
)
