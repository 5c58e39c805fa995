"""Scenes as the commands are given them, loaded and bound to a camera path."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ataa_jax import effects, paths, world


def stem(scene: str) -> str:
    """Returns what a scene's results are named by."""
    return Path(scene).stem or "scene"


def load(
    scene: str,
    camera: str | None,
    motion: str | None,
    extent: tuple[int, int],
    wish: "effects.Wish | None" = None,
) -> tuple["world.World", "paths.CameraPath"]:
    """Loads a scene, lit and exposed for the camera at which the path starts."""
    from ataa_jax import paths
    from ataa_jax import world as worlds

    text = camera or "walk"
    paths.load(text, motion)  # so that a mistake is told before a long read
    sources = [worlds.read(scene, extent)]
    path = paths.load(text, motion, [known.name for known in sources[0].cameras])
    # Popped: who keeps a source keeps its textures, which are packed by then.
    world = worlds.prepare(sources.pop(), camera=path.camera, size=extent, wish=wish)
    return world, path


def wish(text: str | None) -> "effects.Wish | None":
    """Reads `--effects`; None where it was not given."""
    if text is None:
        return None
    from ataa_jax import effects

    return effects.parse(text)
