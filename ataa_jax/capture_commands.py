"""The command line's part for captures: `ataa check`, and captures in place of scenes.

As in `cli`: arguments in, files out, no mathematics; JAX is imported inside.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ataa_jax.errors import InputError

if TYPE_CHECKING:
    from ataa_jax import methods
    from ataa_jax.capture import Capture
    from ataa_jax.capture.check import Report


def given(scene: str) -> bool:
    """Returns whether the command's argument names a capture: see `capture.load`."""
    place = Path(scene)
    sequence = place.suffix == ".json" and place.stem.isdecimal()
    return sequence or (bool(scene) and place.is_dir())


def believed(scene: str, frames: int, lead_in: int) -> tuple["Report", int]:
    """Loads a capture, checks it before it is believed, and parts its frames.

    Args:
        scene: the folder.
        frames: frames to show, at least 1.
        lead_in: frames before them, at least 0.

    Returns:
        The report, with the capture after its lead-in, and the frames to show: those
        asked for, or what the capture has left.

    Raises:
        InputError: no capture, or one that contradicts itself.
    """
    from ataa_jax import capture as captures
    from ataa_jax.capture import check

    report = check.check(captures.load(scene))
    check.refuse(report)
    total = len(report.capture.frames)
    # our choice: at most a third of the frames; the first are drawn to no score.
    lead_in = min(lead_in, (total - 1) // 3)
    capture = report.capture.after(lead_in)
    return replace(report, capture=capture), min(frames, total - lead_in)


def told(report: "Report") -> list[str]:
    """Returns what the layout's reader and the checks have to say, in sentences."""
    found = [f"{f.severity}: {f.sentence}" for f in report.findings]
    return [*report.capture.notes, *found]


def prepare(
    scene: str,
    camera: str | None,
    motion: str | None,
    params: Path | None,
    names: tuple[str, ...],
    options: dict[str, Any],
) -> tuple["Capture", "methods.Options"]:
    """Loads a capture, and checks it before it is believed.

    Args:
        scene: the folder.
        camera: refused, a capture has its own.
        motion: likewise.
        params: file with numbers in place of the tuned preset's.
        names: methods that will run.
        options: of `methods.Options`.

    Raises:
        InputError: no capture, or one that contradicts itself.
    """
    from ataa_jax import methods, parameters, pipeline

    if camera is not None or motion is not None:
        raise InputError(
            "a capture has its own camera; leave out --camera and --motion"
        )
    if options.pop("effects", None) is not None:
        raise InputError(
            "a capture holds the effects that its engine drew; leave out --effects"
        )
    report, frames = believed(scene, options["frames"], options.get("lead_in", 0))
    capture = report.capture
    budget = options.pop("budget", None)
    given_budget = pipeline.BUDGET if budget is None else budget
    if not given_budget >= 0.0:
        raise InputError(f"--budget must be at least 0 rays a pixel, not {budget}")
    if params is not None:
        table = parameters.read(params)
        config, numbers = pipeline.preset(
            "tuned", None, capture.size, budget=given_budget
        )
        where = f"parameter file {params}"
        options["params"] = parameters.override(numbers, table, where)
        options["segmentation"] = parameters.choices(table, config.segmentation, where)
        if budget is None:
            given_budget = float(options["params"].budget)
    options |= {
        "frames": frames,
        "lead_in": capture.first,
        "budget": given_budget,
        "reference_samples": capture.reference_samples or 1,
        "average": capture.conventions.average,
    }
    if names:
        options["methods"] = names
    elif "methods" not in options:
        options["methods"] = methods.captured_methods(capture)
    notes = [*told(report), *_rays(capture, options["methods"])]
    if "center" not in capture.frames[0].layers:
        notes.append("the capture has no sample at the pixel centre: No AA and FXAA "
                     "show its jittered frames")  # fmt: skip
    return replace(capture, notes=notes), methods.Options(**options)


def _rays(capture: "Capture", methods: tuple[str, ...]) -> list[str]:
    """Returns the sentences that say what stood in for rays."""
    counts = {int(m[4]) for m in methods if m.startswith("ataa")}
    return [capture.stand_in(count)[1] for count in sorted(counts)]


def check_folder(folder: str) -> int:
    """Prints what is found about a capture.

    Returns:
        Exit code: 0, or 2 where the capture contradicts itself.
    """
    from rich.console import Console

    from ataa_jax import capture as captures
    from ataa_jax.capture import check

    report = check.check(captures.load(folder))
    capture = report.capture
    console = Console(soft_wrap=True, highlight=False, markup=False)
    height, width = capture.size
    console.print(
        f"{capture.name}: {capture.layout} layout, {len(capture.frames)} frames, "
        f"{width}×{height}"
    )
    for name, value in _facts(capture, report.facts):
        console.print(f"  {name}: {value}")
    for note in capture.notes:
        console.print(f"note: {note}")
    for finding in report.findings:
        place = f" ({finding.where})" if finding.where else ""
        console.print(f"{finding.severity}: {finding.name}{place}")
        console.print(f"  {finding.evidence}")
        console.print(f"  remedy: {finding.remedy}")
    if not report.errors:
        console.print("no contradiction between metadata and images was found")
    return 2 if report.errors else 0


def _facts(
    capture: "Capture", measured: list[tuple[str, str]]
) -> list[tuple[str, str]]:
    """Returns how the capture is read, then what was measured."""
    c = capture.conventions
    rays = ", ".join(str(n) for n in capture.sample_counts) or "none"
    reference = capture.reference_samples
    samples = "of unknown samples" if reference == 0 else f"{reference} samples a pixel"
    return [
        ("colour", f"{c.color}, means taken {c.average}"),
        (
            "motion",
            f"{c.motion_sign}, {c.motion_unit}, y {c.motion_y}, axes {c.motion_axes}, "
            f"jitter {'inside' if c.motion_jittered else 'removed'}",
        ),
        ("depth", c.depth),
        ("reference", "none" if reference is None else samples),
        ("images of several samples a pixel", rays),
        *measured,
    ]
