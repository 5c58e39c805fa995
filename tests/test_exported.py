"""Stages whose lowered programs outlive the process."""

import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax._src import lru_cache

from ataa_jax import exported, pipeline, programs

# Draws a frame of a small scene; prints what was traced, and a digest of all bits.
SCRIPT = """
import hashlib, json, sys
from ataa_jax import programs
programs.keep()
import jax, numpy as np
from ataa_jax import pipeline, world as worlds
from ataa_jax.builtin import failures
traced = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, _, **at: traced.append(at.get("fun_name"))
)
case = failures.case("a")
world = worlds.prepare(case.build(), size=(18, 32))
shot = worlds.sequence(world, case.path, (18, 32))
config, params = pipeline.preset(sys.argv[1], world.scene, (18, 32))
state, digest = pipeline.init((18, 32)), hashlib.sha256()
for index in range(3):
    output, state = pipeline.stages(
        state, shot.inputs(index), params,
        scene=world.scene, tracer=world.tracer, config=config,
    )
    for leaf in jax.tree.leaves((output, state)):
        digest.update(np.asarray(leaf).tobytes())
print(json.dumps({"traced": traced, "bits": digest.hexdigest()}))
"""
STAGES = {"raster", "taa", "segment", "raytrace", "resolve", "fxaa_sparse"}


def draw(folder, preset="tuned", **environment):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, preset],
        env={
            **os.environ,
            "JAX_COMPILATION_CACHE_DIR": str(folder),
            "ATAA_CACHE": str(folder / "own"),
            **environment,
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    return STAGES & set(found["traced"]), found["bits"]


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    folder = tmp_path_factory.mktemp("programs")
    return folder, *draw(folder)


def test_the_next_process_traces_no_stage_and_gives_the_same_bits(first):
    folder, traced, bits = first
    assert traced == STAGES
    assert draw(folder) == (set(), bits)


def test_without_keeping_the_bits_are_the_same(first):
    folder, _, bits = first
    traced, plain = draw(folder, JAX_DEBUG_NANS="1")  # one of what prevents it
    assert traced == STAGES
    assert plain == bits


def test_other_choices_are_other_programs(first):
    folder, _, bits = first
    traced, others = draw(folder, "paper")
    assert {"segment", "raytrace", "resolve"} <= traced
    assert "taa" not in traced
    assert others != bits


def test_a_damaged_file_counts_as_none(first):
    folder, _, bits = first
    files = sorted((folder / "traced").glob("*.npz"))
    for file in files:
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 0xFF
        file.write_bytes(bytes(data))
    traced, again = draw(folder)
    assert traced == STAGES
    assert again == bits


@exported.jit("power")
def _raised(x, scale=None, *, power):
    return (
        {"a": x}
        if power == 0
        else (x**power if scale is None else x**power * scale, None)
    )


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "kept", lambda: True)
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "traced"
    jax.config.update("jax_compilation_cache_dir", before)


def test_transformations_see_the_function_itself(kept):
    x = jnp.arange(4.0)
    cube = lambda v: _raised(v, power=3)[0]  # noqa: E731
    np.testing.assert_array_equal(jax.vmap(cube)(x), x**3)
    np.testing.assert_array_equal(jax.jit(cube)(x), x**3)
    np.testing.assert_array_equal(jax.grad(lambda v: cube(v).sum())(x), 3 * x**2)
    assert not kept.exists()
    np.testing.assert_array_equal(cube(x), x**3)
    assert len(list(kept.glob("*.npz"))) == 1


def test_arrays_and_numbers_are_operands_and_none_is_structure(kept):
    x = np.arange(4.0, dtype=np.float32)
    for scale in (2.0, 3.0):
        found, nothing = _raised(x, scale, power=2)
        np.testing.assert_array_equal(found, x**2 * scale)
        assert nothing is None
    assert len(list(kept.glob("*.npz"))) == 1
    _raised(x, power=2)
    assert len(list(kept.glob("*.npz"))) == 2


def test_a_result_that_cannot_be_told_is_an_error(kept):
    with pytest.raises(TypeError, match="tuples or modules"):
        _raised(np.zeros(2, np.float32), power=0)


def test_structures_come_back_and_only_of_the_package():
    state = jax.tree.map(lambda _: 0, pipeline.init((2, 3)))
    described = exported._described((state, None, [0]))
    again = exported._rebuilt(json.loads(json.dumps(described)))
    assert jax.tree.structure(again) == jax.tree.structure((state, None, [0]))
    described[1][0]["module"] = "os"
    with pytest.raises(ValueError, match="not of the package"):
        exported._rebuilt(described)


def test_a_program_is_kept_whole_or_not_at_all(tmp_path):
    """JAX's own way, which opens the file first, leaves an empty one behind here."""
    exported._keep_whole()
    kept = lru_cache.LRUCache(str(tmp_path), max_size=-1)
    with pytest.raises(TypeError):
        kept.put("half", None)
    assert list(tmp_path.iterdir()) == []
    kept.put("whole", b"program")
    kept.put("whole", b"another")  # what is there, stays
    assert kept.get("whole") == b"program"
    assert len(list(tmp_path.iterdir())) == 1
