"""The outer layer of a glTF file: JSON, the binary chunk, buffers and URIs.

Everything read here comes from a file that nobody vouches for, so every length is
compared with what is really there before it is used, and every URI must stay inside
the scene's own folder.
"""

import base64
import binascii
import json
import re
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ataa_jax.errors import InputError

SUPPORTED_EXTENSIONS = frozenset(
    {
        "KHR_lights_punctual",
        "KHR_texture_transform",
        "KHR_materials_emissive_strength",
        "KHR_materials_transmission",
        "KHR_mesh_quantization",
    }
)
# What to do about a required extension that is not read.
ADVICE = {
    "KHR_draco_mesh_compression": "re-export without Draco compression",
    "EXT_meshopt_compression": "re-export without meshopt compression",
    "KHR_meshopt_compression": "re-export without meshopt compression",
    "KHR_texture_basisu": "re-export with PNG or JPEG textures",
    "EXT_texture_webp": "re-export with PNG or JPEG textures",
    "EXT_texture_avif": "re-export with PNG or JPEG textures",
    "MSFT_texture_dds": "re-export with PNG or JPEG textures",
    "KHR_materials_pbrSpecularGlossiness": "re-export as metallic-roughness",
}
MAX_INTEGER = 1 << 53  # what JSON readers agree on

_MAGIC = b"glTF"
_CHUNK_JSON = 0x4E4F534A
_CHUNK_BIN = 0x004E4942
_NO_DEFAULT = object()
_ADDRESS = re.compile(r"[a-zA-Z][a-zA-Z0-9+.-]+:|//")  # a scheme, or a host


