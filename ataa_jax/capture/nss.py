"""Arm's data set layout for Neural Super Sampling (NSS dataset specification 1.0).

    0000.json  …                      metadata, one file a sequence
    ground_truth/0000/0000.exr  …     16 samples a pixel, linear
    x1/color, x1/depth, x1/motion     the same names below: one jittered sample a pixel

The specification leaves open: the sign and orientation of motion and jitter, the
orientation of the view-projection's second axis, and whether it multiplies rows or
columns. The first three are inferred from the images (see `check`), the last from the
matrix: its row for w has unit length.

Ratios: x1 is read where there is one. Else the smallest whole ratio is used at its own
resolution, with the ground truth averaged down under the tone map; others are refused.
`Exposure` multiplies colour and ground truth by its first frame's value, for all
frames: a sequence is shown at one exposure.
"""

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from ataa_jax.capture import exr
from ataa_jax.capture.conventions import Conventions, Frame, Layer, Pose
from ataa_jax.capture.fields import Table, read_json
from ataa_jax.capture.findings import ERROR, WARNING, Finding
from ataa_jax.capture.record import Capture
from ataa_jax.errors import InputError

_SEQUENCE = re.compile(r"\d{4,}\.json")
_RATIO = re.compile(r"x(\d+)(_\d+)?")
_SAMPLES = 16  # of the ground truth: a 4×4 box filter of 8K
# our choice: matrices are written as single floats.
_EXACT = 1e-6


def sequences(folder: Path) -> list[Path]:
    """Returns the metadata files of a folder, in order."""
    return sorted(f for f in folder.glob("*.json") if _SEQUENCE.fullmatch(f.name))


