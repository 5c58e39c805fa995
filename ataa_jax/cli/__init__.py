"""The command line: arguments in, files out, no mathematics.

Results appear in the output folder all at once, when they are complete (see `files`).
A user's mistake is one line on standard error and exit code 2; `--traceback` shows
where it came from. What needs JAX is imported inside the commands, so that `--help`
answers at once.
"""

import gc
import sys
import traceback as tracebacks
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer.core import TyperGroup

from ataa_jax import capture_commands, errors, programs
from ataa_jax.cli import (
    bench_command,
    cache_commands,
    fit_commands,
    given,
    loading,
    reference_command,
    terminal,
    verify_command,
    workers,
)
from ataa_jax.errors import InputError

if TYPE_CHECKING:
    from ataa_jax import methods, world

_LONGEST = 900  # characters of a message. our choice: a long path and a sentence
_SHOWN_ROWS = 24  # of `statistics.csv`, in the terminal
BAD_INPUT, INTERRUPTED, FAILED = 2, 130, 1
# our choice: some thirty times Python's. Nearly all that imports and traces make stays,
# and to look through it again and again took a twentieth of a start.
_COLLECT_AFTER = 20_000


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


@app.command()
def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where results go.")] = Path(
        "out/demo"
    ),
    size: given.Size = "640x360",
    frames: given.Frames = 4,
    reference_samples: given.ReferenceSamples = 16,
    traceback: given.Traceback = False,
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
    scene: given.Scene,
    effects: given.Effects = None,
    traceback: given.Traceback = False,
) -> None:
    """Tells what a scene holds, and which effects will be rendered, and why."""
    from ataa_jax import world as worlds

    wish = loading.wish(effects)
    with terminal.progress() as report:
        report("loading the scene", 0, 1)
        loaded = worlds.load(scene, wish=wish)
    terminal.describe(loaded)


@app.command()
def run(
    scene: given.Scene,
    size: given.Size = "640x360",
    frames: given.Frames = 12,
    method: given.Method = "ataa8",
    preset: given.Preset = "tuned",
    camera: given.CameraOption = None,
    motion: given.Motion = None,
    budget: given.Budget = None,
    lead_in: given.LeadIn = 0,
    params: given.ParamsOption = None,
    effects: given.Effects = None,
    exr: Annotated[bool, typer.Option("--exr", help="Also linear OpenEXR.")] = False,
    out: given.Out = None,
    traceback: given.Traceback = False,
) -> None:
    """Renders a scene along a camera path by one method."""
    extent = given.size_of(size)
    given.at_least("--frames", frames, 1)
    given.at_least("--lead-in", lead_in, 0)
    if "," in method:
        raise InputError(
            f"--method of `ataa run` takes one method, not '{method}'; `ataa compare` "
            "takes several"
        )
    place = out or Path("out") / f"{loading.stem(scene)}-{method}"
    with _output(place, resume=True) as (folder, final):
        from ataa_jax import compare, film, methods
        from ataa_jax.journal import Journal

        (name,) = methods.check_methods([method])
        name = methods.with_preset(name, preset)
        if params is not None and methods.preset_of(name) != "tuned":
            raise InputError(
                "--params changes the tuned preset; leave out --preset and the methods "
                "that end in a preset's name"
            )
        options = {
            "frames": frames,
            "lead_in": lead_in,
            "budget": budget,
            "effects": effects,
        }
        with terminal.progress() as report:
            if capture_commands.given(scene):
                shot, chosen = capture_commands.prepare(
                    scene, camera, motion, params, (name,), options
                )
            else:
                shot, chosen = _prepare(
                    scene, extent, camera, motion, params, report, options
                )
            key = methods.job_key(shot, f"run {name} {exr}", chosen)
            rows = film.shoot(
                shot, name, chosen, folder,
                exr=exr, journal=Journal(folder, key), progress=report,
            )  # fmt: skip
    console = Console(soft_wrap=True, highlight=False)
    heads = ("frame", "FXAA", "TAA", "ATAA", "rays/px", "over budget", "shadow rays")
    if any(row[1] for row in rows):
        console.print(terminal.table(heads, rows[:_SHOWN_ROWS]))
    terminal.notes(console, compare.notes(shot))
    terminal.wrote(
        console,
        final,
        "frames/ mask/ why/ exr/ video.mp4 statistics.csv timings.csv",
    )


@app.command(name="compare")
def compare_command(
    scene: given.Scene,
    size: given.Size = "640x360",
    frames: given.Frames = 12,
    method: given.Methods = None,
    camera: given.CameraOption = None,
    motion: given.Motion = None,
    budget: given.Budget = None,
    reference_samples: given.ReferenceSamples = 64,
    lead_in: given.LeadIn = 8,
    params: given.ParamsOption = None,
    effects: given.Effects = None,
    jobs: given.Jobs = 1,
    scheduler: given.Scheduler = None,
    out: given.Out = None,
    traceback: given.Traceback = False,
) -> None:
    """Renders a scene by every method, and scores all against a supersampled truth."""
    _compare(
        scene,
        size=size,
        names=method,
        camera=camera,
        motion=motion,
        params=params,
        out=out or Path("out") / loading.stem(scene),
        jobs=jobs,
        scheduler=scheduler,
        options={
            "frames": frames,
            "lead_in": lead_in,
            "budget": budget,
            "reference_samples": reference_samples,
            "effects": effects,
        },
    )


@app.command()
def check(
    capture: Annotated[
        Path, typer.Argument(metavar="CAPTURE", help="The folder of a capture.")
    ],
    traceback: given.Traceback = False,
) -> None:
    """Tells whether a capture's images agree with its metadata, and what to mend."""
    raise typer.Exit(capture_commands.check_folder(str(capture)))


