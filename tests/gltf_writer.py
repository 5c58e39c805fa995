"""A tiny hand writer of glTF files, for tests: it checks nothing on purpose."""

import base64
import io
import json
import struct
from pathlib import Path

import numpy as np
from PIL import Image

from tests import tiny

_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)


class Writer:
    """Collects a document; `doc` is its JSON, free to be edited by a test."""

    def __init__(self):
        self.doc = {"asset": {"version": "2.0"}}
        self.data = bytearray()

    def add(self, key, **record):
        """Appends a record to a top-level array and returns its index."""
        items = self.doc.setdefault(key, [])
        items.append(record)
        return len(items) - 1

    def view(self, data, **record):
        """Appends bytes, aligned to 4, and a buffer view of them."""
        self.data += bytes(-len(self.data) % 4)
        offset = len(self.data)
        self.data += data
        return self.add(
            "bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), **record
        )

    def accessor(self, array, stride=0, **record):
        """Appends an accessor; a `stride` in bytes leaves gaps between elements."""
        array = np.asarray(array)
        if array.dtype in (np.float64, np.int64):
            array = array.astype(np.float32 if array.dtype.kind == "f" else np.uint16)
        rows = array.reshape(len(array), -1)
        data = rows.tobytes()
        extra = {}
        if stride:
            size = rows.shape[1] * rows.itemsize
            gap = b"\xee" * (stride - size)
            data = gap.join(row.tobytes() for row in rows)
            extra = {"byteStride": stride}
        fields = {
            "bufferView": self.view(data, **extra),
            "componentType": _COMPONENTS[array.dtype.str[1:]],
            "count": len(array),
            "type": _TYPES[rows.shape[1]],
        }
        return self.add("accessors", **(fields | record))

    def primitive(self, position=TRIANGLE, indices=None, **extra):
        """Returns a primitive; attributes are given by their lower-case names."""
        attributes = {"POSITION": self.accessor(position)}
        for name in ("normal", "texcoord_0", "texcoord_1", "joints_0", "weights_0"):
            if name in extra:
                attributes[name.upper()] = self.accessor(extra.pop(name))
        result = {"attributes": attributes, **extra}
        if indices is not None:
            result["indices"] = self.accessor(indices)
        return result

    def mesh(self, position=TRIANGLE, indices=None, **extra):
        """Appends a mesh with one primitive."""
        return self.add(
            "meshes", primitives=[self.primitive(position, indices, **extra)]
        )

    def node(self, **record):
        return self.add("nodes", **record)

    def animate(self, node, path, times, values, interpolation="LINEAR"):
        """Appends an animation with one channel."""
        sampler = {
            "input": self.accessor(np.array(times, np.float32)),
            "output": self.accessor(np.array(values, np.float32)),
            "interpolation": interpolation,
        }
        channel = {"sampler": 0, "target": {"node": node, "path": path}}
        return self.add("animations", samplers=[sampler], channels=[channel])

    def image(self, image, kind="PNG"):
        """Appends an embedded image, given as a Pillow image or as its bytes."""
        data = image if isinstance(image, bytes) else encode(image, kind)
        return self.add(
            "images", bufferView=self.view(data), mimeType=f"image/{kind.lower()}"
        )

    def glb(self, path):
        """Writes a binary file and returns its path."""
        return write_bytes(path, self.glb_bytes())

    def glb_bytes(self):
        doc = self._with_buffer({})
        chunks = [(b"JSON", json.dumps(doc).encode(), b" ")]
        if self.data:
            chunks.append((b"BIN\0", bytes(self.data), b"\0"))
        body = b""
        for kind, data, pad in chunks:
            data += pad * (-len(data) % 4)
            body += struct.pack("<I", len(data)) + kind + data
        return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body

    def gltf(self, path, uri=None):
        """Writes a JSON file; its buffer is inline, or in the file that `uri` names."""
        path = Path(path)
        if uri is None:
            inline = base64.b64encode(bytes(self.data)).decode()
            doc = self._with_buffer(
                {"uri": f"data:application/octet-stream;base64,{inline}"}
            )
        else:
            write_bytes(path.parent / uri, bytes(self.data))
            doc = self._with_buffer({"uri": uri})
        return write_bytes(path, json.dumps(doc).encode())

    def _with_buffer(self, fields):
        if not self.data or "buffers" in self.doc:
            return self.doc
        return self.doc | {"buffers": [{"byteLength": len(self.data), **fields}]}


def encode(image, kind="PNG"):
    out = io.BytesIO()
    image.save(out, kind)
    return out.getvalue()


def solid(color, size=(2, 2), mode="RGBA"):
    return Image.new(mode, size, color)


def write_bytes(path, data):
    Path(path).write_bytes(data)
    return Path(path)


def triangle_scene():
    """Returns a writer with one node that shows one triangle."""
    writer = Writer()
    writer.node(mesh=writer.mesh())
    return writer


def ball(path, color=(200, 120, 40, 255)):
    """Writes a small textured sphere, and returns where."""
    writer = Writer()
    writer.add("textures", source=writer.image(solid(color, (4, 4))))
    writer.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    corners = np.float32(tiny.sphere(6, 9, 0.8).position).reshape(-1, 3)
    uv = np.ascontiguousarray(corners[:, :2])
    writer.node(mesh=writer.mesh(corners, material=0, texcoord_0=uv))
    return writer.glb(path)
