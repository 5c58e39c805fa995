"""Rays through alpha masks."""

import numpy as np
import pytest

from ataa_jax import embree, types
from tests import tiny
from tests.tracing import (
    EPS,
    everything,
)

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
