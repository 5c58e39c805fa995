"""Host functions called from compiled programs, by name."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ataa_jax import errors, hostcall

SEEN: list[np.ndarray] = []


@hostcall.target
def scaled(x: np.ndarray, flags: np.ndarray, *, factor: int, shift: int) -> tuple:
    SEEN.append(x)
    return x * np.float32(factor) + np.float32(shift), ~flags


@hostcall.target
def failing(x: np.ndarray) -> tuple[np.ndarray]:
    raise ValueError("the reason why")


@hostcall.target
def misshapen(x: np.ndarray) -> tuple[np.ndarray]:
    return (np.zeros(x.size + 1, np.float32),)


@hostcall.target
def greedy(x: np.ndarray) -> tuple[np.ndarray]:
    x[...] = 0.0
    return (x,)


@hostcall.target
def interrupted(x: np.ndarray) -> tuple[np.ndarray]:
    raise KeyboardInterrupt


def call(x: jax.Array, flags: jax.Array, factor: int = 3) -> tuple[jax.Array, ...]:
    shapes = (
        jax.ShapeDtypeStruct(x.shape, jnp.float32),
        jax.ShapeDtypeStruct(flags.shape, jnp.bool_),
    )
    return hostcall.call(scaled, shapes, x, flags, factor=factor, shift=-1)


def one(function: hostcall.HostFunction, x: jax.Array) -> jax.Array:
    shape = jax.ShapeDtypeStruct(x.shape, jnp.float32)
    return hostcall.call(function, (shape,), x)[0]


def test_arrays_and_numbers_reach_the_function_and_its_results_come_back() -> None:
    x = jnp.arange(6.0).reshape(2, 3)
    flags = jnp.asarray([True, False, True])
    for way in (call, jax.jit(call)):
        y, turned = way(x, flags)
        np.testing.assert_array_equal(y, np.arange(6).reshape(2, 3) * 3.0 - 1.0)
        np.testing.assert_array_equal(turned, [False, True, False])


def test_arrays_without_elements_pass() -> None:
    y, turned = jax.jit(call)(jnp.zeros((0, 3)), jnp.zeros((0,), bool))
    assert y.shape == (0, 3)
    assert turned.shape == (0,)


def test_a_program_keeps_its_own_numbers() -> None:
    x, flags = jnp.ones(2), jnp.zeros(2, bool)
    for factor in (2, 5, -(2**40)):
        y, _ = jax.jit(lambda x, f, n=factor: call(x, f, n))(x, flags)
        np.testing.assert_array_equal(y, np.float32(factor) + np.float32(-1))


def test_vmap_calls_one_by_one() -> None:
    SEEN.clear()
    x, flags = jnp.arange(8.0).reshape(4, 2), jnp.zeros((4, 2), bool)
    y, _ = jax.vmap(call)(x, flags)
    np.testing.assert_array_equal(y, x * 3.0 - 1.0)
    assert [seen.shape for seen in SEEN] == [(2,)] * 4


def test_calls_stand_inside_loops() -> None:
    flags = jnp.zeros(2, bool)

    def body(x: jax.Array, _: None) -> tuple[jax.Array, None]:
        return call(x, flags)[0], None

    y, _ = jax.jit(lambda x: jax.lax.scan(body, x, length=3))(jnp.ones(2))
    np.testing.assert_array_equal(y, ((1 * 3 - 1) * 3 - 1) * 3 - 1)


def test_what_a_function_raises_is_told() -> None:
    with pytest.raises(jax.errors.JaxRuntimeError, match="the reason why"):
        jax.block_until_ready(jax.jit(lambda x: one(failing, x))(jnp.ones(2)))


def test_a_result_of_another_shape_is_an_error() -> None:
    with pytest.raises(jax.errors.JaxRuntimeError, match="broadcast"):
        jax.block_until_ready(jax.jit(lambda x: one(misshapen, x))(jnp.ones(2)))


def test_operands_cannot_be_written() -> None:
    with pytest.raises(jax.errors.JaxRuntimeError, match="read-only"):
        jax.block_until_ready(jax.jit(lambda x: one(greedy, x))(jnp.ones(2)))


def test_ctrl_c_inside_a_call_is_told() -> None:
    with pytest.raises(jax.errors.JaxRuntimeError, match=errors.INTERRUPTED):
        jax.block_until_ready(jax.jit(lambda x: one(interrupted, x))(jnp.ones(2)))


ENTERED = """
import os, signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
import jax
import jax.numpy as jnp
from ataa_jax import errors, hostcall

