"""The short benchmark of a scene: where a frame's time goes, and what tracing costs.

Times are steady-state: compiled, blocked until ready, medians of repeated runs, all in
one process. They are never mixed with results.
"""

import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import jax
import numpy as np
from jax.experimental.compilation_cache import compilation_cache

from ataa_jax import (
    builtin,
    competitor,
    embree,
    memory,
    paths,
    pipeline,
    programs,
    reference,
    sampling,
    verify,
)
from ataa_jax import camera as cameras
from ataa_jax import world as worlds
from ataa_jax.stopwatch import Lap, Stopwatch
from ataa_jax.types import FrameInputs

Row = tuple[str, float, str]
_REPEATS = 9
_WARM = 3  # frames: those that compile, and a history to read


def run(
    world: worlds.World,
    size: tuple[int, int] = (360, 640),
    camera: str | None = None,
    budget: float = pipeline.BUDGET,
) -> list[Row]:
    """Measures a scene.

    Args:
        world: the scene.
        size: image (height, width).
        camera: a camera's name, or a path, as the command line takes it.
        budget: sparse primary rays a pixel of the ATAA frame.

    Returns:
        Name, value and unit of each figure.
    """
    path = paths.load(camera or "walk", cameras=[c.name for c in world.cameras])
    shot = worlds.sequence(world, path, size)
    rows = _trace_rate(shot)
    rows += _frames(shot, budget)
    return rows


def against_mitsuba(
    world: worlds.World,
    size: tuple[int, int] = (360, 640),
    camera: str | None = None,
    budget: float = pipeline.BUDGET,
) -> list[Row]:
    """Measures one directional light's image against Mitsuba 3's, by brute force.

    The three take turns, so that other work on the machine disturbs them alike; a
    ratio is the median of the rounds' ratios. All have their programs compiled, and
    neither moving the scene nor reading its files is counted.

    Args:
        world: the scene; its lights give way to one, see `competitor.one_light`.
        size: image (height, width).
        camera: a camera's name, or a path, as the command line takes it.
        budget: sparse primary rays a pixel of the ATAA frame.

    Returns:
        Name, value and unit: medians, quartiles and ratios.

    Raises:
        InputError: Mitsuba or LLVM is missing.
    """
    path = paths.load(camera or "walk", cameras=[c.name for c in world.cameras])
    shot = worlds.sequence(competitor.one_light(world), path, size)
    rival, inputs = competitor.Competitor(shot), shot.inputs(0)
    ataa = _spending_frames(shot, budget)
    runs = {
        "Mitsuba 8 spp": lambda: rival.render(0, 8),
        "SSAA 8x": lambda: reference.supersample(
            shot.world, inputs, sampling.pattern(8), size
        ),
        "ATAA 8x": lambda: next(ataa),
    }
    times = _in_turns(runs)
    rows: list[Row] = []
    for name, ms in times.items():
        low, middle, high = np.percentile(ms, (25, 50, 75))
        rows += [(f"{name}", middle, "ms"), (f"{name}, first quartile", low, "ms")]
        rows.append((f"{name}, third quartile", high, "ms"))
    for name in ("ATAA 8x", "SSAA 8x"):
        ratio = float(np.median(times[name] / times["Mitsuba 8 spp"]))
        rows.append((f"{name} over Mitsuba 8 spp", ratio, "x"))
    return rows


