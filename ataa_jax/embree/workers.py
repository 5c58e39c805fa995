"""The threads that trace: one pool for the process, and how work is cut for it."""

import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


_threads = _cores()


def threads() -> int:
    """Returns the number of threads that trace one batch of rays."""
    return _threads


def set_threads(count: int | None) -> None:
    """Sets how many threads trace one batch of rays; None: all cores.

    Hits do not depend on it: the cuts between chunks are fixed.
    """
    global _threads
    if count is not None and count < 1:
        raise ValueError(f"threads must be at least 1, got {count}")
    _threads = _cores() if count is None else count


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(
        max_workers=max(1, _cores() - 1), thread_name_prefix="ataa-rays"
    )


def for_chunks(count: int, size: int, work: Callable[[int, int], object]) -> None:
    """Calls ``work(first, last)`` on pieces of ``range(count)``, `size` each.

    They run on several threads, in any order; `last` is one past a piece's end.
    The calling thread works too, and the others only ever take what is left, so a
    pool that other callers keep busy delays nobody.
    """
    starts = itertools.count(0, size)  # `next` is atomic under the interpreter lock

    def drain() -> None:
        while (first := next(starts)) < count:
            work(first, min(first + size, count))

    chunks = -(-count // size)
    helpers = [_pool().submit(drain) for _ in range(min(_threads, chunks) - 1)]
    drain()
    for helper in helpers:
        if not helper.cancel():
            helper.result()
