"""The command line: arguments in, files out, no mathematics.

Results appear in the output folder all at once, when they are complete (see `files`).
A user's mistake is one line on standard error and exit code 2; `--traceback` shows
where it came from. What needs JAX is imported inside the commands, so that `--help`
answers at once.
"""

import sys
import traceback as tracebacks
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from typer.core import TyperGroup

from ataa_jax import capture_commands
from ataa_jax.errors import InputError

if TYPE_CHECKING:
    from ataa_jax import compare, world

MAX_SIDE = 16384
_SHOWN_ROWS = 24  # of `statistics.csv`, in the terminal
BAD_INPUT, INTERRUPTED, FAILED = 2, 130, 1

Report = Callable[[str, int, int], None]


class _Group(TyperGroup):
    """Turns Ctrl-C inside a command into one line, before typer sees it."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise typer.Exit(INTERRUPTED) from None


app = typer.Typer(
    cls=_Group,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Adaptive temporal antialiasing: render, compare and measure.",
)

Scene = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        help="A .glb, .gltf or mesh file, the folder of a capture, or the word "
        "'builtin'.",
    ),
]
Size = Annotated[str, typer.Option(metavar="WxH", help="Image size in pixels.")]
Frames = Annotated[int, typer.Option(help="Frames to render, at least 1.")]
Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        help="Method, or several with commas or by repeating: none, fxaa, taa, ataa2, "
        "ataa4, ataa8, ssaa2 … ssaa16; taa_ue4 and ataa8_ue4 use the literature's "
        "constants. All by default.",
    ),
]
Method = Annotated[
    str, typer.Option(help="none, fxaa, taa, ataa2, ataa4, ataa8, ssaa2 … ssaa16.")
]
CameraOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="A camera of the scene, a kind of path (still, pan, orbit, dolly, walk), "
        "CAMERA:KIND, or a TOML file as in data/. A walk by default.",
    ),
]
Motion = Annotated[
    str | None,
    typer.Option(
        metavar="SPEED",
        help="typical (1 % of the width a frame), rapid (10 %), or a share such as "
        "0.02.",
    ),
]
ParamsOption = Annotated[
    Path | None,
    typer.Option(
        "--params",
        metavar="FILE",
        help="TOML with numbers in place of the tuned preset's.",
    ),
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Where results go; new or empty.")
]
Budget = Annotated[
    float | None,
    typer.Option(
        help="Sparse rays a pixel of the frame, or inf; 0.5 unless --params says."
    ),
]
ReferenceSamples = Annotated[int, typer.Option(help="Samples a pixel of the truth.")]
LeadIn = Annotated[int, typer.Option(help="Frames before the first that is kept.")]
Preset = Annotated[str, typer.Option(help="TAA constants: tuned or ue4.")]
Traceback = Annotated[
    bool, typer.Option("--traceback", help="Show where an error came from.")
]


@app.command()
def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where results go.")] = Path(
        "out/demo"
    ),
    size: Size = "640x360",
    frames: Frames = 4,
    reference_samples: ReferenceSamples = 16,
    traceback: Traceback = False,
) -> None:
    """Shows on the built-in scene what ATAA does, in about a minute."""
    _compare(
        "builtin",
        size=size,
        names=["none", "fxaa", "taa", "ataa8", "ssaa8"],
        camera=None,
        motion=None,
        params=None,
        out=out,
        options={"frames": frames, "reference_samples": reference_samples},
    )
    console = Console(soft_wrap=True)
    console.print(
        f"\nLook at [bold]{out / 'hero.png'}[/bold] first: one crop and the whole "
        "frame, without antialiasing, with TAA, with ATAA, the truth, and the mask."
        "\nRed pixels had no history and got FXAA, blue ones TAA is right about, "
        "yellow ones were traced.\nThen open "
        f"[bold]{out / 'index.html'}[/bold] in a browser and drag the divider between "
        "any two methods.",
        highlight=False,
    )


@app.command()
def info(
    scene: Scene,
    traceback: Traceback = False,
) -> None:
    """Tells what a scene holds, and which effects will be rendered, and why."""
    from ataa_jax import effects
    from ataa_jax import world as worlds

    with _progress() as report:
        report("loading the scene", 0, 1)
        loaded = worlds.load(scene)
    source, console = loaded.source, Console(highlight=False)
    triangles = sum(len(mesh.triangles) for mesh in source.meshes)
    moving = f"{source.duration:.2f} s, loops" if source.duration else "none"
    facts = [
        ("Triangles", f"{triangles:,}"),
        ("Objects", f"{len(source.meshes):,}"),
        ("Materials", f"{len(source.materials):,}"),
        ("Textures", f"{len(source.textures):,}"),
        ("Rigid groups", f"{len(source.group_names):,}"),
        ("Animation", moving),
        ("Exposure", f"{loaded.exposure:.4g}"),
    ]
    console.print(f"[bold]{loaded.name}[/bold]")
    console.print(_table((), [(name, value) for name, value in facts]))
    console.print("\n[bold]Cameras[/bold]")
    rows = [
        (c.name, _vector(c.world_from_view[:3, 3]), f"{_degrees(c.fov_y):.1f}°")
        for c in loaded.cameras
    ]
    console.print(_table(("Name", "Position", "Vertical field"), rows))
    console.print("\n[bold]Lights[/bold]")
    kinds = ("directional", "point", "spot")
    lights = [(li.name, kinds[li.kind], _vector(li.intensity)) for li in loaded.lights]
    console.print(_table(("Name", "Kind", "Intensity (lux or cd)"), lights))
    console.print("\n[bold]Effects[/bold]")
    looked = [
        (e.name, "on" if e.on else "off", e.reason) for e in effects.look(loaded.scene)
    ]
    console.print(_table(("Effect", "", "Reason"), looked))
    _notes(console, loaded.notes)


@app.command()
def run(
    scene: Scene,
    size: Size = "640x360",
    frames: Frames = 12,
    method: Method = "ataa8",
    preset: Preset = "tuned",
    camera: CameraOption = None,
    motion: Motion = None,
    budget: Budget = None,
    lead_in: LeadIn = 0,
    params: ParamsOption = None,
    exr: Annotated[bool, typer.Option("--exr", help="Also linear OpenEXR.")] = False,
    out: Out = None,
    traceback: Traceback = False,
) -> None:
    """Renders a scene along a camera path by one method."""
    extent = _size(size)
    _at_least("--frames", frames, 1)
    _at_least("--lead-in", lead_in, 0)
    with _output(out or Path("out") / f"{_stem(scene)}-{method}") as (folder, final):
        from ataa_jax import compare, film

        (name,) = compare.check_methods([method])
        if preset not in ("tuned", "ue4"):
            raise InputError(f"unknown preset '{preset}'; known are tuned, ue4")
        if preset == "ue4" and name.startswith(("taa", "ataa")):
            name = name.removesuffix("_ue4") + "_ue4"
        if name.endswith("_ue4") and params is not None:
            raise InputError(
                "--params changes the tuned preset; leave out --preset ue4 and the "
                "methods that end in _ue4"
            )
        options = {"frames": frames, "lead_in": lead_in, "budget": budget}
        with _progress() as report:
            if capture_commands.given(scene):
                shot, chosen = capture_commands.prepare(
                    scene, camera, motion, params, (name,), options
                )
            else:
                shot, chosen = _prepare(
                    scene, extent, camera, motion, params, report, options
                )
            rows = film.shoot(shot, name, chosen, folder, exr=exr, progress=report)
    console = Console(soft_wrap=True, highlight=False)
    heads = ("frame", "FXAA", "TAA", "ATAA", "rays/px", "over budget", "shadow rays")
    if any(row[1] for row in rows):
        console.print(_table(heads, rows[:_SHOWN_ROWS]))
    _notes(console, compare.notes(shot))
    console.print(f"\nWrote {final}: frames/, video.mp4, statistics.csv, timings.csv")


@app.command(name="compare")
def compare_command(
    scene: Scene,
    size: Size = "640x360",
    frames: Frames = 12,
    method: Methods = None,
    camera: CameraOption = None,
    motion: Motion = None,
    budget: Budget = None,
    reference_samples: ReferenceSamples = 64,
    lead_in: LeadIn = 8,
    params: ParamsOption = None,
    out: Out = None,
    traceback: Traceback = False,
) -> None:
    """Renders a scene by every method, and scores all against a supersampled truth."""
    _compare(
        scene,
        size=size,
        names=method,
        camera=camera,
        motion=motion,
        params=params,
        out=out or Path("out") / _stem(scene),
        options={
            "frames": frames,
            "lead_in": lead_in,
            "budget": budget,
            "reference_samples": reference_samples,
        },
    )


@app.command()
def check(
    capture: Annotated[
        Path, typer.Argument(metavar="CAPTURE", help="The folder of a capture.")
    ],
    traceback: Traceback = False,
) -> None:
    """Tells whether a capture's images agree with its metadata, and what to mend."""
    raise typer.Exit(capture_commands.check_folder(str(capture)))


