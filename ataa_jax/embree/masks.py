"""Alpha masks: which hits on a masked material are solid, and which are holes.

At a hit with barycentric weights b1, b2 of corners 1 and 2 (b0 = 1 − b1 − b2),

    (u, v)  = b0 uv0 + b1 uv1 + b2 uv2
    (x, y)  = (u · width − ½, v · height − ½)          texel centres lie at +0.5
    texel   = bilinear interpolation of level 0's alpha / 255 at (x, y)
    solid   ⇔ texel · base colour's alpha ≥ cutoff     (glTF 2.0, alphaMode MASK)

all in float32. Texel indices beyond the image follow the texture's wrap modes:
repeat (i mod n), clamp (nearest texel inside), mirror (reflected about the edge, the
edge texel twice). Without a texture, texel is 1; a uv that is not finite reads
texel (0, 0). The rule never depends on distance or on mip levels, so that a shadow
ray and a camera ray see the same hole.
"""

# ruff: noqa: ANN001, ANN201, ANN202 (numba infers types; comments say the shapes)

import functools
from typing import NamedTuple, cast, no_type_check

import numba
import numpy as np
from numba import types as nb
from numba.core import cgutils
from numba.core.ccallback import CFunc
from numba.extending import intrinsic

from ataa_jax import loops, types

_HALF = np.float32(0.5)
_ONE = np.float32(1.0)


class MaskTable(NamedTuple):
    """What the test reads about q masked triangles and k textures."""

    corner: np.ndarray  # float32 (q, 8): u0 v0 u1 v1 u2 v2, base alpha, cutoff
    texture: np.ndarray  # int32 (q,): row of `image`
    image: np.ndarray  # int64 (k, 5): first texel, height, width, wrap u, wrap v
    alpha: np.ndarray  # uint8: level 0 of every texture that a mask uses


class Split(NamedTuple):
    """Triangle ids of every geometry: one opaque and one masked a rigid group."""

    opaque: list[np.ndarray]  # per group, int32
    masked: list[np.ndarray]  # per group, int32
    mask: MaskTable  # rows: the masked triangles, group after group


def split(scene: types.Scene, *, blended: bool = False) -> Split:
    """Sorts the triangles by rigid group, and into always solid and to be tested.

    Args:
        scene: The scene.
        blended: Take the triangles that something shows through, in place of the
            others. They are never masked.

    A mask without a texture is the same everywhere: its triangles are solid, or they
    are left out. (Deciding textured triangles beforehand from the texels they span
    was tried: it settles 101 of the 34,940 masked triangles of Sponza.)
    """
    group = np.asarray(scene.geometry.group)
    material = np.asarray(scene.geometry.material)
    materials = scene.materials
    tested = np.asarray(materials.alpha_masked)
    textured = np.asarray(materials.base_color_texture) != types.NO_TEXTURE
    below = np.asarray(materials.base_color)[:, 3] < np.asarray(materials.alpha_cutoff)
    taken = np.asarray(materials.blended) == blended
    tested = tested & ~np.asarray(materials.blended)
    masked = (tested & textured & taken)[material]
    opaque = ((~tested | (~textured & ~below)) & taken)[material]
    groups = range(int(group.max()) + 1 if group.size else 1)
    opaque_ids, masked_ids = (
        [np.flatnonzero((group == g) & wanted).astype(np.int32) for g in groups]
        for wanted in (opaque, masked)
    )
    return Split(opaque_ids, masked_ids, _table(scene, np.concatenate(masked_ids)))


def _table(scene: types.Scene, triangles: np.ndarray) -> MaskTable:
    """Gathers the mask data of some triangles.

    Args:
        scene: Their scene.
        triangles: int (q,), ids of triangles with masked materials.
    """
    material = np.asarray(scene.geometry.material)[triangles]
    corner = np.empty((triangles.size, 8), np.float32)
    corner[:, :6] = np.asarray(scene.geometry.uv)[triangles].reshape(-1, 6)
    corner[:, 6] = np.asarray(scene.materials.base_color)[material, 3]
    corner[:, 7] = np.asarray(scene.materials.alpha_cutoff)[material]
    texture = np.asarray(scene.materials.base_color_texture)[material].astype(np.int32)

    textures = scene.textures
    texels = np.asarray(textures.texels)
    count = np.asarray(textures.level_count).size
    image = np.zeros((count, 5), np.int64)
    alpha: list[np.ndarray] = []
    size = 0
    for k in np.unique(texture[texture >= 0]):
        first = int(np.asarray(textures.level_offset)[k, 0])
        height = int(np.asarray(textures.level_height)[k, 0])
        width = int(np.asarray(textures.level_width)[k, 0])
        wraps = (int(np.asarray(w)[k]) for w in (textures.wrap_u, textures.wrap_v))
        image[k] = (size, height, width, *wraps)
        alpha.append((texels[first : first + height * width] >> 24).astype(np.uint8))
        size += height * width
    texels_8bit = np.concatenate(alpha) if alpha else np.zeros(1, np.uint8)
    return MaskTable(corner, np.ascontiguousarray(texture), image, texels_8bit)


