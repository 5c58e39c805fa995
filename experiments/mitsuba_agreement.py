"""Do the package and Mitsuba 3 draw the same picture, before either is timed.

Found: on all six scenes, SSIM 0.9975 to 1.0000; two images of Mitsuba's own with
different seeds are no nearer to each other.

Each scene under one directional light (`competitor.one_light`), the middle frame of a
typical walk; both renderers take 256 samples a pixel and average linear radiance. The
goal is an SSIM of 0.99. Two Mitsuba images of different seeds tell what of the
difference is noise; the share of lit pixels tells how much there was to compare.

    python experiments/mitsuba_agreement.py         # results/mitsuba_agreement.csv
    python experiments/mitsuba_agreement.py sponza  # measures this scene's row anew
    python experiments/mitsuba_agreement.py --width 320 --samples 16 --out /tmp/look

With `--out` the table goes there, and beside it a picture of each scene: the package's
image, Mitsuba's, and eight times the difference.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
import scenes
from PIL import Image

from ataa_jax import color as colors
from ataa_jax import competitor, files, metrics, reference

FRAME = 6
RESULTS = Path(__file__).parent / "results"
COLUMNS = (
    *("scene", "size", "samples", "ssim", "psnr", "differ", "lit"),
    *("ssim_of_two_seeds", "agrees"),
)
GOAL = 0.99
VISIBLE = 2.0 / 255.0  # of an sRGB channel


def display(linear: np.ndarray) -> np.ndarray:
    """Returns the image as it is shown, sRGB in [0, 1]."""
    return np.asarray(colors.display(jax.numpy.asarray(linear)))


def measure(
    name: str, size: tuple[int, int], samples: int, pictures: Path | None
) -> tuple[str, ...]:
    """Returns the row of one scene."""
    shot = scenes.shot(competitor.one_light(scenes.load(name)), size=size)
    rival = competitor.Competitor(shot)
    theirs, again = (display(rival.render(FRAME, samples, seed)) for seed in (0, 1000))
    own = reference.reference(shot, FRAME, samples, average="linear")
    ours = display(np.asarray(own.color))
    difference = np.abs(ours - theirs)
    if pictures is not None:
        both = np.concatenate([ours, theirs, np.minimum(8.0 * difference, 1.0)])
        image = Image.fromarray((both * 255.0 + 0.5).astype(np.uint8))
        image.save(pictures / f"{name}.png")
    ssim = metrics.ssim(theirs, ours)
    return (
        name,
        f"{size[1]}x{size[0]}",
        str(samples),
        f"{ssim:.4f}",
        f"{metrics.psnr(theirs, ours):.2f}",
        f"{np.mean(difference.max(axis=-1) > VISIBLE):.4f}",
        f"{np.mean(ours.max(axis=-1) > VISIBLE):.3f}",
        f"{metrics.ssim(theirs, again):.4f}",
        "yes" if ssim >= GOAL else "no",
    )


def main() -> None:
    """Measures and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="SCENE")
    parser.add_argument("--width", type=int, default=640, help="of a 16:9 image")
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--out", type=Path, default=None)
    given = parser.parse_args()
    size = (given.width * 9 // 16, given.width)
    out = given.out or RESULTS
    out.mkdir(parents=True, exist_ok=True)
    names = given.names or scenes.available()
    file = out / "mitsuba_agreement.csv"
    rows = [tuple(row) for row in scenes.other_rows(file, names)[1:]]
    for name in names:
        rows.append(measure(name, size, given.samples, given.out))
        print(*rows[-1], flush=True)
        files.write_csv(file, COLUMNS, rows)
        jax.clear_caches()


if __name__ == "__main__":
    main()
