"""What the commands show in a terminal: a progress bar, tables, notes."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

if TYPE_CHECKING:
    from ataa_jax import effects, types, world

Report = Callable[[str, int, int], None]


def describe(loaded: "world.World") -> None:
    """Prints what a scene holds, and which effects it calls for, and their rays."""
    from ataa_jax import effects
    from ataa_jax.exposure import PREVIEW

    source, console = loaded.source, Console(highlight=False)
    triangles = sum(len(mesh.triangles) for mesh in source.meshes)
    objects = f"{len(source.meshes):,}"
    if (source.distinct_meshes or len(source.meshes)) != len(source.meshes):
        objects += f", instances of {source.distinct_meshes:,} meshes"
    moving = f"{source.duration:.2f} s, loops" if source.duration else "none"
    facts = [
        ("Triangles", f"{triangles:,}"),
        ("Objects", objects),
        ("Materials", f"{len(source.materials):,}"),
        ("Textures", f"{_textures(loaded.scene.materials):,}"),
        ("Rigid groups", f"{len(source.group_names):,}"),
        ("Animation", moving),
        ("Exposure", f"{loaded.exposure:.4g}"),
    ]
    console.print(f"[bold]{escape(loaded.name)}[/bold]")
    console.print(table((), [(name, value) for name, value in facts]))
    console.print("\n[bold]Cameras[/bold]")
    rows = [
        (c.name, _vector(c.world_from_view[:3, 3]), f"{_degrees(c.fov_y):.1f}°")
        for c in loaded.cameras
    ]
    console.print(table(("Name", "Position", "Vertical field"), rows))
    console.print("\n[bold]Lights[/bold]")
    kinds = ("directional", "point", "spot")
    lights = [(li.name, kinds[li.kind], _vector(li.intensity)) for li in loaded.lights]
    console.print(table(("Name", "Kind", "Intensity (lux or cd)"), lights))
    console.print("\n[bold]Effects[/bold]")
    costs = {}
    if loaded.rays is not None:
        costs = effects.costs(loaded.rays, PREVIEW[0] * PREVIEW[1])
    looked = [
        (
            e.name,
            _state(e, loaded.wish),
            costs.get(e.name, "") if e.on else "",
            e.reason,
        )
        for e in loaded.looked
    ]
    heads = ("Effect", "", f"Rays in {PREVIEW[1]}x{PREVIEW[0]}", "Reason")
    console.print(table(heads, looked))
    notes(console, loaded.notes)


@contextmanager
def progress() -> Iterator[Report]:
    """Yields what draws a progress bar on standard error, if that is a terminal."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("starting", total=1)
        yield lambda text, done, total: bar.update(
            task, description=text, completed=done, total=total
        )


def table(
    heads: tuple[str, ...],
    rows: list[tuple[str, ...]],
    right: tuple[int, ...] = (),
) -> Table:
    """Returns a table without lines; `right` are the columns of numbers."""
    drawn = Table(box=None, pad_edge=False, show_header=bool(heads), header_style="dim")
    for index in range(len(heads or rows[0])):
        side = "right" if index in right else "left"
        drawn.add_column(heads[index] if heads else "", justify=side)
    for row in rows:
        drawn.add_row(*map(escape, row))  # a file's names may hold brackets
    return drawn


def notes(console: Console, texts: list[str]) -> None:
    """Prints what a reader of the scene noted."""
    if texts:
        console.print("\n[bold]Notes[/bold]")
    for note in texts:
        console.print(f"  {note}", markup=False)


def wrote(console: Console, final: Path, names: str) -> None:
    """Tells which of the named files and folders lie in the output folder."""
    there = ", ".join(name for name in names.split() if (final / name).exists())
    console.print(f"\nWrote {final}: {there}", markup=False)


def _state(effect: "effects.Effect", wish: "effects.Wish") -> str:
    if not wish.keeps(effect.name):
        return "left out" if effect.on else "off"
    if effect.on:
        return "on"
    return "forced" if wish.everything else "off"


def _vector(values: Any) -> str:
    return ", ".join(f"{float(value):.4g}" for value in values)


def _degrees(radians: float) -> float:
    return radians * 57.29577951308232


def _textures(materials: "types.Materials") -> int:
    """Returns how many textures the materials read."""
    import numpy as np

    tables = (
        materials.base_color_texture,
        materials.metallic_roughness_texture,
        materials.normal_texture,
        materials.emissive_texture,
    )
    ids = np.unique(np.concatenate([np.asarray(table) for table in tables]))
    return int(np.sum(ids >= 0))
