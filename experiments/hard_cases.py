"""Do hard cases stay numerically stable? One row a case: measured, bound, verdict.

The cases are those of `tests/hard_cases`: a row that is measured calls the function
that the test calls; a row that another test holds runs that test, whose asserts are
the bound. Each row tells the command, the date and the versions it came from.

    python experiments/hard_cases.py                   # writes results/hard_cases.csv
    python experiments/hard_cases.py --only mirror   # these anew, the rest as read
"""

import argparse
import csv
import datetime
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import jax
import versions

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.hard_cases.case import Case, Covered
from tests.hard_cases.topics import TOPICS

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = (
    *("topic", "case", "what could break", "measured", "value", "bound", "verdict"),
    *("reason", "command", "date", "versions"),
)


def measured(topic: str, case: Case) -> list[str]:
    """Returns the cells of a case that is measured here, up to its reason."""
    value = case.measure()
    sign = "≥" if case.at_least else "≤"
    verdict = "holds" if case.holds(value) else "fails"
    return [
        *(topic, case.name, case.danger, case.quantity, f"{value:.3g}"),
        *(f"{sign} {case.bound:.3g}", verdict, case.reason),
    ]


def covered(topic: str, row: Covered, *, passed: bool) -> list[str]:
    """Returns the cells of a property that another test holds, up to its reason."""
    value, verdict = ("passes", "holds") if passed else ("fails", "fails")
    return [
        *(topic, row.name, row.danger, row.test, value),
        *(row.bound, verdict, row.reason),
    ]


def run_tests(names: list[str]) -> dict[str, bool]:
    """Runs tests in a process of their own; returns which passed, all parameters."""
    if not names:
        return {}
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
    """Measures cases, prints the table and writes it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", help="rows with this in topic or name")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    # As the tests have it.
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    jax.config.update("jax_numpy_rank_promotion", "raise")
    rows = [(topic.name, row) for topic in TOPICS for row in topic.rows]
    chosen = [
        options.only is None
        or any(text in f"{topic}: {row.name}" for text in options.only)
        for topic, row in rows
    ]
    file = options.out / "hard_cases.csv"
    kept = read(file) if options.only else {}
    # All in one process, beforehand: they share compiled programs.
    passed = run_tests(
        [row.test for (_, row), now in zip(rows, chosen, strict=True)
         if now and isinstance(row, Covered)]
    )  # fmt: skip
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    command = " ".join(["python experiments/hard_cases.py", *sys.argv[1:]])
    installed = versions.here()
    table = []
    for (topic, row), now in zip(rows, chosen, strict=True):
        if not now:
            table += [kept[row.name]] if row.name in kept else []
            continue
        if isinstance(row, Covered):
            cells = covered(topic, row, passed=passed.get(row.test, False))
        else:
            cells = measured(topic, row)
        table.append([*cells, command, today, installed])
        print(" | ".join(cells[:2] + cells[4:7]), flush=True)
    held = sum(row[6] == "holds" for row in table)
    print(f"{held} of {len(table)} rows hold")
    options.out.mkdir(exist_ok=True)
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(table)


def read(file: Path) -> dict[str, list[str]]:
    """Returns the rows of an earlier table by their case; a missing column is empty."""
    if not file.is_file():
        return {}
    with file.open(newline="") as stream:
        return {
            row["case"]: [row.get(column) or "" for column in COLUMNS]
            for row in csv.DictReader(stream)
        }


if __name__ == "__main__":
    main()
