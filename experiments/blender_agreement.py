"""The same scene by this package's renderer and by a Blender capture: do they agree?

    python experiments/blender_agreement.py capture --budget inf

`results/blender_agreement.csv` holds budgets of inf and 0.5 on six frames of 160×90.

Prints, over the frames after the first: SSIM between the two pipelines' TAA and ATAA
images, that of the raw frames as the measure of how far the renderers differ, overlap
(intersection over union) and agreement of the masks, and each pipeline's own gain over
TAA against its own reference. `level 0` renders ours without mip levels, as Cycles
reads textures.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from ataa_jax import capture, color, compare, methods, metrics, world
from ataa_jax.types import METHOD_ATAA, METHOD_FXAA


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--scene", default="builtin")
    parser.add_argument("--path", default="walk")
    parser.add_argument("--motion", default="typical")
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--budget", type=float, default=0.5)
    given = parser.parse_args()
    read = capture.load(given.capture)
    count = len(read.frames)
    loaded = world.load(given.scene)
    shot = world.shot(loaded, given.path, read.size, motion=given.motion)
    print("budget,variant,quantity,mean,least")
    for variant in ("mip levels", "level 0"):
        rows: dict[str, list[float]] = {}
        mips = variant == "mip levels"
        options = methods.Options(
            frames=count,
            lead_in=0,
            reference_samples=read.reference_samples or 1,
            budget=given.budget,
        )
        ours = frames(shot, options, given.samples, mips=mips)
        theirs = frames(read, options, given.samples, mips=True)
        for a, b in zip(ours[1:], theirs[1:], strict=True):
            compare_frames(a, b, rows)
        for name, values in rows.items():
            print(
                f"{given.budget:g},{variant},{name},{np.mean(values):.4f},{np.min(values):.4f}"
            )


def frames(
    shot: methods.Source, options: methods.Options, samples: int, *, mips: bool
) -> list[dict[str, np.ndarray]]:
    """Returns TAA, ATAA, raw, reference and mask of every frame."""
    name = f"ataa{samples}_paper"  # its rays read mip level 0, as Cycles does
    runners = [methods.runner(n, shot, options) for n in ("taa", name)]
    for each in runners:
        config = each.config  # type: ignore[attr-defined]
        drawn = replace(config.raster, mip_maps=mips)
        each.config = replace(config, raster=drawn)  # type: ignore[attr-defined]
    drawer = methods.Drawer(shot)
    found = []
    for index in range(options.frames):
        drawer.start(index)
        held = {each.name: each.run(index, drawer) for each in runners}
        ataa = runners[1]
        output = ataa.output  # type: ignore[attr-defined]
        held["raw"] = np.asarray(color.display(output.raw))
        truth = compare.truth(shot, index, options)
        held["reference"] = np.asarray(color.display(truth.color))
        assert ataa.method is not None
        held["method"] = ataa.method
        held["ataa"] = held.pop(name)
        found.append(held)
    return found


def compare_frames(
    a: dict[str, np.ndarray], b: dict[str, np.ndarray], rows: dict[str, list[float]]
) -> None:
    def note(name: str, value: float) -> None:
        rows.setdefault(name, []).append(float(value))

    for name in ("raw", "reference", "taa", "ataa"):
        note(f"SSIM between the pipelines: {name}", metrics.ssim(b[name], a[name]))
    for word, method in (("ATAA", METHOD_ATAA), ("FXAA", METHOD_FXAA)):
        one, other = a["method"] == method, b["method"] == method
        union = np.logical_or(one, other).sum()
        share = np.logical_and(one, other).sum() / max(union, 1)
        note(f"overlap of {word} pixels", share)
        note(f"share of {word} pixels: ours", one.mean())
        note(f"share of {word} pixels: Blender", other.mean())
    note("pixels with the same method", np.mean(a["method"] == b["method"]))
    for word, side in (("ours", a), ("Blender", b)):
        for name in ("taa", "ataa"):
            value = metrics.ssim(side[name], side["reference"])
            note(f"SSIM of {name} to its own reference: {word}", value)


if __name__ == "__main__":
    main()
