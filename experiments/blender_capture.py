"""Renders an animated Blender scene as a capture that `ataa run` and `compare` read.

    blender -b file.blend -P experiments/blender_capture.py -- --out capture
    python experiments/blender_capture.py --world scene.npz --out capture   # with bpy

For each frame, by Cycles and a box filter so narrow that every sample lies where the
camera's shift puts it: the jittered frame with all passes, as multilayer EXR; images at
the standard 2, 4 and 8-sample patterns, one at the pixel centre, and an N-sample
reference, each the mean under the tone map x / (1 + max rgb); and `capture.toml`.

`--light-samples` takes more light samples at the same place: what an engine's lights
do not show as noise, Cycles' must not either. `bpy` is a tool of this script alone.
"""

import argparse
import math
import sys
import tempfile
from pathlib import Path

import bpy  # pyright: ignore[reportMissingImports]
import numpy as np

# The jitter and the patterns are the package's own; this module needs NumPy alone.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from ataa_jax import sampling

JITTER_LENGTH = 16


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--world", type=Path, help="of blender_export.py")
    parser.add_argument("--frames", help="A-B, frames of the scene")
    parser.add_argument("--size", help="WxH; the scene's own by default")
    parser.add_argument("--samples", default="2,4,8")
    parser.add_argument("--reference-samples", type=int, default=64)
    parser.add_argument("--light-samples", type=int, default=1)
    parser.add_argument("--half", action="store_true", help="16-bit colours")
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    return parser.parse_args(words)


def main() -> None:
    given = arguments()
    if given.world is not None:
        from blender_world import build

        build(given.world)
    scene = bpy.context.scene
    if given.size:
        width, height = (int(part) for part in given.size.split("x"))
        scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.resolution_percentage = 100
    first, last = scene.frame_start, scene.frame_end
    if given.frames:
        first, last = (int(part) for part in given.frames.split("-"))
    prepare(scene, given)
    given.out.mkdir(parents=True, exist_ok=True)
    counts = [int(part) for part in given.samples.split(",") if part]
    jitter = sampling.halton_jitter(JITTER_LENGTH)
    entries = []
    for index, frame in enumerate(range(first, last + 1)):
        scene.frame_set(frame)
        entries.append(
            capture(scene, given, index, jitter[index % JITTER_LENGTH], counts)
        )
    (given.out / "capture.toml").write_text(metadata(scene, given, entries))


def prepare(scene: "bpy.types.Scene", given: argparse.Namespace) -> None:
    """Sets what makes one sample a pixel, where the camera's shift puts it."""
    scene.render.engine = "CYCLES"
    scene.render.use_motion_blur = False
    scene.render.use_persistent_data = True
    scene.render.use_compositing = False
    scene.render.use_sequencer = False
    cycles = scene.cycles
    cycles.samples = given.light_samples
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 0.01
    for layer in scene.view_layers:
        layer.use = layer == scene.view_layers[0]
    layer = scene.view_layers[0]
    for name in ("z", "vector", "normal", "object_index", "material_index"):
        setattr(layer, f"use_pass_{name}", True)


def capture(
    scene: "bpy.types.Scene",
    given: argparse.Namespace,
    index: int,
    jitter: np.ndarray,
    counts: list[int],
) -> dict[str, object]:
    """Renders one frame; returns its entry of `capture.toml`."""
    name = f"{index:04d}.exr"
    settings = scene.render.image_settings
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "16" if given.half else "32"
    settings.exr_codec = "ZIP"
    shifted(scene, jitter, given.out / name)
    patterns = {"center": np.zeros((1, 2))}
    patterns |= {f"samples{n}": sampling.pattern(n) for n in counts}
    patterns["reference"] = sampling.reference_pattern(given.reference_samples)
    entry: dict[str, object] = {"file": name}
    for kind, offsets in patterns.items():
        if len(offsets):
            entry[kind] = f"{kind}/{name}"
            save(scene, mean(scene, offsets), given.out / kind / name, given.half)
    entry |= {
        "number": index,
        "cut": index == 0,
        "jitter": [float(x) for x in jitter],
        "fov_y": 2.0 * math.atan(tangent(scene)),
        "world_from_view": [
            float(x) for row in scene.camera.matrix_world.normalized() for x in row
        ],
    }
    return entry


