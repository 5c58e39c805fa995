"""The methods that are compared: what draws one frame of each, and times its stages.

A `Runner` goes over a sequence frame by frame; a `Drawer` beside it draws what several
runners share. Times are taken around blocked stages.
"""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ataa_jax import (
    cache,
    effects,
    fxaa,
    memory,
    pipeline,
    raster,
    reference,
    sampling,
    segmentation,
)
from ataa_jax import color as colors
from ataa_jax.capture.record import Capture
from ataa_jax.errors import InputError
from ataa_jax.raster import RasterOutput
from ataa_jax.segmentation import Config as SegmentationConfig
from ataa_jax.stopwatch import Lap, Stopwatch
from ataa_jax.types import FrameInputs, Scene
from ataa_jax.world import Sequence

# What a method runs over: a world along a path, or frames that an engine rendered.
Source = Sequence | Capture

# Method name → label of its row, in the order of the table.
METHODS: dict[str, str] = {
    "none": "No AA",
    "fxaa": "FXAA",
    "taa_ue4": "TAA (literature)",
    "taa": "TAA (tuned)",
    "ataa2": "ATAA 2x",
    "ataa4": "ATAA 4x",
    "ataa8": "ATAA 8x",
    "ataa8_paper": "ATAA 8x (paper's criteria)",
    "ataa8_ue4": "ATAA 8x (literature TAA)",
    "ssaa2": "SSAA 2x",
    "ssaa4": "SSAA 4x",
    "ssaa8": "SSAA 8x",
    "ssaa16": "SSAA 16x",
}


@dataclass(frozen=True)
class Options:
    """What to compare, and how."""

    frames: int = 12
    # our choice: frames rendered before the first that is scored, so that a sequence
    # shows steady motion; the first frame, all of it new, is a case of its own.
    lead_in: int = 8
    reference_samples: int = 64
    budget: float = pipeline.BUDGET  # rays a pixel
    average: colors.Average = "tonemap"
    methods: tuple[str, ...] = tuple(METHODS)
    params: pipeline.Params | None = None  # overrides the tuned preset's numbers
    segmentation: SegmentationConfig | None = None  # and its segmentation's choices


def check_methods(names: Iterable[str]) -> tuple[str, ...]:
    """Returns the methods asked for.

    Raises:
        InputError: one of them is unknown.
    """
    chosen = tuple(names)
    for name in chosen:
        if name not in METHODS:
            raise InputError(f"unknown method '{name}'; known are {', '.join(METHODS)}")
    return chosen


def captured_methods(shot: Capture) -> tuple[str, ...]:
    """Returns the methods that a capture's images allow.

    ATAA only at the counts of samples that it has images of: the reference standing in
    beside them would make fewer rays look better than more. Where it has none, the
    reference stands in for all.
    """
    counts = shot.sample_counts
    if not counts and shot.reference_samples is not None:
        counts = (2, 4, 8)

    def allowed(name: str) -> bool:
        if name.startswith("ataa"):
            return int(name.removeprefix("ataa").partition("_")[0]) in counts
        if name.startswith("ssaa"):
            return int(name.removeprefix("ssaa")) in shot.sample_counts
        return True

    return tuple(name for name in METHODS if allowed(name))


def scene_of(shot: Source) -> Scene | None:
    """Returns what decides the compiled effects; a capture has none."""
    return None if isinstance(shot, Capture) else shot.world.scene


def effects_of(shot: Source) -> effects.Selection | None:
    """Returns the effects to compile for; a capture is drawn already."""
    return None if isinstance(shot, Capture) else shot.effects


class Drawer:
    """Draws each raster variant of a frame once, for all methods that read it."""

    def __init__(self, shot: Source) -> None:
        self.shot = shot
        self.frame = 0
        self.drawn: dict[Any, tuple[RasterOutput, FrameInputs, Lap]] = {}

    def start(self, frame: int) -> None:
        """Forgets the last frame's buffers."""
        self.frame = frame
        self.drawn.clear()

    def draw(
        self,
        config: raster.Config,
        params: raster.Params,
        jitter: np.ndarray | None,
    ) -> tuple[RasterOutput, FrameInputs, Lap]:
        """Returns the raster output, its inputs and its time."""
        if isinstance(self.shot, Capture):
            return self._captured(self.shot, centred=jitter is None)
        offset = (0.0, 0.0) if jitter is None else tuple(float(x) for x in jitter)
        key = (config, float(params.mip_bias), offset)
        if key not in self.drawn:
            inputs = self.shot.inputs(self.frame, jitter)
            world = self.shot.world
            watch = Stopwatch()
            out = raster.raster(
                world.scene, inputs, params, tracer=world.tracer, config=config
            )
            jax.block_until_ready(out)
            self.drawn[key] = (out, inputs, watch.lap())
        return self.drawn[key]

    def _captured(
        self, shot: Capture, *, centred: bool
    ) -> tuple[RasterOutput, FrameInputs, Lap]:
        """Reads a frame; its own jitter and mip levels are what they are."""
        if centred not in self.drawn:
            watch = Stopwatch()
            out, inputs = shot.draw(self.frame, centred=centred)
            self.drawn[centred] = (out, inputs, watch.lap())
        return self.drawn[centred]


