"""How many bits do history and G-buffer need?

Found: with the default preset nothing drifts. Kept in float16 the composite is off by
5e-5 on average from frame 10 to frame 1,000, an 80th of a step of 8 bits, and 0.1 % of
the pixels get another method; in bfloat16 by 3e-4 (0.7 %), in float32 by 3e-8 (none). A
plain mean of all frames does drift in 16 bits, for what a frame adds falls under the
history's last bit: float16 is off by 6e-5 after 10 frames and 0.003 after 1,000,
bfloat16 by 0.014, float32 by 2e-7. 16 bits halve the history (28 to 14 bytes a pixel)
and save no time on a CPU, which computes in float32. Hence the default: float32, with
which a still image converges; float16 for who has the default's running mean and
little memory; bfloat16 for nobody.

1,000 frames at 160×90 of the built-in scene, a still camera (jittered) and one that
circles; with the default preset, and ("mean") with TAA as a plain mean of all frames,
weight 1/(n + 1), which asks the most of the history. The history, the G-buffer, or both
are kept in float16, bfloat16 or float32, and read into float32; float64 throughout is
the truth, from the same float32 draws. Errors are of the composite in sRGB, and the
share of pixels whose method differs. No budget, so that a pixel's method is its own.

Memory is what one pixel takes; times are of TAA, segmentation and resolve as one
compiled program at 1920×1080, medians and quartiles of runs in turn.

    python experiments/precision.py           # writes results/precision*.csv, .png
"""

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, get_args

import equinox as eqx
import figures
import jax
import jax.numpy as jnp
import numpy as np
import playback
import scenes
from matplotlib import pyplot as plt

from ataa_jax import color as colors
from ataa_jax import formats, pipeline, raster, raytrace, resolve, sampling, types
from ataa_jax import world as worlds
from ataa_jax.fit import replay
from ataa_jax.fit.recording import Recorded
from ataa_jax.formats import Format

SIZE, TIMED_SIZE = (90, 160), (1080, 1920)
FRAMES = 1000
TOLD = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
NARROW: tuple[Format, ...] = ("float16", "bfloat16", "float32")
KEPT = ("history", "gbuffer", "both")
REPEATS = 15
COLUMNS = (
    *("path", "taa", "kept", "format", "frame"),
    *("largest_error", "mean_error", "other_method"),
)
_Row = tuple[str, str, str, str, int, float, float, float]


def presets(scene: types.Scene) -> dict[str, tuple[pipeline.Config, pipeline.Params]]:
    """Returns the default, and TAA as the plain mean of all frames."""
    config, params = pipeline.preset("tuned", scene, SIZE, budget=float("inf"))
    plain = replace(config.taa, rectify="none", blend="accumulate")
    unlimited = eqx.tree_at(
        lambda p: p.taa.count_limit, params, jnp.asarray(65535.0, jnp.float32)
    )
    mean = replace(config, taa=plain, adaptive=False)
    return {"tuned": (config, params), "mean": (mean, unlimited)}


def recorded(shot: worlds.Sequence) -> Iterator[Recorded]:
    """Yields the frames: draws in float32, and what tracing gives everywhere."""
    world = shot.world
    config, params = pipeline.preset("tuned", world.scene, SIZE, selection=shot.effects)
    offsets = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    for index in range(FRAMES):
        inputs = shot.inputs(index, offsets[index % len(offsets)])
        drawn = raster.raster(
            world.scene, inputs, params.raster,
            tracer=world.tracer, config=config.raster,
        )  # fmt: skip
        traced = raytrace.raytrace(
            world.scene, inputs, jnp.ones(SIZE, bool),
            tracer=world.tracer, config=config.raytrace,
        )  # fmt: skip
        yield without_truth(inputs, drawn, traced.color)


def without_truth(
    inputs: types.FrameInputs, drawn: raster.RasterOutput, traced: jax.Array
) -> Recorded:
    """Returns a frame's record; nothing here reads the truth."""
    return Recorded(
        color=drawn.color,
        gbuffer=drawn.gbuffer,
        traced=traced,
        truth=jnp.zeros_like(drawn.color),
        jitter=inputs.jitter,
        cut=inputs.cut,
    )