def shifted(scene: "bpy.types.Scene", offset_px: np.ndarray, file: Path) -> None:
    """Renders with every sample so many pixels off the centre, x right, y down."""
    lens = scene.camera.data
    render = scene.render
    # A camera's shift is in units of the side that its sensor is fitted to.
    sides = {"HORIZONTAL": render.resolution_x, "VERTICAL": render.resolution_y}
    longer = max(render.resolution_x, render.resolution_y)
    side = sides.get(lens.sensor_fit, longer)
    before = lens.shift_x, lens.shift_y
    lens.shift_x += float(offset_px[0]) / side
    lens.shift_y -= float(offset_px[1]) / side
    render.filepath = str(file.resolve())
    bpy.ops.render.render(write_still=True)
    lens.shift_x, lens.shift_y = before


def mean(scene: "bpy.types.Scene", offsets: np.ndarray) -> np.ndarray:
    """Returns the mean of renders under the tone map, linear, rows from the bottom."""
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth = "OPEN_EXR", "32"
    total = np.zeros(())
    with tempfile.TemporaryDirectory() as folder:
        for k, offset in enumerate(offsets):
            file = Path(folder) / f"{k}.exr"
            shifted(scene, offset, file)
            image = bpy.data.images.load(str(file))
            pixels = np.empty(len(image.pixels), np.float32)
            image.pixels.foreach_get(pixels)
            bpy.data.images.remove(image)
            color = pixels.reshape(-1, 4)[:, :3].astype(np.float64)
            color = np.maximum(color, 0.0)
            total = total + color / (1.0 + color.max(axis=1, keepdims=True))
    mapped = total / len(offsets)
    return mapped / (1.0 - mapped.max(axis=1, keepdims=True))


def save(scene: "bpy.types.Scene", color: np.ndarray, file: Path, half: bool) -> None:
    """Writes linear colour, rows from the bottom, as EXR."""
    render = scene.render
    image = bpy.data.images.new(
        "mean", render.resolution_x, render.resolution_y, float_buffer=True
    )
    pixels = np.ones((len(color), 4), np.float32)
    pixels[:, :3] = color
    image.pixels.foreach_set(pixels.ravel())
    file.parent.mkdir(exist_ok=True)
    settings = render.image_settings
    settings.file_format = "OPEN_EXR"
    settings.color_mode, settings.exr_codec = "RGB", "ZIP"
    settings.color_depth = "16" if half else "32"
    image.save_render(str(file.resolve()), scene=scene)
    bpy.data.images.remove(image)


def tangent(scene: "bpy.types.Scene") -> float:
    """Returns the tangent of half the vertical field of view."""
    render = scene.render
    width, height = render.resolution_x, render.resolution_y
    frame = scene.camera.data.view_frame(scene=scene)
    top = max(corner[1] for corner in frame) - min(corner[1] for corner in frame)
    assert render.pixel_aspect_x == render.pixel_aspect_y
    assert width > 0
    assert height > 0
    return 0.5 * top / abs(frame[0][2])


def metadata(
    scene: "bpy.types.Scene", given: argparse.Namespace, entries: list[dict]
) -> str:
    """Returns `capture.toml`."""
    render = scene.render
    lines = [
        "[capture]",
        'layout = "blender"',
        f"size = [{render.resolution_x}, {render.resolution_y}]",
        f"fps = {render.fps / render.fps_base:g}",
        f"reference_samples = {given.reference_samples}",
    ]
    for entry in entries:
        lines += ["", "[[frame]]"]
        for name, value in entry.items():
            text = str(value).lower() if isinstance(value, bool) else repr(value)
            lines.append(f"{name} = {text}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
