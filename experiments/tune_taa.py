"""Tunes TAA for quality alone, before ATAA is looked at.

Found: a running mean that ends at weight 0.3, mip bias −2, Catmull-Rom and clip: SSIM
0.9579 over all sequences. Clamp and variance clip are within 0.0005; weights 0.2 and
0.4, biases −1 and −3 are worse, so the best lies within the grid. Level 0 everywhere
(bias −16) costs 0.004.

A grid over blend weight, mip bias, history filter and rectifier, on a still, a typical
and a rapid sequence of every scene; the score is the mean SSIM against the reference.
The best of the grid is `taa.PRESETS["tuned"]` and the mip bias of `pipeline.PRESETS`.

    python experiments/tune_taa.py            # writes experiments/results/tune_taa.csv
"""

import argparse
import csv
import itertools
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import scenes

from ataa_jax import color as colors
from ataa_jax import metrics, pipeline, raster, reference, sampling, taa
from ataa_jax import world as worlds

WEIGHTS = (0.1, 0.2, 0.3, 0.4, 0.5)
MIP_BIASES = (0.0, -1.0, -2.0, -3.0, -16.0)  # the last is mip level 0 everywhere
FILTERS = ("bilinear", "catmull_rom")
RECTIFIERS = (
    ("none", 1.0),
    ("clamp", 1.0),
    ("clip", 1.0),
    ("variance_clip", 1.0),
)
SEQUENCES = {
    "still": ("still", "typical"),
    "typical": ("walk", "typical"),
    "rapid": ("walk", "rapid"),
}
SCORED = 2  # the last frames of each sequence


def grid() -> list[tuple[str, taa.Config, taa.Params]]:
    """Returns the grid's members that share one raster sequence.

    The weight is the one that the running mean of the tuned preset ends at.
    """
    base, _ = taa.PRESETS["tuned"]
    members = []
    for weight, name, (rectify, gamma) in itertools.product(
        WEIGHTS, FILTERS, RECTIFIERS
    ):
        choices: dict[str, Any] = {"history_filter": name, "rectify": rectify}
        config = replace(base, **choices)
        label = f"{weight},{name},{rectify},{gamma}"
        numbers = taa.default_params(
            count_limit=1.0 / weight - 1.0, variance_gamma=gamma
        )
        members.append((label, config, numbers))
    return members


def scores(
    shot: worlds.Sequence, mip_bias: float, frames: int, truth: list[np.ndarray]
) -> dict[str, float]:
    """Runs every member over one raster sequence."""
    config, params = pipeline.preset("tuned", shot.world.scene, shot.size)
    jitter = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    drawn = [
        raster.raster(
            shot.world.scene,
            shot.inputs(index, jitter[index % len(jitter)]),
            raster.default_params(mip_bias),
            tracer=shot.world.tracer,
            config=config.raster,
        )
        for index in range(frames)
    ]
    found = {}
    for label, taa_config, taa_params in grid():
        plain = replace(config, adaptive=False, taa=taa_config)
        state = pipeline.init(shot.size)
        ssim = []
        for index, out in enumerate(drawn):
            inputs = shot.inputs(index, jitter[index % len(jitter)])
            output, state = pipeline.antialias(
                state,
                out,
                inputs,
                pipeline.with_taa(params, taa_params),
                scene=shot.world.scene,
                tracer=shot.world.tracer,
                config=plain,
            )
            if index >= frames - SCORED:
                image = np.asarray(output.image)
                ssim.append(metrics.ssim(image, truth[index - frames + SCORED]))
        found[label] = float(np.mean(ssim))
    return found


def main() -> None:
    """Runs the grid and writes the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--size", default="320x180")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--reference-samples", type=int, default=64)
    options = parser.parse_args()
    width, height = (int(part) for part in options.size.split("x"))
    table: dict[tuple[float, str], dict[str, float]] = defaultdict(dict)
    for name in scenes.available():
        world = scenes.load(name)
        for label, (kind, motion) in SEQUENCES.items():
            shot = scenes.shot(world, kind, motion, size=(height, width))
            truth = [
                np.asarray(
                    colors.display(
                        jnp.asarray(
                            reference.reference(
                                shot, index, options.reference_samples
                            ).color
                        )
                    )
                )
                for index in range(options.frames - SCORED, options.frames)
            ]
            for mip_bias in MIP_BIASES:
                found = scores(shot, mip_bias, options.frames, truth)
                for member, ssim in found.items():
                    table[mip_bias, member][f"{name}/{label}"] = ssim
                best = max(found, key=lambda member: found[member])
                print(f"{name}/{label} bias {mip_bias}: {best} {found[best]:.4f}")
    write(table)


def write(table: dict[tuple[float, str], dict[str, float]]) -> None:
    """Writes every member, best first."""
    file = Path(__file__).parent / "results" / "tune_taa.csv"
    file.parent.mkdir(exist_ok=True)
    columns = sorted(next(iter(table.values())))
    rows = sorted(
        table.items(), key=lambda item: -float(np.mean(list(item[1].values())))
    )
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        head = ["mip_bias", "weight", "filter", "rectifier", "gamma", "mean"]
        writer.writerow([*head, *columns])
        for (bias, label), row in rows:
            mean = float(np.mean(list(row.values())))
            values = [f"{row[column]:.5f}" for column in columns]
            writer.writerow([bias, *label.split(","), f"{mean:.5f}", *values])
    bias, label = rows[0][0]
    print(f"best: mip bias {bias}, {label}")
    for name, value, values in (
        ("mip bias", bias, MIP_BIASES),
        ("weight", float(label.split(",")[0]), WEIGHTS),
    ):
        if value in (min(values), max(values)):
            print(f"the best {name}, {value}, lies at the end of its range {values}")


if __name__ == "__main__":
    main()
