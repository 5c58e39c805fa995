"""Mutated scene files: each a sound file with one thing wrong, drawn by seed.

A mutation works on a `Draft`, a document with its binary data, before it is written, or
on the bytes of the written file. Most files are binary (.glb); some are JSON with files
beside them (.gltf).
"""

import copy
import io
import json
import random
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.gltf_writer import Writer, write_bytes

JUNK = (
    *(None, True, [], {}, [[]], "", "\0", "x" * 70000, "−1", "1e9", "../x"),
    *(-1, 0, 1, 7, 255, 65536, 2**31 - 1, 2**31, 2**32, 2**63, 10**18, -(2**31)),
    *(0.5, -0.0, 1e-45, 1e30, 1e308, float("nan"), float("inf"), float("-inf")),
)
WORDS = (0x7FC00000, 0x7F800000, 0xFF800000, 0x7F7FFFFF, 0x00000001, 0xFFFFFFFF, 0)


@dataclass
class Draft:
    """A file about to be written."""

    doc: dict[str, Any]
    data: bytearray
    files: dict[str, bytes] = field(default_factory=dict)  # beside a .gltf

    def leaves(self) -> list[tuple[Any, Any]]:
        """Lists every (container, key) of the document, in order."""
        return list(_leaves(self.doc))

    def records(self, key: str) -> list[dict[str, Any]]:
        """Returns a top-level array's objects."""
        return [each for each in self.doc.get(key, []) if isinstance(each, dict)]


def _leaves(value: Any) -> Iterator[tuple[Any, Any]]:
    keys = value if isinstance(value, dict) else range(len(value))
    for key in keys:
        yield value, key
        if isinstance(value[key], dict | list):
            yield from _leaves(value[key])


Edit = Callable[[random.Random, Draft, str], None]
Spoil = Callable[[random.Random, bytes], bytes]


def _count(draw: random.Random, draft: Draft, bait: str) -> None:
    record = draw.choice(draft.records("accessors"))
    record["count"] = draw.choice((0, -1, 2, 10**9, 2**31, 10**18, 1.5, "3", None))


def _component(draw: random.Random, draft: Draft, bait: str) -> None:
    record = draw.choice(draft.records("accessors"))
    record["componentType"] = draw.choice((5120, 5121, 5122, 5123, 5124, 5125, 5126, 0))
    if draw.random() < 0.5:
        record["type"] = draw.choice(("SCALAR", "VEC2", "VEC4", "MAT2", "MAT4", "VEC9"))


def _view(draw: random.Random, draft: Draft, bait: str) -> None:
    key = draw.choice(("byteLength", "byteOffset", "byteStride", "buffer"))
    junk = (-1, 0, 1, 3, 252, 255, 10**9, 2**40, "0", None)
    draw.choice(draft.records("bufferViews"))[key] = draw.choice(junk)


def _index(draw: random.Random, draft: Draft, bait: str) -> None:
    found = [
        (place, key)
        for place, key in draft.leaves()
        if isinstance(place[key], int) and not isinstance(place[key], bool)
    ]
    place, key = draw.choice(found)
    place[key] = draw.choice((-1, place[key] + 1, len(found), 10**9, 2**63, 0))


def _leaf(draw: random.Random, draft: Draft, bait: str) -> None:
    place, key = draw.choice(draft.leaves())
    place[key] = copy.deepcopy(draw.choice(JUNK))


def _drop(draw: random.Random, draft: Draft, bait: str) -> None:
    place, key = draw.choice(draft.leaves())
    del place[key]


def _cycle(draw: random.Random, draft: Draft, bait: str) -> None:
    nodes = draft.records("nodes")
    index = draw.randrange(len(nodes))
    other = draw.choice((index, draw.randrange(len(nodes))))
    nodes[index].setdefault("children", []).append(other)
    nodes[other].setdefault("children", []).append(index)


def _pose(draw: random.Random, draft: Draft, bait: str) -> None:
    node = draw.choice(draft.records("nodes"))
    numbers = (0, -1, 1e-30, 1e30, 1e39, float("nan"))
    key, size = draw.choice(
        (
            ("matrix", 16),
            ("scale", 3),
            ("rotation", 4),
            ("translation", 3),
            ("scale", 2),
        )
    )
    if key == "matrix":
        for other in ("scale", "rotation", "translation"):
            node.pop(other, None)
    else:
        node.pop("matrix", None)
    node[key] = [draw.choice(numbers) for _ in range(size)]
    if draw.random() < 0.3:
        node[key] = [draw.choice(numbers)] * size


