"""State of an optimizer on disk after every step: killed at any moment, it goes on.

A checkpoint belongs to a question (scenes, budget, options, code, versions): its key is
part of the file's name, so an answer is never taken for another question's.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ataa_jax import cache

_Tree = TypeVar("_Tree")


@dataclass(frozen=True)
class Checkpoints:
    """A folder of checkpoints of one question; None keeps nothing."""

    folder: Path | None
    key: str

    def file(self, name: str) -> Path | None:
        """Returns where the state of a named step lies."""
        if self.folder is None:
            return None
        return self.folder / f"{hashed(self.key)}-{name}.npz"

    def load(self, name: str, like: _Tree) -> _Tree | None:
        """Returns the saved tree, or None where there is none or it does not fit."""
        file = self.file(name)
        return None if file is None else cache.read(file, like)

    def save(self, name: str, tree: object) -> None:
        """Writes a tree of arrays, all of it or nothing."""
        file = self.file(name)
        if file is not None:
            cache.write(file, tree)


def hashed(text: str) -> str:
    """Returns a short name for a text."""
    return hashlib.blake2b(text.encode(), digest_size=10).hexdigest()


NOWHERE = Checkpoints(folder=None, key="")
