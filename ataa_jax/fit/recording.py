"""Records a sequence once, so that any mask can be replayed without a single ray.

Per frame: the raster sample and its G-buffer, what tracing *every* pixel would give,
and the supersampled truth. None of it depends on the segmentation, its history or
TAA's numbers; so `replay` closes the loop over any parameters on these arrays alone.

A frame's record is cached on disk by the content that decides it: a recording that was
killed goes on where it stopped.
"""

import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ataa_jax import cache, pipeline, raster, raytrace, reference, sampling
from ataa_jax import color as colors
from ataa_jax.errors import InputError
from ataa_jax.types import FrameInputs, GBuffer
from ataa_jax.world import Sequence

# our choice: as in `compare`; the first frame, all of it new, is a case of its own.
LEAD_IN = 8

# our choice: about 1,000 frames of 320×180; the oldest go first.
CACHE_LIMIT_BYTES = 4 << 30

Progress = Callable[[str], None]


class Recorded(eqx.Module):
    """One frame's record; a `Recording` stacks them along a leading axis."""

    color: Float[Array, "h w 3"]  # raster's jittered sample, linear
    gbuffer: GBuffer
    traced: Float[Array, "h w 3"]  # what tracing gives at every pixel, linear
    truth: Float[Array, "h w 3"]  # the reference as sRGB; 0 in frames of the lead-in
    jitter: Float[Array, " 2"]
    cut: Bool[Array, ""]


@dataclass(frozen=True)
class Captured:
    """What a recording of an engine's frames is made of; see `captured`."""

    layout: str  # plain, nss or blender
    traced: str  # the image in the place of rays: samples8, samples4, … or reference
    reference_samples: int  # of the truth, a pixel; 0: nobody says
    frames: int  # that are scored
    lead_in: int
    notes: tuple[str, ...]  # of the capture, and what stood in for rays


@dataclass(frozen=True, eq=False)
class Recording:
    """A sequence: its first `lead_in` frames warm the history and are not scored."""

    name: str
    frames: Recorded  # every leaf with a leading axis of all frames
    lead_in: int
    config: pipeline.Config
    params: pipeline.Params  # the preset's, but the paper's criteria: fits start there
    captured: Captured | None = None  # None: rendered from a scene

    @property
    def size(self) -> tuple[int, int]:
        """Image (height, width)."""
        return self.config.raster.size

    @property
    def truth(self) -> np.ndarray:
        """The reference of the scored frames, sRGB (frames, h, w, 3)."""
        return np.asarray(self.frames.truth[self.lead_in :])


def record(
    shot: Sequence,
    *,
    frames: int = 12,
    lead_in: int = LEAD_IN,
    samples: int = 8,
    reference_samples: int = 64,
    preset: str = "tuned",
    progress: Progress = lambda text: None,
    use_cache: bool = True,
) -> Recording:
    """Renders everything about a sequence that does not depend on a mask.

    Args:
        shot: the world along a path.
        frames: frames to score, at least 1.
        lead_in: frames before them.
        samples: rays a traced pixel: 2, 4 or 8.
        reference_samples: samples a pixel of the truth.
        preset: decides TAA, jitter, texture mip bias, and what a ray reads.
        progress: told after every frame.
        use_cache: read and write the cache folder.

    Raises:
        InputError: no frames, or an unknown preset.
    """
    if frames < 1 or lead_in < 0:
        raise InputError(
            f"a recording needs at least 1 frame, not {frames}, after a lead-in of at "
            f"least 0, not {lead_in}"
        )
    recorder = Recorder.of(
        shot,
        lead_in=lead_in,
        samples=samples,
        reference_samples=reference_samples,
        preset=preset,
    )
    records = []
    for index in range(-lead_in, frames):
        records.append(recorder.record(index, use_cache=use_cache))
        progress(f"recording {shot.world.name}, frame {index + lead_in + 1}")
    stacked = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *records)
    return Recording(
        name=f"{shot.world.name}:{shot.path.name}",
        frames=stacked,
        lead_in=lead_in,
        config=recorder.config,
        params=recorder.params,
    )


