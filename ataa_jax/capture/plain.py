"""The package's own layout: `capture.toml` and one EXR a frame with named channels.

    [capture]                            [[frame]]
    layout = "plain"                     file = "0000.exr"
    size = [160, 90]  # width, height    jitter = [0.1, -0.2]  # px, x right, y down
    fps = 30                             cut = false
    reference_samples = 64               fov_y = 0.9           # radians
    [conventions]                        world_from_view = [ … ]  # 16, row by row
    …                                    near = 0.1  # with device depth; far = inf

Channels: `R G B`, `depth.Z`, `motion.X motion.Y`, and where there are any `motion.V`
(1: the previous position was seen), `reference.R …`, `samples2.R …`, `samples4.R …`,
`samples8.R …`, `center.R …` (one sample at the pixel centre). The keys of
`[conventions]` are the fields of `record.Conventions`. A frame may name other files
for the reference and the samples; their channels are then `R G B`.

Blender's multilayer EXRs use the same `capture.toml`, with `layout = "blender"`.
"""

import math
from collections.abc import Iterable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import get_args

import numpy as np
import tomli_w

from ataa_jax import files
from ataa_jax.capture import exr
from ataa_jax.capture.conventions import (
    CURRENT_MINUS_PREVIOUS,
    PREVIOUS_MINUS_CURRENT,
    SAMPLE_COUNTS,
    Conventions,
    Depth,
    Encoding,
    Frame,
    Layer,
    Pose,
    Unit,
)
from ataa_jax.capture.fields import Table
from ataa_jax.capture.record import Capture
from ataa_jax.errors import InputError

NAME = "capture.toml"
RGB = ("R", "G", "B")
_CHOICES: dict[str, tuple[str, ...]] = {
    "color": get_args(Encoding),
    "average": ("tonemap", "linear"),
    "motion_unit": get_args(Unit),
    "motion_sign": (PREVIOUS_MINUS_CURRENT, CURRENT_MINUS_PREVIOUS),
    "motion_y": ("down", "up"),
    "motion_axes": ("xy", "yx"),
    "depth": get_args(Depth),
    "camera_y": ("up", "down"),
}


def images(prefix: str = "") -> dict[str, tuple[str, ...]]:
    """Returns the layout's channels by kind of image, all in one file."""
    kinds = {
        "color": RGB,
        "depth": ("depth.Z",),
        "motion": ("motion.X", "motion.Y"),
        "motion_valid": ("motion.V",),
    }
    for kind in ("reference", "center", *(f"samples{n}" for n in SAMPLE_COUNTS)):
        kinds[kind] = tuple(f"{kind}.{c}" for c in RGB)
    return {
        kind: tuple(f"{prefix}{name}" for name in names)
        for kind, names in kinds.items()
    }


def load(folder: Path, table: Table) -> Capture:
    """Reads a capture's metadata; images are read when they are asked for.

    Args:
        folder: where it lies.
        table: `capture.toml`.

    Raises:
        InputError: the metadata is damaged, or the first frame lacks an image.
    """
    head = table.table("capture")
    if (layout := head.text("layout", "plain")) != "plain":
        raise InputError(f"{folder / NAME} names the unknown layout '{layout}'")
    entries = table.tables("frame")
    first = exr.look(exr.inside(folder, entries[0].text("file")))
    known = {name for part in first for name in part.channels}
    channels = {
        kind: names
        for kind, names in images().items()
        if kind in ("color", "depth", "motion") or set(names) <= known
    }
    frames = [
        frame(entry, number, channels, RGB) for number, entry in enumerate(entries)
    ]
    return assemble(
        folder, "plain", head, frames, conventions(table, Conventions()), first[0].size
    )


def assemble(
    folder: Path,
    layout: str,
    head: Table,
    frames: list[Frame],
    found: Conventions,
    seen: tuple[int, int],
) -> Capture:
    """Puts a capture together from `[capture]` and its frames.

    Args:
        folder: where it lies.
        layout: plain or blender.
        head: the table `[capture]`.
        frames: every frame.
        found: conventions.
        seen: (height, width) of the first frame's file.
    """
    size = seen
    if head.has("size"):
        width, height = (int(value) for value in head.numbers("size", 2))
        size = (height, width)
        if size != seen:
            raise InputError(
                f"{head.where}: size is {width}×{height} where the first frame's file "
                f"has {seen[1]}×{seen[0]} pixels; write the size of the images"
            )
    held = set(frames[0].layers)
    count = None
    if "reference" in held:
        count = head.integer("reference_samples", 0, 0, 1 << 20)
    return Capture(
        name=head.text("name", folder.resolve().name or "capture"),
        folder=folder,
        layout=layout,
        size=size,
        frames=tuple(frames),
        conventions=found,
        fps=head.number("fps", 30.0, 1e-3, 1e6),
        reference_samples=count,
        sample_counts=tuple(n for n in SAMPLE_COUNTS if f"samples{n}" in held),
        sky_still=layout == "blender",
    )


