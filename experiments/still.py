"""A still camera: does the picture converge, and what do filtered mips cost?

SSIM against the reference after 8, 16, 32, 64 and 128 frames, of TAA and ATAA with the
defaults, of ATAA by the paper's criteria, of TAA at mip level 0, and of the plain mean
of jittered frames at mip level 0 (no rectification, weight 1/(n + 1)), which is the box
filter of its samples.

    python experiments/still.py               # writes experiments/results/still.csv
"""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import scenes

from ataa_jax import color as colors
from ataa_jax import metrics, pipeline, reference, sampling, taa
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
AT = (8, 16, 32, 64, 128)
SIZE = (180, 320)


def variants(
    shot: worlds.Sequence,
) -> dict[str, tuple[pipeline.Config, pipeline.Params]]:
    """Returns what is compared."""
    config, params = pipeline.preset("tuned", shot.world.scene, shot.size)
    plain = replace(config, adaptive=False)
    unfiltered = replace(plain, raster=replace(plain.raster, mip_maps=False))
    mean = replace(
        unfiltered,
        taa=replace(
            config.taa,
            rectify="none",
            history_filter="bilinear",
            motion="pixel",
            jitter_length=128,
        ),
    )
    unlimited = pipeline.with_taa(params, taa.default_params())
    return {
        "ataa8": (config, params),
        "ataa8_paper": pipeline.preset("paper", shot.world.scene, shot.size),
        "taa": (plain, params),
        "taa, mip 0": (unfiltered, params),
        "mean, mip 0": (mean, unlimited),
    }


def main() -> None:
    """Measures and writes the table."""
    table = []
    for name in scenes.available(SCENES):
        shot = scenes.shot(scenes.load(name), "still", size=SIZE)
        still = replace(shot.world.source, duration=0.0)
        shot = replace(shot, world=replace(shot.world, source=still))
        truth = np.asarray(colors.display(reference.reference(shot, 0, 256).color))
        for label, (config, params) in variants(shot).items():
            state = pipeline.init(SIZE)
            jitter = sampling.halton_jitter(config.taa.jitter_length)
            row = [name, label]
            for index in range(max(AT)):
                inputs = shot.inputs(0, jitter[index % len(jitter)])
                output, state = pipeline.frame(
                    state,
                    pipeline.with_cut(inputs, index == 0),
                    params,
                    scene=shot.world.scene,
                    tracer=shot.world.tracer,
                    config=config,
                )
                if index + 1 in AT:
                    ssim = metrics.ssim(np.asarray(output.image), truth)
                    row.append(f"{ssim:.4f}")
            table.append(row)
            print(*row, flush=True)
    file = Path(__file__).parent / "results" / "still.csv"
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["scene", "method", *(f"ssim_{n}" for n in AT)])
        writer.writerows(table)


if __name__ == "__main__":
    main()
