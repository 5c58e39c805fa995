"""The criteria's terms, by hand and by their definitions."""

import jax.numpy as jnp
import numpy as np

from ataa_jax import terms


def test_a_planes_depth_term_is_its_constant_gradient():
    # 1/z rises by 0.01 a pixel: Sobel's 8 · 0.01, over 8 · the largest, to the right.
    inverse = 1.0 + 0.01 * np.arange(9.0)
    depth = np.broadcast_to(1.0 / inverse, (5, 9)).astype(np.float32)
    term = terms.depth_edge(jnp.asarray(depth))
    expected = 0.01 / inverse[2:]
    # 1/z near 1 is rounded to 6e-8; its differences are summed.
    np.testing.assert_allclose(term[2, 1:-1], expected, atol=3e-7)


def test_the_normal_term_is_the_angle_over_pi():
    angle = np.radians([0.0, 0.01, 0.01, 90.01, 0.0, 0.0])
    normal = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=-1)
    normal[5] = 0.0  # sky
    term = terms.normal_edge(jnp.asarray(normal[None], jnp.float32))
    expected = np.array([[0.01, 0.01, 90.0, 90.01, 90.01, 0.0]]) / 180.0
    # A float32 component near 1 is rounded to 6e-8, which at 0.01° is that / π.
    np.testing.assert_allclose(term, expected, atol=4e-8, rtol=1e-6)


def test_the_response_term_agrees_with_the_oracle():
    rng = np.random.default_rng(4)
    blended, then = rng.uniform(0.0, 4.0, (2, 5, 7, 3)).astype(np.float32)

    def shown(image):
        mapped = image.astype(float) / (1.0 + image.max(axis=-1, keepdims=True))
        low = mapped <= 0.0031308
        return np.where(low, 12.92 * mapped, 1.055 * mapped ** (1 / 2.4) - 0.055)

    distance = np.sqrt(((shown(blended) - shown(then)) ** 2).mean(axis=-1))
    luma = np.pad(shown(then) @ np.array([0.2126, 0.7152, 0.0722]), 1, mode="edge")
    busy = np.array(
        [[luma[i : i + 3, j : j + 3].std() for j in range(7)] for i in range(5)]
    )
    expected = distance * 0.1 / np.hypot(busy, 0.1)
    term = terms.response(jnp.asarray(blended), jnp.asarray(then), jnp.float32(0.1))
    # A few float32 steps of a power near 1.
    np.testing.assert_allclose(term, expected, atol=1e-6)


def test_the_layers_term_is_the_share_of_what_moves_otherwise():
    share = np.linspace(0.0, 0.5, 12, dtype=np.float32).reshape(3, 4)
    apart = np.array([0.0, 0.5, 3.0, 1e4], np.float32)
    motion = np.random.default_rng(2).normal(size=(3, 4, 2)).astype(np.float32)
    # The other surface moves by (0.6, −0.8) of that beside the first.
    other = motion + apart[None, :, None] * np.float32([0.6, -0.8])
    term = terms.layers(*(jnp.asarray(x) for x in (motion, other, share)))
    # A motion of 1 px is rounded to 6e-8, of 1e4 px to 5e-4.
    np.testing.assert_allclose(term, share * (apart / (1.0 + apart)), atol=1e-6)
