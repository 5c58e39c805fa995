"""Who holds Embree's memory: the tracer's owner, then the programs still under way.

Programs name a tracer by a key and hold nothing of it. Where dispatch is asynchronous
(a GPU; a CPU whose client was made before this package could ask for the other), the
owner may let go of a tracer before the program that it gave it to has traced a ray.
What it named therefore stays until every array that anyone holds is ready: a program
that is still to run has results that are not.
"""

import weakref
from typing import Any

import jax

_held: dict[int, Any] = {}  # by key
_owners: dict[int, object] = {}  # by key: a mark of who holds it now
_left: set[int] = set()  # keys whose owner is gone


def hold(key: int, named: Any, owner: object) -> None:
    """Has programs find `named` by its key while `owner` lives, and until they end."""
    _held[key], _owners[key] = named, (mark := object())
    _left.discard(key)
    weakref.finalize(owner, _leave, key, mark).atexit = False


def find(key: int) -> Any | None:
    """Returns what a key names; None: it is gone."""
    return _held.get(key)


def sweep() -> None:
    """Lets go of what has lost its owner, if no program is under way."""
    if _left and all(x.is_deleted() or x.is_ready() for x in jax.live_arrays()):
        while _left:
            key = _left.pop()
            _held.pop(key, None)
            _owners.pop(key, None)


def _leave(key: int, mark: object) -> None:
    """Notes that a key's owner is gone; waits for nothing, since it runs anywhere.

    Where two threads built the same at once, the later holds the key.
    """
    if _owners.get(key) is mark:
        _left.add(key)
        sweep()