class Runner(ABC):
    """One method over a sequence; `run` returns a frame as sRGB."""

    temporal = False

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: Any = None  # what the next frame reads, a pytree
        self.times: dict[str, list[Lap]] = {}  # of each stage, a frame each
        self.shares: dict[str, float] = {}
        self.method: np.ndarray | None = None
        self.why: np.ndarray | None = None
        self.warming: Future[None] | None = None

    @abstractmethod
    def run(self, frame: int, drawer: Drawer) -> np.ndarray:
        """Renders a frame; `shares`, `method` and `why` then tell of it."""

    def warm(self, shot: Source) -> None:
        """Compiles what the first frame does not need at once; changes nothing else."""
        del shot  # by default there is nothing

    def ready(self) -> None:
        """Waits for what `warm` compiles in another thread."""
        if self.warming is not None:
            self.warming.result()
            self.warming = None

    def steady(self) -> dict[str, list[float]]:
        """Returns each stage's ms without its first frame, which may compile."""
        return {
            stage: [lap.clock_ms for lap in laps[1:] or laps]
            for stage, laps in self.times.items()
        }

    def record(self, stage: str, lap: Lap) -> None:
        """Notes what one stage took."""
        self.times.setdefault(stage, []).append(lap)


class _Plain(Runner):
    """No AA, and full-screen FXAA: one sample at the pixel centre, hardware mips."""

    def __init__(self, name: str, shot: Source, *, filtered: bool) -> None:
        super().__init__(name)
        config, params = pipeline.preset(
            "ue4", scene_of(shot), shot.size, selection=effects_of(shot)
        )
        self.config = config
        self.params = params
        self.filtered = filtered

    def run(self, frame: int, drawer: Drawer) -> np.ndarray:
        out, _, lap = drawer.draw(self.config.raster, self.params.raster, None)
        self.record("raster", lap)
        image = colors.display(out.color)
        if self.filtered:
            watch = Stopwatch()
            image = jax.block_until_ready(
                fxaa.fxaa(image, self.params.fxaa, config=self.config.fxaa)
            )
            self.record("fxaa", watch.lap())
            self.shares = {"fxaa_share": 1.0}
        return np.asarray(image)


class _Adaptive(Runner):
    """TAA alone (no pixel is traced) or ATAA, by one preset."""

    temporal = True

    def __init__(
        self,
        name: str,
        shot: Source,
        options: Options,
        *,
        preset: str,
        samples: int | None,
    ) -> None:
        super().__init__(name)
        budget = options.budget if samples else 0.0
        self.config, self.params = pipeline.preset(
            preset,
            scene_of(shot),
            shot.size,
            samples=samples or 2,
            budget=budget,
            selection=effects_of(shot),
        )
        if options.params is not None and preset == "tuned":
            self.params = pipeline.with_budget(options.params, budget)
        if options.segmentation is not None and preset == "tuned":
            self.config = replace(self.config, segmentation=options.segmentation)
        if samples is None:
            self.config = replace(self.config, adaptive=False)
        self.samples = samples
        self.state = pipeline.init(shot.size, self.config.resolve.history)
        self.jitter = sampling.halton_jitter(
            self.config.taa.jitter_length, centred=self.config.taa.jitter_centred
        )
        self.first = -options.lead_in
        self.shadow_rays = 0
        self.output: pipeline.FrameOutput | None = None

    def warm(self, shot: Source) -> None:
        if self.samples and not isinstance(shot, Capture):
            world = shot.world
            pipeline.warm(
                shot.inputs(0, self.jitter[0]),
                scene=world.scene,
                tracer=world.tracer,
                config=self.config,
            )

    def run(self, frame: int, drawer: Drawer) -> np.ndarray:
        self.output = None  # before the next one needs the memory
        phase = (frame - self.first) % len(self.jitter)
        drawn, inputs, lap = drawer.draw(
            pipeline.raster_config(self.config), self.params.raster, self.jitter[phase]
        )
        self.record("raster", lap)
        shot = drawer.shot
        self.ready()
        watch = Stopwatch()

        def observe(stage: str, buffers: Any) -> Any:
            jax.block_until_ready(buffers)
            self.record(stage, watch.lap())
            watch.start()
            return buffers

        if isinstance(shot, Capture):  # its own cuts reset the history
            rays: dict[str, Any] = {
                "trace": shot.trace(frame, self.samples) if self.samples else None
            }
        else:
            inputs = pipeline.with_cut(inputs, frame == self.first)
            rays = {"scene": shot.world.scene, "tracer": shot.world.tracer}
        output, self.state = pipeline.antialias(
            self.state,
            drawn,
            inputs,
            self.params,
            config=self.config,
            observe=observe,
            **rays,
        )
        self.output = output
        pixels = drawer.shot.size[0] * drawer.shot.size[1]
        self.shadow_rays = int(np.sum(output.statistics.rays.shadow))
        stats = output.statistics
        ataa, new = int(stats.ataa_pixels), int(stats.fxaa_pixels)
        self.shares = {
            "fxaa_share": new / pixels,
            "ataa_share": ataa / pixels,
            "taa_share": 1.0 - (new + ataa) / pixels,
            "rays_per_pixel": int(stats.primary_rays) / pixels,
            "overflow_share": int(stats.overflow_pixels) / pixels,
        }
        method, _ = segmentation.unpack_mask(output.segmentation.mask)
        if self.samples:
            self.method = np.asarray(method).astype(np.uint8)
            self.why = np.asarray(output.segmentation.why)
        return np.asarray(output.image)


