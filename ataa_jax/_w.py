import jax.numpy as jnp
from ataa_jax.vector import materialize
def shift_rows(image, step):
    if step > 0: return jnp.concatenate([image[1:], image[-1:]], axis=0)
    return jnp.concatenate([image[:1], image[:-1]], axis=0)
def shift_columns(image, step):
    if step > 0: return jnp.concatenate([image[:, 1:], image[:, -1:]], axis=1)
    return jnp.concatenate([image[:, :1], image[:, :-1]], axis=1)
def neighbours(image):
    rows = [shift_rows(image, -1), image, shift_rows(image, 1)]
    return [[shift_columns(row, -1), row, shift_columns(row, 1)] for row in (materialize(r) for r in rows)]
def separable(image, combine):
    column = materialize(combine(combine(shift_rows(image, -1), image), shift_rows(image, 1)))
    return materialize(combine(combine(shift_columns(column, -1), column), shift_columns(column, 1)))
def minimum(image): return separable(image, jnp.minimum)
def maximum(image): return separable(image, jnp.maximum)
def mean(image): return separable(image, jnp.add) * (1.0 / 9.0)
def plus(image, combine):
    vertical = combine(combine(shift_rows(image, -1), image), shift_rows(image, 1))
    return combine(combine(vertical, shift_columns(image, -1)), shift_columns(image, 1))
def sobel(image):
    up, down = materialize((shift_rows(image, -1), shift_rows(image, 1)))
    smooth = materialize(up + 2.0 * image + down)
    slope = materialize(down - up)
    gx = shift_columns(smooth, 1) - shift_columns(smooth, -1)
    gy = shift_columns(slope, -1) + 2.0 * slope + shift_columns(slope, 1)
    return jnp.sqrt(gx * gx + gy * gy)
