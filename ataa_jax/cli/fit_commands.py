"""The command line's part for fits: `ataa fit` and `ataa export`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from ataa_jax.cli import fit_sources, given, terminal, workers
from ataa_jax.errors import InputError

if TYPE_CHECKING:
    from ataa_jax.fit import Fitted, Standing

Scenes = Annotated[
    list[str],
    typer.Argument(
        metavar="SCENE…",
        help="What to fit to: files or the word 'builtin', each with a camera path "
        "after an @ if not a walk, such as sponza.glb@pan; or captures' folders.",
    ),
]
FitBudget = Annotated[
    float, typer.Option(metavar="RAYS_PER_PIXEL", help="Sparse rays a pixel to spend.")
]
Held = Annotated[
    list[str] | None,
    typer.Option("--holdout", metavar="SCENE", help="Scored, not fitted; repeatable."),
]
FitSize = Annotated[
    str | None,
    typer.Option(
        metavar="WxH",
        help="Image size in pixels: 320x180, or that of the captures given.",
    ),
]
FitFrames = Annotated[
    int, typer.Option(help="Frames to score; of a capture, those that it has.")
]
FitReferenceSamples = Annotated[
    int | None,
    typer.Option(help="Samples a pixel of a scene's truth; 64 by default."),
]
ResultFile = Annotated[
    Path, typer.Option("--output", "-o", metavar="FILE", help="The parameters, TOML.")
]
Terms = Annotated[
    str,
    typer.Option(
        metavar="NAMES", help="Criteria to weigh, with commas; the first weighs 1."
    ),
]
_HEADS = ("scene", "TAA", "random", "equal", "fitted", "oracle", "closed", "carried")


def fit(
    scene: Scenes,
    budget: FitBudget = 0.48,
    holdout: Held = None,
    size: FitSize = None,
    frames: FitFrames = 12,
    lead_in: given.LeadIn = 8,
    reference_samples: FitReferenceSamples = None,
    motion: given.Motion = None,
    terms: Terms = "luminance,depth,response",
    reading: Annotated[str, typer.Option(help="sum or either.")] = "sum",
    solver: Annotated[str, typer.Option(help="Relaxed: lm, bfgs, none.")] = "lm",
    starts: Annotated[int, typer.Option(help="Starts of the relaxed fit.")] = 1,
    steps: Annotated[int, typer.Option(help="Of Nelder–Mead; 0: none.")] = 8,
    taa: Annotated[bool, typer.Option("--taa", help="Also TAA's own numbers.")] = False,
    seed: Annotated[int, typer.Option(help="Of all that is drawn by chance.")] = 0,
    output: ResultFile = Path("params.toml"),
    jobs: given.Jobs = 1,
    scheduler: given.Scheduler = None,
    traceback: given.Traceback = False,
) -> None:
    """Fits the segmentation's weights and threshold to a ray budget."""
    extent = None if size is None else given.size_of(size)
    given.at_least("--frames", frames, 1)
    given.at_least("--lead-in", lead_in, 0)
    if reference_samples is not None:
        given.at_least("--reference-samples", reference_samples, 1)
    given.at_least("--starts", starts, 1)
    given.at_least("--steps", steps, 0)
    for name, value, known in (
        ("--reading", reading, ("sum", "either")),
        ("--solver", solver, ("lm", "bfgs", "none")),
    ):
        if value not in known:
            raise InputError(f"{name} must be one of {', '.join(known)}, not '{value}'")
    if output.suffix.lower() != ".toml":
        raise InputError(f"--output must be a .toml file, not '{output}'")
    workers.check(jobs, scheduler)
    from ataa_jax import cache, files
    from ataa_jax import fit as fits

    files.check_writable(output)
    fits.check_budget(budget)
    if extent is not None:
        fits.check_size(extent)
    also = ("taa.count_limit", "resolve.traced_count") if taa else ()
    options = fits.Options(
        budget=budget,
        terms=tuple(term.strip() for term in terms.split(",") if term.strip()),
        quantities=(*fits.Options().quantities, *also),
        reading=reading,  # pyright: ignore[reportArgumentType]
        solver=solver,  # pyright: ignore[reportArgumentType]
        starts=starts,
        steps=steps,
        seed=seed,
    )
    fits.check_options(options)
    asked = fit_sources.Asked(
        size=extent,
        motion=motion,
        frames=frames,
        lead_in=lead_in,
        reference_samples=reference_samples,
    )
    with terminal.progress() as report:
        texts = (*scene, *(holdout or ()))
        planned = fit_sources.plan(texts, asked, lambda text: report(text, 0, 1))
        fits.check_budget(budget, planned.samples)
        fits.check_size(planned.size)
        if planned.captures:
            fits.check_terms(options.terms)
        recorded, hashes = [], {}
        with workers.workers(jobs, scheduler, needed=planned.renders) as crew:
            for made, content in fit_sources.record(planned, report, crew):
                recorded.append(made)
                hashes[made.name] = content
        seen, unseen = recorded[: len(scene)], recorded[len(scene) :]
        kept = fits.checkpoints_of(seen, options, cache.folder() / "fit")
        found = fits.fit(
            seen, options, held_out=unseen, checkpoints=kept, progress=report
        )
    fits.write(found, hashes, output)
    _show(found, output, workers.notes(jobs, scheduler, needed=planned.renders))


def _show(found: "Fitted", output: Path, notes: list[str]) -> None:
    console = Console(soft_wrap=True, highlight=False)
    rows = [_row(each, "") for each in found.standings]
    rows += [_row(each, " *") for each in found.held_out]
    right = tuple(range(1, len(_HEADS)))
    console.print(terminal.table(_HEADS, rows, right=right))
    told = [
        f"all at {found.options.budget:g} rays a pixel, by thresholds of their own; "
        "carried: the file untouched",
        *(["*: held out"] if found.held_out else []),
        *found.notes,
        *notes,
    ]
    terminal.notes(console, told)
    console.print(f"\nWrote {output}; use it with --params", markup=False)


def _row(standing: "Standing", suffix: str) -> tuple[str, ...]:
    s = standing
    scores = (s.taa, s.random, s.equal, s.fitted, s.oracle)
    return (
        s.scene + suffix,
        *(f"{value:.4f}" for value in scores),
        f"{s.closed:.2f}",
        f"{s.carried:.4f}",
    )


def export(
    params: Annotated[Path, typer.Argument(metavar="PARAMS", help="A TOML file.")],
    to: Annotated[str, typer.Option("--to", help="hlsl, glsl or json.")] = "hlsl",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="In place of the screen."),
    ] = None,
    traceback: given.Traceback = False,
) -> None:
    """Writes fitted numbers as constants for an engine."""
    from ataa_jax import files, parameters
    from ataa_jax import fit as fits

    text = fits.export(parameters.read(params), to, params.name)
    if output is None:
        sys.stdout.write(text)
    else:
        files.write_text(output, text)
