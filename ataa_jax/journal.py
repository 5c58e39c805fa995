"""How far a long job has come, so that the same command goes on where it was killed.

A journal lies in the hidden folder that an output grows in (`files.output_folder`).
After every step it takes what the next step reads, and what the end needs of this one;
the entry that names the step is written last and at once. A step without its entry was
not done; work in flight is all that is lost.
"""

import json
from pathlib import Path
from typing import Any, TypeVar

from ataa_jax import cache, files

_ENTRY = "entry.json"

Tree = TypeVar("Tree")


class Journal:
    """The steps of one job that are done."""

    def __init__(self, folder: Path, key: str) -> None:
        """Opens the journal of a job, or begins it.

        Args:
            folder: where the job's output grows; what another job left there goes.
            key: hash of all that decides the output.
        """
        self.folder = folder / files.JOURNAL
        entry = self._read()
        if entry is None or entry["key"] != key:
            if self.folder.exists():
                files.empty(folder)
            entry = {"key": key, "step": None, "facts": None}
            self._write(entry)
        self._entry = entry

    @property
    def step(self) -> int | None:
        """The last step that is done."""
        return self._entry["step"]

    @property
    def facts(self) -> Any:
        """What was told of the steps so far, as JSON keeps it."""
        return self._entry["facts"]

    def commit(
        self, step: int, latest: Any, facts: Any, kept: dict[str, Any] | None = None
    ) -> None:
        """Notes that a step is done.

        Args:
            step: its number.
            latest: a pytree of arrays that the next step reads.
            facts: of all steps so far: whatever JSON can hold.
            kept: arrays by name that `kept` shall return at the end.
        """
        # By turns, so that the last step's file stands until the entry names this one.
        # Removed first: if the disk is full, the step before the last must not be taken
        # for this one.
        self._latest(step).unlink(missing_ok=True)
        cache.write(self._latest(step), latest)
        if kept is not None:
            cache.write(self._kept(step), kept)
        self._entry = {**self._entry, "step": step, "facts": facts}
        self._write(self._entry)

    def latest(self, like: Tree) -> Tree:
        """Returns what the next step reads; `like` tells its shapes and types.

        Raises:
            KeyError: it is missing or damaged.
        """
        assert self.step is not None
        found = cache.read(self._latest(self.step), like)
        if found is None:
            raise KeyError(self.step)
        return found

    def kept(self, step: int) -> dict[str, Any]:
        """Returns the arrays that a step kept.

        Raises:
            KeyError: they are missing or damaged.
        """
        found = cache.read_all(self._kept(step))
        if found is None:
            raise KeyError(step)
        return found

    def _latest(self, step: int) -> Path:
        return self.folder / f"latest-{step % 2}.npz"

    def _kept(self, step: int) -> Path:
        return self.folder / f"step-{step}.npz"

    def _write(self, entry: dict[str, Any]) -> None:
        files.write_text(self.folder / _ENTRY, json.dumps(entry))

    def _read(self) -> dict[str, Any] | None:
        try:
            entry = json.loads((self.folder / _ENTRY).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        known = isinstance(entry, dict) and {"key", "step", "facts"} <= entry.keys()
        return entry if known else None
