"""Nine small scenes, each of which isolates one failure of temporal antialiasing.

Section 2 of the paper lists the failures; `CASES` has one scene and camera path for
each. Everything else in a scene is meant to be easy: patterns coarser than pixels, a
lamp at the camera, whose shadows no one sees, and no second motion. Speeds are shares
of the image's width a frame, as in `paths`; units are metres, the camera stands 1.5 m
high and looks along −z.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ataa_jax import camera as cameras
from ataa_jax.builtin import images, shapes
from ataa_jax.builtin.materials import Palette
from ataa_jax.builtin.shapes import Part, Point, Shape, box, merge, quad
from ataa_jax.paths import CameraPath, Keyframe
from ataa_jax.scene import (
    CameraSource,
    LightSource,
    MaterialSource,
    MeshSource,
    SceneSource,
    SkySource,
)
from ataa_jax.types import LIGHT_DIRECTIONAL, LIGHT_POINT

_EYE: Point = (0.0, 1.5, 0.0)
_FOV_Y = 45.0  # degrees
_FPS = 30.0
# Width of a 16:9 view at unit depth.
_WIDTH = 2.0 * float(np.tan(np.radians(_FOV_Y / 2.0))) * 16.0 / 9.0
_PERIOD = 4.0  # seconds; a moving group passes the middle at t = 0

_AMBIENT = SkySource(
    zenith=(0.55, 0.55, 0.55), horizon=(0.45, 0.45, 0.45), ground=(0.25, 0.25, 0.25)
)
_DAY = SkySource(
    zenith=(0.16, 0.34, 0.72), horizon=(0.75, 0.85, 0.95), ground=(0.30, 0.28, 0.24)
)


@dataclass(frozen=True)
class Case:
    """One failure: a scene, a camera path and the frames in which it shows.

    Frames count from 0; the `LEAD_IN` frames before it fill the history and do not
    count.
    """

    letter: str
    name: str
    fails: str  # what temporal antialiasing gets wrong
    build: Callable[[], SceneSource]
    path: CameraPath
    frames: tuple[int, ...] = (1, 4, 7)  # the ones that are scored
    cut: int | None = None  # frame at which the camera jumps


LEAD_IN = 8


def case(letter: str) -> Case:
    """Returns the case of a letter of `CASES`."""
    return next(c for c in CASES if c.letter == letter)


def moving_object() -> SceneSource:
    """(a) A crate crosses before a wall at 4 % of the width a frame."""
    p = _palette()
    _add_texture(p, "crate", _diamonds((0.66, 0.30, 0.20), (0.80, 0.42, 0.26), 2))
    crate = box((-0.9, 0.5, -6.2), (0.9, 2.5, -5.6)).tiled(2.0)
    parts = [_wall(-8.0), Part("crate", crate, "crate", "crate")]
    groups = {"crate": (0.04 * _WIDTH * 5.6 * _FPS, 0.0, 0.0)}
    return _source("moving object", parts, p, groups)


def rotating_camera() -> SceneSource:
    """(b) A round room, of which a turning camera sees a new strip each frame."""
    angle = np.linspace(0.0, 2.0 * np.pi, 97)
    ring = np.stack([np.sin(angle), 0.0 * angle, -np.cos(angle)], axis=-1) * 9.0
    points = ring[None] + np.array([[[0.0, 9.0, 0.0]], [[0.0, -6.0, 0.0]]])
    around = angle * 9.0
    uv = np.stack(np.broadcast_arrays(around[None], np.array([[0.0], [15.0]])), -1)
    room = shapes.facing(shapes.sheet(points, uv / _repeat(around[-1], 4.8)), (0, 0, 0))
    return _source("round room", [Part("round wall", room, "bold wall")], _palette())


def backward_step() -> SceneSource:
    """(c) A flat wall, from which the camera steps backward."""
    parts = [Part("bold wall", _across(-7.0).tiled(4.8), "bold wall")]
    return _source("flat wall", parts, _palette())


def wires() -> SceneSource:
    """(d) Wires of a fifth of a pixel (at 160 px width) against the sky."""
    p = _palette()
    p.plain("cable", (0.012, 0.012, 0.013), 0.6)
    p.plain("hill", (0.10, 0.17, 0.10), 1.0)
    ends = [((-9, 4.6, -9.0), (9, 3.2, -11.0)), ((-9, 3.6, -10.0), (9, 4.4, -9.0))]
    ends += [((-9, 2.4, -9.0), (9, 2.9, -10.0)), ((-7, 0.6, -9.0), (-3, 6.0, -9.0))]
    ends += [((2.5, 0.6, -9.5), (6.5, 6.0, -9.5))]
    ropes = [
        shapes.tube(shapes.sagging(a, b, 0.35, 24), 0.0085, 5)
        for a, b in ends
    ]  # fmt: skip
    parts = [
        Part("wire overhead", merge(ropes), "cable"),
        Part("hill", box((-60.0, -60.0, -41.0), (60.0, 0.6, -40.0)), "hill"),
    ]
    source = _source("wires", parts, p)
    return replace(source, sky=_DAY, lights=[_sun((-0.3, -0.8, -0.5))])


def fine_material() -> SceneSource:
    """(e) A carpet whose weave is about a pixel near, and a third of one far."""
    p = Palette()
    _add_texture(p, "carpet", _weave())
    floor = quad((-9.0, 0.0, 3.0), (18.0, 0, 0), (0, 0, -18.0)).tiled(1.0)
    source = _source("carpet", [Part("carpet", floor, "carpet")], p)
    return replace(source, cameras=[_camera((0.0, 2.2, 0.0), (0.0, 0.0, -2.0))])


def transparent_pane() -> SceneSource:
    """(f) A still pane before a wall that slides by at 2 % of the width a frame."""
    p = _palette()
    # Whichever surface the motion vectors tell of, the bands or what is behind them
    # moves otherwise.
    y, x = np.mgrid[:128, :128] / 128.0
    bands = np.clip(0.5 + 8.0 * np.sin(2.0 * np.pi * (2.0 * x + y)), 0.0, 1.0)
    tinted = images.tint(bands, (0.30, 0.55, 0.80), (0.62, 0.82, 0.95))
    p.materials.append(
        MaterialSource(
            name="pane",
            base_color=(1.0, 1.0, 1.0, 0.55),
            metallic=0.0,
            roughness=0.4,
            alpha_mode="BLEND",
            double_sided=True,
            base_color_texture=p.image(tinted, srgb=True),
        )
    )
    # Bold, as only 45 % of it is seen through the pane.
    _add_texture(p, "poster", _diamonds((0.32, 0.29, 0.26), (0.84, 0.76, 0.55), 2))
    p.plain("frame", (0.05, 0.05, 0.06), 0.6)
    frame = [
        box((-1.55, 0.35, -4.05), (1.55, 0.45, -3.95)),
        box((-1.55, 2.55, -4.05), (1.55, 2.65, -3.95)),
        box((-1.55, 0.45, -4.05), (-1.45, 2.55, -3.95)),
        box((1.45, 0.45, -4.05), (1.55, 2.55, -3.95)),
    ]
    pane = quad((-1.45, 0.45, -4.0), (2.9, 0, 0), (0, 2.1, 0))
    parts = [
        Part("poster", _across(-8.0).tiled(4.8), "poster", "wall"),
        Part("frame", merge(frame), "frame"),
        Part("pane", pane, "pane"),
    ]
    return _source("pane", parts, p, {"wall": (0.02 * _WIDTH * 8.0 * _FPS, 0, 0)})


def moving_shadow() -> SceneSource:
    """(g) Boards above the view cast shadows that slide over a still floor."""
    p = _palette()
    floor = quad((-14.0, 0.0, 3.0), (28.0, 0, 0), (0, 0, -14.0)).tiled(2.4)
    boards = [box((x, 6.0, -9.0), (x + 0.55, 6.1, 2.0)) for x in np.arange(-9, 9, 1.8)]
    parts = [
        Part("floor", floor, "floor"),
        Part("boards", merge(boards), "accent", "boards"),
    ]
    source = _source("shadow", parts, p, {"boards": (0.02 * _WIDTH * 4.5 * _FPS, 0, 0)})
    camera = _camera((0.0, 2.6, 0.5), (0.0, 0.0, -3.6))
    return replace(
        source,
        lights=[_sun((0.1, -1.0, 0.05))],
        cameras=[camera],
        sky=_AMBIENT,
    )


def moving_reflection() -> SceneSource:
    """(h) A still mirror shows a crate that moves behind the camera."""
    p = _palette()
    p.plain("mirror", (0.92, 0.92, 0.92), 0.0, metallic=1.0)
    p.plain("frame", (0.30, 0.20, 0.10), 0.7)
    _add_texture(p, "crate", _diamonds((0.66, 0.20, 0.14), (0.82, 0.36, 0.22), 2))
    mirror = quad((-2.6, 0.5, -6.0), (5.2, 0, 0), (0, 2.2, 0))
    frame = box((-2.75, 0.35, -6.2), (2.75, 2.85, -6.01))
    back = quad((16.0, -6.0, 6.0), (-32.0, 0, 0), (0, 16.0, 0)).tiled(2.4)
    crate = box((-1.0, 0.3, 2.0), (1.0, 2.7, 2.6)).tiled(2.0)
    parts = [
        _wall(-8.0),
        Part("back wall", back, "accent"),
        Part("mirror", mirror, "mirror"),
        Part("mirror frame", frame, "frame"),
        Part("crate", crate, "crate", "crate"),
    ]
    # Seen by way of the mirror the crate is 14 m away.
    source = _source(
        "mirror", parts, p, {"crate": (0.02 * _WIDTH * 14.0 * _FPS, 0.0, 0.0)}
    )
    # High up: its highlight lies above the mirror, and the crate's shadow behind it.
    lamp = replace(source.lights[0], position=(0.0, 7.0, 0.5))
    return replace(source, lights=[lamp])


def camera_cut() -> SceneSource:
    """(i) Two ends of a room; the camera jumps from one view to the other."""
    p = _palette()
    back = quad((16.0, -6.0, 8.0), (-32.0, 0, 0), (0, 16.0, 0)).tiled(4.8)
    column = box((-2.2, -6.0, 5.0), (-1.4, 9.0, 5.6)).tiled(1.2)
    crate = box((-1.2, 0.2, -6.2), (1.2, 2.4, -5.2)).tiled(1.2)
    parts = [
        _wall(-8.0),
        Part("back wall", back, "bold wall"),
        Part("column", column, "accent"),
        Part("crate", crate, "accent"),
    ]
    return _source("room", parts, p)


_CUT = 4
_AHEAD, _BACK = (0.0, 1.5, -8.0), (0.4, 1.5, 8.0)

CASES = (
    Case(
        "a",
        "moving object",
        "the wall that a crate uncovers was never seen",
        moving_object,
        CameraPath("still", fps=_FPS),
    ),
    Case(
        "b",
        "camera rotation",
        "the strip that comes into view was never seen",
        rotating_camera,
        CameraPath("pan", motion=0.04, fps=_FPS),
    ),
    Case(
        "c",
        "backward translation",
        "the rim that comes into view was never seen",
        backward_step,
        # Under a tenth of the wall's distance a frame: beyond that, what was seen in a
        # point's place counts as something nearer, though it was the point itself.
        CameraPath("dolly", motion=-0.02, fps=_FPS),
    ),
    Case(
        "d",
        "wires",
        "wires slip between samples and are lost or broken",
        wires,
        CameraPath("pan", motion=0.003, fps=_FPS),
    ),
    Case(
        "e",
        "fine material",
        "a weave finer than pixels flickers or blurs",
        fine_material,
        CameraPath("walk", motion=0.01, fps=_FPS),
    ),
    Case(
        "f",
        "transparent surface",
        "what is seen through the pane moves, the pane's motion vectors do not",
        transparent_pane,
        CameraPath("still", fps=_FPS),
    ),
    Case(
        "g",
        "moving shadow",
        "shadows slide over a floor whose motion vectors are zero",
        moving_shadow,
        CameraPath("still", fps=_FPS),
    ),
    Case(
        "h",
        "moving reflection",
        "a reflection crosses a mirror whose motion vectors are zero",
        moving_reflection,
        CameraPath("still", fps=_FPS),
    ),
    Case(
        "i",
        "camera cut",
        "nothing of the new view was ever seen",
        camera_cut,
        CameraPath(
            "keyframes",
            fps=_FPS,
            keyframes=(
                Keyframe(0.0, (0.0, 1.5, 0.0), _AHEAD),
                Keyframe(_CUT - 1.0, (0.0, 1.5, 0.0), _AHEAD),
                Keyframe(float(_CUT), (0.0, 1.5, 0.0), _BACK),
                Keyframe(_CUT + 8.0, (0.0, 1.5, 0.0), _BACK),
            ),
        ),
        frames=(_CUT,),
        cut=_CUT,
    ),
)


def _source(
    name: str,
    parts: list[Part],
    palette: Palette,
    speeds: dict[str, Point] | None = None,
) -> SceneSource:
    """Puts a scene together: one camera, one lamp at it, groups of constant speed.

    Args:
        name: of the scene.
        parts: what is in it.
        palette: its materials.
        speeds: velocity of every moving group, units a second.
    """
    speeds = speeds or {}
    groups = ["static", *speeds]
    velocity = np.array([(0.0, 0.0, 0.0), *speeds.values()])

    def transforms(time: float) -> np.ndarray:
        since = (time + _PERIOD / 2.0) % _PERIOD - _PERIOD / 2.0
        matrices = np.tile(np.eye(3, 4), (len(groups), 1, 1))
        matrices[:, :, 3] = velocity * since
        return matrices.astype(np.float32)

    return SceneSource(
        name=name,
        meshes=[_mesh(part, palette, groups) for part in parts],
        materials=palette.materials,
        textures=palette.textures,
        lights=[LightSource(LIGHT_POINT, intensity=(90.0, 88.0, 82.0), position=_EYE)],
        cameras=[_camera(_EYE, (0.0, 1.5, -1.0))],
        sky=_AMBIENT,
        group_names=groups,
        transforms=transforms,
        duration=_PERIOD if speeds else 0.0,
    )


def _mesh(part: Part, palette: Palette, groups: list[str]) -> MeshSource:
    return MeshSource(
        name=part.name,
        position=part.shape.position.astype(np.float32),
        triangles=part.shape.triangles.astype(np.int32),
        material=palette.index(part.material),
        normal=part.shape.normal.astype(np.float32),
        uv=part.shape.uv.astype(np.float32),
        group=groups.index(part.group),
    )


def _camera(eye: Point, target: Point) -> CameraSource:
    matrix = cameras.look_at(np.array(eye), np.array(target))
    return CameraSource("main", matrix, float(np.radians(_FOV_Y)))


def _sun(direction: Point) -> LightSource:
    return LightSource(
        LIGHT_DIRECTIONAL, intensity=(4.0, 3.8, 3.4), direction=direction
    )


def _wall(z: float) -> Part:
    """Returns a wall across the view, large enough to slide a few metres."""
    return Part("wall", _across(z).tiled(2.4), "wall")


def _across(z: float) -> Shape:
    return quad((-24.0, -8.0, z), (48.0, 0, 0), (0, 20.0, 0))


def _palette() -> Palette:
    """Returns the coarse patterns that all scenes share.

    Of so little contrast that jitter at their edges changes a 3×3 mean by less than
    the luminance criterion asks for: what it finds is the scene's own failure.
    """
    p = Palette()
    _add_texture(p, "wall", _diamonds((0.40, 0.47, 0.54), (0.60, 0.67, 0.74), 2))
    _add_texture(p, "floor", _diamonds((0.50, 0.42, 0.33), (0.72, 0.63, 0.50), 2))
    _add_texture(p, "accent", _diamonds((0.56, 0.36, 0.26), (0.78, 0.54, 0.38), 2))
    # Where aliasing itself is the failure: sharper, bolder, with fewer edges.
    bold = _diamonds((0.30, 0.34, 0.42), (0.70, 0.76, 0.80), 2, size=1024)
    _add_texture(p, "bold wall", bold)
    return p


def _add_texture(p: Palette, name: str, image: np.ndarray) -> None:
    p.materials.append(
        MaterialSource(
            name=name,
            metallic=0.0,
            roughness=1.0,
            double_sided=True,
            base_color_texture=p.image(image, srgb=True),
        )
    )


def _diamonds(
    dark: images.Color, light: images.Color, cells: int, size: int = 256
) -> np.ndarray:
    """Returns a slanted checker, whose edges lie on no row or column of pixels."""
    y, x = (np.mgrid[:size, :size] + 0.5) / size * cells
    # Slopes of 1 : 2 and 2 : 1 repeat with the texture.
    a, b = np.sin(np.pi * (2.0 * x + y)), np.sin(np.pi * (x - 2.0 * y))
    # Edges three texels wide.
    soft = np.clip(0.5 + a * b * size / (6.0 * np.pi * cells), 0.0, 1.0)
    return images.tint(soft, dark, light)


def _weave() -> np.ndarray:
    """Returns 48 pairs of threads a repeat, light and dark, in broad coloured bands."""
    size, thread = 480, 5
    y, x = np.mgrid[:size, :size]
    woven = ((x // thread + y // thread) % 2).astype(float)
    band = 0.5 + 0.5 * np.sin(2.0 * np.pi * (x + 0.5) / size)
    dark = images.tint(band, (0.20, 0.26, 0.42), (0.46, 0.22, 0.22))
    light = images.tint(band, (0.60, 0.66, 0.80), (0.84, 0.62, 0.58))
    return dark + (light - dark) * woven[..., None]


def _repeat(around: float, about: float) -> float:
    """Returns a texture's size that fits a circumference a whole number of times."""
    return around / max(round(around / about), 1)