@dataclass
class Container:
    """A glTF document with its buffers, and the warnings that reading it raised."""

    path: Path
    json: dict[str, Any]
    binary: bytes | None  # the GLB's binary chunk
    warnings: list[str] = field(default_factory=list)
    _buffers: dict[int, bytes] = field(default_factory=dict)
    _items: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def fail(self, message: str) -> InputError:
        """Returns the error for this file; `message` is the rest of the sentence."""
        return InputError(f"{self.path}: {message}")

    def warn(self, message: str) -> None:
        """Keeps a warning, once."""
        if message not in self.warnings:
            self.warnings.append(message)

    def items(self, name: str) -> list[dict[str, Any]]:
        """Returns a top-level array of the document; absent: empty."""
        if name not in self._items:
            self._items[name] = self.records(self.json, name, "the file")
        return self._items[name]

    def records(
        self, record: dict[str, Any], key: str, where: str
    ) -> list[dict[str, Any]]:
        """Returns an array of objects; absent: empty."""
        found = self.array(record, key, where)
        for index, item in enumerate(found):
            if not isinstance(item, dict):
                raise self.fail(
                    f"{where}.{key}[{index}] must be an object; re-export the file"
                )
        return found

    def item(self, name: str, index: Any, user: str) -> dict[str, Any]:
        """Returns ``name[index]``; `user` is the place in the file that asked."""
        found = self.items(name)
        self.check_index(index, len(found), f"{user} refers to {name}[{short(index)}]")
        return found[index]

    def check_index(self, index: Any, count: int, what: str) -> int:
        """Returns `index` if it is an integer in [0, count)."""
        if isinstance(index, bool) or not isinstance(index, int):
            raise self.fail(
                f"{what}, but an index must be an integer; re-export the file"
            )
        if not 0 <= index < count:
            raise self.fail(
                f"{what}, but there are only {count}; re-export the file"
                if count
                else f"{what}, but there are none; re-export the file"
            )
        return index

    def integer(
        self, record: dict[str, Any], key: str, where: str, default: Any = _NO_DEFAULT
    ) -> int:
        """Returns a non-negative integer property."""
        value = record.get(key, default)
        if value is _NO_DEFAULT:
            raise self.fail(f"{where} lacks `{key}`; re-export the file")
        if (
            isinstance(value, bool)
            or not isinstance(value, int)
            or not 0 <= value < MAX_INTEGER
        ):
            raise self.fail(
                f"{where}.{key} is {short(value)}, but must be a non-negative "
                "integer; re-export the file"
            )
        return value

    def number(
        self, record: dict[str, Any], key: str, where: str, default: Any = _NO_DEFAULT
    ) -> float:
        """Returns a finite number."""
        value = record.get(key, default)
        if value is _NO_DEFAULT:
            raise self.fail(f"{where} lacks `{key}`; re-export the file")
        if not _is_finite(value):
            raise self.fail(
                f"{where}.{key} is {short(value)}, but must be a finite number; "
                "correct it or re-export the file"
            )
        return float(value)

    def numbers(
        self,
        record: dict[str, Any],
        key: str,
        count: int,
        where: str,
        default: tuple[float, ...],
    ) -> tuple[float, ...]:
        """Returns `count` finite numbers."""
        if key not in record:
            return default
        value = record[key]
        if (
            not isinstance(value, list)
            or len(value) != count
            or not all(_is_finite(v) for v in value)
        ):
            raise self.fail(
                f"{where}.{key} is {short(value)}, but must be {count} finite "
                "numbers; correct it or re-export the file"
            )
        return tuple(float(v) for v in value)

    def string(
        self, record: dict[str, Any], key: str, where: str, default: str = ""
    ) -> str:
        """Returns a text property."""
        value = record.get(key, default)
        if not isinstance(value, str):
            raise self.fail(
                f"{where}.{key} is {short(value)}, but must be text; re-export the file"
            )
        # A lone surrogate is legal JSON, but cannot be printed.
        return value.encode("utf-8", "replace").decode()

    def array(self, record: dict[str, Any], key: str, where: str) -> list[Any]:
        """Returns an array property; absent: empty."""
        value = record.get(key, [])
        if not isinstance(value, list):
            raise self.fail(
                f"{where}.{key} is {short(value)}, but must be an array; re-export "
                "the file"
            )
        return value

    def table(self, record: dict[str, Any], key: str, where: str) -> dict[str, Any]:
        """Returns an object property; absent: empty."""
        value = record.get(key, {})
        if not isinstance(value, dict):
            raise self.fail(
                f"{where}.{key} is {short(value)}, but must be an object; re-export "
                "the file"
            )
        return value

    def extension(self, record: dict[str, Any], name: str, where: str) -> dict | None:
        """Returns an extension's object, or None where it is absent."""
        found = self.table(record, "extensions", where)
        if name not in found:
            return None
        return self.table(found, name, f"{where}.extensions")

    def buffer(self, index: Any, user: str) -> bytes:
        """Returns a buffer's bytes, at least as many as it declares."""
        record = self.item("buffers", index, user)
        if index not in self._buffers:
            where = f"buffers[{index}]"
            length = self.integer(record, "byteLength", where)
            if "uri" in record:
                data = self.fetch(self.string(record, "uri", where), where)
            elif index == 0 and self.binary is not None:
                data = self.binary
            else:
                raise self.fail(
                    f"{where} has no `uri` and there is no binary chunk for it; "
                    "re-export the file"
                )
            if len(data) < length:
                raise self.fail(
                    f"{where} should hold {length} bytes but only {len(data)} are "
                    "there; the file is cut short, copy or export it again"
                )
            self._buffers[index] = data
        return self._buffers[index]

    def view(self, index: Any, user: str) -> tuple[memoryview, int]:
        """Returns a buffer view's bytes and its stride (0: tightly packed)."""
        record = self.item("bufferViews", index, user)
        where = f"bufferViews[{index}]"
        data = self.buffer(record.get("buffer"), where)
        offset = self.integer(record, "byteOffset", where, 0)
        length = self.integer(record, "byteLength", where)
        stride = self.integer(record, "byteStride", where, 0)
        if offset + length > len(data):
            raise self.fail(
                f"{where} ends at byte {offset + length}, beyond the {len(data)} of "
                "its buffer; the file is damaged, export it again"
            )
        return memoryview(data)[offset : offset + length], stride

    def fetch(self, uri: str, where: str) -> bytes:
        """Returns what a URI names: inline data, or a file in the scene's folder."""
        if uri[:5].lower() == "data:":
            return self._inline(uri, where)
        target = self._local(uri, where)
        try:
            if target.exists() and not target.is_file():
                raise ValueError("not a regular file")
            return target.read_bytes()
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise self.fail(
                f"{where} names the file {short(uri)}, which cannot be read "
                f"({reason}); put it back beside the scene"
            ) from None

    def _inline(self, uri: str, where: str) -> bytes:
        head, comma, body = uri.partition(",")
        if not comma or not head.lower().endswith(";base64"):
            raise self.fail(
                f"{where} has a data URI that is not base64; re-export the file"
            )
        try:
            return base64.b64decode(unquote(body), validate=True)
        except (binascii.Error, ValueError):
            raise self.fail(
                f"{where} has a data URI with bad base64; re-export the file"
            ) from None

    def _local(self, uri: str, where: str) -> Path:
        if _ADDRESS.match(uri):
            raise self.fail(
                f"{where} names the network address {short(uri)}, which is never "
                "fetched; download it beside the scene and name it by its file name"
            )
        name = unquote(uri)
        outside = self.fail(
            f"{where} names {short(uri)}, outside the scene's own folder; copy the "
            "file into that folder and name it relative to the scene"
        )
        if not name or "\0" in name:
            raise outside
        try:
            folder = self.path.resolve().parent
            target = (folder / name).resolve()
        except (OSError, RuntimeError, ValueError):
            raise outside from None
        if not target.is_relative_to(folder):
            raise outside
        return target


