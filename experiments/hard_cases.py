"""Do hard cases stay numerically stable? One row a case: measured, bound, verdict.

The cases are those of `tests/hard_cases`: a row that is measured calls the function
that the test calls; a row that another test holds runs that test.

    python experiments/hard_cases.py           # writes results/hard_cases.csv
    python experiments/hard_cases.py --long    # the long cases too
"""

import argparse
import csv
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import jax

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.hard_cases.case import Case, Covered
from tests.hard_cases.topics import TOPICS

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = (
    *("topic", "case", "what could break", "measured", "value", "bound", "verdict"),
    "reason",
)


def measured(topic: str, case: Case) -> list[str]:
    """Returns the row of a case that is measured here."""
    value = case.measure()
    sign = "≥" if case.at_least else "≤"
    verdict = "holds" if case.holds(value) else "fails"
    reason = f"{case.fails}; bound: {case.reason}" if case.fails else case.reason
    return [
        *(topic, case.name, case.danger, case.quantity, f"{value:.3g}"),
        *(f"{sign} {case.bound:.3g}", verdict, reason),
    ]


def run_tests(names: list[str]) -> dict[str, bool]:
    """Runs tests in a process of their own; returns which passed, all parameters."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "--dist", "no"]
        paths = [str(ROOT / "tests" / name) for name in dict.fromkeys(names)]
        subprocess.run(
            [*command, f"--junitxml={report}", *paths], cwd=ROOT, check=False,
            stdout=subprocess.DEVNULL,
        )  # fmt: skip
        passed: dict[str, bool] = {}
        for found in ElementTree.parse(report).iter("testcase"):
            file = found.get("classname", "").split(".")[-1]
            name = f"{file}.py::{found.get('name', '').split('[')[0]}"
            passed[name] = passed.get(name, True) and len(found) == 0
    return passed


def main() -> None:
    """Measures every case, prints the table and writes it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--long", action="store_true", help="the long cases too")
    parser.add_argument("--topic", help="of this topic alone")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    # As the tests have it.
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    jax.config.update("jax_numpy_rank_promotion", "raise")
    topics = [t for t in TOPICS if options.topic in (None, t.name)]
    elsewhere = [r.test for t in topics for r in t.rows if isinstance(r, Covered)]
    passed = run_tests(elsewhere)
    table = []
    for topic in topics:
        for row in topic.rows:
            if isinstance(row, Covered):
                verdict = "holds" if passed.get(row.test) else "fails"
                cells = [
                    topic.name,
                    row.name,
                    row.danger,
                    row.test,
                    "",
                    "",
                    verdict,
                    "",
                ]
            elif row.hard and not options.long:
                continue
            else:
                cells = measured(topic.name, row)
            table.append(cells)
            print(" | ".join(cells[:2] + cells[4:7]), flush=True)
    held = sum(row[6] == "holds" for row in table)
    print(f"{held} of {len(table)} cases hold")
    if options.topic:
        return
    options.out.mkdir(exist_ok=True)
    with (options.out / "hard_cases.csv").open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(table)


if __name__ == "__main__":
    main()
