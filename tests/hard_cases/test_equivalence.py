"""Hard cases: see `cases_equivalence`."""

import pytest

from tests.hard_cases import cases_equivalence
from tests.hard_cases.checks import check, parameters


@pytest.mark.parametrize("case", parameters(cases_equivalence.TOPIC))
def test_the_measured_value_keeps_its_bound(case):
    check(case)
