"""Workers of a Dask cluster, on this machine or others.

They need the same version of the package and the scene under the same name; files of
the cache come back over the network, so no folder need be shared. Dask's messages are
trusted as Python code is: use a scheduler that only you can reach, or its TLS.
"""

import contextlib
import logging
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from types import ModuleType
from typing import Any

from ataa_jax import embree, programs
from ataa_jax.errors import InputError
from ataa_jax.jobs import tasks
from ataa_jax.jobs.tasks import Task

# our choice: a scheduler in reach answers within a second.
CONNECT_S = 10.0
# our choice: a nanny starts a worker that died anew within some seconds.
ALONE_S = 60.0
# our choice: short beside a frame, and cheap: it asks this process alone.
POLL_S = 0.02
# our choice: as often as Dask tries again by itself when a worker dies.
RETRIES = 3


class Cluster:
    """The workers of one scheduler."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._distributed = _distributed()
        for name in ("distributed.client", "distributed.utils"):
            # They log whole tracebacks of what the errors here say in a sentence.
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            self._client = self._distributed.Client(
                address, timeout=CONNECT_S, set_as_default=False
            )
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                f"no Dask scheduler answers at '{address}' ({_brief(error)}); start "
                "one with `dask scheduler`, and give the address that it tells"
            ) from error
        try:
            self._client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError:
            self.close()
            raise InputError(
                f"the Dask scheduler at {address} has no workers; start some with "
                f"`dask worker {address}`"
            ) from None

    @property
    def count(self) -> int:
        """Workers that are there now, at least 1."""
        return max(1, len(self._workers()))

    def run(self, given: Sequence[Task]) -> Iterator[Task]:
        """Performs tasks; yields each when its files are in this process's cache.

        Raises:
            InputError: see `tasks.perform` and `tasks.receive`; workers died too often
                over the same task; all are gone; or so is the scheduler.
            Exception: whatever else a worker raised, `RETRIES` times over.
        """
        under_way = {
            self._client.submit(perform, task, retries=RETRIES, pure=False): task
            for task in given
        }
        try:
            while under_way:
                for future in self._finished(list(under_way)):
                    task = under_way.pop(future)
                    tasks.receive(task, self._result(future, task))
                    future.release()
                    yield task
        finally:
            with contextlib.suppress(Exception):  # the scheduler may be gone
                self._client.cancel(list(under_way), force=True)

    def close(self) -> None:
        """Leaves the cluster; its workers stay."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            self._client.close(timeout=2.0)

    def _workers(self) -> dict[str, Any]:
        return self._client.scheduler_info(n_workers=-1)["workers"]

    def _finished(self, futures: list[Any]) -> list[Any]:
        """Waits for at least one future."""
        seen = time.monotonic()  # when there was a worker
        while not (done := [future for future in futures if future.done()]):
            time.sleep(POLL_S)
            now = time.monotonic()
            if now - seen > CONNECT_S and self._workers():
                seen = now
            if now - seen > ALONE_S:
                raise InputError(
                    f"all workers of the Dask scheduler at {self.address} are gone; "
                    "start others and give the command again: it goes on from there"
                )
        return done

    def _result(self, future: Any, task: Task) -> dict[str, bytes]:
        try:
            return future.result()
        except self._distributed.scheduler.KilledWorker as error:
            raise InputError(
                f"workers of the Dask scheduler at {self.address} died over {task}; if "
                f"their memory is short, try a smaller --size ({_brief(error)})"
            ) from error
        except CancelledError:
            raise InputError(
                f"the Dask scheduler at {self.address} is gone; start it and give the "
                "command again: it goes on from there"
            ) from None
        except ModuleNotFoundError as error:
            raise InputError(
                f"a worker of the Dask scheduler at {self.address} lacks {error.name}; "
                "install the same version of ataa_jax there"
            ) from error


def perform(task: Task) -> dict[str, bytes]:
    """Performs a task in a worker, with as many threads as the worker has."""
    programs.keep()
    embree.set_threads(max(1, _distributed().get_worker().state.nthreads))
    return tasks.send(task)


def _distributed() -> ModuleType:
    try:
        import distributed
    except ImportError:
        raise InputError(
            "--scheduler needs Dask, which is not installed; "
            "pip install 'ataa-jax[dask]'"
        ) from None
    return distributed


def _brief(error: Exception) -> str:
    return str(error).partition("\n")[0] or type(error).__name__
