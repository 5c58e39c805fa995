"""How much of every frame is new: the last thing that tells a bad capture.

The segmentation stage itself is asked, on the frames as they are read.
"""

import jax.numpy as jnp
import numpy as np

from ataa_jax import pipeline
from ataa_jax.capture.findings import WARNING, Finding
from ataa_jax.capture.record import Capture
from ataa_jax.raytrace import RaytraceOutput
from ataa_jax.shading import no_rays
from ataa_jax.types import METHOD_FXAA

LIMIT = 0.30  # of the pixels, without a camera cut


def shares(capture: Capture, most: int = 24) -> list[float]:
    """Returns the share of FXAA's pixels of every frame."""
    whole = capture.after(0)
    config, params = pipeline.preset("tuned", None, whole.size, budget=0.0)
    state = pipeline.init(whole.size)
    nothing = RaytraceOutput(
        color=jnp.zeros((*whole.size, 3), jnp.float32),
        primary_rays=jnp.zeros((), jnp.int32),
        rays=no_rays(None),
    )
    found = []
    for index in range(min(len(whole.frames), most)):
        drawn, inputs = whole.draw(index)
        output, state = pipeline.antialias(
            state, drawn, inputs, params, config=config, trace=lambda _: nothing
        )
        method = np.asarray(output.segmentation.mask) & 0xFFFF
        found.append(float(np.mean(method == METHOD_FXAA)))
    return found


def check(capture: Capture) -> tuple[list[Finding], list[tuple[str, str]]]:
    """Warns of frames that are mostly new though no cut was told."""
    found = shares(capture)
    steady = [
        (share, frame)
        for share, frame in zip(found, capture.frames, strict=False)
        if not frame.cut and frame is not capture.frames[0]
    ]
    findings = [
        Finding(
            WARNING,
            "mostly new",
            f"frame {frame.number}",
            f"{share:.0%} of the pixels have no usable history, over {LIMIT:.0%}, and "
            "no camera cut is told",
            "mark the cut (NSS: CameraCut), or check the motion vectors",
        )
        for share, frame in steady
        if share > LIMIT
    ]
    mean = float(np.mean([share for share, _ in steady])) if steady else 0.0
    return findings, [("pixels without history, mean", f"{mean:.1%}")]
