"""One method over a camera path, as files: frames, masks, counts, times and a video."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax import files, memory, methods
from ataa_jax.capture import results
from ataa_jax.capture.record import Capture
from ataa_jax.journal import Journal
from ataa_jax.methods import Drawer, Options, Runner, Source
from ataa_jax.report import mask_overlay, why_overlay, write_timings

STATISTICS = (
    "frame",
    "fxaa_share",
    "taa_share",
    "ataa_share",
    "rays_per_pixel",
    "overflow_share",
    "shadow_rays",
)


def shoot(
    shot: Source,
    method: str,
    options: Options,
    folder: Path,
    *,
    exr: bool = False,
    journal: Journal | None = None,
    progress: Callable[[str, int, int], None] = lambda text, done, total: None,
) -> list[tuple[str, ...]]:
    """Renders a sequence and writes it.

        frames/NNNN.png   what is shown, sRGB
        exr/NNNN.exr      linear radiance, on request
        mask/NNNN.png     ATAA alone: methods over the greyscale frame; why/: reasons
        statistics.csv    counts of every frame
        video.mp4         all frames
        timings.csv       milliseconds a stage, apart from all else

    Of a capture also, named as its own files are (see `capture.results`):

        antialiased/      linear frames and masks as EXR
        notes.txt         what stood in for rays, and what the checks found

    Args:
        shot: the world along a path, or a capture.
        method: a key of `methods.METHODS`.
        options: frames, lead-in, budget and parameters.
        folder: where to.
        exr: also write linear frames.
        journal: in `folder`; frames that it holds are not rendered again.
        progress: told what is done, and how many of how many steps.

    Returns:
        The rows of `statistics.csv`.
    """
    runner = methods.runner(method, shot, options)
    drawer = Drawer(shot)
    first = -options.lead_in if runner.temporal else 0
    rows: list[tuple[str, ...]] = []
    begin = first
    if journal is not None and journal.step is not None:
        with suppress(KeyError):
            runner.state = journal.latest(runner.state)
            rows = [tuple(row) for row in journal.facts]
            begin = journal.step + 1
    with methods.warming([runner], shot):
        for index in range(begin, options.frames):
            drawer.start(index)
            image = runner.run(index, drawer)
            if index >= 0:
                _write_frame(folder, index, image, runner, exr=exr)
                rows.append(_statistics(index, runner))
                if isinstance(shot, Capture):
                    output = getattr(runner, "output", None)
                    output = output if runner.method is not None else None
                    rays = rays_of(shot, method)
                    results.write(folder, shot, index, image, output, rays)
            if journal is not None:
                journal.commit(index, runner.state, rows)
            progress(
                f"frame {max(index + 1, 0)}", index - first + 1, options.frames - first
            )
    files.write_csv(folder / "statistics.csv", STATISTICS, rows)
    write_timings({method: runner.steady()}, memory.peak(), folder / "timings.csv")
    shown = (_read(folder / f"frames/{i:04d}.png") for i in range(options.frames))
    if isinstance(shot, Capture):
        text = "".join(f"{note}\n" for note in shot.notes)
        files.write_text(folder / "notes.txt", text)
    fps = shot.fps if isinstance(shot, Capture) else shot.path.fps
    files.write_video(folder / "video.mp4", shown, fps)
    return rows


def rays_of(shot: Capture, method: str) -> str:
    """Returns what a capture's frames owe to rays, for their headers."""
    if not method.startswith("ataa"):
        return "no ray was traced, and none asked for"
    return shot.stand_in(int(method[4]))[1]


def _write_frame(
    folder: Path, index: int, image: np.ndarray, runner: Runner, *, exr: bool
) -> None:
    shown = np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    files.write_png(folder / f"frames/{index:04d}.png", shown)
    if runner.method is not None and runner.why is not None:
        overlay = mask_overlay(shown, runner.method)
        files.write_png(folder / f"mask/{index:04d}.png", overlay)
        reasons = why_overlay(shown, runner.why)
        files.write_png(folder / f"why/{index:04d}.png", reasons)
    if exr:
        # FXAA works on the display image, so the one linear image that holds what all
        # stages did is the display image taken back.
        decoded = colors.srgb_decode(jnp.asarray(image, jnp.float32))
        linear = np.asarray(colors.inverse_tonemap(decoded))
        files.write_exr(folder / f"exr/{index:04d}.exr", linear)


def _read(file: Path) -> np.ndarray:
    from PIL import Image

    with Image.open(file) as picture:
        return np.asarray(picture.convert("RGB"))


def _statistics(index: int, runner: Runner) -> tuple[str, ...]:
    """Returns a row of counts; cells that mean nothing for the method are empty."""
    shares = [
        files.decimals(runner.shares[name], 6) if name in runner.shares else ""
        for name in STATISTICS[1:-1]
    ]
    shadow = getattr(runner, "shadow_rays", None)
    return (str(index), *shares, "" if shadow is None else str(shadow))
