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

from ataa_jax.capture import plain
from ataa_jax.capture.record import Capture
from ataa_jax.capture.world import render
from ataa_jax.errors import InputError

write = plain.write

__all__ = ["Capture", "is_capture", "load", "render", "write"]


def is_capture(path: str | Path) -> bool:
    """Returns whether a command's argument names a captured sequence, not a scene."""
    return Path(path).is_dir()


def load(path: str | Path) -> Capture:
    """Reads a capture's metadata, in whichever layout.

    Raises:
        InputError: no layout fits, or the metadata is damaged.
    """
    folder = Path(path)
    if (folder / plain.NAME).is_file():
        return plain.load(folder)
    raise InputError(
        f"folder {folder} is no capture: it has neither {plain.NAME}, nor NNNN.json of "
        "the NSS layout, nor Blender's multilayer EXRs"
    )
