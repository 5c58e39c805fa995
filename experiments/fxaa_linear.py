"""Does FXAA's time fall linearly with its pixels?

Paper, section 4: the FXAA pass "in practice scales linearly down to 0 as fewer of the
pixels are identified for FXAA in the mask". `fxaa.fxaa_sparse` is timed for masks of 0
to 100 % of the pixels at 640×360 and 1280×720: *border* masks are bands at the right
side, as a pan uncovers them, *scattered* ones single pixels at random. The image is a
frame of the built-in scene, where only some pixels show an edge and get filtered, or
*noise*, where all do: the worst case. All variants take turns, so that other work on
the machine falls on all alike. *cpu* is the processor time of all threads, median of
the rounds, which other work disturbs less than the clock's; the clock's median and
least are given beside it. A line a + b · pixels is fitted to cpu by least squares,
against the pixels asked for and against those of them that show an edge.

Found: linear, R² 0.996 to 0.9999 in every series, but not down to 0: what all pixels
pay (luma, contrast, compaction, half of a chunk of 4,096) is 3 to 9 % of the full
cost, and 11 to 15 % in two runs on the built-in scene at 640×360, where all of the
screen takes but 40 ms of processor time. Chunks of 8,192 left 15 to 20 % there.

    python experiments/fxaa_linear.py         # writes results/fxaa_linear.csv, .png
"""

import argparse
from dataclasses import dataclass, field

import figures
import jax
import jax.numpy as jnp
import lines
import numpy as np
import playback
import scenes
from matplotlib import pyplot as plt

from ataa_jax import color as colors
from ataa_jax import fxaa, pipeline
from ataa_jax import world as worlds
from ataa_jax.stopwatch import Lap, Stopwatch

SIZES = ((360, 640), (720, 1280))
SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
COLUMNS = (
    *("size", "image", "mask", "share", "pixels", "edge_pixels"),
    *("cpu_ms", "median_ms", "least_ms", "a_ms", "b_ns_per_pixel", "a_over_full"),
    *("r2", "r2_edge_pixels", "r2_median", "r2_least"),
)


@dataclass
class Case:
    """One image and mask, and what filtering it took."""

    series: tuple[str, str, str]  # size, image, kind of mask
    share: float
    image: jax.Array
    needed: jax.Array
    edges: int  # pixels asked for that show an edge
    laps: list[Lap] = field(default_factory=list)

    def run(self) -> None:
        """Filters once; the time is until the result is ready."""
        watch = Stopwatch()
        jax.block_until_ready(
            fxaa.fxaa_sparse(
                self.image, self.needed, fxaa.default_params(), config=fxaa.Config()
            )
        )
        self.laps.append(watch.lap())

    def median(self) -> Lap:
        """Returns the median by each clock."""
        return Lap(*np.median(self.laps, axis=0))


def mask(kind: str, share: float, size: tuple[int, int]) -> np.ndarray:
    """Returns a mask of about this share of the pixels."""
    if kind == "border":
        column = np.arange(size[1])
        return np.broadcast_to(column >= size[1] * (1.0 - share), size)
    return np.random.default_rng(1).random(size) < share


def images(size: tuple[int, int]) -> dict[str, np.ndarray]:
    """Returns the images that are filtered, sRGB."""
    shot = scenes.shot(scenes.load(worlds.BUILTIN), size=size)
    config, params = pipeline.preset("tuned", shot.world.scene, size)
    ((_, drawn),) = playback.draw(shot, config, params, range(1))
    noise = np.random.default_rng(0).random((*size, 3))
    return {
        "builtin": np.asarray(colors.display(drawn.color)),
        "noise": noise.astype(np.float32),
    }


def shows_edge(image: np.ndarray) -> np.ndarray:
    """Returns where the luma of the cross has the contrast of an edge."""
    luma = np.pad(np.asarray(colors.luma(jnp.asarray(image))), 1, mode="edge")
    middle = slice(1, -1)
    rows, columns = (slice(-2), slice(2, None)), (slice(-2), slice(2, None))
    cross = np.stack(
        [
            luma[middle, middle],
            *(luma[row, middle] for row in rows),
            *(luma[middle, column] for column in columns),
        ]
    )
    p = fxaa.default_params()
    limit = np.maximum(p.edge_threshold_min, p.edge_threshold * cross.max(axis=0))
    return np.ptp(cross, axis=0) >= limit


def cases() -> list[Case]:
    """Returns every image under every mask."""
    found = []
    for size in SIZES:
        for name, image in images(size).items():
            edge, on_device = shows_edge(image), jnp.asarray(image)
            for kind in ("border", "scattered"):
                for share in SHARES:
                    needed = mask(kind, share, size)
                    found.append(
                        Case(
                            series=(f"{size[1]}x{size[0]}", name, kind),
                            share=share,
                            image=on_device,
                            needed=jnp.asarray(needed),
                            edges=int((needed & edge).sum()),
                        )
                    )
    return found


def main() -> None:
    """Times everything and writes table and plot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=11)
    options = parser.parse_args()
    every = cases()
    for case in every:  # compiles
        case.run()
        case.laps.clear()
    for _ in range(options.rounds):
        for case in every:
            case.run()
    table: list[tuple[object, ...]] = []
    series = {
        case.series: [c for c in every if c.series == case.series] for case in every
    }
    for key, members in series.items():
        pixels = np.array([float(c.needed.sum()) for c in members])
        edges = np.array([float(c.edges) for c in members])
        medians, cpu = np.array([c.median() for c in members]).T
        least = np.array([min(lap.clock_ms for lap in c.laps) for c in members])
        a, b, r2 = lines.fit(pixels, cpu)
        others = [lines.fit(*pair)[2] for pair in ((edges, cpu), (pixels, medians))]
        others.append(lines.fit(pixels, least)[2])
        full = float(cpu[-1])
        print(*key, f"a {a:.2f} ms, b {1e6 * b:.1f} ns, full {full:.2f} ms", end=" ")
        print(f"a/full {a / full:.3f}, R² {r2:.4f}, of edges, median, least", *others)
        for k, case in enumerate(members):
            table.append(
                (
                    *(*key, case.share, int(pixels[k]), case.edges),
                    *(float(cpu[k]), float(medians[k]), float(least[k])),
                    *(a, 1e6 * b, a / full, r2, *others),
                )
            )
    playback.write(playback.RESULTS / "fxaa_linear.csv", COLUMNS, table)
    plot(series)


def plot(series: dict[tuple[str, str, str], list[Case]]) -> None:
    """Draws time over pixels, as shares of the whole frame's."""
    sizes = list(dict.fromkeys(key[0] for key in series))
    figure, axes = plt.subplots(1, len(sizes), figsize=(10, 4.2))
    palette = {"builtin": "#2f66cf", "noise": "#d23b3b"}
    for panel, size in zip(axes, sizes, strict=True):
        for (this, image, kind), members in series.items():
            if this != size:
                continue
            x = 100.0 * np.array([c.share for c in members])
            y = np.array([c.median().processor_ms for c in members])
            style = "o-" if kind == "border" else "x--"
            panel.plot(x, y, style, color=palette[image], label=f"{image}, {kind}")
        panel.set(
            title=size,
            xlabel="pixels asked for, %",
            ylabel="FXAA, ms of processor time",
        )
        panel.set_ylim(bottom=0)
        panel.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    figure.tight_layout()
    figures.save(figure, playback.RESULTS / "fxaa_linear.png", dpi=100)


if __name__ == "__main__":
    main()