@hostcall.target
def same(x):
    return (x,)

def stop(frame, event, _):
    if event == "call" and frame.f_code.co_name == "_handle":
        os.kill(os.getpid(), signal.SIGINT)

shape = jax.ShapeDtypeStruct((2,), jnp.float32)
program = jax.jit(lambda x: hostcall.call(same, (shape,), x)[0])
jax.block_until_ready(program(jnp.ones(2)))
sys.setprofile(stop)
try:
    jax.block_until_ready(program(jnp.ones(2)))
except (jax.errors.JaxRuntimeError, ValueError) as error:
    sys.setprofile(None)
    assert errors.INTERRUPTED in str(error)
    print(program(jnp.ones(2)).sum())
"""


def test_ctrl_c_on_the_way_into_a_call_is_told_and_nothing_hangs() -> None:
    done = subprocess.run(
        [sys.executable, "-c", ENTERED],
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "2.0\n"), done.stderr


def test_threads_call_at_once() -> None:
    program = jax.jit(call)
    flags = jnp.zeros(4, bool)
    wrong = []

    def work(start: float) -> None:
        for step in range(50):
            y, _ = program(jnp.full(4, start + step), flags)
            if not np.array_equal(y, np.full(4, (start + step) * 3 - 1)):
                wrong.append(start)

    threads = [threading.Thread(target=work, args=(100.0 * i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_other_devices_get_a_callback_of_jax_that_does_the_same() -> None:
    x, flags = jnp.arange(6.0).reshape(2, 3), jnp.asarray([True, False])
    traced = jax.jit(call).trace(x, flags)
    assert str(traced.jaxpr).count("pure_callback[") == 1
    assert "callback" not in traced.lower(lowering_platforms=("cpu",)).as_text()
    shapes = tuple(jax.ShapeDtypeStruct(a.shape, a.dtype) for a in (x, flags))
    other = hostcall.by_address(
        scaled, shapes, (("factor", 3), ("shift", -1)), x, flags
    )
    for a, b in zip(call(x, flags), other, strict=True):
        np.testing.assert_array_equal(a, b)


def test_another_process_loads_the_program_and_gets_the_same(tmp_path: Path) -> None:
    script = (
        "import jax, jax.numpy as jnp, logging, numpy as np\n"
        "from ataa_jax import hostcall\n"
        "def f(x): return (x * np.float32(2),)\n"
        "f = hostcall.target(f)\n"
        "def g(x):\n"
        "    s = jax.ShapeDtypeStruct(x.shape, jnp.float32)\n"
        "    return hostcall.call(f, (s,), jnp.sin(x))[0] + 1\n"
        "logging.basicConfig(level=logging.DEBUG)\n"
        "print(jax.jit(g)(jnp.arange(3.0)).tolist())\n"
    )
    settings = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    runs = [
        subprocess.run(
            [sys.executable, "-c", script],
            env=os.environ | settings,
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    ]
    expected = (np.sin(np.arange(3, dtype=np.float32)) * 2 + 1).tolist()
    for run in runs:
        np.testing.assert_allclose(eval(run.stdout), expected, rtol=1e-6)  # float32
    assert "cache hit for 'jit_g'" not in runs[0].stderr
    assert "cache hit for 'jit_g'" in runs[1].stderr
