"""Values out of a capture's JSON or TOML: looked at one by one, refused in one line."""

import json
import math
import tomllib
from pathlib import Path
from typing import Any

from ataa_jax.errors import InputError

MAX_BYTES = 64 << 20  # of one metadata file
MAX_FRAMES = 100_000


class Table:
    """A table of untrusted values, with a name for messages."""

    def __init__(self, where: str, value: object) -> None:
        if not isinstance(value, dict):
            raise InputError(f"{where} is no table of names and values")
        self.where = where
        self.value: dict[str, Any] = value

    def has(self, name: str) -> bool:
        """Returns whether the name is there and not null."""
        return self.value.get(name) is not None

    def table(self, name: str) -> "Table":
        """Returns a table within; an absent one is empty."""
        return Table(f"{self.where}, {name}", self.value.get(name, {}))

    def tables(self, name: str) -> list["Table"]:
        """Returns a list of tables, at least one."""
        items = self.value.get(name)
        if not isinstance(items, list) or not items:
            raise InputError(f"{self.where} has no list '{name}'")
        if len(items) > MAX_FRAMES:
            raise InputError(
                f"{self.where} has {len(items):,} entries in '{name}'; at most "
                f"{MAX_FRAMES:,} are read"
            )
        return [
            Table(f"{self.where}, {name} {number}", item)
            for number, item in enumerate(items)
        ]

    def number(
        self,
        name: str,
        default: float | int | None = None,
        low: float | int = -1e30,
        high: float | int = 1e30,
    ) -> float:
        """Returns a finite number in a range."""
        value = self.value.get(name, default)
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not low <= value <= high
        ):
            raise InputError(
                f"{self.where}: {name} must be a number from {low:g} to {high:g}, not "
                f"{_short(value)}"
            )
        return float(value)

    def integer(self, name: str, default: int | None, low: int, high: int) -> int:
        """Returns a whole number in a range."""
        value = self.number(name, default, low, high)
        if value != math.floor(value):
            raise InputError(f"{self.where}: {name} must be whole, not {value:g}")
        return int(value)

    def flag(self, name: str, default: bool | None) -> bool:
        """Returns a truth value."""
        value = self.value.get(name, default)
        if not isinstance(value, bool):
            raise InputError(
                f"{self.where}: {name} must be true or false, not {_short(value)}"
            )
        return value

    def text(self, name: str, default: str | None = None) -> str:
        """Returns a text without control characters."""
        value = self.value.get(name, default)
        if not isinstance(value, str) or len(value) > 1024 or not value.isprintable():
            raise InputError(
                f"{self.where}: {name} must be a text, not {_short(value)}"
            )
        return value

    def choice(self, name: str, default: str, known: tuple[str, ...]) -> Any:
        """Returns one of the known words."""
        value = self.value.get(name, default)
        if value not in known:
            raise InputError(
                f"{self.where}: {name} must be one of {', '.join(known)}, not "
                f"{_short(value)}"
            )
        return value

    def numbers(self, name: str, count: int) -> list[float]:
        """Returns a list of so many finite numbers."""
        items = self.value.get(name)
        if not isinstance(items, list) or len(items) != count:
            raise InputError(f"{self.where}: {name} must be {count} numbers")
        row = {f"value {k}": item for k, item in enumerate(items)}
        cells = Table(f"{self.where}, {name}", row)
        return [cells.number(key) for key in row]


def _short(value: object) -> str:
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def read_json(file: Path) -> Table:
    """Reads a JSON object.

    Raises:
        InputError: unreadable, too large, not JSON, nested too deeply.
    """
    data = _bytes(file)
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file} is not valid JSON: {_reason(error)}") from None
    return Table(str(file), value)


def read_toml(file: Path) -> Table:
    """Reads a TOML table; raises as `read_json`."""
    data = _bytes(file)
    try:
        value = tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file} is not valid TOML: {_reason(error)}") from None
    return Table(str(file), value)


def _reason(error: Exception) -> str:
    return (
        "nested too deeply" if isinstance(error, RecursionError) else str(error)[:120]
    )


def _bytes(file: Path) -> bytes:
    if file.exists() and not file.is_file():  # a pipe would wait for ever
        raise InputError(f"{file} is no regular file")
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror})") from None
    if len(data) > MAX_BYTES:
        raise InputError(f"{file} is larger than {MAX_BYTES >> 20} MiB")
    return data
