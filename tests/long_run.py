"""Renders many frames in a process of its own and prints what it holds on the way.

    python -m tests.long_run FRAMES WIDTHxHEIGHT CPUS(one|all) DISPATCH(sync|async)

Prints JSON: per sample the frame, resident bytes, threads, open files, live arrays; and
how many programs were compiled after the first frames.
"""

import gc
import json
import os
import sys

import psutil


def main(frames: int, size: tuple[int, int], cpus: str, dispatch: str) -> None:
    if cpus == "one":
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    from ataa_jax import programs

    programs.keep()
    import jax
    import numpy as np
    from jax._src import xla_bridge

    from ataa_jax import embree

    # `embree` switches it off; here it is on in spite of that. JAX reads the flag when
    # it makes its client, for which the other modules' constants are reason enough.
    jax.config.update("jax_cpu_enable_async_dispatch", dispatch == "async")
    assert not xla_bridge.backends_are_initialized()
    from ataa_jax import memory, pipeline
    from ataa_jax import world as worlds
    from ataa_jax.builtin import failures

    if cpus == "one":
        embree.set_threads(1)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, _, **__: compiled.append(event) if "backend" in event else None
    )
    case = failures.case("a")
    world = worlds.prepare(case.build(), size=size)
    shot = worlds.sequence(world, case.path, size)
    config, params = pipeline.preset("tuned", world.scene, size)
    process, samples, early = psutil.Process(), [], 0
    outputs = pipeline.sequence(shot, params, config=config, frames=frames)
    for index, (output, _) in enumerate(outputs):
        if index == 20:
            early = len(compiled)
        if index % 50 == 49:
            assert np.all(np.isfinite(np.asarray(output.image)))
            gc.collect()
            memory.release()  # freed pieces that the allocator keeps are not held
            held = (process.memory_info().rss, process.num_threads(), process.num_fds())
            samples.append((index, *held, len(jax.live_arrays())))
    print(json.dumps({"samples": samples, "late_programs": len(compiled) - early}))


if __name__ == "__main__":
    _, frames, size, cpus, dispatch = sys.argv
    width, height = size.split("x")
    main(int(frames), (int(height), int(width)), cpus, dispatch)