def _outside(draw: random.Random, draft: Draft, bait: str) -> None:
    where = draw.choice(
        (
            *(bait, f"file://{bait}", f"../{Path(bait).name}", "..\\secret.png"),
            *(f"%2e%2e/{Path(bait).name}", f"a/../../{Path(bait).name}", "/dev/zero"),
            *("http://127.0.0.1:9/a.png", "//127.0.0.1/a.png", "ftp://127.0.0.1/a"),
            *("data:image/png;base64,####", "data:,", "data:image/png;base64,"),
            *("\0", "a\nb", "x" * 5000, "", ".", "nothing.png", "CON", "~/a.png"),
        )
    )
    if draw.random() < 0.5 and draft.records("images"):
        image = draw.choice(draft.records("images"))
        image.pop("bufferView", None)
        image["uri"] = where
    else:
        draft.doc["buffers"] = [{"byteLength": len(draft.data), "uri": where}]


def _png(width: int, height: int, body: bytes, extra: bytes = b"") -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data
            + struct.pack(">I", zlib.crc32(kind + data))
        )  # fmt: skip

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra
        + chunk(b"IDAT", body) + chunk(b"IEND", b"")
    )  # fmt: skip


def _bomb(draw: random.Random, draft: Draft, bait: str) -> None:
    if not draft.records("images"):
        return
    zeros = zlib.compress(bytes(1 << 22), 9)
    text = b"Comment\0\0" + zlib.compress(bytes(1 << 26), 9)
    comment = struct.pack(">I", len(text)) + b"zTXt" + text
    comment += struct.pack(">I", zlib.crc32(b"zTXt" + text))
    jpeg = (
        b"\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff\x03\x01\x11\0\x02\x11\0\x03\x11\0"
    )
    data = draw.choice(
        (
            _png(40000, 25000, zeros),
            _png(2**31 - 1, 1, zeros),
            _png(1, 2**31 - 1, zeros),
            _png(0, 4, zeros),
            _png(2000, 2000, zeros),
            _png(4, 4, zlib.compress(bytes(20)), comment),
            _png(4, 4, b"not deflate"),
            jpeg + b"\xff\xd9",
            b"GIF89a\xff\xff\xff\xff\0\0\0;",
            b"BM" + bytes(60),
            b"",
            bait.encode(),
        )
    )
    image = draw.choice(draft.records("images"))
    image.pop("uri", None)
    draft.data += bytes(-len(draft.data) % 4)
    start = len(draft.data)
    draft.data += data
    views = draft.doc["bufferViews"]
    views.append({"buffer": 0, "byteOffset": start, "byteLength": len(data)})
    image["bufferView"] = len(views) - 1


def _words(draw: random.Random, draft: Draft, bait: str) -> None:
    for _ in range(draw.choice((1, 3, 30, 300))):
        at = 4 * draw.randrange(len(draft.data) // 4)
        draft.data[at : at + 4] = struct.pack("<I", draw.choice(WORDS))


def _optics(draw: random.Random, draft: Draft, bait: str) -> None:
    numbers = (0, -1, 1e-30, 1e30, float("nan"), 3.2, "1", None, [])
    lights = draft.doc.get("extensions", {}).get("KHR_lights_punctual", {})
    places = [
        *(each.get("perspective", each) for each in draft.records("cameras")),
        *lights.get("lights", []),
        *(s for a in draft.records("animations") for s in a.get("samplers", [])),
        *(m.get("pbrMetallicRoughness", m) for m in draft.records("materials")),
        *draft.records("samplers"),
    ]
    place = draw.choice(places)
    if place:
        place[draw.choice(sorted(place))] = draw.choice(numbers)


def _extension(draw: random.Random, draft: Draft, bait: str) -> None:
    names = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "X", "", 3, None)
    draft.doc["extensionsRequired"] = [draw.choice(names)]


def _nest(draw: random.Random, draft: Draft, bait: str) -> None:
    deep: Any = 1
    for _ in range(draw.choice((50, 500))):
        deep = [deep] if draw.random() < 0.5 else {"a": deep}
    draft.doc["extras"] = deep


def _empty(draw: random.Random, draft: Draft, bait: str) -> None:
    key = draw.choice(sorted(draft.doc))
    draft.doc[key] = draw.choice(([], {}, None))


def _truncated(draw: random.Random, data: bytes) -> bytes:
    return data[: draw.randrange(len(data))]


