"""Camera paths: where the camera stands in each frame, from a name or a TOML file.

Speeds are shares of the image's width a frame, so that one path fits a scene of any
scale: *typical* motion is at most 1 %, *rapid* 8 to 12 %. A path starts at one of the
scene's cameras and moves relative to it; ``focus`` is the distance to what that camera
looks at.

    kind = "walk"          # still, pan, orbit, dolly, walk or keyframes
    camera = "main"        # a camera of the scene; its first where absent
    motion = 0.01          # share of the image's width a frame, or "typical", "rapid"
    fps = 30               # animation advances by 1/fps a frame

    [[keyframe]]           # with kind = "keyframes": at least two, in order of frames
    frame = 0
    position = [0, 1, 5]   # world
    target = [0, 1, 0]     # world
    fov_y_degrees = 50     # optional

On the command line a path is named by a text, read by the first rule that fits:

1. a name that ends in ``.toml`` is a file as above;
2. the exact name of a camera of the scene: a walk from there, even if the name is also
   a kind of path or holds a colon;
3. a kind of path, other than keyframes: from the scene's first camera;
4. ``CAMERA:KIND``, split at the last colon, if what follows it is such a kind.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ataa_jax import files
from ataa_jax.camera import look_at
from ataa_jax.errors import InputError
from ataa_jax.scene import CameraSource

KINDS = ("still", "pan", "orbit", "dolly", "walk", "keyframes")
NAMED_KINDS = KINDS[:-1]  # those that need no file
SPEEDS = {"typical": 0.01, "rapid": 0.1}
_KEYFRAME_KEYS = {"frame", "position", "target", "fov_y_degrees"}


@dataclass(frozen=True)
class Keyframe:
    """Where the camera stands at one frame."""

    frame: float
    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_y: float | None = None  # radians


@dataclass(frozen=True)
class CameraPath:
    """A path relative to a scene's camera."""

    kind: str = "walk"
    camera: str | None = None  # name of one of the scene's cameras
    motion: float = SPEEDS["typical"]  # share of the image's width a frame
    fps: float = 30.0
    keyframes: tuple[Keyframe, ...] = ()
    name: str = "walk"


@dataclass(frozen=True)
class Pose:
    """The camera in one frame."""

    world_from_view: np.ndarray  # float64 (4, 4), rigid
    fov_y: float  # radians
    time: float  # seconds


def load(
    text: str, motion: str | float | None = None, cameras: Sequence[str] = ()
) -> CameraPath:
    """Reads ``KIND``, ``CAMERA``, ``CAMERA:KIND`` or the name of a TOML file.

    Args:
        text: what the user gave; the module's docstring has the rules. What fits none
            is taken for a camera that is not known yet.
        motion: overrides the path's speed: "typical", "rapid" or a share of the width.
        cameras: names of the scene's cameras, as far as they are known.

    Returns:
        The path.

    Raises:
        InputError: the file is missing or not a camera path, or a value is out of
            range.
    """
    if text.endswith(".toml"):
        path = _from_toml(Path(text))
    else:
        camera, _, kind = text.rpartition(":")
        if text in cameras or kind not in NAMED_KINDS:
            camera, kind = text, "walk"
        path = CameraPath(kind=kind, camera=camera or None, name=text)
    if motion is not None:
        path = replace(path, motion=_speed("--motion", motion))
    return path


def pose(
    path: CameraPath, camera: CameraSource, focus: float, aspect: float, frame: int
) -> Pose:
    """Returns the camera of one frame.

    Args:
        path: the path.
        camera: where it starts.
        focus: distance to what the camera looks at, scene units.
        aspect: image width over height.
        frame: index of the frame; −1 is the frame before the first.
    """
    time = frame / path.fps
    start = np.asarray(camera.world_from_view, np.float64)
    if path.kind == "keyframes":
        return _keyframed(path, camera, frame, time)
    # The angle by which a yaw moves the middle of the image by `motion` widths.
    angle = np.arctan(2.0 * np.tan(camera.fov_y / 2.0) * aspect * path.motion) * frame
    moved = np.eye(4)
    if path.kind == "pan":
        moved[:3, :3] = _yaw(angle)
    elif path.kind == "orbit":
        pivot = np.array([0.0, 0.0, -focus])
        moved[:3, :3] = _yaw(angle)
        moved[:3, 3] = pivot - _yaw(angle) @ pivot
    elif path.kind == "dolly":
        # A point at depth `focus` and half a width aside moves by ½ s / focus widths.
        moved[2, 3] = -2.0 * path.motion * focus * frame
    elif path.kind == "walk":
        moved[:3, :3] = _yaw(0.6 * angle)
        step = 0.4 * path.motion * focus
        bob = 0.25 * step * np.sin(2.0 * np.pi * frame / 15.0)  # two steps a second
        moved[:3, 3] = (0.5 * step * frame, bob, -step * frame)
    return Pose(start @ moved, camera.fov_y, time)


