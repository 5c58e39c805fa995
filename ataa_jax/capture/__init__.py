"""Frames that an engine rendered, read in the place of a scene (the paper's Figure 2).

Everything after the raster stage takes a colour image and a G-buffer, whoever made
them. Three layouts are read; `load` tells them apart:

    plain      `capture.toml` and one EXR a frame with named channels: this package's
    nss        Arm's Neural Super Sampling data set: `NNNN.json`, `x1/color/…`
    blender    multilayer EXRs, with `capture.toml` as `experiments/blender_capture.py`
               writes it

What no capture has is a ray tracer: images of 2, 4 or 8 samples a pixel stand in for
the traced colours, or the reference where there are none, and every output says so.
"""

from pathlib import Path

from ataa_jax.capture import blender, fields, nss, plain
from ataa_jax.capture.record import Capture
from ataa_jax.capture.world import render
from ataa_jax.errors import InputError

write = plain.write

__all__ = ["Capture", "load", "render", "write"]


def load(path: str | Path) -> Capture:
    """Reads a capture's metadata, in whichever layout.

    Args:
        path: the capture's folder, or one sequence's `NNNN.json` of an NSS data set,
            of which a folder stands for the first.

    Raises:
        InputError: no layout fits, or the metadata is damaged.
    """
    place = Path(path)
    if place.suffix == ".json":
        return nss.load(place)
    if not place.is_dir():
        raise InputError(f"{place} is no folder; give the folder of a capture")
    if (place / plain.NAME).is_file():
        table = fields.read_toml(place / plain.NAME)
        if table.table("capture").value.get("layout") == "blender":
            return blender.load(place, table)
        return plain.load(place, table)
    if found := nss.sequences(place):
        return nss.load(found[0])
    files = sorted(place.glob("*.exr"))
    if files and blender.channels(files[0]) is not None:
        return blender.load_bare(place, files)
    raise InputError(
        f"{place} is a folder; give the path of a file of a scene, or a capture: it "
        f"has neither {plain.NAME}, nor NNNN.json of "
        "the NSS layout, nor Blender's multilayer EXRs"
    )
