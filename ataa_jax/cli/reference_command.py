"""`ataa reference`: the supersampled truth of a sequence, into the cache or as files.

As in `cli`: JAX is imported inside.
"""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from ataa_jax import capture_commands, programs
from ataa_jax.cli import given, loading, terminal, workers
from ataa_jax.errors import InputError

if TYPE_CHECKING:
    from ataa_jax import reference as references

Samples = Annotated[int, typer.Option(help="Samples a pixel.")]
FilesOut = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Also write them as PNG; a new or empty folder."),
]
Exr = Annotated[bool, typer.Option("--exr", help="With --out: also linear OpenEXR.")]


def reference(
    scene: given.Scene,
    size: given.Size = "640x360",
    frames: given.Frames = 12,
    samples: Samples = 64,
    camera: given.CameraOption = None,
    motion: given.Motion = None,
    effects: given.Effects = None,
    jobs: given.Jobs = 1,
    scheduler: given.Scheduler = None,
    exr: Exr = False,
    out: FilesOut = None,
    traceback: given.Traceback = False,
) -> None:
    """Renders the supersampled truth of a sequence, so that `compare` finds it done."""
    extent = given.size_of(size)
    given.at_least("--frames", frames, 1)
    given.at_least("--samples", samples, 1)
    workers.check(jobs, scheduler)
    if exr and out is None:
        raise InputError("--exr writes files; say where to with --out")
    if capture_commands.given(scene):
        raise InputError(
            f"{scene} is a capture, which is not rendered; give a scene, or use "
            "`ataa compare`, which reads the capture's own reference"
        )
    from ataa_jax import files
    from ataa_jax import reference as references
    from ataa_jax import world as worlds

    place = nullcontext() if out is None else files.output_folder(out)
    with place as folder, terminal.progress() as report:
        report("loading the scene", 0, 1)
        wish = loading.wish(effects)
        loaded, path = loading.load(scene, camera, motion, extent, wish)
        shot = worlds.sequence(loaded, path, extent)
        with workers.workers(jobs, scheduler) as crew:
            workers.references(
                crew, scene, shot, range(frames), samples, "tonemap", report
            )
        for index in range(frames):
            found = references.reference(shot, index, samples)
            if folder is not None:
                _write(folder, index, found, exr=exr)
            report(f"frame {index + 1} of {frames}", index + 1, frames)
    console = Console(soft_wrap=True, highlight=False)
    console.print(
        f"{frames} references of {samples} samples a pixel are in "
        f"{programs.folder() / 'reference'}",
        markup=False,
    )
    if out is not None:
        terminal.wrote(console, out, "frames/ exr/")


def _write(
    folder: Path, index: int, found: "references.Supersampled", *, exr: bool
) -> None:
    """Writes ``frames/NNNN.png``, sRGB, and on request linear ``exr/NNNN.exr``."""
    import numpy as np

    from ataa_jax import color as colors
    from ataa_jax import files

    shown = np.clip(np.asarray(colors.display(found.color)), 0.0, 1.0)
    picture = np.round(shown * 255.0).astype(np.uint8)
    files.write_png(folder / f"frames/{index:04d}.png", picture)
    if exr:
        files.write_exr(folder / f"exr/{index:04d}.exr", np.asarray(found.color))
