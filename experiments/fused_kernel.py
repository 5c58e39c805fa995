"""TAA and segmentation as fused numba loops: how far off are the jitted stages?

Found: by 2.1 times at 640×360 and 2.7 at 1920×1080, where two cores take some 600 ms
for both stages (1.5 and 1.7 while other work shared the cores, which slowed the loops
more); the oracle takes thousands of times as long. Both give the same picture within
1.1e-4 in sRGB, and the same method at every pixel.

The tuned preset alone (`fused_loops`). It is a yardstick of speed, kept
honest by comparing its results with the stages'. The NumPy oracle of the tests, one
pixel after another in float64, is timed on a small image and counted by pixels.

    python experiments/fused_kernel.py        # writes results/fused_kernel.csv
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import scenes
from fused_loops import fused

from ataa_jax import color as colors
from ataa_jax import files, pipeline, raster, sampling, segmentation, taa, types
from ataa_jax import world as worlds

sys.path.append(str(Path(__file__).resolve().parents[1]))  # the oracles are the tests'

RESULTS = Path(__file__).parent / "results"
SIZES = ((360, 640), (1080, 1920))
ORACLE_SIZE = (36, 64)
ROUNDS = 21
LEAD_IN = 6
COLUMNS = (
    *("size", "jax_ms", "jax_q1", "jax_q3", "numba_ms", "numba_q1", "numba_q3"),
    *("jax_over_numba", "oracle_ms", "oracle_over_jax"),
    *("largest_color_error", "other_method_share", "largest_score_error"),
)


def stages(
    state: types.State, color: Any, gbuffer: Any, jitter: Any, params: Any, config: Any
) -> tuple[taa.TaaOutput, types.Segmentation]:
    """Runs both jitted stages."""
    after = taa.taa(
        state.history, color, gbuffer, jitter, params.taa, config=config.taa
    )
    found = segmentation.segmentation(
        state, color, gbuffer, after.reprojected, params.segmentation,
        config=config.segmentation, blended=after.color,
    )  # fmt: skip
    return jax.block_until_ready((after, found))


def inputs(size: tuple[int, int]) -> tuple[Any, ...]:
    """Returns what the stages read in a frame of the built-in scene in motion."""
    shot = scenes.shot(scenes.load(worlds.BUILTIN), size=size)
    world = shot.world
    config, params = pipeline.preset("tuned", world.scene, size, selection=shot.effects)
    offsets = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    state = pipeline.init(size)
    for frame in range(LEAD_IN):
        given = pipeline.with_cut(shot.inputs(frame, offsets[frame]), frame == 0)
        _, state = pipeline.stages(
            state, given, params, scene=world.scene, tracer=world.tracer, config=config
        )
    given = shot.inputs(LEAD_IN, offsets[LEAD_IN])
    drawn = raster.raster(
        world.scene, given, params.raster, tracer=world.tracer, config=config.raster
    )
    return state, drawn.color, drawn.gbuffer, given.jitter, params, config


def oracle_ms_per_pixel() -> float:
    """Times the tests' oracle of both stages."""
    from tests.oracles import segmentation as segmentation_oracle
    from tests.oracles import taa as taa_oracle

    state, color, gbuffer, jitter, params, config = inputs(ORACLE_SIZE)
    host = jax.tree.map(np.asarray, (state, color, gbuffer, jitter, params))
    state, color, gbuffer, jitter, params = host
    start = time.perf_counter()
    _, read, _, _ = taa_oracle.taa(
        state.history, color, gbuffer, jitter, params.taa, config.taa
    )
    segmentation_oracle.segmentation(
        state, color, gbuffer, read, params.segmentation, config.segmentation
    )
    return 1e3 * (time.perf_counter() - start) / (ORACLE_SIZE[0] * ORACLE_SIZE[1])


def measure(size: tuple[int, int], oracle_ms: float) -> list[str]:
    """Returns a row: both in turn, and how far their results are apart."""
    given = inputs(size)
    state, color, gbuffer, _, params, _ = given
    host = jax.tree.map(np.asarray, (state, color, gbuffer, params))
    times: dict[str, list[float]] = {"jax": [], "numba": []}
    runs = {"jax": lambda: stages(*given), "numba": lambda: fused(*host)}
    for _ in range(ROUNDS + 1):
        for name, run in runs.items():
            start = time.perf_counter()
            run()
            times[name].append(1e3 * (time.perf_counter() - start))
    (after, found), (blended, _, _, method, score) = stages(*given), fused(*host)
    shown = [
        np.asarray(colors.display(jax.numpy.asarray(image)))
        for image in (after.color, blended)
    ]
    quartiles = {k: np.percentile(ms[1:], (50, 25, 75)) for k, ms in times.items()}
    total = oracle_ms * size[0] * size[1]
    jax_ms, numba_ms = quartiles["jax"][0], quartiles["numba"][0]
    numbers = [
        *quartiles["jax"],
        *quartiles["numba"],
        *(jax_ms / numba_ms, total, total / jax_ms),
        float(np.abs(shown[0] - shown[1]).max()),
        float(np.mean((np.asarray(found.mask) & 0xFFFF) != method)),
        float(np.abs(np.asarray(found.score) - score).max()),
    ]
    return [f"{size[1]}x{size[0]}", *(f"{number:.4g}" for number in numbers)]


def main() -> None:
    """Measures and writes the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    oracle_ms = oracle_ms_per_pixel()
    rows = [measure(size, oracle_ms) for size in SIZES]
    for row in rows:
        print(dict(zip(COLUMNS, row, strict=True)))
    files.write_csv(RESULTS / "fused_kernel.csv", COLUMNS, rows)


if __name__ == "__main__":
    main()
