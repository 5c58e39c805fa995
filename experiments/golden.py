"""Renders the golden sequences that `ataa verify` compares with.

python experiments/golden.py              # writes ataa_jax/golden/
"""

import datetime
from pathlib import Path

import tomli_w

from ataa_jax import files, verify

FOLDER = Path(__file__).resolve().parents[1] / "ataa_jax" / "golden"


def main() -> None:
    """Renders, writes, and notes by what."""
    digests = {}
    for name in verify.SEQUENCES:
        golden = verify.render(name)
        verify.write(FOLDER, name, golden)
        digests[name] = golden.digest
        print(name, golden.digest, flush=True)
    table = {
        "command": "python experiments/golden.py",
        "date": datetime.datetime.now(datetime.UTC).date(),
        "versions": verify.here(),
        "digests": digests,
    }
    files.write_text(FOLDER / "golden.toml", tomli_w.dumps(table))


if __name__ == "__main__":
    main()