@loops.compiled
@no_type_check
def _wrap(index, size, mode):
    if mode == types.WRAP_CLAMP:
        return min(max(index, 0), size - 1)
    if mode == types.WRAP_MIRROR:
        reflected = index % (2 * size)
        return min(reflected, 2 * size - 1 - reflected)
    return index % size


@loops.compiled
@no_type_check
def solid(corner, texture, image, alpha, row, b1, b2):
    """Returns whether a hit on masked triangle `row` is solid (module docstring)."""
    k = texture[row]
    b0 = _ONE - b1 - b2
    u = b0 * corner[row, 0] + b1 * corner[row, 2] + b2 * corner[row, 4]
    v = b0 * corner[row, 1] + b1 * corner[row, 3] + b2 * corner[row, 5]
    first, height, width = image[k, 0], image[k, 1], image[k, 2]
    x = u * np.float32(width) - _HALF
    y = v * np.float32(height) - _HALF
    # Also false for NaN; beyond 1e9 texels a float32 has no fraction anyway.
    if not (abs(x) < np.float32(1e9) and abs(y) < np.float32(1e9)):
        x = y = np.float32(0.0)
    column, line = int(np.floor(x)), int(np.floor(y))
    right, below = x - np.float32(column), y - np.float32(line)
    c0 = _wrap(column, width, image[k, 3])
    c1 = _wrap(column + 1, width, image[k, 3])
    r0 = first + width * _wrap(line, height, image[k, 4])
    r1 = first + width * _wrap(line + 1, height, image[k, 4])
    left, above = _ONE - right, _ONE - below
    upper = left * np.float32(alpha[r0 + c0]) + right * np.float32(alpha[r0 + c1])
    lower = left * np.float32(alpha[r1 + c0]) + right * np.float32(alpha[r1 + c1])
    texel = (above * upper + below * lower) / np.float32(255.0)
    return texel * corner[row, 6] >= corner[row, 7]


@loops.compiled
@no_type_check
def solid_many(corner, texture, image, alpha, row, b1, b2):
    """Returns `solid` for a batch of hits: row int (n,), b1 and b2 float32 (n,)."""
    answer = np.empty(row.size, np.bool_)
    for i in range(row.size):
        answer[i] = solid(corner, texture, image, alpha, row[i], b1[i], b2[i])
    return answer


@intrinsic
@no_type_check
def _pointer(typing_context, address):
    """Turns an int64 into a pointer that `carray` takes."""

    def codegen(context, builder, signature, arguments):
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return nb.voidptr(address), codegen


# RTCFilterFunctionNArguments as seven 8-byte words: valid, user data, query context,
# rays, hits, N (32 bits, then padding). Rays and hits are structures of arrays of N.
_WORD_VALID, _WORD_DATA, _WORD_HITS, _WORD_COUNT = 0, 1, 4, 5
_HIT_U, _HIT_V, _HIT_PRIMITIVE = 3, 4, 5  # rows of RTCHitN


@no_type_check
def _reject_holes(arguments):
    """Embree's filter of candidate hits: holes are marked invalid, so it goes on."""
    words = numba.carray(_pointer(arguments), 6, np.int64)
    count = int(numba.carray(_pointer(arguments + 8 * _WORD_COUNT), 1, np.int32)[0])
    valid = numba.carray(_pointer(words[_WORD_VALID]), count, np.int32)
    hit = numba.carray(_pointer(words[_WORD_HITS]), (6, count), np.float32)
    primitive = numba.carray(
        _pointer(words[_WORD_HITS] + 4 * _HIT_PRIMITIVE * count), count, np.int32
    )
    data = numba.carray(_pointer(words[_WORD_DATA]), 8, np.int64)
    corner = numba.carray(_pointer(data[0]), (data[4], 8), np.float32)
    texture = numba.carray(_pointer(data[1]), data[4], np.int32)
    image = numba.carray(_pointer(data[2]), (data[5], 5), np.int64)
    alpha = numba.carray(_pointer(data[3]), data[6], np.uint8)
    for lane in range(count):
        if valid[lane] != 0 and not solid(
            corner,
            texture,
            image,
            alpha,
            primitive[lane],
            hit[_HIT_U, lane],
            hit[_HIT_V, lane],
        ):
            valid[lane] = 0


@functools.cache
def _filter() -> CFunc:
    # Compiled when the first scene with masks is built, and kept: Embree calls it.
    signature = nb.void(nb.int64)
    return loops.called_back(signature, _reject_holes)


def filter_address() -> int:
    """Returns the address of Embree's filter function, for both kinds of rays."""
    return cast("int", _filter().address)


def filter_data(mask: MaskTable, first: int, last: int) -> np.ndarray:
    """Packs the addresses that the filter of one geometry reads.

    Args:
        mask: The table; it must outlive the geometry.
        first: The row of the geometry's first triangle.
        last: One past the row of its last.
    """
    corner = mask.corner[first:last]
    texture = mask.texture[first:last]
    return np.array(
        [
            corner.ctypes.data,
            texture.ctypes.data,
            mask.image.ctypes.data,
            mask.alpha.ctypes.data,
            last - first,
            mask.image.shape[0],
            mask.alpha.size,
            0,
        ],
        np.int64,
    )