def _in_turns(runs: dict[str, Callable[[], Any]]) -> dict[str, np.ndarray]:
    """Returns the times of each in ms, one a round; the first rounds compile."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(_WARM + _REPEATS):
        for name, run in runs.items():
            watch = Stopwatch()
            jax.block_until_ready(run())
            times[name].append(watch.lap().clock_ms)
    return {name: np.array(found[_WARM:]) for name, found in times.items()}


def peak_memory(scene: str, size: tuple[int, int] = (1080, 1920)) -> list[Row]:
    """Runs two frames in processes of their own and returns the peaks they came to.

    As `ataa run` does, loading included: the first process compiles, the second finds
    what it compiled. A process's peak only grows, so the one that measures the rest
    cannot tell.

    Args:
        scene: as `world.load` takes it.
        size: image (height, width).
    """
    context = multiprocessing.get_context("spawn")
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for start in ("first", "second"):
            with ProcessPoolExecutor(1, mp_context=context) as pool:
                peak = pool.submit(_peak_of_frames, scene, size, folder).result()
            name = f"peak memory at {size[1]}x{size[0]}, {start} start"
            rows.append((name, peak / 1e9, "GB"))
    return rows


def agreement(golden: list[verify.Difference]) -> list[Row]:
    """Returns how golden images compare: no time may be bought with other pictures.

    Of each sequence the share of pixels that differ by more than 1/255, and the share
    that another method drew; last 1 if all are within the tolerance, else 0.
    """
    rows: list[Row] = []
    for each in golden:
        rows.append((f"golden {each.name}, changed pixels", each.changed, ""))
        rows.append((f"golden {each.name}, other method", each.other_method, ""))
    most = f"1: changed ≤ {verify.CHANGED:g}, other method ≤ {verify.OTHER_METHOD:g}"
    holds = all(each.holds for each in golden)
    return [*rows, ("golden images within the tolerance", float(holds), most)]


def generation() -> Row:
    """Times how long the built-in scene takes to be made, in processor time."""
    times = []
    for _ in range(3):
        watch = Stopwatch()
        builtin.garden_house()
        times.append(watch.lap().processor_ms)
    return ("making the built-in scene", float(np.median(times)) / 1e3, "s")


def _peak_of_frames(scene: str, size: tuple[int, int], folder: str) -> int:
    os.environ["ATAA_CACHE"] = folder
    # The asking process's choice, which this one inherits, is full of programs.
    os.environ.pop("JAX_COMPILATION_CACHE_DIR", None)
    jax.config.update("jax_compilation_cache_dir", None)
    compilation_cache.reset_cache()
    programs.keep()
    world = worlds.load(scene, size=size)
    shot = worlds.shot(world, "walk", size)
    config, params = pipeline.preset("tuned", world.scene, size, selection=shot.effects)
    given: dict[str, Any] = {"scene": world.scene, "tracer": world.tracer}
    pipeline.warm(shot.inputs(0), config=config, **given)
    state = pipeline.init(size, config.resolve.history)
    for frame in range(2):
        output, state = pipeline.stages(
            state, shot.inputs(frame), params, config=config, **given
        )
        jax.block_until_ready(output)
        del output
    return memory.peak()


def _trace_rate(shot: worlds.Sequence) -> list[Row]:
    """Rays a second of the stage's batches, by packets and by `EmbreeScene.run`.

    All take turns. The packet loop alone is the one that the stage calls, on NumPy
    arrays that are there already; the stage's has the way through XLA as well.
    """
    world, inputs = shot.world, shot.inputs(0)
    origin, direction = _stage_rays(inputs, shot.size)
    matrices = np.asarray(inputs.world_from_group)
    jitted = jax.jit(
        lambda o, d: embree.intersect(world.tracer, inputs.world_from_group, o, d)
    )
    on_device = jax.device_put((origin, direction))
    bare = embree.bare_run(world.scene)
    backend = world.tracer.backend
    stage, loop, run = f"{backend} in jit", f"{backend} loop alone", "EmbreeScene.run"
    times = _in_turns(
        {
            stage: lambda: jitted(*on_device),
            loop: lambda: world.tracer.intersect_numpy(matrices, origin, direction),
            run: lambda: bare(origin, direction),
        }
    )
    rows: list[Row] = [
        (f"primary rays, {name}", len(origin) / 1e3 / float(np.median(ms)), "M/s")
        for name, ms in times.items()
    ]
    for other in (loop, run):
        ratio = float(np.median(times[other] / times[stage]))
        rows.append((f"primary rays, {stage} over {other}", ratio, "x"))
    return rows


def _stage_rays(
    inputs: FrameInputs, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The rays of one in sixteen pixels, eight each: a frame at 0.5 rays a pixel."""
    height, width = size
    index = np.arange(0, height * width, 16)
    offsets = sampling.pattern(8)
    x = ((index % width)[:, None] + 0.5 + offsets[:, 0]).reshape(-1)
    y = ((index // width)[:, None] + 0.5 + offsets[:, 1]).reshape(-1)
    direction = cameras.directions(
        inputs.camera,
        size,
        jax.numpy.asarray(x, jax.numpy.float32),
        jax.numpy.asarray(y, jax.numpy.float32),
    )
    array = np.stack([direction.x, direction.y, direction.z], axis=-1)
    eye = np.asarray(inputs.camera.world_from_view)[:3, 3]
    return np.broadcast_to(eye, array.shape).copy(), array


def _spending_frames(
    shot: worlds.Sequence,
    budget: float,
    observe: Callable[[str, Any], Any] = lambda _, buffers: buffers,
) -> Iterator[pipeline.FrameOutput]:
    """Yields ATAA 8x frames that spend their whole budget, one a round."""
    world = shot.world
    config, params = pipeline.preset(
        "tuned", world.scene, shot.size, samples=8, budget=budget,
        selection=shot.effects,
    )  # fmt: skip
    # A threshold of 0 makes every pixel ask for rays, so the budget is spent in full.
    params = pipeline.with_threshold(params, 0.0)
    jitter = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    state = pipeline.init(shot.size)
    inputs = [shot.inputs(i, jitter[i % len(jitter)]) for i in range(_WARM + _REPEATS)]
    for each in inputs:
        output, state = pipeline.stages(
            state, each, params,
            scene=world.scene, tracer=world.tracer, config=config, observe=observe,
        )  # fmt: skip
        yield output


def _frames(shot: worlds.Sequence, budget: float) -> list[Row]:
    """An ATAA 8x frame that spends its whole budget, by stages, against SSAA 8x.

    The two take turns; the ratio is the median of the rounds' ratios.
    """
    world, inputs = shot.world, shot.inputs(0)
    stages: dict[str, list[Lap]] = {}
    watch = Stopwatch()

    def observe(stage: str, buffers: Any) -> Any:
        jax.block_until_ready(buffers)
        stages.setdefault(stage, []).append(watch.lap())
        watch.start()
        return buffers

    frames = _spending_frames(shot, budget, observe)
    supersampled, spent = [], 0.0
    for _ in range(_WARM + _REPEATS):
        watch.start()
        output = next(frames)
        spent = int(output.statistics.primary_rays) / (shot.size[0] * shot.size[1])
        del output
        watch.start()
        jax.block_until_ready(
            reference.supersample(world, inputs, sampling.pattern(8), shot.size)
        )
        supersampled.append(watch.lap())
    # (stage, round, clock and processor)
    laps = np.array([each[_WARM:] for each in stages.values()])
    frame, ssaa = laps.sum(axis=0), np.array(supersampled[_WARM:])
    medians = np.median(laps[:, :, 0], axis=1)
    rows: list[Row] = [("ATAA 8x rays a pixel", spent, "")]
    rows += [
        (f"ATAA 8x {stage}", float(ms), "ms")
        for stage, ms in zip(stages, medians, strict=True)
    ]
    for name, times in (("ATAA 8x", frame), ("SSAA 8x", ssaa)):
        clock, processor = np.median(times, axis=0)
        rows.append((f"{name} frame", float(clock), "ms"))
        rows.append((f"{name} frame, processor time", float(processor), "ms"))
    clock, processor = np.median(ssaa / frame, axis=0)
    rows.append(("SSAA 8x over ATAA 8x", float(clock), "x"))
    rows.append(("SSAA 8x over ATAA 8x, processor time", float(processor), "x"))
    return rows
