"""The sequences that the experiments run on: the built-in scene and the real ones.

The real scenes are found under `ATAA_SCENES`, or in `../shared/scenes` beside the
checkout; a missing one is left out with a word.
"""

import csv
import os
import sys
from pathlib import Path

from ataa_jax import paths, programs
from ataa_jax import world as worlds

programs.keep()  # the next script draws the same scenes

REAL = ("sponza", "modern_house", "dutch_ship", "littlest_tokyo", "cesium_milk_truck")


def scene_folder() -> Path:
    """Returns where the real scenes lie."""
    beside = Path(__file__).resolve().parents[1] / ".." / "shared" / "scenes"
    return Path(os.environ.get("ATAA_SCENES", beside))


def available(names: tuple[str, ...] = (worlds.BUILTIN, *REAL)) -> list[str]:
    """Returns the names of the scenes that are here."""
    found = []
    for name in names:
        if name == worlds.BUILTIN or (scene_folder() / f"{name}.glb").is_file():
            found.append(name)
        else:
            print(f"{name}: left out, not in {scene_folder()}", file=sys.stderr)
    return found


def load(name: str) -> worlds.World:
    """Loads a scene by its name."""
    if name == worlds.BUILTIN:
        return worlds.load(name)
    return worlds.load(scene_folder() / f"{name}.glb")


def shot(
    world: worlds.World,
    kind: str = "walk",
    motion: str | float = "typical",
    size: tuple[int, int] = (360, 640),
) -> worlds.Sequence:
    """Binds a world to one of the stock paths."""
    return worlds.sequence(world, paths.load(kind, motion), size)


def other_rows(file: Path, names: list[str]) -> list[list[str]]:
    """Returns a table's head, and its rows but for these scenes'; empty: no table."""
    if not file.is_file():
        return []
    with file.open(encoding="utf-8", newline="") as stream:
        head, *rows = list(csv.reader(stream))
    return [head, *(row for row in rows if row[0] not in names)]