def load(file: Path) -> Capture:
    """Reads one sequence's metadata.

    Args:
        file: `NNNN.json`.

    Raises:
        InputError: a field that the specification calls mandatory is missing, or no
            ratio can be used.
    """
    folder, name = file.parent, file.stem
    table = read_json(file)
    version = table.text("Version")
    target = table.table("TargetResolution")
    full = (target.integer("Y", None, 1, 16384), target.integer("X", None, 1, 16384))
    table.table("Samples").integer("Count", None, 1, 1 << 20)
    reverse = table.flag("ReverseZ", None)
    ratio = _ratio(folder)
    size = (full[0] // ratio, full[1] // ratio)
    entries = table.tables("Frames")
    layers = _layers(folder, name, ratio, entries)
    frames, findings = [], []
    for entry, held in zip(entries, layers, strict=True):
        frame, found = _frame(entry, held)
        frames.append(frame)
        findings += found
    exposure = frames[0].exposure
    notes = [f"NSS layout {version}, x{ratio}, sequence {name}"]
    if any(frame.exposure != exposure for frame in frames):
        notes.append(f"the exposure varies; all frames are shown at {exposure:g}")
    if table.flag("MotionVectorsDilated", False):
        notes.append("motion vectors are dilated: edges carry the nearer one's already")
    if len(others := sequences(folder)) > 1:
        notes.append(f"{len(others)} sequences; name another's .json to read it")
    return Capture(
        name=f"{folder.resolve().name} {name}",
        folder=folder,
        layout="nss",
        size=size,
        frames=tuple(replace(frame, exposure=exposure) for frame in frames),
        conventions=Conventions(
            motion_unit="uv",
            motion_sign=None,
            motion_y=None,
            camera_y=None,
            jitter_stated=False,
            depth="device reversed" if reverse else "device",
        ),
        fps=table.number("EmulatedFramerate", None, 1e-3, 1e6),
        reference_samples=_SAMPLES,
        reference_ratio=ratio,
        notes=notes,
        contradictions=_merged(findings),
    )


def _ratio(folder: Path) -> int:
    names = sorted(
        entry.name for entry in folder.iterdir() if _RATIO.fullmatch(entry.name)
    )
    whole = sorted(int(name[1:]) for name in names if "_" not in name)
    whole = [ratio for ratio in whole if 1 <= ratio <= 16]
    if not whole:
        held = ", ".join(names) or "none"
        raise InputError(
            f"NSS data set {folder} has no x1 and no other whole ratio to use at its "
            f"own resolution (it has {held}); capture at x1"
        )
    return whole[0]


def _layers(
    folder: Path, sequence: str, ratio: int, entries: list[Table]
) -> list[dict[str, Layer]]:
    """Returns where every frame's images lie, with the channels of the first."""
    places = {
        "color": f"x{ratio}/color",
        "depth": f"x{ratio}/depth",
        "motion": f"x{ratio}/motion",
        "reference": "ground_truth",
    }
    numbers = [entry.integer("Frame", None, 0, 1 << 31) for entry in entries]
    found: list[dict[str, Layer]] = [{} for _ in numbers]
    for kind, place in places.items():
        first = f"{place}/{sequence}/{numbers[0]:04d}.exr"
        held = exr.look(exr.inside(folder, first))[0].channels
        channels = _channels(kind, held, first)
        for number, layers in zip(numbers, found, strict=True):
            layers[kind] = Layer(f"{place}/{sequence}/{number:04d}.exr", channels)
    return found


def _channels(kind: str, held: tuple[str, ...], file: str) -> tuple[str, ...]:
    options = {
        "depth": (("R",), ("Z",), ("Y",)),
        "motion": (("R", "G"), ("X", "Y")),
    }.get(kind, (("R", "G", "B"),))
    for names in options:
        if set(names) <= set(held):
            return names
    raise InputError(
        f"{file} has the channels {', '.join(held[:8])} where {kind} needs "
        f"{' '.join(options[0])}"
    )


def _frame(entry: Table, layers: dict[str, Layer]) -> tuple[Frame, list[Finding]]:
    jitter = None
    if entry.has("Jitter"):
        offset = entry.table("Jitter")
        jitter = (offset.number("X"), offset.number("Y"))
    near = entry.number("CameraNearPlane", None, 1e-9)
    far = entry.number("CameraFarPlane", None)
    far = math.inf if far == -1.0 else far
    if not far > near:
        raise InputError(
            f"{entry.where}: CameraFarPlane must be −1 or beyond CameraNearPlane, not "
            f"{far:g}"
        )
    fov = (
        entry.number("FovX", None, 1e-6, math.pi - 1e-6),
        entry.number("FovY", None, 1e-6, math.pi - 1e-6),
    )
    matrix = np.array(entry.numbers("ViewProjection", 16)).reshape(4, 4)
    pose, findings = _pose(matrix, fov, far)
    frame = Frame(
        number=entry.integer("Frame", None, 0, 1 << 31),
        layers=layers,
        jitter=jitter,
        cut=entry.flag("CameraCut", False),
        pose=pose,
        near=near,
        far=far,
        exposure=entry.number("Exposure", 1.0, 1e-12),
    )
    return frame, findings


def _pose(
    stored: np.ndarray, fov: tuple[float, float], far: float
) -> tuple[Pose | None, list[Finding]]:
    """Takes a view-projection apart.

    Args:
        stored: (4, 4), sixteen numbers four by four.
        fov: horizontal and vertical field of view, radians.
        far: the far plane, inf where infinite.
    """
    # A column-major matrix that multiplies rows, as DirectX engines have it, holds the
    # equations of x, y, z and w one after the other; one that multiplies columns holds
    # them interleaved. The equation of w is distance along the view: a unit vector.
    for rows in (stored, stored.T):
        if abs(np.linalg.norm(rows[3, :3]) - 1.0) < 1e-3:
            break
    else:
        text = "no row of ViewProjection is a unit vector, as the one for w must be"
        remedy = "write the matrix of a perspective camera, 16 numbers column by column"
        return None, [Finding(WARNING, "camera unreadable", "", text, remedy)]
    forward, w = rows[3, :3], rows[3, 3]
    axes, tangents = [], []
    for row in rows[:2]:
        across = row[:3] - (row[:3] @ forward) * forward  # jitter leans on forward
        length = np.linalg.norm(across)
        if length < 1e-9:
            text = "ViewProjection maps the image to a line"
            return None, [Finding(WARNING, "camera unreadable", "", text, "correct it")]
        axes.append(across / length)
        tangents.append(1.0 / length)
    lean = [(row[:3] @ forward) for row in rows[:2]]
    system = np.stack([axes[0], axes[1], forward])
    offset = [-(rows[k, 3] - lean[k] * w) * tangents[k] for k in range(2)]
    pose = np.eye(4)
    pose[:3, :3] = np.stack([axes[0], axes[1], -forward], axis=1)
    pose[:3, 3] = np.linalg.solve(system, np.array([*offset, -w]))
    found = _compare(rows, tangents, fov, far)
    return Pose(pose, (tangents[0], tangents[1])), found


def _compare(
    rows: np.ndarray, tangents: list[float], fov: tuple[float, float], far: float
) -> list[Finding]:
    """Compares fields of view and far plane with the matrix."""
    found = []
    for axis, tangent, angle in zip("XY", tangents, fov, strict=True):
        seen = 2.0 * math.atan(tangent)
        if abs(seen - angle) > 1e-3:
            found.append(
                Finding(
                    WARNING,
                    "field of view",
                    "",
                    f"Fov{axis} is {angle:.4f}, ViewProjection has {seen:.4f} radians",
                    "write both of the same camera, in radians",
                )
            )
    # The equation of z is A · (that of w) + B: at infinity the depth is A, which is 1
    # (forward) or 0 (reversed) where the far plane is infinite.
    a = float(rows[2, :3] @ rows[3, :3])
    infinite = abs(a) < _EXACT or abs(a - 1.0) < _EXACT
    if infinite and not math.isinf(far):
        text = (
            f"CameraFarPlane is {far:g}, but ViewProjection has an infinite far plane"
        )
        name, remedy = "infinite far plane", "write CameraFarPlane −1"
        number = f"{text} (depth at infinity {a:.7f})"
        found.append(Finding(ERROR, name, "", number, remedy))
    elif not infinite and math.isinf(far):
        text = (
            f"CameraFarPlane is −1, but ViewProjection reaches depth {a:.6f} only at "
        )
        name, remedy = "finite far plane", "write the far plane's distance"
        number = f"{text}infinity: its far plane is finite"
        found.append(Finding(ERROR, name, "", number, remedy))
    return found


def _merged(findings: list[Finding]) -> list[Finding]:
    """Returns one finding of a name: frames repeat each other."""
    return list({finding.name: finding for finding in reversed(findings)}.values())