@partial(jax.jit, static_argnames=("config", "gbuffer"))
def step(
    state: types.State,
    frame: Recorded,
    params: pipeline.Params,
    *,
    config: pipeline.Config,
    gbuffer: Format,
) -> tuple[types.State, jax.Array, jax.Array]:
    """Returns the next state, the composite in sRGB, and each pixel's METHOD_*."""
    kept = jax.tree.map(partial(_kept, kept_as=gbuffer), frame.gbuffer)
    frame = eqx.tree_at(lambda f: f.gbuffer, frame, kept)
    choose = replay.by_criteria(config.segmentation)
    if not config.adaptive:
        choose = _all_taa
    state, _, method, composite = replay.composed(
        state, frame, params, config=config, choose=choose
    )
    return state, colors.display(composite), method


def _kept(leaf: jax.Array, kept_as: Format) -> jax.Array:
    floats = jnp.issubdtype(leaf.dtype, jnp.floating)
    return formats.narrow(leaf, kept_as) if floats else leaf


def _all_taa(
    state: types.State, frame: Recorded, blended: Any, params: Any, extra: object
) -> types.Segmentation:
    del state, blended, params, extra
    height, width = frame.gbuffer.depth.shape
    return pipeline.segmentation.all_taa((height, width))


def variants() -> dict[tuple[str, Format], tuple[Format, Format]]:
    """Returns what the history and what the G-buffer is kept in."""
    found: dict[tuple[str, Format], tuple[Format, Format]] = {}
    for kept in KEPT:
        for each in NARROW:
            if each == "float32" and kept != "both":
                continue
            history: Format = each if kept != "gbuffer" else "float32"
            buffers: Format = each if kept != "history" else "float32"
            found[kept, each] = (history, buffers)
    return found


def double(tree: Any) -> Any:
    """Returns the tree with its floats in 64 bits; call where they are enabled."""
    return jax.tree.map(
        lambda leaf: (
            jnp.asarray(np.asarray(leaf).astype(np.float64))
            if jnp.issubdtype(leaf.dtype, jnp.floating)
            else jnp.asarray(leaf)
        ),
        tree,
    )


def drift(path: str) -> list[_Row]:
    """Returns the errors of every preset and variant along one path."""
    world = scenes.load(worlds.BUILTIN)
    if path == "still":
        world = replace(world, source=replace(world.source, duration=0.0))
    shot = scenes.shot(world, path, size=SIZE)
    told = presets(world.scene)
    states = {
        (taa, name): pipeline.init(SIZE, history)
        for taa in told
        for name, (history, _) in variants().items()
    }
    with jax.enable_x64(True):
        exact = {taa: pipeline.init(SIZE, "float64") for taa in told}
        exact_params = {taa: double(params) for taa, (_, params) in told.items()}
    table: list[_Row] = []
    for number, frame in enumerate(recorded(shot), start=1):
        for taa, (config, params) in told.items():
            truth, exact[taa] = _exactly(exact[taa], frame, exact_params[taa], config)
            for name, (history, buffers) in variants().items():
                kept = replace(config, resolve=replace(config.resolve, history=history))
                states[taa, name], image, method = step(
                    states[taa, name], frame, params, config=kept, gbuffer=buffers
                )
                if number in TOLD:
                    error = np.abs(np.asarray(image, np.float64) - truth[0])
                    other = float(np.mean(np.asarray(method) != truth[1]))
                    row = (float(error.max()), float(error.mean()), other)
                    table.append((path, taa, *name, number, *row))
        if number in TOLD:
            print(path, "frame", number, flush=True)
    return table


def _exactly(
    state: types.State, frame: Recorded, params: pipeline.Params, config: Any
) -> tuple[tuple[np.ndarray, np.ndarray], types.State]:
    with jax.enable_x64(True):
        kept = replace(config, resolve=replace(config.resolve, history="float64"))
        state, image, method = step(
            state, double(frame), params, config=kept, gbuffer="float64"
        )
        return (np.asarray(image), np.asarray(method)), state


