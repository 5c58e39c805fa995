"""Collects shapes under the names of the meshes that they become."""

from collections import defaultdict

import numpy as np

from ataa_jax.builtin.materials import Palette
from ataa_jax.builtin.shapes import Shape, merge
from ataa_jax.scene import MeshSource

GROUPS = ["static", "boat", "pinwheel", "car", "ball"]


class Parts:
    """Shapes by (name, material, group); each such key becomes one mesh."""

    def __init__(self, palette: Palette) -> None:
        self.palette = palette
        self._shapes: dict[tuple[str, str, str], list[Shape]] = defaultdict(list)

    def add(
        self, name: str, material: str, *shapes: Shape, group: str = "static"
    ) -> None:
        """Adds shapes to a mesh, given in the space of its rigid group."""
        self._shapes[name, material, group].extend(shapes)

    def meshes(self) -> list[MeshSource]:
        """Returns the collected meshes, in the order of their first shapes."""
        return [
            _mesh(name, self.palette.index(material), GROUPS.index(group), shapes)
            for (name, material, group), shapes in self._shapes.items()
        ]


def _mesh(name: str, material: int, group: int, shapes: list[Shape]) -> MeshSource:
    shape = merge(shapes)
    return MeshSource(
        name=name,
        position=shape.position.astype(np.float32),
        triangles=shape.triangles.astype(np.int32),
        material=material,
        normal=shape.normal.astype(np.float32),
        uv=shape.uv.astype(np.float32),
        group=group,
    )
