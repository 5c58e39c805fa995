"""Small copies of real scenes: the same structure, few triangles, tiny images."""

import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

from tests.gltf_writer import Writer, encode

_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_DTYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}

MESHES, TRIANGLES, KEYS = 12, 24, 4


class _Source:
    """A binary glTF file, read without any check: the scenes are known to be sound."""

    def __init__(self, file: Path) -> None:
        data = file.read_bytes()
        (length,) = struct.unpack_from("<I", data, 12)
        self.doc = json.loads(data[20 : 20 + length])
        self.data = data[20 + length + 8 :]

    def view(self, index: int) -> bytes:
        view = self.doc["bufferViews"][index]
        start = view.get("byteOffset", 0)
        return self.data[start : start + view["byteLength"]]

    def array(self, index: int) -> np.ndarray:
        record = self.doc["accessors"][index]
        dtype = np.dtype("<" + _DTYPES[record["componentType"]])
        columns = _COLUMNS[record["type"]]
        if "bufferView" not in record:
            return np.zeros((record["count"], columns), dtype)
        view = self.doc["bufferViews"][record["bufferView"]]
        return np.ndarray(
            (record["count"], columns),
            dtype,
            self.view(record["bufferView"]),
            record.get("byteOffset", 0),
            (view.get("byteStride", columns * dtype.itemsize), dtype.itemsize),
        )


def reduced(file: Path) -> Writer:
    """Returns a writer that holds a small copy of a binary glTF file.

    Nodes, materials, textures, cameras, lights, skins and animations stay; meshes after
    the twelfth go, and of every primitive its first triangles stay, of every animation
    its first keys, of every image 4×4 texels.
    """
    source, writer = _Source(file), Writer()
    doc = {
        key: value
        for key, value in source.doc.items()
        if key not in ("accessors", "bufferViews", "buffers")
    }
    writer.doc = doc
    for mesh in doc["meshes"]:
        mesh["primitives"] = [
            _primitive(source, writer, each) for each in mesh["primitives"]
        ]
        mesh.pop("weights", None)
    for node in doc["nodes"]:
        if node.get("mesh", 0) >= MESHES:
            del node["mesh"]
            node.pop("skin", None)
    doc["meshes"] = doc["meshes"][:MESHES]
    for skin in doc.get("skins", []):
        if "inverseBindMatrices" in skin:
            matrices = source.array(skin["inverseBindMatrices"])
            skin["inverseBindMatrices"] = writer.accessor(matrices)
    for animation in doc.get("animations", []):
        _animation(source, writer, animation)
    for image in doc.get("images", []):
        small = Image.open(io.BytesIO(source.view(image.pop("bufferView"))))
        kind = "JPEG" if image["mimeType"] == "image/jpeg" else "PNG"
        tiny = small.convert("RGB" if kind == "JPEG" else "RGBA").resize((4, 4))
        image["bufferView"] = writer.view(encode(tiny, kind))
    return writer


def _primitive(source: _Source, writer: Writer, primitive: dict) -> dict:
    arrays = {k: source.array(i) for k, i in primitive["attributes"].items()}
    count = len(arrays["POSITION"])
    order = np.arange(count)
    if "indices" in primitive:
        order = source.array(primitive["indices"])[:, 0].astype(np.int64)
    order = order[: 3 * TRIANGLES]
    used, indices = np.unique(order, return_inverse=True)
    result = {k: v for k, v in primitive.items() if k not in ("targets", "indices")}
    result["attributes"] = {
        k: writer.accessor(np.ascontiguousarray(v[used])) for k, v in arrays.items()
    }
    if "indices" in primitive:
        result["indices"] = writer.accessor(indices.astype(np.uint16))
    return result


def _animation(source: _Source, writer: Writer, animation: dict) -> None:
    for sampler in animation["samplers"]:
        times = source.array(sampler["input"])
        values = source.array(sampler["output"])
        a_key = len(values) // len(times)
        keys = min(KEYS, len(times))
        sampler["input"] = writer.accessor(np.ascontiguousarray(times[:keys]))
        sampler["output"] = writer.accessor(
            np.ascontiguousarray(values[: keys * a_key])
        )
