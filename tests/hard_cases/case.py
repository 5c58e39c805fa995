"""A hard case: what could break, a number that tells, a bound, and its reason.

Cases are gathered in topics, one module each. Every number of a case comes from its
one function, which the tests and the table call alike.
"""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Case:
    """One measured property."""

    name: str  # the property, as a sentence without its full stop
    danger: str  # what could break
    quantity: str  # what is measured, with its unit
    bound: float
    reason: str  # why this bound
    measure: Callable[[], float]
    at_least: bool = False  # the bound is a lower one
    hard: bool = False  # takes long: runs under `pytest -m hard` only

    def holds(self, value: float) -> bool:
        """Returns whether a value keeps the bound; NaN never does."""
        return value >= self.bound if self.at_least else value <= self.bound


@dataclass(frozen=True)
class Covered:
    """A property that a test outside this folder holds already."""

    name: str
    danger: str
    test: str  # as pytest names it, under tests/: "test_taa.py::test_…"
    bound: str  # what the test asserts, with its numbers; atol and rtol as NumPy's
    reason: str  # why this bound


@dataclass(frozen=True)
class Topic:
    """Cases of one kind, in the table's order."""

    name: str
    rows: list[Case | Covered] = field(default_factory=list)

    def case(
        self,
        name: str,
        *,
        danger: str,
        quantity: str,
        bound: float,
        reason: str,
        at_least: bool = False,
        hard: bool = False,
    ) -> Callable[[Callable[[], float]], Callable[[], float]]:
        """Makes a case of the function that measures it."""

        def add(measure: Callable[[], float]) -> Callable[[], float]:
            self.rows.append(
                Case(
                    name=name,
                    danger=danger,
                    quantity=quantity,
                    bound=bound,
                    reason=reason,
                    measure=measure,
                    at_least=at_least,
                    hard=hard,
                )
            )
            return measure

        return add

    def covered(
        self, name: str, *, danger: str, test: str, bound: str, reason: str
    ) -> None:
        """Gives a row to a property that another test holds."""
        self.rows.append(
            Covered(name=name, danger=danger, test=test, bound=bound, reason=reason)
        )

    @property
    def cases(self) -> list[Case]:
        """The measured ones."""
        return [row for row in self.rows if isinstance(row, Case)]
