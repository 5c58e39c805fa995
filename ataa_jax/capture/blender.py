"""Blender's multilayer EXRs, Cycles or EEVEE: one file a frame with all passes.

Channels are `LAYER.PASS.COMPONENT`. Read are Combined, Depth and Vector (X and Y: where
the point was, previous − current, px, y up); Normal, Object Index and Material Index
are not needed by any stage. Background has no motion vectors in Blender: where the
camera is known, its motion is computed from it.

`capture.toml` as in `plain`, with `layout = "blender"`, gives jitter and camera;
without it a folder of such files is read too, but its jitter is unknown.
"""

from pathlib import Path

from ataa_jax.capture import exr, plain
from ataa_jax.capture.conventions import Conventions, Frame, Layer
from ataa_jax.capture.fields import Table
from ataa_jax.capture.record import Capture
from ataa_jax.errors import InputError

_PASSES: dict[str, tuple[str, tuple[str, ...]]] = {
    "color": ("Combined", ("R", "G", "B")),
    "depth": ("Depth", ("Z",)),
    "motion": ("Vector", ("X", "Y")),
}


def conventions() -> Conventions:
    """Returns what Blender's passes hold."""
    return Conventions(motion_y="up")


def channels(file: Path) -> dict[str, tuple[str, ...]] | None:
    """Returns the names of a file's passes by kind of image, or None.

    Of several view layers the first that has all passes is taken.
    """
    held = {name for part in exr.look(file) for name in part.channels}
    layers = sorted({name.rpartition(".Combined.")[0] for name in held
                     if ".Combined." in name})  # fmt: skip
    for layer in layers:
        found = {
            kind: tuple(f"{layer}.{name}.{part}" for part in parts)
            for kind, (name, parts) in _PASSES.items()
        }
        if all(set(names) <= held for names in found.values()):
            return found
    return None


def load(folder: Path, table: Table) -> Capture:
    """Reads a folder with `capture.toml`.

    Raises:
        InputError: metadata or the first frame's passes are not there.
    """
    entries = table.tables("frame")
    first = exr.inside(folder, entries[0].text("file"))
    names = _needed(first)
    frames = [
        plain.frame(entry, number, names, plain.RGB)
        for number, entry in enumerate(entries)
    ]
    found = plain.conventions(table, conventions())
    size = exr.look(first)[0].size
    head = table.table("capture")
    return plain.assemble(folder, "blender", head, frames, found, size)


def load_bare(folder: Path, files: list[Path]) -> Capture:
    """Reads a folder of multilayer EXRs alone, in the order of their names."""
    names = _needed(files[0])
    frames = [
        Frame(
            number=number,
            layers={kind: Layer(file.name, found) for kind, found in names.items()},
            cut=number == 0,
        )
        for number, file in enumerate(files)
    ]
    head = Table(str(folder), {})
    size = exr.look(files[0])[0].size
    return plain.assemble(folder, "blender", head, frames, conventions(), size)


def _needed(file: Path) -> dict[str, tuple[str, ...]]:
    found = channels(file)
    if found is None:
        raise InputError(
            f"{file} has no view layer with the passes Combined, Depth and Vector; "
            "turn Z and Vector on in the view layer's properties"
        )
    return found
