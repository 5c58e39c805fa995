"""What each effect costs: time and rays of the raster stage, leaving one out at a time.

Found: without shadows the raster stage takes 0.72 to 0.88 of its time, without
transparency 0.43 (house) and 0.59 (Tokyo). With everything compiled in it takes 1.07 to
1.61, and no bit of any scene changes.

On each scene, every effect that it calls for, then without one of them, then with
everything compiled in. Times are medians of interleaved runs at 640×360; the tracer
runs the same code on fewer pixels. Ratios are of processor time, of all threads, which
other work on the machine disturbs less than the clock's. An effect that the scene does
not call for must change no bit: the column says whether forcing everything did.

    python experiments/effects_cost.py        # writes results/effects_cost.csv, .png
"""

import time
from pathlib import Path

import jax
import matplotlib as mpl
import numpy as np
import scenes

from ataa_jax import effects, files, pipeline, raster
from ataa_jax import world as worlds

mpl.use("Agg")
from matplotlib import pyplot as plt

REPEATS = 15
RESULTS = Path(__file__).parent / "results"
COLUMNS = (
    *("scene", "variant", "raster_ms", "cpu_ms", "cpu_over_all_called_for"),
    *("shadow_rays", "reflection_rays", "layer_rays", "same_bits"),
)


def variants(world: worlds.World) -> dict[str, worlds.World]:
    """Returns the world as it calls for, without one effect each, and with all."""
    found = {"called for": world}
    for effect in world.looked:
        if effect.on and effect.name not in (
            effects.CAMERA_MOTION,
            effects.OBJECT_MOTION,
        ):
            wish = effects.parse(f"no-{effect.name}")
            found[f"no {effect.name}"] = worlds.wished(world, wish)
    found["everything"] = worlds.wished(world, effects.parse("all"))
    return found


def drawing(world: worlds.World):  # noqa: ANN201 (a closure over compiled code)
    """Returns what draws frame 1 of a typical walk."""
    shot = scenes.shot(world)
    config, params = pipeline.preset(
        "tuned", world.scene, shot.size, selection=shot.effects
    )
    inputs = shot.inputs(1)

    def draw() -> raster.RasterOutput:
        out = raster.raster(
            world.scene,
            inputs,
            params.raster,
            tracer=world.tracer,
            config=config.raster,
        )
        return jax.block_until_ready(out)

    return draw


def measure(name: str) -> list[list[str]]:
    """Returns the rows of one scene."""
    draws = {key: drawing(w) for key, w in variants(scenes.load(name)).items()}
    outputs = {key: draw() for key, draw in draws.items()}  # compiles
    times: dict[str, list[tuple[float, float]]] = {key: [] for key in draws}
    for _ in range(REPEATS):
        for key, draw in draws.items():
            start, busy = time.perf_counter(), time.process_time()
            draw()
            passed = time.perf_counter() - start, time.process_time() - busy
            times[key].append((1e3 * passed[0], 1e3 * passed[1]))
    _, base = np.median(times["called for"], axis=0)
    expected = np.asarray(outputs["called for"].color)
    rows = []
    for key, out in outputs.items():
        ms, cpu = np.median(times[key], axis=0)
        same = bool(np.array_equal(np.asarray(out.color), expected))
        rays = (np.sum(out.rays.shadow), out.rays.reflection, out.rays.layer)
        cells = [f"{ms:.1f}", f"{cpu:.1f}", f"{cpu / base:.3f}"]
        cells += [str(int(count)) for count in rays]
        rows.append([name, key, *cells, "yes" if same else "no"])
        print(*rows[-1], flush=True)
    return rows


def plot(rows: list[list[str]], file: Path) -> None:
    """Draws the time of each variant as a share of all called-for effects' time."""
    names = list(dict.fromkeys(row[0] for row in rows))
    figure, axes = plt.subplots(
        1, len(names), figsize=(3.2 * len(names), 3.4), sharex=True, squeeze=False
    )
    for axis, name in zip(axes[0], names, strict=True):
        own = [row for row in rows if row[0] == name][::-1]
        axis.barh([row[1] for row in own], [float(row[4]) for row in own])
        axis.axvline(1.0, color="0.4", linewidth=0.8)
        axis.set_title(name)
        axis.tick_params(labelsize=7)
        axis.set_xlabel("processor time, all called for = 1", fontsize=8)
    figure.tight_layout()
    figure.savefig(file, dpi=110)


def main() -> None:
    """Measures and writes the table and the plot."""
    rows = [row for name in scenes.available() for row in measure(name)]
    files.write_csv(RESULTS / "effects_cost.csv", COLUMNS, [tuple(r) for r in rows])
    plot(rows, RESULTS / "effects_cost.png")


if __name__ == "__main__":
    main()
