"""Every method on every scene: what the mask and its rays buy.

A walk of typical motion (1 % of the image's width a frame), 12 frames after 8 of
lead-in, 640×360, 64 reference samples, at most 0.48 sparse rays a pixel. Writes one row
a scene and method; the full report of each scene goes to ``out/quality``. *thin_share*
is the share of the pixels that wires, ropes, slats and leaves cross; 0.48 rays a pixel
pay for 0.06 of them at 8x.

    python experiments/quality.py             # writes experiments/results/quality.csv
"""

import argparse
import csv
from pathlib import Path

import numpy as np
import scenes

from ataa_jax import compare, methods, reference, report
from ataa_jax import world as worlds

COLUMNS = (
    *("ssim", "psnr", "flip", "flicker", "border_mse", "thin_mse"),
    *("fxaa_share", "taa_share", "ataa_share", "rays_per_pixel", "overflow_share"),
)


def thin_share(shot: worlds.Sequence, frames: int, samples: int) -> float:
    """Returns the share of the pixels that thin features cross."""
    found = []
    for frame in range(frames):
        thin = np.asarray(reference.reference(shot, frame, samples).thin)
        found.append(np.mean((thin > 0.0) & (thin < 1.0)))
    return float(np.mean(found))


def rows(name: str, result: compare.Comparison, thin_of: float) -> list[list[str]]:
    """Returns the scene's rows, means over its frames."""
    taa = 1.0 - result.mean("taa", "ssim")
    ue4 = 1.0 - result.mean("taa_ue4", "ssim")
    table = []
    for method in (*result.options.methods, compare.REFERENCE):
        base = "taa_ue4" if method.endswith("ue4") else "taa"
        left = 1.0 - result.mean(method, "ssim")
        removed = 1.0 - left / (ue4 if base == "taa_ue4" else taa)
        thin = result.mean(method, "thin_mse") / result.mean(base, "thin_mse")
        values = [f"{result.mean(method, column):.6g}" for column in COLUMNS]
        table.append([name, method, *values, f"{removed:.4f}", f"{thin:.4f}"])
        table[-1].append(f"{thin_of:.4f}")
    return table


def main() -> None:
    """Compares on all scenes and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--reference-samples", type=int, default=64)
    parser.add_argument(
        "--methods", help="only these, with commas; other rows stay as they are"
    )
    parser.add_argument("--scenes", help="only these, with commas")
    options = parser.parse_args()
    chosen = tuple(methods.METHODS)
    if options.methods:
        chosen = methods.check_methods(options.methods.split(","))
    results = Path(__file__).parent / "results"
    results.mkdir(exist_ok=True)
    file = results / "quality.csv"
    table: dict[tuple[str, str], list[str]] = {}
    if (options.methods or options.scenes) and file.is_file():
        with file.open(newline="") as stream:
            table = {(row[0], row[1]): row for row in list(csv.reader(stream))[1:]}
    named = options.scenes.split(",") if options.scenes else scenes.available()
    for name in named:
        shot = scenes.shot(scenes.load(name))
        result = compare.compare(
            shot,
            methods.Options(
                frames=options.frames,
                reference_samples=options.reference_samples,
                methods=chosen,
            ),
        )
        if not options.methods:
            folder = Path("out") / "quality" / name
            folder.mkdir(parents=True, exist_ok=True)
            report.write(result, folder)
        thin = thin_share(shot, options.frames, options.reference_samples)
        for row in rows(name, result, thin):
            table[row[0], row[1]] = row
            print(*row[:3], *row[-3:], flush=True)
        with file.open("w", newline="") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            head = ["scene", "method", *COLUMNS, "taa_error_removed", "thin_mse_ratio"]
            head.append("thin_share")
            writer.writerows([head, *table.values()])


if __name__ == "__main__":
    main()
