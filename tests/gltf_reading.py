"""What the tests of the glTF reader share: loading, refusing, looking at it."""

import numpy as np
import pytest

from ataa_jax import gltf
from ataa_jax.errors import InputError
from tests.gltf_writer import solid

QUARTER = np.sqrt(0.5)  # sine and cosine of a quarter turn's half angle
# Positions are float32 of float64 products of small numbers: an ulp or two of 1.
ULP = 3e-7


def load(writer, tmp_path):
    return gltf.load(writer.glb(tmp_path / "scene.glb"))


def corners(mesh):
    """Returns the corners of a mesh's triangles, (t, 3, 3)."""
    return mesh.position[mesh.triangles]


def planes(mesh):
    a, b, c = corners(mesh).transpose(1, 0, 2)
    plane = np.cross(b - a, c - a)
    return plane / np.linalg.norm(plane, axis=1, keepdims=True)


def refuse(path, *words):
    """Checks that loading fails in one sentence that has all `words` in it."""
    with pytest.raises(InputError) as caught:
        gltf.load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(path))
    for word in words:
        assert word in message
    return message


def textured(writer, **info):
    """Adds a textured triangle and returns its material's record."""
    image = writer.image(solid((10, 20, 30, 40)))
    texture = writer.add("textures", source=image)
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": texture} | info}}
    writer.doc["materials"] = [material]
    uv = np.array([[0, 0], [1, 0], [0, 1]], np.float32)
    writer.node(mesh=writer.mesh(texcoord_0=uv, material=0))
    return material