class _Supersampled(Runner):
    """N samples a pixel everywhere, in the Direct3D pattern, at mip level 0."""

    def __init__(self, name: str, samples: int, average: colors.Average) -> None:
        super().__init__(name)
        self.offsets = sampling.pattern(samples)
        self.average: colors.Average = average

    def warm(self, shot: Source) -> None:
        if not isinstance(shot, Capture):
            reference.supersample(
                shot.world,
                shot.inputs(0),
                self.offsets[:1],
                shot.size,
                average=self.average,
            )

    def run(self, frame: int, drawer: Drawer) -> np.ndarray:
        shot = drawer.shot
        count = len(self.offsets)
        self.shares = {"rays_per_pixel": float(count)}
        if isinstance(shot, Capture):
            image = shot.samples(frame, count)
            if image is None:
                raise InputError(
                    f"capture {shot.folder} has no {count}-sample images, which method "
                    f"{self.name} shows"
                )
            return np.asarray(colors.display(jnp.asarray(image)))
        inputs = shot.inputs(frame)
        self.ready()
        watch = Stopwatch()
        out = reference.supersample(
            shot.world, inputs, self.offsets, shot.size, average=self.average
        )
        jax.block_until_ready(out)
        self.record("supersample", watch.lap())
        return np.asarray(colors.display(out.color))


def runner(name: str, shot: Source, options: Options) -> Runner:
    """Returns what runs one method of `METHODS` over a sequence."""
    if name in ("none", "fxaa"):
        return _Plain(name, shot, filtered=name == "fxaa")
    if name.startswith("ssaa"):
        return _Supersampled(name, int(name.removeprefix("ssaa")), options.average)
    kind, _, _ = name.partition("_")
    samples = int(kind.removeprefix("ataa")) if kind.startswith("ataa") else None
    return _Adaptive(name, shot, options, preset=preset_of(name), samples=samples)


@contextmanager
def warming(runners: Iterable[Runner], shot: Source) -> Iterator[None]:
    """Compiles in another thread what the runners will need, while they begin.

    XLA compiles a program mostly on one core; the frames on the way here take another.
    Where memory is scarce, all is compiled before the first frame is there.
    """
    pool = ThreadPoolExecutor(1, thread_name_prefix="warm")
    try:
        for each in runners:
            each.warming = pool.submit(each.warm, shot)
            if memory.scarce(shot.size):
                each.ready()
        yield
    finally:
        pool.shutdown(cancel_futures=True)


def job_key(shot: Source, command: str, options: Options) -> str:
    """Hashes all that decides what a command makes of a sequence."""
    digest = hashlib.blake2b(digest_size=20)
    choices = replace(options, params=None)
    digest.update(f"{cache.package_hash()} {command} {choices} {shot.size}".encode())
    digest.update(cache.content_hash(options.params).encode())
    if isinstance(shot, Capture):
        for file in sorted(shot.folder.rglob("*")):  # its bytes may be many
            stat = file.stat()
            digest.update(f"{file} {stat.st_size} {stat.st_mtime_ns}".encode())
        return digest.hexdigest()
    digest.update(f"{shot.world.content_hash} {shot.path} {shot.effects}".encode())
    digest.update(reference.thin_objects(shot.world.source).tobytes())
    digest.update(cache.content_hash(shot.inputs(0)).encode())
    return digest.hexdigest()


def preset_of(method: str) -> str:
    """Returns the preset that a method's name ends in; without one, the tuned."""
    return method.partition("_")[2] or "tuned"


def with_preset(method: str, preset: str) -> str:
    """Returns a method's name by another preset; what has none keeps its name.

    Raises:
        InputError: unknown preset.
    """
    if preset not in pipeline.PRESETS:
        known = ", ".join(pipeline.PRESETS)
        raise InputError(f"unknown preset '{preset}'; known are {known}")
    kind, _, _ = method.partition("_")
    if preset == "tuned" or not kind.startswith(("taa", "ataa")):
        return method
    return f"{kind}_{preset}"
