"""OpenEXR files of foreign origin: looked at before they are decoded, then read.

The header is parsed here, byte by byte and with limits, so that a file which promises
more pixels, channels or parts than any frame has is refused before anything of that
size is allocated. Only then does OpenEXR decode it.
"""

import os
import struct
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ataa_jax.errors import InputError

MAX_SIDE = 16384
# our choice: 4K with all of Blender's passes has 8.3 million × 30 values, half a
# gigabyte as half floats.
MAX_VALUES = 1 << 28
MAX_CHANNELS = 256
MAX_PARTS = 64
_MAX_HEADER = 1 << 20
# our choice: DEFLATE packs at most 1032 : 1, and constant blocks of the lossy codecs a
# little more; beyond, the header promises what the file cannot hold.
_MAX_RATIO = 4096
_MAGIC = 20000630
_BYTES = {0: 4, 1: 2, 2: 4}  # UINT, HALF, FLOAT


@dataclass(frozen=True)
class Part:
    """What one part's header promises."""

    name: str
    size: tuple[int, int]  # height, width
    channels: tuple[str, ...]
    value_bytes: int  # of one pixel


class _DamagedError(Exception):
    """Says what is wrong with a header."""


def look(file: Path) -> list[Part]:
    """Reads a file's header alone.

    Raises:
        InputError: no OpenEXR file, damaged, or larger than any frame.
    """
    if file.exists() and not file.is_file():  # a pipe would wait for ever
        raise InputError(f"{file} is no regular file")
    try:
        with file.open("rb") as stream:
            data = stream.read(_MAX_HEADER)
            length = os.fstat(stream.fileno()).st_size
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror})") from None
    try:
        parts = _parse(data)
    except (_DamagedError, struct.error, IndexError) as error:
        reason = (
            str(error) if isinstance(error, _DamagedError) else "its header is cut off"
        )
        raise InputError(f"{file} is no usable OpenEXR file: {reason}") from None
    _refuse_large(file, parts, length)
    return parts


def _refuse_large(file: Path, parts: list[Part], length: int) -> None:
    channels = sum(len(part.channels) for part in parts)
    values = sum(p.size[0] * p.size[1] * len(p.channels) for p in parts)
    promised = sum(p.size[0] * p.size[1] * p.value_bytes for p in parts)
    if channels > MAX_CHANNELS or values > MAX_VALUES:
        raise InputError(
            f"{file} holds {channels} channels and {values:,} values; at most "
            f"{MAX_CHANNELS} and {MAX_VALUES:,} are read"
        )
    if promised > _MAX_RATIO * (length + 4096):
        raise InputError(
            f"{file} promises {promised:,} bytes of pixels in a file of {length:,}; "
            "it is damaged"
        )


def _parse(data: bytes) -> list[Part]:
    magic, version = struct.unpack_from("<ii", data, 0)
    if magic != _MAGIC:
        raise _DamagedError("it does not begin as one")
    if version & 0xFF != 2 or version & 0x800:
        raise _DamagedError("deep images and other versions than 2 are not read")
    multiple = bool(version & 0x1000)
    at, parts = 8, []
    while len(parts) <= MAX_PARTS:
        attributes, at = _attributes(data, at)
        if not attributes and multiple:
            break
        parts.append(_part(attributes))
        if not multiple:
            break
    else:
        raise _DamagedError(f"it has more than {MAX_PARTS} parts")
    if not parts:
        raise _DamagedError("it has no part")
    return parts


def _attributes(data: bytes, at: int) -> tuple[dict[str, bytes], int]:
    """Returns one header's attributes, and where it ends."""
    found: dict[str, bytes] = {}
    while data[at] != 0:
        name, at = _text(data, at)
        _, at = _text(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        at += 4
        if size < 0 or at + size > len(data):
            raise _DamagedError(f"its attribute '{name[:40]}' is cut off or too long")
        found[name] = data[at : at + size]
        at += size
    return found, at + 1


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at, at + 256)
    if end < 0:
        raise _DamagedError("a name in its header does not end")
    return data[at:end].decode("utf-8", "replace"), end + 1


