"""`ataa bench`: what a scene costs here, and whether the pictures are still the same.

As in `cli`: JAX is imported inside.
"""

from pathlib import Path

import typer
from rich.console import Console

from ataa_jax.cli import given, loading, terminal
from ataa_jax.errors import InputError


def bench(
    scene: given.Scene,
    size: given.Size = "640x360",
    camera: given.CameraOption = None,
    budget: given.Budget = None,
    against: given.Against = None,
    out: given.Out = None,
    traceback: given.Traceback = False,
) -> None:
    """Measures a scene: rays a second, stages of a frame, peak memory.

    Also whether the package still draws its golden images, as `ataa verify` does.
    """
    extent = given.size_of(size)
    if against not in (None, "mitsuba"):
        raise InputError(f"--against takes 'mitsuba', not '{against}'")
    place = out or Path("out") / f"{loading.stem(scene)}-bench"
    from ataa_jax import files

    with files.output_folder(place) as folder:
        from ataa_jax import bench as benchmark
        from ataa_jax import pipeline, verify
        from ataa_jax import world as worlds
        from ataa_jax.competitor import library

        rays = pipeline.BUDGET if budget is None else budget
        with terminal.progress() as report:
            if against is not None:
                library.load()  # so that a missing one is told before a long read
            report("loading the scene", 0, 3)
            loaded, _ = loading.load(scene, camera, None, extent)
            report("measuring", 1, 3)
            if against is not None:
                rows = benchmark.against_mitsuba(loaded, extent, camera, rays)
            else:
                rows = benchmark.run(loaded, extent, camera, rays)
                rows += benchmark.peak_memory(scene)
                if scene == worlds.BUILTIN:
                    rows.append(benchmark.generation())
            report("comparing golden images", 2, 3)
            golden = verify.verify()
            rows += benchmark.agreement(golden)
        cells = [(name, f"{value:.6g}", unit) for name, value, unit in rows]
        files.write_csv(folder / "bench.csv", ("name", "value", "unit"), cells)
    console = Console(soft_wrap=True, highlight=False)
    console.print(terminal.table(("Quantity", "Value", "Unit"), cells, right=(1,)))
    console.print(f"\nWrote {place / 'bench.csv'}", markup=False)
    if not all(each.holds for each in golden):
        console.print("The golden images are others here: see `ataa verify`.")
        raise typer.Exit(1)
