"""State of an optimizer on disk after every step: killed at any moment, it goes on.

A checkpoint belongs to a question (scenes, budget, options, code, versions): its key is
part of the file's name, so an answer is never taken for another question's.
"""

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np

from ataa_jax import files

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
        if file is None:
            return None
        leaves, tree = jax.tree.flatten(like)
        try:
            with file.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
                found = [data[f"arr_{index}"] for index in range(len(leaves))]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        pairs = zip(found, leaves, strict=True)
        if any(
            a.shape != np.shape(b) or a.dtype != np.asarray(b).dtype for a, b in pairs
        ):
            return None
        return jax.tree.unflatten(tree, found)

    def save(self, name: str, tree: object) -> None:
        """Writes a tree of arrays, all of it or nothing."""
        file = self.file(name)
        if file is None:
            return
        leaves: list[np.ndarray] = [np.asarray(x) for x in jax.tree.leaves(tree)]
        with files.atomic(file) as part, part.open("wb") as stream:
            np.savez(stream, *leaves)  # named arr_0, arr_1, …


def hashed(text: str) -> str:
    """Returns a short name for a text."""
    return hashlib.blake2b(text.encode(), digest_size=10).hexdigest()


NOWHERE = Checkpoints(folder=None, key="")
