"""Makes the small capture in `data/`: only the channels that are read, as half floats.

    python experiments/blender_shrink.py capture data/capture --samples 8

Run it in the package's environment on what `blender_capture.py` wrote. Depth keeps its
32 bits: its background is 1e10.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np

from ataa_jax.capture import blender, exr
from ataa_jax.capture.plain import NAME, RGB


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--samples", default="8")
    given = parser.parse_args()
    kinds = ["reference", *(f"samples{n}" for n in given.samples.split(","))]
    given.out.mkdir(parents=True, exist_ok=True)
    for file in sorted(given.source.glob("*.exr")):
        names = blender.channels(file)
        assert names is not None
        shrink(file, given.out / file.name, sum(names.values(), ()))
        for kind in kinds:
            name = f"{kind}/{file.name}"
            shrink(given.source / name, given.out / name, RGB)
    lines = (given.source / NAME).read_text().splitlines(keepends=True)
    left_out = [f"{k} = " for k in ("center", "samples2", "samples4", "samples8")
                if k not in kinds]  # fmt: skip
    kept = [line for line in lines if not line.startswith(tuple(left_out))]
    (given.out / NAME).write_text("".join(kept))
    size = sum(file.stat().st_size for file in given.out.rglob("*") if file.is_file())
    print(f"{size:,} bytes in {given.out}")


def shrink(source: Path, target: Path, names: tuple[str, ...]) -> None:
    held = exr.read(source)
    planes = {
        name: held[name].astype(np.float32 if name.endswith(".Z") else np.float16)
        for name in names
    }
    exr.write(target, planes)
    shutil.copymode(source, target)


if __name__ == "__main__":
    main()
