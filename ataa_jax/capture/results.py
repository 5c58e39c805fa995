"""What goes back to the engine: antialiased frames and masks, named as the capture's.

    plain, blender   antialiased/FILE.exr, FILE as in `capture.toml`
    nss              x1/antialiased/NNNN/MMMM.exr, beside the data set's x1/color/…

One file a frame: `R G B` linear radiance as shown, `mask.method` (0 FXAA, 1 TAA,
2 ATAA), `mask.hold` (the classification history) and `mask.why` (WHY_* bits), uint32.
The header's `ataa.rays` says what stood in for rays.
"""

from pathlib import Path, PurePosixPath

import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax import segmentation
from ataa_jax.capture import exr
from ataa_jax.capture.record import Capture
from ataa_jax.pipeline import FrameOutput


def name(capture: Capture, frame: int) -> str:
    """Returns the relative name of a frame's result."""
    source = capture.frames[capture.place(frame)].layers["color"].file
    path = PurePosixPath(source.replace("\\", "/"))
    if capture.layout == "nss":  # x1/color/0000/0000.exr
        parts = ["antialiased" if part == "color" else part for part in path.parts]
        return "/".join(parts)
    return f"antialiased/{path}"


def write(
    folder: Path,
    capture: Capture,
    frame: int,
    image: np.ndarray,
    output: FrameOutput | None,
    rays: str,
) -> None:
    """Writes a frame.

    Args:
        folder: the output folder.
        capture: names the file.
        frame: index.
        image: (h, w, 3) sRGB as shown, FXAA's work included.
        output: of the pipeline; None: a method without a mask.
        rays: what stood in for rays.
    """
    decoded = colors.srgb_decode(jnp.asarray(image, jnp.float32))
    linear = np.asarray(colors.inverse_tonemap(decoded))
    exposure = np.float32(capture.frames[capture.place(frame)].exposure)
    planes: dict[str, np.ndarray] = {
        c: linear[..., k] / exposure for k, c in enumerate("RGB")
    }
    if output is not None:
        method, hold = segmentation.unpack_mask(output.segmentation.mask)
        planes["mask.method"] = np.asarray(method).astype(np.uint32)
        planes["mask.hold"] = np.asarray(hold).astype(np.uint32)
        planes["mask.why"] = np.asarray(output.segmentation.why).astype(np.uint32)
    exr.write(folder / name(capture, frame), planes, attributes={"ataa.rays": rays})
