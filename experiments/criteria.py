"""What each choice of the paper's segmentation is worth: one changed at a time.

A walk of typical motion at 640×360 and at most 0.48 sparse rays a pixel; the share of
TAA's 1 − SSIM that ATAA 8x removes, and its error over TAA's on thin features.

    python experiments/criteria.py            # writes experiments/results/criteria.csv
"""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scenes

from ataa_jax import color as colors
from ataa_jax import metrics, pipeline, reference, sampling
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "sponza", "littlest_tokyo")
LEAD_IN, FRAMES = 8, 3
VARIANTS: dict[str, tuple[dict[str, Any], dict[str, float]]] = {
    "paper": ({}, {}),
    "luminance alone": ({"use_depth": False}, {}),
    "depth alone": ({"use_luminance": False}, {}),
    "no classification history": ({"use_history": False}, {}),
    "paper's disocclusion": ({"disocclusion": "pixel"}, {}),
    "threshold 0.10": ({}, {"threshold": 0.10}),
    "threshold 0.20": ({}, {"threshold": 0.20}),
    "threshold 0.27": ({}, {"threshold": 0.27}),
}


def render(
    shot: worlds.Sequence,
    config: pipeline.Config,
    params: pipeline.Params,
) -> tuple[list[np.ndarray], float]:
    """Returns the scored frames, and the mean rays a pixel in them."""
    jitter = sampling.halton_jitter(config.taa.jitter_length)
    state = pipeline.init(shot.size)
    images, rays = [], []
    for index in range(-LEAD_IN, FRAMES):
        inputs = shot.inputs(index, jitter[(index + LEAD_IN) % len(jitter)])
        output, state = pipeline.stages(
            state,
            pipeline.with_cut(inputs, index == -LEAD_IN),
            params,
            scene=shot.world.scene,
            tracer=shot.world.tracer,
            config=config,
        )
        if index >= 0:
            images.append(np.asarray(output.image))
            rays.append(int(output.statistics.primary_rays))
    return images, float(np.mean(rays)) / (shot.size[0] * shot.size[1])


def errors(images: list[np.ndarray], truth: list[Any]) -> tuple[float, float]:
    """Returns 1 − SSIM, and the squared error where thin features cross a pixel."""
    left, thin = [], []
    for image, exact in zip(images, truth, strict=True):
        shown = np.asarray(colors.display(exact.color))
        share = np.asarray(exact.thin)
        left.append(1.0 - metrics.ssim(image, shown))
        crossed = (share > 0.0) & (share < 1.0)
        thin.append(metrics.mean_squared_error(image, shown, crossed))
    return float(np.mean(left)), float(np.mean(thin))


def main() -> None:
    """Measures and writes the table."""
    table: list[tuple[Any, ...]] = []
    for name in scenes.available(SCENES):
        shot = scenes.shot(scenes.load(name))
        truth = [reference.reference(shot, index, 64) for index in range(FRAMES)]
        config, params = pipeline.preset("paper", shot.world.scene, shot.size)
        images, _ = render(shot, replace(config, adaptive=False), params)
        taa, taa_thin = errors(images, truth)
        images, rays = render(
            shot, *pipeline.preset("tuned", shot.world.scene, shot.size)
        )
        left, thin = errors(images, truth)
        table.append((name, "tuned preset", 1.0 - left / taa, thin / taa_thin, rays))
        for label, (choices, numbers) in VARIANTS.items():
            changed = params
            for field, value in numbers.items():
                changed = eqx.tree_at(
                    lambda p, field=field: getattr(p.segmentation, field),
                    changed,
                    jnp.asarray(value, jnp.float32),
                )
            segmentation = replace(config.segmentation, **choices)
            images, rays = render(
                shot, replace(config, segmentation=segmentation), changed
            )
            left, thin = errors(images, truth)
            row = (name, label, 1.0 - left / taa, thin / taa_thin, rays)
            table.append(row)
            print(*row, flush=True)
    file = Path(__file__).parent / "results" / "criteria.csv"
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        head = ["scene", "variant", "taa_error_removed", "thin_mse_ratio"]
        writer.writerow([*head, "rays_per_pixel"])
        for name, label, *values in table:
            writer.writerow([name, label, *(f"{value:.4f}" for value in values)])


if __name__ == "__main__":
    main()
