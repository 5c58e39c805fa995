"""The long versions of the tests of trust, and a table of what they did.

Runs ``pytest -m hard``: 2,000 spoiled scenes, 75 commands killed at random moments,
2,000 frames on one processor and on all, with asynchronous dispatch and without. Every
test states its bound; the table tells what each did, and how it ended.

    python experiments/trust.py             # writes experiments/results/trust.toml
    python experiments/trust.py tests/test_long_runs.py     # only these; others stay
"""

import datetime
import subprocess
import sys
import tempfile
import tomllib
import xml.etree.ElementTree as Tree
from pathlib import Path

import tomli_w
import versions

ROOT = Path(__file__).parents[1]
FILE = Path(__file__).parent / "results" / "trust.toml"


def rows(report: Path) -> list[dict[str, object]]:
    """Returns one row a test of a JUnit report: what it did, its end, its seconds."""
    found = []
    for case in Tree.parse(report).iter("testcase"):
        ends = {each.tag for each in case} - {"properties", "system-out", "system-err"}
        did = {
            str(each.get("name")): _number(str(each.get("value")))
            for each in case.iter("property")
        }
        found.append(
            {
                "test": f"{case.get('classname')}.{case.get('name')}",
                "date": datetime.datetime.now(datetime.UTC).date(),
                "versions": versions.here(),
                "end": ", ".join(sorted(ends)) or "passed",
                "seconds": round(float(case.get("time", 0.0))),
                "did": did,
            }
        )
    return found


def _number(text: str) -> int | float:
    return float(text) if "." in text else int(text)


def main() -> int:
    """Runs the tests and writes the table."""
    words = ["-m", "pytest", "-m", "hard", "-n", "0", *sys.argv[1:]]
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        done = subprocess.run(
            [sys.executable, *words, f"--junitxml={report}"],
            cwd=ROOT,
            check=False,
        )
        if not report.is_file():
            return done.returncode
        found = rows(report)
    new = {str(row["test"]) for row in found}
    old = tomllib.loads(FILE.read_text())["test"] if FILE.is_file() else []
    kept = [row for row in old if row["test"] not in new]
    table = sorted([*kept, *found], key=lambda row: str(row["test"]))
    command = "python -m pytest -m hard -n 0"
    FILE.write_text(tomli_w.dumps({"command": command, "test": table}))
    for row in found:
        print(row["end"], row["test"], row["did"])
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
