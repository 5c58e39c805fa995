"""What each effect costs: time and rays of a frame, leaving one out at a time.

Found: without shadows a frame takes 0.72 to 0.92 of its processor time, without
transparency 0.49 (house) and 0.67 (Tokyo). With the camera at rest it takes 0.63 to
0.84, since hardly a pixel asks for rays then; the motion vectors themselves cost less
than the scatter of the ratios, some 0.1 (0.97 to 1.12 of the raster stage without
them). With everything compiled in a frame takes 1.03 to 1.31, its raster stage 1.06 to
1.55, and no bit of any scene changes.

On each scene, every effect that it calls for, then without one of them, motion of the
camera and of objects included, then with everything compiled in. The frame is the
second of a typical walk at 640×360, with the first one's history; times are medians of
interleaved runs, of the whole frame and of its raster stage. Ratios are of processor
time, of all threads, which other work on the machine disturbs less than the clock's.
Leaving an effect out changes the image, and with it the mask: the rays are those that
the frame then asks for. An effect that the scene does not call for must change no bit
of the raster stage's colour or the final image: the column says whether any did.

    python experiments/effects_cost.py         # writes results/effects_cost.csv, .png
    python experiments/effects_cost.py sponza  # measures this scene's rows anew
"""

import sys
from pathlib import Path
from typing import Any

import figures
import jax
import numpy as np
import scenes
from matplotlib import pyplot as plt

from ataa_jax import effects, files, pipeline, types
from ataa_jax import world as worlds
from ataa_jax.stopwatch import Lap, Stopwatch

REPEATS = 9
RESULTS = Path(__file__).parent / "results"
COLUMNS = (
    *("scene", "variant", "frame_ms", "frame_cpu_ms", "frame_ratio", "raster_ms"),
    *("raster_cpu_ms", "raster_ratio", "sparse_rays", "shadow_rays"),
    *("reflection_rays", "layer_rays", "same_bits"),
)


def variants(world: worlds.World) -> dict[str, worlds.World]:
    """Returns the world as it calls for, without one effect each, and with all."""
    found = {"called for": world}
    for effect in world.looked:
        if effect.on:
            wish = effects.parse(f"no-{effect.name}")
            found[f"no {effect.name}"] = worlds.wished(world, wish)
    found["everything"] = worlds.wished(world, effects.parse("all"))
    return found


class Frame:
    """The second frame of a typical walk, ready to be drawn again and again."""

    def __init__(self, world: worlds.World) -> None:
        """Compiles the stages and draws the first frame."""
        self.world = world
        self.shot = scenes.shot(world)
        self.config, self.params = pipeline.preset(
            "tuned", world.scene, self.shot.size, selection=self.shot.effects
        )
        self.raster = Lap(0.0, 0.0)
        self.state = pipeline.init(self.shot.size)
        _, self.state = self.draw(0)
        self.output, _ = self.draw(1)

    def draw(self, index: int) -> tuple[pipeline.FrameOutput, types.State]:
        """Draws a frame on the stored history, and waits for it."""
        watch = Stopwatch()

        def observe(stage: str, buffer: Any) -> Any:
            if stage == "raster":
                jax.block_until_ready(buffer)
                self.raster = watch.lap()
            return buffer

        return jax.block_until_ready(
            pipeline.stages(
                self.state,
                self.shot.inputs(index),
                self.params,
                scene=self.world.scene,
                tracer=self.world.tracer,
                config=self.config,
                observe=observe,
            )
        )

    def rays(self) -> list[int]:
        """Returns sparse primary rays, and those of all stages by effect."""
        count = self.output.statistics
        both = jax.tree.map(jax.numpy.add, count.rays, count.raster_rays)
        cast = (count.primary_rays, both.shadow.sum(), both.reflection, both.layer)
        return [int(each) for each in cast]

    def images(self) -> list[np.ndarray]:
        """Returns what must not change: raster's colour and the final image."""
        return [np.asarray(self.output.raw), np.asarray(self.output.image)]


def measure(name: str) -> list[tuple[str, ...]]:
    """Returns the rows of one scene."""
    frames = {key: Frame(world) for key, world in variants(scenes.load(name)).items()}
    # Of each variant and run: whole frame and raster stage, both clocks.
    times: dict[str, list[tuple[float, ...]]] = {key: [] for key in frames}
    for _ in range(REPEATS):
        for key, frame in frames.items():
            watch = Stopwatch()
            frame.draw(1)
            times[key].append((*watch.lap(), *frame.raster))
    medians = {key: np.median(runs, axis=0) for key, runs in times.items()}
    base, expected = medians["called for"], frames["called for"].images()
    rows = []
    for key, frame in frames.items():
        ms, cpu, raster_ms, raster_cpu = medians[key]
        same = all(map(np.array_equal, frame.images(), expected))
        cells = [f"{ms:.1f}", f"{cpu:.1f}", f"{cpu / base[1]:.3f}"]
        cells += [f"{raster_ms:.1f}", f"{raster_cpu:.1f}"]
        cells += [f"{raster_cpu / base[3]:.3f}", *map(str, frame.rays())]
        rows.append((name, key, *cells, "yes" if same else "no"))
        print(*rows[-1], flush=True)
    return rows


def plot(rows: list[tuple[str, ...]], file: Path) -> None:
    """Draws the time of each variant as a share of all called-for effects' time."""
    names = list(dict.fromkeys(row[0] for row in rows))
    lines = -(-len(names) // 3)
    figure, axes = plt.subplots(
        lines, 3, figsize=(11, 4 * lines), sharex=True, squeeze=False
    )
    for axis in axes.flat[len(names) :]:
        axis.remove()
    for axis, name in zip(axes.flat, names, strict=False):
        own = [row for row in rows if row[0] == name][::-1]
        place = np.arange(len(own))
        for column, label, shift in ((4, "frame", 0.2), (7, "raster stage", -0.2)):
            ratio = [float(row[column]) for row in own]
            axis.barh(place + shift, ratio, 0.4, label=label)
        axis.set_yticks(place, [row[1] for row in own])
        axis.axvline(1.0, color="0.4", linewidth=0.8)
        axis.set_title(name)
        axis.tick_params(labelsize=7)
        axis.set_xlabel("processor time, all called for = 1", fontsize=8)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=2, loc="upper left")
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 0.97))
    figures.save(figure, file, dpi=100)


def main() -> None:
    """Measures and writes the table and the plot."""
    names = sys.argv[1:] or scenes.available()
    found = scenes.other_rows(RESULTS / "effects_cost.csv", names)[1:]
    rows = [tuple(row) for row in found]
    for name in names:
        rows += measure(name)
        files.write_csv(RESULTS / "effects_cost.csv", COLUMNS, rows)
        jax.clear_caches()
    plot(rows, RESULTS / "effects_cost.png")


if __name__ == "__main__":
    main()
