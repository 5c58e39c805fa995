"""Texture lookup against the loop oracle, and its border rules."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import texture, types
from ataa_jax.surface import Uv
from tests.oracles import texture as oracle

WRAPS = [types.WRAP_REPEAT, types.WRAP_CLAMP, types.WRAP_MIRROR]


def pack(levels: list[np.ndarray], wrap: tuple[int, int], srgb: bool) -> types.Textures:
    """One texture from its mip levels, largest first."""
    flat = [
        level.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16, 1 << 24], np.uint32)
        for level in levels
    ]
    sizes = [level.size // 4 for level in levels]
    return types.Textures(
        texels=jnp.asarray(np.concatenate([f.reshape(-1) for f in flat]), jnp.uint32),
        level_offset=jnp.asarray([np.cumsum([0, *sizes[:-1]])], jnp.int32),
        level_height=jnp.asarray([[level.shape[0] for level in levels]], jnp.int32),
        level_width=jnp.asarray([[level.shape[1] for level in levels]], jnp.int32),
        level_count=jnp.asarray([len(levels)], jnp.int32),
        wrap_u=jnp.asarray([wrap[0]], jnp.int32),
        wrap_v=jnp.asarray([wrap[1]], jnp.int32),
        srgb=jnp.asarray([srgb]),
    )


def lookup(
    textures: types.Textures,
    uv: np.ndarray,
    step: float | None = None,
    bias: float = 0.0,
    srgb: bool = False,
) -> np.ndarray:
    coordinate = Uv(
        jnp.asarray(uv[:, 0], jnp.float32), jnp.asarray(uv[:, 1], jnp.float32)
    )
    ids = jnp.zeros(len(uv), jnp.int32)
    dx = dy = None
    if step is not None:
        full = jnp.full(len(uv), step, jnp.float32)
        dx, dy = Uv(full, full * 0.0), Uv(full * 0.0, full)
    color = texture.sample(textures, ids, coordinate, dx, dy, bias, srgb=srgb)
    return np.stack([color.x, color.y, color.z], axis=-1)


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (8, 4), (1, 7)])
@pytest.mark.parametrize("wrap_u", WRAPS)
@pytest.mark.parametrize("wrap_v", WRAPS)
@pytest.mark.parametrize("srgb", [True, False])
def test_bilinear_lookup_equals_the_loop_oracle(size, wrap_u, wrap_v, srgb):
    rng = np.random.default_rng(1)
    image = rng.integers(0, 256, (*size, 4), np.uint8)
    uv = rng.uniform(-2.5, 3.5, (200, 2)).astype(np.float32)
    uv[:4] = [[0, 0], [1, 1], [0.5, 0.5], [-1, 2]]
    found = lookup(pack([image], (wrap_u, wrap_v), srgb), uv, srgb=srgb)
    expected = [
        oracle.bilinear(image, float(u), float(v), (wrap_u, wrap_v), srgb)
        for u, v in uv
    ]
    # float32 uv near 3.5 lose 2^-22, times 8 texels, times a texel's full range.
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_texel_centres_read_exactly_the_texel():
    image = np.arange(4 * 4 * 4, dtype=np.uint8).reshape(4, 4, 4)
    y, x = np.mgrid[0:4, 0:4]
    uv = np.stack([(x + 0.5) / 4, (y + 0.5) / 4], axis=-1).reshape(-1, 2)
    found = lookup(pack([image], (0, 0), False), uv)
    # One ulp: a product with 1/255 in place of the quotient.
    expected = image.reshape(-1, 4)[:, :3] / 255.0
    np.testing.assert_allclose(found, expected, rtol=1.2e-7)


def test_level_of_detail_follows_the_footprint():
    levels = [np.full((s, s, 4), v, np.uint8) for s, v in ((8, 0), (4, 51), (2, 102))]
    textures = pack(levels, (0, 0), False)
    uv = np.array([[0.3, 0.7]])
    # A footprint of 2^k texels of level 0 reads level k; between, linearly.
    for footprint, value in ((1.0, 0.0), (2.0, 0.2), (4.0, 0.4), (2**0.5, 0.1)):
        found = lookup(textures, uv, step=footprint / 8.0)
        np.testing.assert_allclose(found[0], value, atol=1e-6)
    # A bias shifts the level; the pyramid's ends clamp it.
    np.testing.assert_allclose(lookup(textures, uv, 2 / 8, 1.0)[0], 0.4, atol=1e-6)
    np.testing.assert_allclose(lookup(textures, uv, 2 / 8, -5.0)[0], 0.0, atol=1e-6)
    np.testing.assert_allclose(lookup(textures, uv, 1e6)[0], 0.4, atol=1e-6)


def test_no_texture_reads_white_and_bad_coordinates_stay_finite():
    image = np.full((2, 2, 4), 7, np.uint8)
    textures = pack([image], (0, 0), False)
    uv = jnp.asarray([np.nan, np.inf, 1e6, 0.5], jnp.float32)
    ids = jnp.asarray([0, 0, 0, types.NO_TEXTURE], jnp.int32)
    color = texture.sample(textures, ids, Uv(uv, uv), None, None, srgb=False)
    np.testing.assert_allclose(color.x, [7 / 255, 7 / 255, 7 / 255, 1.0], rtol=1e-6)


def test_jit_equals_eager():
    rng = np.random.default_rng(2)
    image = rng.integers(0, 256, (5, 3, 4), np.uint8)
    textures = pack([image], (0, 2), True)
    uv = Uv(*jnp.asarray(rng.uniform(-2, 2, (2, 50)), jnp.float32))
    ids = jnp.zeros(50, jnp.int32)
    eager = texture.sample(textures, ids, uv, None, None, srgb=True)
    jitted = jax.jit(partial(texture.sample, srgb=True))(textures, ids, uv, None, None)
    # Fused multiply-adds may change the last bit of an interpolation.
    np.testing.assert_allclose(eager.x, jitted.x, rtol=1e-6, atol=1e-7)