def cost() -> list[tuple[str, int, int, float, float, float]]:
    """Returns (format, bytes of history, of G-buffer, ms: quartile, median, quartile).

    float32's history and G-buffer beside those of 16 bits, and float64's.
    """
    told, ready = {}, {}
    for kept_as in get_args(Format):
        with jax.enable_x64(kept_as == "float64"):
            ready[kept_as] = _timed_operands(kept_as)
            state, frame, _, _ = ready[kept_as]
            pixels = TIMED_SIZE[0] * TIMED_SIZE[1]
            told[kept_as] = tuple(
                sum(leaf.nbytes for leaf in jax.tree.leaves(tree)) // pixels
                for tree in (state.history, frame.gbuffer)
            )
    times: dict[str, list[float]] = {kept_as: [] for kept_as in ready}
    for _ in range(REPEATS + 1):
        for kept_as, (state, frame, params, config) in ready.items():
            with jax.enable_x64(kept_as == "float64"):
                start = time.perf_counter()
                out = step(state, frame, params, config=config, gbuffer=kept_as)
                jax.block_until_ready(out)
                times[kept_as].append(1e3 * (time.perf_counter() - start))
    table = []
    for kept_as, each in times.items():
        low, middle, high = np.quantile(each[1:], (0.25, 0.5, 0.75))
        table.append((kept_as, *told[kept_as], float(low), float(middle), float(high)))
        print(*table[-1], flush=True)
    return table


def _timed_operands(
    kept_as: Format,
) -> tuple[types.State, Recorded, pipeline.Params, pipeline.Config]:
    """Draws one 1080p frame and the history it meets, and keeps both in a format."""
    world = scenes.load(worlds.BUILTIN)
    shot = scenes.shot(world, "walk", size=TIMED_SIZE)
    with jax.enable_x64(False):
        config, params = pipeline.preset(
            "tuned", world.scene, TIMED_SIZE, budget=float("inf")
        )
        drawn = playback.draw(shot, config, params, range(2))
        frames = [without_truth(*each, each[1].color) for each in drawn]
    config = replace(config, resolve=resolve.Config(history=kept_as))
    if kept_as == "float64":
        frames, params = double(frames), double(params)
    start = pipeline.init(TIMED_SIZE, kept_as)
    state, _, _ = step(start, frames[0], params, config=config, gbuffer=kept_as)
    gbuffer = jax.tree.map(partial(_kept, kept_as=kept_as), frames[1].gbuffer)
    frame = eqx.tree_at(lambda f: f.gbuffer, frames[1], gbuffer)
    return jax.block_until_ready((state, frame, params, config))


def plot(table: list[_Row], file: Path) -> None:
    """Draws mean errors over the frames, a panel a path and TAA."""
    panels = list(dict.fromkeys(row[:2] for row in table))
    figure, axes = plt.subplots(2, len(panels) // 2, figsize=(11, 8), squeeze=False)
    for axis, panel in zip(axes.flat, panels, strict=True):
        for name in variants():
            own = [r for r in table if r[:2] == panel and r[2:4] == name]
            style = {"history": "o-", "gbuffer": "s--", "both": "^:"}[name[0]]
            color = {"float16": "C0", "bfloat16": "C1", "float32": "C2"}[name[1]]
            x, y = [r[4] for r in own], [max(r[6], 1e-9) for r in own]
            axis.loglog(x, y, style, color=color, label=" in ".join(name), ms=4)
        axis.axhline(1 / 255 / 2, color="gray", ls=":", label="half a step of 8 bits")
        axis.set(title=", ".join(panel), xlabel="frame", ylabel="mean error, sRGB")
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figures.save(figure, file)


def main() -> None:
    """Measures and writes tables and plot."""
    table = [row for path in ("still", "orbit") for row in drift(path)]
    playback.write(playback.RESULTS / "precision.csv", COLUMNS, table)
    plot(table, playback.RESULTS / "precision.png")
    head = ("format", "history_bytes", "gbuffer_bytes", "ms_q1", "ms", "ms_q3")
    playback.write(playback.RESULTS / "precision_cost.csv", head, cost())


if __name__ == "__main__":
    main()
