"""Do traced colours, fed back into the history, lower the number of traced pixels?

Found: yes, but by little: by 0.1 to 6 % of the traced pixels. On Sponza with a still
camera and UE4's TAA it does the opposite, and raises them by 10 %.

Paper, section 5: by feeding the supersampled results back into the TAA buffer "we also
increase the probability that those pixels will not trigger supersampling on subsequent
frames". 30 frames at 320×180 without a ray budget, with and without
`resolve.Config.feedback`, a still camera (jittered) and typical motion, both TAA
presets. *fired*: pixels whose criteria passed in this very frame, without those that
are only held; *luminance*: those whose luminance term passes by itself, the one term
that reads the history.

    python experiments/feedback.py            # writes results/feedback.csv, .png
"""

from dataclasses import replace

import figures
import numpy as np
import playback
import scenes
from matplotlib import pyplot as plt

from ataa_jax import pipeline, types
from ataa_jax import world as worlds

SCENES = (worlds.BUILTIN, "sponza", "dutch_ship")
SIZE = (180, 320)
FRAMES = 30
SETTLED = 10  # from here on the history is full: means are taken over these frames
PRESETS = ("paper", "ue4")
COLUMNS = (
    *("scene", "preset", "motion", "feedback", "frame"),
    *("fxaa_share", "ataa_share", "fired_share", "luminance_share"),
)
_Row = tuple[str, str, str, str, int, float, float, float, float]


def measure(name: str) -> list[_Row]:
    """Returns the scene's rows."""
    shot = scenes.shot(scenes.load(name), size=SIZE)
    table: list[_Row] = []
    for preset in PRESETS:
        config, params = pipeline.preset(
            preset, shot.world.scene, SIZE, budget=float("inf")
        )
        hold = int(params.segmentation.hold)
        for motion in ("still", "typical"):
            drawn = playback.draw(
                shot, config, params, range(FRAMES), still=motion == "still"
            )
            for feedback in (True, False):
                fed = replace(config.resolve, feedback=feedback)
                variant = replace(config, resolve=fed)
                outputs = playback.antialias(shot, drawn, variant, params)
                for frame, output in enumerate(outputs):
                    method = playback.methods(output)
                    fired = np.asarray(output.segmentation.mask) >> 16 == hold
                    by_luminance = np.asarray(output.segmentation.why)
                    by_luminance = (by_luminance & types.WHY_LUMINANCE) != 0
                    shares = (
                        method == types.METHOD_FXAA,
                        method == types.METHOD_ATAA,
                        fired,
                        by_luminance,
                    )
                    table.append(
                        (
                            name,
                            preset,
                            motion,
                            "on" if feedback else "off",
                            frame,
                            *(float(share.mean()) for share in shares),
                        )  # type: ignore[arg-type]
                    )
    return table


def main() -> None:
    """Measures and writes table and plot."""
    table: list[_Row] = []
    names = scenes.available(SCENES)
    for name in names:
        table += measure(name)
        for preset in PRESETS:
            for motion in ("still", "typical"):
                key = (name, preset, motion)
                means = []
                for feedback in ("on", "off"):
                    rows = [r for r in table if r[:4] == (*key, feedback)]
                    rows = [r[6:] for r in rows if r[4] >= SETTLED]
                    means.append(np.mean(rows, axis=0))
                print(*key, "with", means[0], "without", means[1], flush=True)
    playback.write(playback.RESULTS / "feedback.csv", COLUMNS, table)
    plot(table, names)


def plot(table: list[_Row], names: list[str]) -> None:
    """Draws the traced share frame by frame, a panel a scene and motion."""
    figure, axes = plt.subplots(
        2, len(names), figsize=(11, 5.5), sharex=True, sharey="col", squeeze=False
    )
    palette = {"paper": "#2f66cf", "ue4": "#d23b3b"}
    for column, name in enumerate(names):
        for row, motion in enumerate(("still", "typical")):
            panel = axes[row, column]
            for preset in PRESETS:
                for feedback, style in (("on", "-"), ("off", "--")):
                    key = (name, preset, motion, feedback)
                    y = [100.0 * r[6] for r in table if r[:4] == key]
                    label = f"{preset}, feedback {feedback}"
                    x = range(1, len(y))  # the first frame is all FXAA's
                    panel.plot(x, y[1:], style, color=palette[preset], label=label)
            panel.set_title(f"{name}, {motion}", fontsize=9)
            panel.grid(alpha=0.3)
        axes[1, column].set(xlabel="frame", ylim=(0, None))  # shared by the column
    for row in (0, 1):
        axes[row, 0].set_ylabel("pixels traced, %")
    axes[0, 0].legend(fontsize=7)
    figure.tight_layout()
    figures.save(figure, playback.RESULTS / "feedback.png", dpi=100)


if __name__ == "__main__":
    main()