def _yaw(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])


def _keyframed(path: CameraPath, camera: CameraSource, frame: int, time: float) -> Pose:
    keys = path.keyframes
    at = [key.frame for key in keys]
    clamped = float(np.clip(frame, at[0], at[-1]))
    position, target = (
        _along(at, np.array([getattr(key, name) for key in keys]), float(frame))
        for name in ("position", "target")
    )
    fov = [camera.fov_y if key.fov_y is None else key.fov_y for key in keys]
    fov_y = float(_curve(at, fov)(clamped))
    return Pose(look_at(position, target), fov_y, time)


def _along(at: list[float], values: np.ndarray, frame: float) -> np.ndarray:
    """Interpolates keys by monotone cubics, which do not overshoot them.

    Before the first key the motion of the first frame goes on backwards, so that a
    sequence does not start with a jerk; after the last key all stands still.
    """
    curve = _curve(at, values)
    if frame >= at[0]:
        return curve(min(frame, at[-1]))
    step = curve(min(at[0] + 1.0, at[-1])) - values[0]
    return values[0] + step * (frame - at[0])


def _curve(at: list[float], values: Any) -> Callable[[float], np.ndarray]:
    from scipy.interpolate import PchipInterpolator  # here: it imports slowly

    return PchipInterpolator(at, values)


def _from_toml(file: Path) -> CameraPath:
    table = files.read_toml(file, "camera path")
    known = {"kind", "camera", "motion", "fps", "keyframe"}
    if unknown := sorted(set(table) - known):
        raise InputError(
            f"camera path {file} has the unknown key '{unknown[0]}'; "
            f"known are {', '.join(sorted(known))}"
        )
    kind = table.get("kind", "walk")
    if kind not in KINDS:
        raise InputError(
            f"camera path {file} has kind {kind!r}; expected one of {', '.join(KINDS)}"
        )
    keys = ()
    if kind == "keyframes":
        keys = _keyframes(file, table.get("keyframe"))
    elif "keyframe" in table:
        raise InputError(
            f"camera path {file} has [[keyframe]] tables, but kind {kind!r} reads none"
            '; say kind = "keyframes" or leave them out'
        )
    camera = table.get("camera")
    if camera is not None and not isinstance(camera, str):
        raise InputError(f"camera path {file}: camera must be a name, not {camera!r}")
    return CameraPath(
        kind=kind,
        camera=camera,
        motion=_speed(f"camera path {file}: motion", table.get("motion", "typical")),
        fps=_number(file, "fps", table.get("fps", 30.0), 1e-3, 1e6),
        keyframes=keys,
        name=file.stem,
    )


def _keyframes(file: Path, entries: object) -> tuple[Keyframe, ...]:
    if not isinstance(entries, list) or len(entries) < 2:
        raise InputError(f"camera path {file} needs at least two [[keyframe]] tables")
    keys = []
    for number, entry in enumerate(entries):
        where = f"{file}, keyframe {number}"
        if not isinstance(entry, dict):
            raise InputError(f"camera path {where} is not a table")
        if unknown := sorted(set(entry) - _KEYFRAME_KEYS):
            raise InputError(
                f"camera path {where} has the unknown key '{unknown[0]}'; "
                f"known are {', '.join(sorted(_KEYFRAME_KEYS))}"
            )
        fov = entry.get("fov_y_degrees")
        key = Keyframe(
            frame=_number(where, "frame", entry.get("frame"), -1e6, 1e6),
            position=_vector(where, "position", entry.get("position")),
            target=_vector(where, "target", entry.get("target")),
            fov_y=None
            if fov is None
            else float(np.radians(_number(where, "fov_y_degrees", fov, 1.0, 170.0))),
        )
        if keys and key.frame <= keys[-1].frame:
            raise InputError(f"camera path {where}: frames must increase")
        if key.position == key.target:
            raise InputError(f"camera path {where}: position and target are equal")
        keys.append(key)
    return tuple(keys)


def _vector(where: object, name: str, value: object) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"camera path {where}: {name} must be three numbers")
    x, y, z = (_number(where, name, item, -1e12, 1e12) for item in value)
    return (x, y, z)


def _number(where: object, name: str, value: object, low: float, high: float) -> float:
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not low <= value <= high
    ):
        raise InputError(
            f"camera path {where}: {name} must be a number from {low:g} to {high:g}, "
            f"not {value!r}"
        )
    return float(value)


def _speed(where: str, value: object) -> float:
    """Reads a speed; `where` begins the sentence that refuses it."""
    share = value
    if isinstance(value, str):
        share = SPEEDS.get(value)
        if share is None:
            with suppress(ValueError):
                share = float(value)
    if (
        isinstance(share, int | float)
        and not isinstance(share, bool)
        and 0.0 <= share <= 1.0
    ):
        return float(share)
    raise InputError(
        f"{where} must be typical, rapid or a share of the image's width a frame, a "
        f"number from 0 to 1, not {value!r}"
    )
