"""What the test files of this folder share: a parameter a case, and the check."""

import pytest

from tests.hard_cases.case import Case, Topic


def parameters(topic: Topic) -> list:
    """A pytest parameter for each measured case, under the property's name."""
    found = []
    for case in topic.cases:
        marks = [pytest.mark.hard] if case.hard else []
        name = case.name.replace(" ", "_")
        found.append(pytest.param(case, id=name, marks=marks))
    return found


def check(case: Case) -> None:
    """Holds a case to its bound."""
    value = case.measure()
    sign = "at least" if case.at_least else "at most"
    assert case.holds(value), (
        f"{case.quantity}: {value:g}, {sign} {case.bound:g} ({case.reason})"
    )