@app.command()
def bench(
    scene: Scene,
    size: Size = "640x360",
    camera: CameraOption = None,
    budget: Budget = None,
    out: Out = None,
    traceback: Traceback = False,
) -> None:
    """Measures a scene: rays a second, stages of a frame, peak memory."""
    extent = _size(size)
    place = out or Path("out") / f"{_stem(scene)}-bench"
    with _output(place) as (folder, final):
        from ataa_jax import bench as benchmark
        from ataa_jax import files, paths
        from ataa_jax import world as worlds

        name = paths.load(camera).camera if camera else None
        with _progress() as report:
            report("loading the scene", 0, 2)
            loaded = worlds.load(scene, camera=name)
            report("measuring", 1, 2)
            rows = benchmark.run(
                loaded, extent, camera, 0.5 if budget is None else budget
            )
        cells = [(name, f"{value:.6g}", unit) for name, value, unit in rows]
        files.write_csv(folder / "bench.csv", ("name", "value", "unit"), cells)
    console = Console(soft_wrap=True, highlight=False)
    console.print(_table(("Quantity", "Value", "Unit"), cells, right=(1,)))
    console.print(f"\nWrote {final / 'bench.csv'}")


def _compare(
    scene: str,
    *,
    size: str,
    names: list[str] | None,
    camera: str | None,
    motion: str | None,
    params: Path | None,
    out: Path,
    options: dict[str, Any],
) -> None:
    """The body of `compare` and `demo`."""
    extent = _size(size)
    _at_least("--frames", options["frames"], 1)
    _at_least("--lead-in", options.get("lead_in", 0), 0)
    _at_least("--reference-samples", options["reference_samples"], 1)
    with _output(out) as (folder, final):
        from ataa_jax import compare, report

        if names:
            split = [part.strip() for name in names for part in name.split(",")]
            options["methods"] = compare.check_methods(dict.fromkeys(split))
        with _progress() as tell:
            if capture_commands.given(scene):
                shot, chosen = capture_commands.prepare(
                    scene, camera, motion, params, options.pop("methods", ()), options
                )
            else:
                shot, chosen = _prepare(
                    scene, extent, camera, motion, params, tell, options
                )
            result = compare.compare(shot, chosen, tell)
            report.write(
                result, folder, progress=lambda text: tell(f"writing {text}", 1, 1)
            )
    console = Console(soft_wrap=True, highlight=False)
    Console(highlight=False).print(report.terminal(result))
    _notes(console, result.notes)
    console.print(
        f"\nWrote {final}: index.html, strip.png, hero.png, scores.csv, frames.csv, "
        "plots/, frames/, mask/, why/, timings.csv"
    )