def short(value: Any) -> str:
    """Returns a value as an error message quotes it."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _is_finite(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 1e300  # false for NaN too; beyond that, products overflow


def open_container(path: str | Path) -> Container:
    """Reads a ``.glb`` or ``.gltf`` file's outer layer and checks its version.

    Raises:
        InputError: the file is missing, damaged, not glTF 2.0, or needs an extension
            that is not supported.
    """
    path = Path(path)
    data = _read(path)
    if data[:4] == _MAGIC:
        text, binary = _split_glb(path, data)
    else:
        text, binary = data, None
        if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
            raise InputError(
                f"{path}: is neither a binary (.glb) nor a JSON (.gltf) glTF file; "
                "give a glTF 2.0 file"
            )
    container = Container(path, _parse(path, text), binary)
    _check_asset(container)
    return container


def _read(path: Path) -> bytes:
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give a .glb or .gltf file")
        if path.exists() and not path.is_file():
            raise InputError(
                f"{path}: is not a regular file; give a .glb or .gltf file"
            )
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(
            f"{path}: no such file; give the path of a .glb or .gltf file"
        ) from None
    except (OSError, ValueError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"{path}: cannot be read ({reason}); give the path of a readable .glb or "
            ".gltf file"
        ) from None


def _split_glb(path: Path, data: bytes) -> tuple[bytes, bytes | None]:
    """Returns the JSON text and the binary chunk of a GLB."""
    if len(data) < 12:
        raise InputError(
            f"{path}: ends within the glTF header, after {len(data)} bytes; copy or "
            "export it again"
        )
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        raise InputError(
            f"{path}: is binary glTF version {version}, but version 2 is expected; "
            "convert it to glTF 2.0"
        )
    if length > len(data):
        raise InputError(
            f"{path}: declares {length} bytes but holds {len(data)}; the file is cut "
            "short, copy or export it again"
        )
    chunks: list[tuple[int, bytes]] = []
    at = 12
    while at < length:
        size, kind = (
            struct.unpack_from("<II", data, at) if at + 8 <= length else (-1, 0)
        )
        if size < 0 or at + 8 + size > length:
            raise InputError(
                f"{path}: the chunk at byte {at} runs past the end of the file "
                f"({length} bytes); the file is damaged, export it again"
            )
        chunks.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not chunks or chunks[0][0] != _CHUNK_JSON:
        raise InputError(
            f"{path}: does not begin with a JSON chunk; the file is damaged, export it "
            "again"
        )
    binary = next((body for kind, body in chunks[1:] if kind == _CHUNK_BIN), None)
    return chunks[0][1], binary


def _parse(path: Path, text: bytes) -> dict[str, Any]:
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: the JSON text is not UTF-8 (byte {error.start}); save it as UTF-8"
        ) from None
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{path}: the JSON text does not parse ({error}); correct it or export the "
            "file again"
        ) from None
    if not isinstance(document, dict):
        raise InputError(f"{path}: the JSON text is not an object; give a glTF file")
    return document


def _check_asset(container: Container) -> None:
    asset = container.json.get("asset")
    if not isinstance(asset, dict) or "version" not in asset:
        raise container.fail(
            "has no `asset.version`, so it is not glTF; give a glTF 2.0 file"
        )
    version = container.string(asset, "version", "asset")
    if version.split(".")[0] != "2":
        raise container.fail(
            f"is glTF version {short(version)}, but 2.0 is expected; convert it to "
            "glTF 2.0"
        )
    for name in _names(container, "extensionsRequired"):
        if name not in SUPPORTED_EXTENSIONS:
            advice = ADVICE.get(name, "re-export without it")
            raise container.fail(
                f"requires the extension {short(name)}, which is not supported; "
                f"{advice}"
            )
    ignored = sorted(set(_names(container, "extensionsUsed")) - SUPPORTED_EXTENSIONS)
    if ignored:
        container.warn(f"ignored the extensions {', '.join(ignored)}")


def _names(container: Container, key: str) -> list[str]:
    found = container.array(container.json, key, "the file")
    if not all(isinstance(name, str) for name in found):
        raise container.fail(f"`{key}` must list names; re-export the file")
    return [container.string({"name": name}, "name", key) for name in found]