def _flipped(draw: random.Random, data: bytes) -> bytes:
    spoiled = bytearray(data)
    span = len(data) if draw.random() < 0.5 else min(len(data), 4000)
    for _ in range(draw.choice((1, 2, 8, 64))):
        spoiled[draw.randrange(span)] ^= 1 << draw.randrange(8)
    return bytes(spoiled)


def _shuffled(draw: random.Random, data: bytes) -> bytes:
    a, b = sorted(draw.randrange(len(data)) for _ in range(2))
    cut = data[a : min(b, a + draw.choice((1, 4, 1000)))]
    return draw.choice((data[:a] + data[a + len(cut) :], data[:a] + cut + data[a:]))


def _not_text(draw: random.Random, data: bytes) -> bytes:
    at = draw.randrange(20, min(len(data), 4000))
    return (
        data[:at]
        + draw.choice((b"\xff", b"\xc0\xaf", b"\xed\xa0\x80"))
        + data[at + 1 :]
    )


def _header(draw: random.Random, data: bytes) -> bytes:
    at = 4 * draw.randrange(min(5, len(data) // 4))
    number = draw.choice((0, 1, 3, 2**31, 2**32 - 1, len(data) + 4, 0x004E4942))
    return data[:at] + struct.pack("<I", number) + data[at + 4 :]


EDITS: dict[str, Edit] = {
    "oversized count": _count,
    "component type": _component,
    "buffer view": _view,
    "index": _index,
    "any value": _leaf,
    "missing": _drop,
    "cycle": _cycle,
    "pose": _pose,
    "outside": _outside,
    "image bomb": _bomb,
    "numbers": _words,
    "lights, cameras, materials": _optics,
    "extension": _extension,
    "nesting": _nest,
    "empty": _empty,
}
SPOILS: dict[str, Spoil] = {
    "truncated": _truncated,
    "bits flipped": _flipped,
    "bytes moved": _shuffled,
    "not UTF-8": _not_text,
    "header": _header,
}
KINDS = (*EDITS, *SPOILS)


def write(sound: Writer, seed: int, folder: Path, bait: Path) -> tuple[str, Path]:
    """Writes one mutated scene.

    Args:
        sound: the scene to spoil; it is not changed.
        seed: decides everything; kinds take turns.
        folder: where to; empty.
        bait: a file outside of the folder, which no scene may make anyone read.

    Returns:
        What was done, and the file to open.
    """
    draw = random.Random(seed)
    kind = KINDS[seed % len(KINDS)]
    draft = Draft(copy.deepcopy(sound.doc), bytearray(sound.data))
    if kind in EDITS:
        EDITS[kind](draw, draft, str(bait))
    apart = draw.random() < 0.2
    writer = Writer()
    writer.doc, writer.data = draft.doc, draft.data
    if apart:
        file = writer.gltf(folder / "scene.gltf", uri="scene.bin")
        spoiled = draw.choice((file, folder / "scene.bin"))
    else:
        spoiled = file = writer.glb(folder / "scene.glb")
    if kind in SPOILS:
        write_bytes(spoiled, SPOILS[kind](draw, spoiled.read_bytes()))
    return kind, file


def tables(sound: str, seed: int) -> bytes:
    """Returns a TOML file with one thing wrong: parameters, or a camera path."""
    draw = random.Random(seed)
    lines = sound.splitlines()
    at = draw.randrange(len(lines))
    how = draw.randrange(6)
    name = lines[at].partition("=")[0]
    values = (
        *("-1", "nan", "inf", "1e400", "''", "[]", "{}", "true", "[[1, 2], 3]"),
        *("99999999999999999999", '"' + "x" * 70000 + '"', "1979-05-27", "= =", ""),
    )
    if how == 0:
        lines[at] = f"{name} = {draw.choice(values)}"
    elif how == 1:
        del lines[at]
    elif how == 2:
        lines.insert(at, draw.choice(lines))
    elif how == 3:
        lines.insert(at, draw.choice(("[a", "]", "[[[[", "a = " + "[" * 5000, "\0")))
    data = "\n".join(lines).encode()
    if how == 4:
        return _flipped(draw, data)
    if how == 5:
        return draw.choice((_truncated(draw, data), b"\xff\xfe" + data, b""))
    return data


def archive(sound: bytes, seed: int) -> bytes:
    """Returns a cache file (.npz) with one thing wrong."""
    draw = random.Random(seed)
    if seed % 3:
        return draw.choice((_truncated, _flipped, _shuffled))(draw, sound)
    buffer = io.BytesIO()
    # An object array would be a pickle; nothing may load one.
    np.savez(buffer, color=np.array([{"a": json.dumps(seed)}], object))
    return buffer.getvalue()
