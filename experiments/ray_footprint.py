"""What of a texture should a sparse ray read? All pixels traced, one frame a scene.

Eight rays at every pixel of frame 10 of a typical walk, 320×180, against 64 samples a
pixel at mip level 0. *scale* multiplies the ray's share of the pixel; 0 is the paper's
mip level 0.

    python experiments/ray_footprint.py       # writes results/ray_footprint.csv
"""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import scenes

from ataa_jax import color as colors
from ataa_jax import files, metrics, raytrace, reference

SIZE, FRAME, SAMPLES = (180, 320), 10, 64
SCALES = (0.0, 0.125, 0.25, 0.5, 1.0)
RESULTS = Path(__file__).parent / "results"


def measure(name: str) -> list[tuple[str, ...]]:
    """Returns the rows of one scene."""
    shot = scenes.shot(scenes.load(name), size=SIZE)
    world, inputs = shot.world, shot.inputs(FRAME)
    truth = reference.reference(shot, FRAME, SAMPLES).color
    exact = np.asarray(colors.display(truth))
    rows = []
    for scale in SCALES:
        config = raytrace.Config(
            footprint="sample" if scale else "level0",
            footprint_scale=scale,
            shading=world.shading,
        )
        everywhere = jnp.ones(SIZE, jnp.bool_)
        traced = raytrace.raytrace(
            world.scene, inputs, everywhere, tracer=world.tracer, config=config
        )
        image = np.asarray(colors.display(traced.color))
        ssim, mse = metrics.ssim(image, exact), float(np.mean((image - exact) ** 2))
        rows.append((name, f"{scale:g}", f"{ssim:.5f}", f"{mse:.4g}"))
        print(*rows[-1], flush=True)
    return rows


def main() -> None:
    """Measures and writes the table."""
    rows = [row for name in scenes.available() for row in measure(name)]
    columns = ("scene", "scale", "ssim", "mse")
    files.write_csv(RESULTS / "ray_footprint.csv", columns, rows)


if __name__ == "__main__":
    main()
