"""Who renders what the commands need dearly: the command itself, or workers before it.

As in `cli`: JAX is imported inside.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ataa_jax.cli.terminal import Report
from ataa_jax.errors import InputError

if TYPE_CHECKING:
    from ataa_jax import world
    from ataa_jax.color import Average
    from ataa_jax.jobs import Crew


def check(jobs: int, scheduler: str | None) -> None:
    """Refuses numbers of workers that make no sense."""
    if jobs < 1:
        raise InputError(f"--jobs must be at least 1, not {jobs}")
    if scheduler is not None and jobs != 1:
        raise InputError(
            "--jobs counts processes on this machine, and a scheduler has workers of "
            "its own; leave out --jobs or --scheduler"
        )


@contextmanager
def workers(
    jobs: int, scheduler: str | None, *, needed: bool = True
) -> Iterator["Crew | None"]:
    """Yields who renders beforehand; None: nobody, or there is nothing to render."""
    if not needed or not _asked(jobs, scheduler):
        yield None
        return
    from ataa_jax import jobs as crews

    with crews.workers(jobs, scheduler) as crew:
        yield crew


def notes(jobs: int, scheduler: str | None, *, needed: bool) -> list[str]:
    """Returns the note of workers that were asked for and had nothing to do."""
    if needed or not _asked(jobs, scheduler):
        return []
    return ["the frames of a capture are read, not rendered: no worker was needed"]


def references(
    crew: "Crew | None",
    scene: str,
    shot: "world.Sequence",
    frames: range,
    samples: int,
    average: "Average",
    report: Report,
) -> None:
    """Has workers, if there are any, render references into the cache."""
    if crew is None:
        return
    from ataa_jax import jobs

    what = jobs.References(samples, average)
    jobs.fill(
        crew,
        jobs.task(scene, shot, what, frames),
        lambda done, total: report(f"{done} of {total} references", done, total),
    )


def _asked(jobs: int, scheduler: str | None) -> bool:
    return jobs != 1 or scheduler is not None
