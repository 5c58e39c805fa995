"""How cost grows: with pixels, triangles, lights, textures, traced pixels and frames.

Every point is an ATAA 8x frame in a process of its own, whose peak memory is noted;
times are of all threads together, medians of some frames, for the clock's suffer from
what else a machine does (they are given beside). One thing varies at a time:

- pixels: the built-in scene, 320×180 to 3840×2160;
- triangles: a wavy terrain of 10 thousand to 5 million, 640×360;
- lights: the built-in scene under 0 to 16 lights, 640×360;
- textures: the terrain cut into strips with a material and a texture of 512×512 each;
- traced: the built-in scene with budgets of 1/16 to 8 rays a pixel, 640×360;
- frames: the time of 30 to 300 frames of the built-in scene together, 320×180;
- fits: ATAA 8x, 4x and 2x with rays for the same pixels (budgets of 1/2, 1/4 and 1/8
  rays a pixel), each frame one program, 60 frames, to tell by the clock which sizes fit
  into the paper's 33 ms and 16 ms here.

An exponent is the slope of log time over log size by least squares; "last" is that of
the last two points alone, where what does not grow weighs least.

    python experiments/scaling.py             # writes results/scaling.csv, .png
    python experiments/scaling.py pixels      # measures this part anew
"""

import multiprocessing
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import figures
import lines
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.ticker import NullFormatter

from ataa_jax import files

RESULTS = Path(__file__).parent / "results"
SIZE = (360, 640)
PARTS: dict[str, tuple[int | float, ...]] = {
    "pixels": (180, 360, 720, 1080, 1440, 2160),  # rows
    "triangles": (10_000, 50_000, 200_000, 1_000_000, 5_000_000),
    "lights": (0, 1, 2, 4, 8, 16),
    "textures": (1, 4, 16, 64),
    "traced": (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0),  # rays a pixel
    "frames": (30, 100, 300),
    "fits8": (18, 27, 36, 54, 72, 90, 108, 126, 144),  # rows
    "fits4": (18, 27, 36, 54, 72, 90, 108, 126, 144),
    "fits2": (18, 27, 36, 54, 72, 90, 108, 126, 144),
}
DRAWN = ("pixels", "triangles", "lights", "textures", "traced", "frames")
LIMITS_MS = (33.0, 16.0)  # paper, section 1: 30 and 60 frames a second
REPEATS = 7
STAGES = ("raster", "taa", "segmentation", "raytrace", "resolve", "fxaa")
STAGED = tuple(f"{stage}_cpu_ms" for stage in STAGES)
COLUMNS = (*("part", "size", "load_s", "peak_gb", "frame_ms", "frame_cpu_ms"), *STAGED)