def _part(attributes: Mapping[str, bytes]) -> Part:
    for name in ("channels", "dataWindow", "displayWindow", "compression"):
        if name not in attributes:
            raise _DamagedError(f"its header has no '{name}'")
    window = struct.unpack_from("<4i", attributes["dataWindow"])
    if window != struct.unpack_from("<4i", attributes["displayWindow"]):
        raise _DamagedError(
            "its data window is not its display window; write whole frames"
        )
    width, height = window[2] - window[0] + 1, window[3] - window[1] + 1
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise _DamagedError(
            f"it is {width}×{height} pixels; 1 to {MAX_SIDE} a side can be read"
        )
    kind = attributes.get("type", b"scanlineimage").rstrip(b"\0")
    if kind not in (b"scanlineimage", b"tiledimage"):
        raise _DamagedError(
            f"it holds a {kind[:20].decode('ascii', 'replace')}, no image"
        )
    names, total = [], 0
    data, at = attributes["channels"], 0
    while data[at] != 0:
        name, at = _text(data, at)
        pixel, _, step_x, step_y = struct.unpack_from("<iB3x2i", data, at)
        at += 16
        if pixel not in _BYTES:
            raise _DamagedError(f"channel '{name[:40]}' has the unknown type {pixel}")
        if (step_x, step_y) != (1, 1):
            raise _DamagedError(f"channel '{name[:40]}' is subsampled")
        names.append(name)
        total += _BYTES[pixel]
    if not names:
        raise _DamagedError("it has no channel")
    part = attributes.get("name", b"").rstrip(b"\0").decode("utf-8", "replace")
    return Part(part, (height, width), tuple(names), total)


def read(file: Path) -> dict[str, np.ndarray]:
    """Reads every channel of every part.

    Args:
        file: an OpenEXR file of scan lines or tiles.

    Returns:
        Channels by name, (h, w), as stored: float16, float32 or uint32. Where a second
        part repeats a name, its own name is put before it with a dot.

    Raises:
        InputError: see `look`, or the pixels are damaged.
    """
    parts = look(file)
    sizes = {part.size for part in parts}
    if len(sizes) != 1:
        raise InputError(f"{file} has parts of different sizes; write one size a frame")
    import OpenEXR

    found: dict[str, np.ndarray] = {}
    try:
        with _silence(), OpenEXR.File(str(file), separate_channels=True) as image:
            for index in range(len(parts)):
                for name, channel in image.channels(index).items():
                    part = parts[index].name
                    key = f"{part}.{name}" if name in found and part else name
                    found[key] = np.asarray(channel.pixels)
    except (RuntimeError, ValueError, TypeError, OSError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{file} is damaged: {reason}") from None
    size = next(iter(sizes))
    for name, pixels in found.items():
        if pixels.shape != size:
            raise InputError(f"{file} is damaged: channel '{name}' has no whole image")
    if not found:
        raise InputError(f"{file} is damaged: no channel can be decoded")
    return found


_SILENT = threading.Lock()


@contextmanager
def _silence() -> Iterator[None]:
    """Keeps the decoder's own words off the terminal: the error raised says them."""
    with _SILENT:
        sys.stdout.flush()
        sys.stderr.flush()
        saved = [os.dup(1), os.dup(2)]
        try:
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), 1)
                os.dup2(nowhere.fileno(), 2)
            yield
        finally:
            for number, old in zip((1, 2), saved, strict=True):
                os.dup2(old, number)
                os.close(old)


def write(
    file: Path,
    channels: Mapping[str, np.ndarray],
    *,
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Writes named channels, ZIP-compressed, each in its own type.

    Args:
        file: where to; its folder is made.
        channels: (h, w) float16, float32 or uint32 by name.
        attributes: text for the header.
    """
    import OpenEXR

    from ataa_jax import files

    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        **(attributes or {}),
    }
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    with files.atomic(file) as part, OpenEXR.File(header, planes) as image:
        image.write(str(part))


def inside(folder: Path, name: str) -> Path:
    """Returns a file of a capture's folder by its relative name.

    Raises:
        InputError: the name leads out of the folder, also through a link.
    """
    file = folder / name
    try:
        held = file.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        held = False
    if not held:
        raise InputError(
            f"capture {folder} names the file {name[:80]!r}, which lies outside its "
            "folder; give names relative to the folder"
        )
    return file
