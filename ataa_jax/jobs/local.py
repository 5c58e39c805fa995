"""Workers on this machine: processes that are started anew when they die.

Not a pool of `concurrent.futures`: there a process that dies takes the whole pool with
it, and the frames under way in all others.
"""

import contextlib
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess

from ataa_jax import embree, programs
from ataa_jax.errors import InputError
from ataa_jax.jobs import tasks
from ataa_jax.jobs.tasks import Task

# our choice: one death may be chance, three over the same frames are not.
ATTEMPTS = 3

# JAX's threads do not survive a fork.
_context = multiprocessing.get_context("spawn")


@dataclass
class _Worker:
    process: BaseProcess
    connection: Connection


class Processes:
    """Up to `count` processes, started when there is something to do."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._workers: list[_Worker] = []

    def run(self, given: Sequence[Task]) -> Iterator[Task]:
        """Performs tasks; yields each when its files are in the cache.

        Raises:
            InputError: see `tasks.perform`; or processes died `ATTEMPTS` times over
                the same task.
            MemoryError: of a process.
            RuntimeError: a process failed otherwise; tells its error.
        """
        waiting = deque((task, 1) for task in given)
        busy: dict[Connection, tuple[_Worker, Task, int]] = {}
        idle = list(self._workers)
        while waiting or busy:
            while waiting and len(busy) < self.count:
                worker = idle.pop() if idle else self._start()
                task, attempt = waiting.popleft()
                busy[worker.connection] = worker, task, attempt
                with contextlib.suppress(OSError):  # it died; `recv` will tell
                    worker.connection.send(task)
            for connection in wait(list(busy)):
                assert isinstance(connection, Connection)
                worker, task, attempt = busy.pop(connection)
                try:
                    error = connection.recv()
                except (EOFError, OSError):
                    self._bury(worker, task, attempt)
                    waiting.appendleft((task, attempt + 1))
                    continue
                if error is not None:
                    raise error
                idle.append(worker)
                yield task

    def close(self) -> None:
        """Ends all processes at once; what they have finished is in the cache."""
        for worker in self._workers:
            worker.process.kill()
        for worker in self._workers:
            worker.process.join()
            worker.process.close()
            worker.connection.close()
        self._workers.clear()

    def _start(self) -> _Worker:
        ours, theirs = _context.Pipe()
        threads = max(1, embree.threads() // self.count)
        process = _context.Process(
            target=_serve, args=(theirs, threads), name="ataa-job", daemon=True
        )
        with _no_interrupt():
            process.start()
            self._workers.append(_Worker(process, ours))
        theirs.close()  # so that the worker's end is the only one
        return self._workers[-1]

    def _bury(self, worker: _Worker, task: Task, attempt: int) -> None:
        worker.process.join()
        code = worker.process.exitcode
        self._workers.remove(worker)
        worker.process.close()
        worker.connection.close()
        if attempt >= ATTEMPTS:
            assert code is not None
            end = f"signal {-code}" if code < 0 else f"exit code {code}"
            raise InputError(
                f"{attempt} processes died over {task}, the last by {end}; if memory "
                "is short, try a lower --jobs or a smaller --size"
            )


@contextlib.contextmanager
def _no_interrupt() -> Iterator[None]:
    """Keeps Ctrl-C, which goes to a terminal's whole process group, from a child."""
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection, threads: int) -> None:
    """Performs tasks until the other end is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
    programs.keep()
    embree.set_threads(threads)
    with contextlib.suppress(EOFError, OSError):
        while True:
            connection.send(_error(connection.recv()))


def _error(task: Task) -> Exception | None:
    """Performs a task; returns what went wrong, as something that can be sent."""
    try:
        tasks.perform(task)
    except (InputError, MemoryError) as error:
        return error
    except Exception as error:
        return RuntimeError(f"{task} could not be rendered: {error!r}")
    return None