def terrain(triangles: int, strips: int = 1) -> Any:
    """Returns a wavy ground of about so many triangles, cut into textured strips."""
    from ataa_jax import scene as scenes

    side = max(int(np.sqrt(triangles / 2)), strips)
    x, z = np.meshgrid(np.linspace(-20, 20, side + 1), np.linspace(-20, 20, side + 1))
    y = np.sin(x) * np.cos(0.7 * z) + 0.3 * np.sin(3.1 * x + 1.7 * z)
    position = np.stack([x, y, z], axis=-1).astype(np.float32)
    uv = np.stack([x, z], axis=-1).astype(np.float32)
    index = np.arange((side + 1) ** 2, dtype=np.int32).reshape(side + 1, side + 1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    cells = np.stack([a, c, b, b, c, d], axis=-1).reshape(side, -1, 3)
    rng = np.random.default_rng(0)
    meshes = [
        scenes.MeshSource(
            name=f"strip {k}",
            position=position.reshape(-1, 3),
            triangles=part.reshape(-1, 3),
            material=k,
            uv=uv.reshape(-1, 2),
        )
        for k, part in enumerate(np.array_split(cells, strips))
    ]
    return scenes.SceneSource(
        name="terrain",
        meshes=meshes,
        materials=[
            scenes.MaterialSource(metallic=0.0, base_color_texture=k)
            for k in range(strips)
        ],
        textures=[
            scenes.TextureSource(
                rng.integers(60, 256, (512, 512, 4), np.uint8), srgb=True
            )
            for _ in range(strips)
        ],
    )


def world(part: str, value: float) -> Any:
    """Returns the world of one point."""
    from ataa_jax import scene as scenes
    from ataa_jax import world as worlds

    if part in ("triangles", "textures"):
        triangles = int(value) if part == "triangles" else 200_000
        return worlds.prepare(
            terrain(triangles, int(value) if part == "textures" else 1)
        )
    loaded = worlds.load(worlds.BUILTIN)
    if part != "lights":
        return loaded
    rng = np.random.default_rng(0)
    lights = [
        scenes.LightSource(
            kind=1,
            intensity=(50.0, 50.0, 50.0),
            position=(float(x), float(y), float(z)),
        )
        for x, y, z in rng.uniform((-8, 3, -8), (8, 8, 8), (int(value), 3))
    ]
    lit = worlds.replace_lights(
        loaded.scene, scenes.pack_lights(lights), loaded.scene.sky
    )
    return replace(loaded, scene=lit)


def measure(part: str, value: float) -> dict[str, float]:
    """Measures one point, in this process."""
    from ataa_jax import memory, pipeline, programs, sampling
    from ataa_jax import world as worlds
    from ataa_jax.stopwatch import Stopwatch

    programs.keep()
    by_rows = part == "pixels" or part.startswith("fits")
    size = (int(value), int(value) * 16 // 9) if by_rows else SIZE
    size = (180, 320) if part == "frames" else size
    memory.suit(size)
    watch = Stopwatch()
    loaded = world(part, value)
    load_s = 1e-3 * watch.lap().clock_ms
    samples = int(part[4:]) if part.startswith("fits") else 8
    shot = worlds.shot(loaded, "walk", size)
    budget = value if part == "traced" else pipeline.BUDGET * samples / 8
    config, params = pipeline.preset(
        "tuned", loaded.scene, size, samples=samples, budget=budget,
        selection=shot.effects,
    )  # fmt: skip
    if not part.startswith("fits"):
        # Every pixel then asks for rays, so the budget is spent in full.
        params = pipeline.with_threshold(params, 0.0)
    offsets = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    run = once if part.startswith("fits") else by_stages
    state = pipeline.init(size, config.resolve.history)
    times: dict[str, list[float]] = {}
    frames = 60 if part.startswith("fits") else REPEATS
    frames = int(value) if part == "frames" else frames
    for frame in range(-3, frames):
        inputs = shot.inputs(max(frame, 0) % 60, offsets[frame % len(offsets)])
        state, told = run(state, inputs, params, loaded, config)
        for column, each in told.items():
            times.setdefault(column, []).append(each)
    fold: Callable[[Any], Any] = np.sum if part == "frames" else np.median
    found = {column: float(fold(each[3:])) for column, each in times.items()}
    return {"load_s": load_s, "peak_gb": memory.peak() / 1e9, **found}


def once(
    state: Any, inputs: Any, params: Any, loaded: Any, config: Any
) -> tuple[Any, dict[str, float]]:
    """Times a frame as one program."""
    import jax

    from ataa_jax import pipeline
    from ataa_jax.stopwatch import Stopwatch

    watch = Stopwatch()
    _, state = jax.block_until_ready(
        pipeline.frame(
            state, inputs, params, scene=loaded.scene, tracer=loaded.tracer,
            config=config,
        )
    )  # fmt: skip
    lap = watch.lap()
    return state, {"frame_ms": lap.clock_ms, "frame_cpu_ms": lap.processor_ms}


def by_stages(
    state: Any, inputs: Any, params: Any, loaded: Any, config: Any
) -> tuple[Any, dict[str, float]]:
    """Times a frame and its stages."""
    import jax

    from ataa_jax import pipeline
    from ataa_jax.stopwatch import Stopwatch

    watch, told = Stopwatch(), {}

    def observe(stage: str, buffers: Any) -> Any:
        jax.block_until_ready(buffers)
        told[f"{stage}_cpu_ms"] = watch.lap().processor_ms
        watch.start()
        return buffers

    whole = Stopwatch()
    watch.start()
    _, state = pipeline.stages(
        state, inputs, params, scene=loaded.scene, tracer=loaded.tracer,
        config=config, observe=observe,
    )  # fmt: skip
    clock = whole.lap().clock_ms
    return state, {"frame_ms": clock, "frame_cpu_ms": sum(told.values()), **told}


def exponents(rows: list[dict[str, Any]], column: str) -> tuple[float, float]:
    """Returns the slope over all points, and over the last two."""
    told = [row for row in rows if float(row["size"]) > 0 and row[column]]
    x = np.log([_grown(row) for row in told])
    y = np.log([float(row[column]) for row in told])
    last = (y[-1] - y[-2]) / (x[-1] - x[-2])
    return float(np.polyfit(x, y, 1)[0]), float(last)


def rest(rows: list[dict[str, Any]], column: str) -> str:
    """Tells what remains of a cost at size 0."""
    x = np.array([float(row["size"]) for row in rows])
    y = np.array([float(row[column]) for row in rows])
    a, b, r2 = lines.fit(x, y)
    share = a / y[np.argmax(x)]
    return f"{a:.3g} ms + {b:.3g} ms · size, R² {r2:.3f}, a is {share:.1%} of the most"


def _grown(row: dict[str, Any]) -> float:
    """Returns what grew: pixels for rows of an image, else the size itself."""
    size = float(row["size"])
    by_rows = row["part"] == "pixels" or row["part"].startswith("fits")
    return size * size * 16 / 9 if by_rows else size


def fitting(rows: list[dict[str, Any]]) -> list[str]:
    """Tells the largest image of each sample count that fits into each time."""
    told = []
    for limit in LIMITS_MS:
        for part in (name for name in PARTS if name.startswith("fits")):
            own = [row for row in rows if row["part"] == part]
            fits = [int(r["size"]) for r in own if float(r["frame_ms"]) <= limit]
            height = max(fits, default=0)
            size = f"{height * 16 // 9}x{height}" if fits else "none of these"
            told.append(f"{limit:g} ms, ATAA {part[4:]}x: {size}")
    return told


def plot(rows: list[dict[str, Any]], file: Path) -> None:
    """Draws time of all threads over size, a panel a part."""
    figure, axes = plt.subplots(2, 3, figsize=(13, 8))
    for axis, part in zip(axes.flat, DRAWN, strict=True):
        own = [row for row in rows if row["part"] == part]
        if not own:
            continue
        x = [_grown(row) for row in own]
        x = [each or 0.5 * min(filter(None, x)) for each in x]  # none: at the left end
        for column in COLUMNS[5:]:
            y = [float(row[column]) for row in own]
            label = column.removesuffix("_cpu_ms")
            style = "o-" if label == "frame" else ".-"
            axis.loglog(x, y, style, label=label, lw=2.5 if label == "frame" else 1)
        slope, last = exponents(own, "frame_cpu_ms")
        axis.set(title=f"{part}: exponent {slope:.2f}, last {last:.2f}", xlabel=part)
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3, which="both")
    axes[0, 0].set_ylabel("processor time a frame, ms")
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figures.save(figure, file)


def main() -> None:
    """Measures, writes table and plot, and prints the exponents."""
    import csv

    parts = sys.argv[1:] or list(PARTS)
    file = RESULTS / "scaling.csv"
    rows: list[dict[str, Any]] = []
    if file.exists():
        with file.open(newline="") as stream:
            rows = [row for row in csv.DictReader(stream) if row["part"] not in parts]
    context = multiprocessing.get_context("spawn")
    for part in parts:
        for value in PARTS[part]:
            with ProcessPoolExecutor(1, mp_context=context) as pool:
                found = pool.submit(measure, part, value).result()
            told = {name: f"{number:.5g}" for name, number in found.items()}
            rows.append(
                {"part": part, "size": value, **dict.fromkeys(STAGED, ""), **told}
            )
            print(part, value, told, flush=True)
        rows.sort(key=lambda row: list(PARTS).index(row["part"]))
        files.write_csv(file, COLUMNS, [[row[c] for c in COLUMNS] for row in rows])
    for part in PARTS:
        own = [row for row in rows if row["part"] == part]
        if own:
            for column in (name for name in COLUMNS[3:] if own[0][name]):
                slope, last = exponents(own, column)
                print(f"{part} {column}: exponent {slope:.2f}, last {last:.2f}")
    traced = [row for row in rows if row["part"] == "traced"]
    if traced:
        print("traced raytrace_cpu_ms:", rest(traced, "raytrace_cpu_ms"))
    print(*fitting(rows), sep="\n")
    plot(rows, RESULTS / "scaling.png")


if __name__ == "__main__":
    main()