def _prepare(
    scene: str,
    extent: tuple[int, int],
    camera: str | None,
    motion: str | None,
    params: Path | None,
    report: Report,
    options: dict[str, Any],
) -> tuple["world.Sequence", "compare.Options"]:
    """Loads everything that a sequence needs, and checks it before any frame."""
    from ataa_jax import compare, parameters, paths, pipeline
    from ataa_jax import world as worlds

    path = paths.load(camera or "walk", motion)
    given = options.pop("budget", None)
    budget = 0.5 if given is None else given
    if not budget >= 0.0:
        raise InputError(f"--budget must be at least 0 rays a pixel, not {budget}")
    table = parameters.read(params) if params is not None else {}
    report("loading the scene", 0, 1)
    loaded = worlds.load(scene, camera=path.camera)
    if table:
        _, numbers = pipeline.preset("tuned", loaded.scene, extent, budget=budget)
        where = f"parameter file {params}"
        options["params"] = parameters.override(numbers, table, where)
        if given is None:  # the file's budget counts, but the command line wins
            budget = float(options["params"].budget)
    options["budget"] = budget
    return worlds.sequence(loaded, path, extent), compare.Options(**options)


def _size(text: str) -> tuple[int, int]:
    """Returns (height, width) of a text such as 640x360."""
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) == 2 and all(part.isdecimal() and len(part) < 6 for part in parts):
        width, height = (int(part) for part in parts)
        if 1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE:
            return height, width
    raise InputError(
        f"--size must be WIDTHxHEIGHT with 1 to {MAX_SIDE} pixels a side, such as "
        f"640x360, not '{text}'"
    )