@dataclass(frozen=True, eq=False)
class Recorder:
    """What decides the record of every frame of a sequence; frames are independent."""

    shot: Sequence
    lead_in: int
    reference_samples: int
    config: pipeline.Config
    params: pipeline.Params

    @classmethod
    def of(
        cls,
        shot: Sequence,
        *,
        lead_in: int,
        samples: int,
        reference_samples: int,
        preset: str,
    ) -> "Recorder":
        """Returns the recorder of a sequence; arguments and errors as of `record`."""
        config, params = pipeline.preset(
            preset, shot.world.scene, shot.size, samples=samples, budget=float("inf")
        )
        config, params = pipeline.with_criteria(config, params, "paper")
        return cls(shot, lead_in, reference_samples, config, params)

    def inputs(self, index: int) -> FrameInputs:
        """Returns the operands of a frame, from −`lead_in` on, with its jitter."""
        jitter = sampling.halton_jitter(
            self.config.taa.jitter_length, centred=self.config.taa.jitter_centred
        )
        phase = (index + self.lead_in) % len(jitter)
        inputs = self.shot.inputs(index, jitter[phase])
        return pipeline.with_cut(inputs, index == -self.lead_in)

    def samples_of(self, index: int) -> int:
        """Returns the samples a pixel of a frame's truth; the lead-in has none."""
        return self.reference_samples if index >= 0 else 0

    def cache_file(self, index: int) -> Path:
        """Returns where the cache keeps the record of a frame, if it does."""
        return _file(
            self.shot,
            self.inputs(index),
            self.config,
            self.params,
            self.samples_of(index),
        )

    def record(self, index: int, *, use_cache: bool = True) -> Recorded:
        """Returns the record of a frame, from the cache where it has it."""
        file = self.cache_file(index)
        if use_cache:
            like = jax.eval_shape(partial(_like, self.shot.size))
            if (found := cache.read(file, like)) is not None:
                return found
        made = _render(
            self.shot,
            index,
            self.inputs(index),
            self.config,
            self.params,
            self.samples_of(index),
            use_cache,
        )
        if use_cache:
            cache.write(file, made, CACHE_LIMIT_BYTES)
        return made


def _render(
    shot: Sequence,
    index: int,
    inputs: FrameInputs,
    config: pipeline.Config,
    params: pipeline.Params,
    reference_samples: int,
    use_cache: bool,
) -> Recorded:
    world = shot.world
    drawn = raster.raster(
        world.scene, inputs, params.raster, tracer=world.tracer, config=_drawing(config)
    )
    traced = raytrace.raytrace(
        world.scene,
        inputs,
        jnp.ones(shot.size, bool),
        tracer=world.tracer,
        config=config.raytrace,
    )
    truth = np.zeros((*shot.size, 3), np.float32)
    if reference_samples:
        exact = reference.reference(
            shot,
            index,
            reference_samples,
            average=config.raytrace.average,
            use_cache=use_cache,
        )
        truth = colors.display(exact.color)
    return pipeline.to_numpy(
        Recorded(
            color=drawn.color,
            gbuffer=drawn.gbuffer,
            traced=traced.color,
            truth=jnp.asarray(truth),
            jitter=inputs.jitter,
            cut=inputs.cut,
        )
    )


def _drawing(config: pipeline.Config) -> raster.Config:
    """Returns what is drawn: all that any criterion may read."""
    return replace(config.raster, second_motion=True)


def _code_hash() -> str:
    """Hashes the sources that decide a record, and names what runs them."""
    return reference.code_hash() + cache.code_hash(*(raytrace, sys.modules[__name__]))


def _file(
    shot: Sequence,
    inputs: FrameInputs,
    config: pipeline.Config,
    params: pipeline.Params,
    reference_samples: int,
) -> Path:
    digest = hashlib.blake2b(digest_size=20)
    choices = (shot.size, _drawing(config), config.raytrace, reference_samples)
    digest.update(f"{_code_hash()} {choices}".encode())
    digest.update(shot.world.content_hash.encode())
    for array in jax.tree.leaves((inputs, params.raster)):
        digest.update(np.ascontiguousarray(array).tobytes())
    return cache.folder() / "record" / f"{digest.hexdigest()}.npz"


def _like(size: tuple[int, int]) -> Recorded:
    """Returns a record of zeros: its tree, shapes and types."""

    def zeros(*shape: int, dtype: Any = jnp.float32) -> Array:
        return jnp.zeros(shape, dtype)

    image = partial(zeros, *size)
    return Recorded(
        color=image(3),
        gbuffer=GBuffer(
            depth=image(),
            motion=image(2),
            motion_valid=image(dtype=bool),
            normal=image(3),
            object=image(dtype=jnp.int32),
            material=image(dtype=jnp.int32),
            second_motion=image(2),
            second_share=image(),
        ),
        traced=image(3),
        truth=image(3),
        jitter=zeros(2),
        cut=zeros(dtype=bool),
    )
