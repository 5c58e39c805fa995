"""Records frames that an engine rendered, in the place of `recording`'s scenes.

Colour and G-buffer are the capture's, and the truth is its reference. What tracing
gives at every pixel is its image of 8 samples a pixel, of 4 or of 2; where it has none
of them, the reference itself, whose error is 0: then a fit sees what the best of rays
would bring. Rays are counted as if traced. Nothing is rendered and nothing cached.
"""

from collections.abc import Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import color as colors
from ataa_jax import pipeline
from ataa_jax.capture import Capture
from ataa_jax.errors import InputError
from ataa_jax.fit.recording import Captured, Progress, Recorded, Recording

# Rays a traced pixel, the most first: as many as a scene's recording has by default.
_RAYS = (8, 4, 2)
# Terms of buffers that a capture does not have.
_BLIND = ("normal", "object", "material", "layers")


def rays_of(captures: Sequence[Capture]) -> int:
    """Returns the rays a traced pixel that all captures have images for.

    Args:
        captures: those of one fit; of none, 8. For one without any such image its
            reference stands in, whatever the number.

    Raises:
        InputError: they have images of different numbers of samples.
    """
    held = [(each, set(each.sample_counts) & set(_RAYS)) for each in captures]
    for count in _RAYS:
        if all(count in counts or not counts for _, counts in held):
            return count
    told = "; ".join(
        f"{each.name} has those of {' and '.join(map(str, sorted(counts)))}"
        for each, counts in held
        if counts
    )
    raise InputError(
        "captures of one fit need images of the same number of samples a pixel, 8, 4 "
        f"or 2: {told}; capture one number for all"
    )


def check_terms(terms: Iterable[str]) -> None:
    """Refuses terms that a capture has no buffers for.

    Raises:
        InputError: names the first.
    """
    for term in terms:
        if term in _BLIND:
            raise InputError(
                "a capture holds no normals, objects, materials or layers; leave "
                f"'{term}' out of the terms of its fit"
            )


def record_capture(
    capture: Capture,
    *,
    frames: int = 12,
    samples: int | None = None,
    progress: Progress = lambda text: None,
) -> Recording:
    """Reads everything about a capture that does not depend on a mask.

    Args:
        capture: checked (`capture.check`); its frames before index 0 are the lead-in,
            see `Capture.after`.
        frames: frames to score, at least 1.
        samples: rays a traced pixel: 2, 4 or 8; None: see `rays_of`.
        progress: told after every frame.

    Raises:
        InputError: no reference, too few frames, or an image that cannot be read.
    """
    left = len(capture.frames) - capture.first
    if not 1 <= frames <= left:
        raise InputError(
            f"capture {capture.folder} has {left} frames after a lead-in of "
            f"{capture.first}; a fit scores 1 to {left} of them, not {frames}"
        )
    if capture.reference_samples is None:
        raise InputError(
            f"capture {capture.folder} has no reference to fit against; capture one "
            "('reference' in capture.toml)"
        )
    count = rays_of([capture]) if samples is None else samples
    kind, sentence = capture.stand_in(count)
    config, params = pipeline.preset(
        "tuned", None, capture.size, samples=count, budget=float("inf")
    )
    config, params = pipeline.with_criteria(config, params, "paper")
    records = []
    for index in range(-capture.first, frames):
        records.append(_read(capture, index, count))
        progress(f"reading {capture.name}, frame {index + capture.first + 1}")
    stacked = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *records)
    return Recording(
        name=capture.name,
        frames=stacked,
        lead_in=capture.first,
        config=config,
        params=params,
        captured=Captured(
            layout=capture.layout,
            traced=kind,
            reference_samples=capture.reference_samples,
            frames=frames,
            lead_in=capture.first,
            notes=(*capture.notes, sentence),
        ),
    )


def _read(capture: Capture, index: int, samples: int) -> Recorded:
    drawn, inputs = capture.draw(index)
    traced = capture.trace(index, samples)(jnp.ones(capture.size, bool))
    truth = jnp.zeros((*capture.size, 3), jnp.float32)
    if index >= 0:
        exact = capture.reference(index)
        if exact is None:
            number = capture.frames[capture.place(index)].number
            raise InputError(
                f"capture {capture.folder}, frame {number}: its reference is missing; "
                "every frame of a fit needs one"
            )
        truth = colors.display(jnp.asarray(exact))
    return pipeline.to_numpy(
        Recorded(
            color=drawn.color,
            gbuffer=drawn.gbuffer,
            traced=traced.color,
            truth=truth,
            jitter=inputs.jitter,
            cut=inputs.cut,
        )
    )


def notes(recordings: Iterable[Recording]) -> list[str]:
    """Returns what there is to say of the captures among recordings, each by name."""
    return [
        f"{each.name}: {note}"
        for each in recordings
        if each.captured is not None
        for note in each.captured.notes
    ]