def _at_least(name: str, value: int, least: int) -> None:
    if value < least:
        raise InputError(f"{name} must be at least {least}, not {value}")


def _stem(scene: str) -> str:
    return Path(scene).stem or "scene"


@contextmanager
def _output(out: Path) -> Iterator[tuple[Path, Path]]:
    """Yields the folder to write into and its final name; see `files.output_folder`."""
    from ataa_jax import files

    with files.output_folder(out) as folder:
        yield folder, out


@contextmanager
def _progress() -> Iterator[Report]:
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


def _table(
    heads: tuple[str, ...],
    rows: list[tuple[str, ...]],
    right: tuple[int, ...] = (),
) -> Table:
    table = Table(box=None, pad_edge=False, show_header=bool(heads), header_style="dim")
    for index in range(len(heads or rows[0])):
        side = "right" if index in right else "left"
        table.add_column(heads[index] if heads else "", justify=side)
    for row in rows:
        table.add_row(*row)
    return table


def _vector(values: Any) -> str:
    return ", ".join(f"{float(value):.4g}" for value in values)


def _degrees(radians: float) -> float:
    return radians * 57.29577951308232


def _notes(console: Console, notes: list[str]) -> None:
    if notes:
        console.print("\n[bold]Notes[/bold]")
    for note in notes:
        console.print(f"  {note}", markup=False)


@app.callback(invoke_without_command=True)
def _options(
    version: Annotated[bool, typer.Option("--version", help="Show it.")] = False,
) -> None:
    if version:
        typer.echo(metadata.version("ataa-jax"))
        raise typer.Exit


def main(arguments: list[str] | None = None) -> int:
    """Runs the command line.

    Args:
        arguments: without the program's name; the process's own by default.

    Returns:
        Exit code: 0, 2 for a user's mistake, 130 when interrupted, 1 for a failure of
        the program itself.
    """
    given = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    code, message = FAILED, ""
    try:
        result = app(args=given, prog_name="ataa", standalone_mode=False)
        code = result if isinstance(result, int) else 0
        message = "interrupted" if code == INTERRUPTED else ""
    except InputError as error:
        code, message = BAD_INPUT, str(error)
        _traceback(given)
    except (KeyboardInterrupt, typer.Abort):
        code, message = INTERRUPTED, "interrupted"
    except MemoryError:
        message = "out of memory; try a smaller --size"
        _traceback(given)
    except Exception as error:
        # typer's own usage errors; which class, depends on its version.
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            code, message = BAD_INPUT, error.format_message()  # type: ignore[attr-defined]
        else:
            message = (
                f"unexpected {type(error).__name__}: {error}; --traceback shows where"
            )
        _traceback(given)
    if message:
        line = " ".join(message.split())
        print(f"error: {line}" if code != INTERRUPTED else line, file=sys.stderr)
    return code


def _traceback(given: list[str]) -> None:
    if "--traceback" in given:
        tracebacks.print_exc()


if __name__ == "__main__":
    sys.exit(main())
