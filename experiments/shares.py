"""The paper's shares: how much of a frame FXAA and the tracer take.

Typical (1 % of the width a frame) and rapid (10 %) motion with the default parameters,
8 rays a traced pixel: within the default budget of 0.48 rays a pixel, and the mask's
own demand without a budget.

    python experiments/shares.py              # writes experiments/results/shares.csv
"""

import csv
from pathlib import Path

import numpy as np
import scenes

from ataa_jax import pipeline
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "modern_house", "dutch_ship")
FRAMES, SKIPPED = 14, 6


def shares(
    shot: worlds.Sequence, budget: float, threshold: float | None = None
) -> dict[str, float]:
    """Returns mean shares and rays of the frames after the first few."""
    config, params = pipeline.preset(
        "tuned", shot.world.scene, shot.size, budget=budget
    )
    if threshold is not None:
        params = pipeline.with_threshold(params, threshold)
    pixels = shot.size[0] * shot.size[1]
    found = []
    for index, (output, _) in enumerate(
        pipeline.sequence(shot, params, config=config, frames=FRAMES)
    ):
        if index >= SKIPPED:
            s = output.statistics
            found.append((int(s.fxaa_pixels), int(s.ataa_pixels), int(s.primary_rays)))
    fxaa, ataa, rays = np.mean(found, axis=0) / pixels
    return {"fxaa": float(fxaa), "ataa": float(ataa), "rays": float(rays)}


def main() -> None:
    """Measures and writes the table."""
    table = []
    for name in scenes.available(SCENES):
        world = scenes.load(name)
        for motion in ("typical", "rapid"):
            shot = scenes.shot(world, "walk", motion)
            within = shares(shot, pipeline.BUDGET)
            free = shares(shot, float("inf"))
            row = [name, motion, within["fxaa"], within["ataa"], within["rays"]]
            table.append([*row, free["rays"]])
            print(*table[-1], flush=True)
    file = Path(__file__).parent / "results" / "shares.csv"
    with file.open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        head = ["scene", "motion", "fxaa_share", "ataa_share", "rays_per_pixel"]
        writer.writerow([*head, "rays_per_pixel_without_budget"])
        for name, motion, *values in table:
            writer.writerow([name, motion, *(f"{value:.4f}" for value in values)])


if __name__ == "__main__":
    main()
