"""References and records rendered by several processes, here or on other machines.

Frames of a reference and of a recording are independent of each other, and dear. A
`Task` names a chunk of them; whoever performs it leaves their files in the cache, and
the code that needs them finds them there. So nothing but time depends on who rendered
what, and a frame that is done is never done again.

    with jobs.workers(4) as crew:  # or scheduler="tcp://host:8786"
        jobs.fill(crew, jobs.task(scene, shot, jobs.References(64), range(12)))
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ataa_jax.errors import InputError
from ataa_jax.jobs.cluster import Cluster
from ataa_jax.jobs.local import Processes
from ataa_jax.jobs.tasks import Records, References, Task, missing, task

__all__ = [
    "Crew",
    "Records",
    "References",
    "Task",
    "fill",
    "missing",
    "task",
    "workers",
]

Crew = Processes | Cluster

# our choice: chunks so small that every worker gets about four of them, so that none
# has long to wait for the last; and that a worker that dies takes little with it.
_CHUNKS, _LONGEST = 4, 4


@contextmanager
def workers(count: int = 1, scheduler: str | None = None) -> Iterator[Crew | None]:
    """Yields who performs tasks; None where the caller's own process shall.

    Whatever ends the block, also Ctrl-C, ends local workers at once.

    Args:
        count: processes on this machine; 1: none but the caller's.
        scheduler: address of a Dask scheduler, whose workers are used instead.

    Raises:
        InputError: no process; Dask is not installed; no scheduler answers at the
            address, or it has no workers.
    """
    if count < 1:
        raise InputError(f"there must be at least 1 process, not {count}")
    if count == 1 and scheduler is None:
        yield None
        return
    crew = Processes(count) if scheduler is None else Cluster(scheduler)
    try:
        yield crew
    finally:
        crew.close()


def fill(
    crew: Crew, wanted: Task, progress: Callable[[int, int], None] = lambda *_: None
) -> None:
    """Has the frames of a task rendered that the cache lacks.

    Args:
        crew: who renders.
        wanted: all frames of a sequence.
        progress: told how many of how many frames are done, first those that were.

    Raises:
        InputError: workers died too often over one chunk, or all are gone; a worker
            has another version of the package, another kind of processor or another
            scene; or what the task names cannot be rendered.
        MemoryError: of a worker.
        RuntimeError: whatever else went wrong in a worker.
    """
    total = len(wanted.frames)
    needed = missing(wanted)
    done = total - len(needed.frames)
    progress(done, total)
    for part in crew.run(_chunks(needed, crew.count)):
        done += len(part.frames)
        progress(done, total)


def _chunks(whole: Task, count: int) -> list[Task]:
    frames = len(whole.frames)
    length = min(max(frames // (_CHUNKS * count), 1), _LONGEST)
    return [whole.part(slice(at, at + length)) for at in range(0, frames, length)]
