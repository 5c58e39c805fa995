"""The table's rows: no row twice, and the tests that rows name are there."""

import ast
from pathlib import Path

from tests.hard_cases.case import Covered
from tests.hard_cases.topics import TOPICS

TESTS = Path(__file__).parents[1]


def test_no_property_is_claimed_twice():
    names = [row.name for topic in TOPICS for row in topic.rows]
    assert len(set(names)) == len(names)


def test_every_row_says_what_could_break_and_every_bound_has_its_reason():
    for topic in TOPICS:
        assert all(row.danger and row.reason for row in topic.rows)
        assert all(case.quantity for case in topic.cases)


def test_every_row_that_another_test_holds_says_what_the_test_asserts():
    for topic in TOPICS:
        assert all(row.bound for row in topic.rows if isinstance(row, Covered))


def test_a_test_that_a_row_names_exists():
    for topic in TOPICS:
        for row in topic.rows:
            if isinstance(row, Covered):
                file, _, name = row.test.partition("::")
                tree = ast.parse((TESTS / file).read_text("utf-8"))
                defined = [n.name for n in tree.body if isinstance(n, ast.FunctionDef)]
                assert name in defined, row.test