def conventions(table: Table, defaults: Conventions) -> Conventions:
    """Reads `[conventions]` over a layout's own."""
    given = table.table("conventions")
    known = {field.name for field in fields(Conventions)}
    if unknown := sorted(set(given.value) - known):
        raise InputError(
            f"{given.where} has the unknown key '{unknown[0]}'; known are "
            f"{', '.join(sorted(known))}"
        )
    values: dict[str, object] = {
        name: given.choice(name, "", words)
        for name, words in _CHOICES.items()
        if given.has(name)
    }
    if given.has("motion_jittered"):
        values["motion_jittered"] = given.flag("motion_jittered", None)
    return replace(defaults, **values)  # type: ignore[arg-type]


def frame(
    entry: Table,
    number: int,
    channels: dict[str, tuple[str, ...]],
    apart: tuple[str, ...],
) -> Frame:
    """Reads one `[[frame]]`.

    Args:
        entry: the table.
        number: its place, where it does not number itself.
        channels: what `file` holds, by kind of image.
        apart: the colour channels of an image that has a file of its own.
    """
    file = entry.text("file")
    layers = {kind: Layer(file, names) for kind, names in channels.items()}
    for kind in ("reference", "center", *(f"samples{n}" for n in SAMPLE_COUNTS)):
        if entry.has(kind):
            layers[kind] = Layer(entry.text(kind), apart)
    jitter = None
    if entry.has("jitter"):
        x, y = entry.numbers("jitter", 2)
        jitter = (x, y)
    return Frame(
        number=entry.integer("number", number, -(1 << 31), 1 << 31),
        layers=layers,
        jitter=jitter,
        cut=entry.flag("cut", False),
        pose=_pose(entry),
        near=entry.number("near", 0.1, 1e-12),
        far=_far(entry),
        exposure=entry.number("exposure", 1.0, 1e-12),
    )


def _far(entry: Table) -> float:
    if entry.value.get("far") in (None, math.inf, -1, -1.0):
        return math.inf
    return entry.number("far", None, 1e-12)


def _pose(entry: Table) -> Pose | None:
    if not entry.has("world_from_view"):
        return None
    matrix = np.array(entry.numbers("world_from_view", 16)).reshape(4, 4)
    fov_y = entry.number("fov_y", None, 1e-6, math.pi - 1e-6)
    tan_y = math.tan(fov_y / 2.0)
    if entry.has("fov_x"):
        tan_x = math.tan(entry.number("fov_x", None, 1e-6, math.pi - 1e-6) / 2.0)
    else:
        tan_x = math.nan  # square pixels: the image's size says
    return Pose(matrix, (tan_x, tan_y))


def write(
    folder: Path,
    capture: Capture,
    frames: Iterable[dict[str, np.ndarray]],
    *,
    half: bool = False,
) -> None:
    """Writes a capture in this layout.

    Args:
        folder: where to; files of the same names are replaced.
        capture: metadata; the frames' layers are not read.
        frames: for each frame its images by kind, (h, w, channels), as stored.
        half: colours as 16-bit floats.
    """
    entries = []
    for number, (meta, held) in enumerate(zip(capture.frames, frames, strict=True)):
        name = f"{number:04d}.exr"
        planes: dict[str, np.ndarray] = {}
        for kind, image in held.items():
            small = half and kind not in ("depth", "motion")
            dtype = np.float16 if small else np.float32
            stack = image if image.ndim == 3 else image[..., None]
            for k, channel in enumerate(images()[kind]):
                planes[channel] = stack[..., k].astype(dtype)
        exr.write(folder / name, planes)
        entries.append(_entry(name, number, meta))
    height, width = capture.size
    head = {
        "layout": "plain",
        "name": capture.name,
        "size": [width, height],
        "fps": capture.fps,
    }
    if capture.reference_samples is not None:
        head["reference_samples"] = capture.reference_samples
    told = {k: v for k, v in asdict(capture.conventions).items() if v is not None}
    text = tomli_w.dumps({"capture": head, "conventions": told, "frame": entries})
    files.write_text(folder / NAME, text)


def _entry(name: str, number: int, meta: Frame) -> dict[str, object]:
    entry: dict[str, object] = {"file": name, "cut": meta.cut}
    if meta.number != number:
        entry["number"] = meta.number
    if meta.jitter is not None:
        entry["jitter"] = [float(x) for x in meta.jitter]
    if meta.pose is not None:
        entry["fov_y"] = 2.0 * math.atan(meta.pose.tan_half[1])
        matrix = np.asarray(meta.pose.world_from_view, np.float64)
        entry["world_from_view"] = [float(x) for x in matrix.ravel()]
    if not math.isnan(meta.near):
        entry |= {"near": meta.near, "far": meta.far}
    if meta.exposure != 1.0:
        entry["exposure"] = meta.exposure
    return entry
