"""Number formats of images in memory: narrow where they are kept, wide where used.

Engines keep histories and G-buffers in 16 bits. Here any stage takes its images in any
floating-point format and computes in float32, or in float64 where an image has that.
"""

from typing import Literal, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Format = Literal["float16", "bfloat16", "float32", "float64"]

Tree = TypeVar("Tree")


def widen(tree: Tree) -> Tree:
    """Returns the tree with floats of 16 bits as float32."""

    def wide(leaf: Array) -> Array:
        floats = jnp.issubdtype(leaf.dtype, jnp.floating)
        narrow = floats and jnp.finfo(leaf.dtype).bits < 32
        return leaf.astype(jnp.float32) if narrow else leaf

    return jax.tree.map(wide, tree)


def narrow(values: Float[Array, "*n"], kept_as: Format) -> Float[Array, "*n"]:
    """Returns values in the format that they are kept in.

    Args:
        values: may be inf or NaN, which stay what they are.
        kept_as: the format.

    Returns:
        A finite value beyond the format's range becomes its largest: inf is a depth
        that means sky.
    """
    if kept_as == "float16":
        largest = float(jnp.finfo(jnp.float16).max)
        limited = jnp.clip(values, -largest, largest)
        values = jnp.where(jnp.isinf(values), values, limited)
    return values.astype(jnp.dtype(kept_as))