app.command(name="reference")(reference_command.reference)
app.command(name="fit")(fit_commands.fit)
app.command(name="export")(fit_commands.export)
app.command(name="bench")(bench_command.bench)
app.command(name="verify")(verify_command.verify)
app.add_typer(cache_commands.app, name="cache")


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
    jobs: int = 1,
    scheduler: str | None = None,
) -> None:
    """The body of `compare` and `demo`."""
    extent = given.size_of(size)
    given.at_least("--frames", options["frames"], 1)
    given.at_least("--lead-in", options.get("lead_in", 0), 0)
    given.at_least("--reference-samples", options["reference_samples"], 1)
    workers.check(jobs, scheduler)
    renders = not capture_commands.given(scene)
    with _output(out, resume=True) as (folder, final):
        from ataa_jax import compare, methods, report, world
        from ataa_jax.journal import Journal

        if names:
            split = [part.strip() for name in names for part in name.split(",")]
            options["methods"] = methods.check_methods(dict.fromkeys(split))
        with terminal.progress() as tell:
            if not renders:
                shot, chosen = capture_commands.prepare(
                    scene, camera, motion, params, options.pop("methods", ()), options
                )
            else:
                shot, chosen = _prepare(
                    scene, extent, camera, motion, params, tell, options
                )
            key = methods.job_key(shot, "compare", chosen)
            journal = Journal(folder, key)
            if isinstance(shot, world.Sequence):
                begin = 0 if journal.step is None else max(journal.step + 1, 0)
                with workers.workers(jobs, scheduler) as crew:
                    workers.references(
                        crew, scene, shot, range(begin, chosen.frames),
                        chosen.reference_samples, chosen.average, tell,
                    )  # fmt: skip
            result = compare.compare(shot, chosen, tell, journal)
            report.write(
                result, folder, progress=lambda text: tell(f"writing {text}", 1, 1)
            )
    console = Console(soft_wrap=True, highlight=False)
    Console(highlight=False).print(report.terminal(result))
    idle = workers.notes(jobs, scheduler, needed=renders)
    terminal.notes(console, [*result.notes, *idle])
    terminal.wrote(
        console,
        final,
        "index.html strip.png hero.png scores.csv frames.csv plots/ frames/ mask/ why/ "
        "timings.csv",
    )


def _prepare(
    scene: str,
    extent: tuple[int, int],
    camera: str | None,
    motion: str | None,
    params: Path | None,
    report: terminal.Report,
    options: dict[str, Any],
) -> tuple["world.Sequence", "methods.Options"]:
    """Loads everything that a sequence needs, and checks it before any frame."""
    from ataa_jax import methods, parameters, pipeline
    from ataa_jax import world as worlds

    asked = options.pop("budget", None)
    budget = pipeline.BUDGET if asked is None else asked
    if not budget >= 0.0:
        raise InputError(f"--budget must be at least 0 rays a pixel, not {budget}")
    wish = loading.wish(options.pop("effects", None))
    table = parameters.read(params) if params is not None else {}
    report("loading the scene", 0, 1)
    loaded, path = loading.load(scene, camera, motion, extent, wish)
    if table:
        config, numbers = pipeline.preset("tuned", loaded.scene, extent, budget=budget)
        where = f"parameter file {params}"
        options["params"] = parameters.override(numbers, table, where)
        options["segmentation"] = parameters.choices(table, config.segmentation, where)
        if asked is None:  # the file's budget counts, but the command line wins
            budget = float(options["params"].budget)
    options["budget"] = budget
    return worlds.sequence(loaded, path, extent), methods.Options(**options)


@contextmanager
def _output(out: Path, *, resume: bool = False) -> Iterator[tuple[Path, Path]]:
    """Yields the folder to write into and its final name; see `files.output_folder`."""
    from ataa_jax import files

    with files.output_folder(out, resume=resume) as folder:
        yield folder, out


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
    words = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    code, message = FAILED, ""
    programs.keep()
    gc.set_threshold(_COLLECT_AFTER)
    try:
        result = app(args=words, prog_name="ataa", standalone_mode=False)
        code = result if isinstance(result, int) else 0
        message = "interrupted" if code == INTERRUPTED else ""
    except InputError as error:
        code, message = BAD_INPUT, str(error)
        _traceback(words)
    except (KeyboardInterrupt, typer.Abort):
        code, message = INTERRUPTED, "interrupted"
    except MemoryError:
        message = "out of memory; try a smaller --size"
        _traceback(words)
    except Exception as error:
        # typer's own usage errors; which class, depends on its version.
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            code, message = BAD_INPUT, error.format_message()  # type: ignore[attr-defined]
        elif errors.INTERRUPTED in str(error):  # Ctrl-C while rays were traced
            code, message = INTERRUPTED, "interrupted"
        else:
            message = (
                f"unexpected {type(error).__name__}: {error}; --traceback shows where"
            )
        _traceback(words)
    if message:
        line = " ".join(message.split())
        if len(line) > _LONGEST:  # it quotes what a file holds
            line = f"{line[: _LONGEST * 2 // 3]} … {line[-_LONGEST // 3 :]}"
        print(f"error: {line}" if code != INTERRUPTED else line, file=sys.stderr)
    if arguments is None:
        gc.freeze()  # the process ends: half a second is saved where all is left to it
    return code


def _traceback(words: list[str]) -> None:
    if "--traceback" in words:
        tracebacks.print_exc()
