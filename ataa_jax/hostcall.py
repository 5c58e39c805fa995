"""Calls of host functions from compiled programs, by name.

JAX's own callbacks put an address of the process into the program, so that it can
never be kept on disk, and hand over arrays by calling JAX, which can deadlock. Here a
program for the CPU names its target, which this module registers through XLA's foreign
function interface: the same program serves any process, operands are views of XLA's
buffers, results go straight into them. On other devices `jax.pure_callback` stands in.

A host function is pure, takes NumPy arrays and, by keyword, whole numbers that are
part of the program. It must not write to its operands, keep them, or call JAX.

Ctrl-C that comes while a program waits for a host function is told by the program's
error: for that, importing this module takes the place of Python's own handler of it.

The records below mirror ``xla/ffi/api/c_api.h`` (version 0.3, as jaxlib ships it), to
which XLA promises to stay compatible: fields are added at the end only.
"""

import ctypes
import functools
import math
import signal
import struct
import threading
import traceback
from collections.abc import Callable
from ctypes import POINTER, Structure, c_int, c_int64, c_size_t, c_uint32, c_void_p
from types import FrameType
from typing import Any

import jax
import numpy as np

from ataa_jax.errors import INTERRUPTED

HostFunction = Callable[..., tuple[np.ndarray, ...]]

_API_VERSION = (0, 1)  # what is used here has been there since
_METADATA, _EXECUTE = 1, 3  # XLA_FFI_Extension_Metadata, XLA_FFI_ExecutionStage_EXECUTE
_ERROR_INTERNAL, _ERROR_CANCELLED = 13, 1  # XLA_FFI_Error_Code
_DTYPES = {
    1: np.bool_, 2: np.int8, 3: np.int16, 4: np.int32, 5: np.int64,
    6: np.uint8, 7: np.uint16, 8: np.uint32, 9: np.uint64,
    10: np.float16, 11: np.float32, 12: np.float64,
}  # fmt: skip
# XLA_FFI_Buffer (struct_size, extension, dtype, data, rank, dims) and two pairs. Read
# by `struct`: as ctypes' records they took most of a call's 170 µs.
_BUFFER = struct.Struct("@NPiPqP")
_SPAN, _SCALAR = struct.Struct("@PN"), struct.Struct("@iP")

_names: dict[HostFunction, str] = {}
_handlers: list[Any] = []  # ctypes frees a handler that nobody holds


def target(function: HostFunction) -> HostFunction:
    """Registers a module's function, under its full name, as one to `call`."""
    name = f"{function.__module__}.{function.__qualname__}"
    handler = _Handler(functools.partial(_handle, function))
    _handlers.append(handler)
    address = ctypes.cast(handler, c_void_p).value
    jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(address), platform="cpu")
    _names[function] = name
    return function


def names() -> list[str]:
    """Returns the names of all targets."""
    return list(_names.values())


def call(
    function: HostFunction,
    results: tuple[jax.ShapeDtypeStruct, ...],
    *operands: jax.Array,
    **numbers: int,
) -> tuple[jax.Array, ...]:
    """Calls a host function, inside `jit` or outside; under `vmap` one by one.

    Not differentiable.

    Args:
        function: one that `target` registered.
        results: shapes and types of what it returns.
        operands: arrays that it is given.
        numbers: 64-bit integers that it is given by keyword, fixed in the program.

    Returns:
        The results.

    Raises:
        jax.errors.JaxRuntimeError: the function raised; the text says what. Ctrl-C
            inside it is told by `errors.INTERRUPTED`. A program that has run before
            may raise it as a ValueError.
    """
    return _call(function, results, tuple(sorted(numbers.items())), *operands)


@functools.partial(jax.jit, static_argnums=(0, 1, 2), inline=True)
def _call(
    function: HostFunction,
    results: tuple[jax.ShapeDtypeStruct, ...],
    numbers: tuple[tuple[str, int], ...],
    *operands: jax.Array,
) -> tuple[jax.Array, ...]:
    given = functools.partial(_by_name, function, results, numbers)
    other = functools.partial(by_address, function, results, numbers)
    return jax.lax.platform_dependent(*operands, cpu=given, default=other)


def _by_name(
    function: HostFunction,
    results: tuple[jax.ShapeDtypeStruct, ...],
    numbers: tuple[tuple[str, int], ...],
    *operands: jax.Array,
) -> tuple[jax.Array, ...]:
    called = jax.ffi.ffi_call(_names[function], results, vmap_method="sequential")
    return tuple(called(*operands, **{key: np.int64(n) for key, n in numbers}))


def by_address(
    function: HostFunction,
    results: tuple[jax.ShapeDtypeStruct, ...],
    numbers: tuple[tuple[str, int], ...],
    *operands: jax.Array,
) -> tuple[jax.Array, ...]:
    """Does what `call` does, through JAX's own callback."""

    def convert(*arrays: Any) -> tuple[np.ndarray, ...]:
        return function(*map(np.asarray, arrays), **dict(numbers))

    return tuple(
        jax.pure_callback(convert, results, *operands, vmap_method="sequential")
    )


class _Buffers(Structure):  # XLA_FFI_Args and XLA_FFI_Rets
    _fields_ = [
        ("struct_size", c_size_t), ("extension", c_void_p), ("size", c_int64),
        ("types", c_void_p), ("buffers", c_void_p),
    ]  # fmt: skip


class _Attributes(Structure):
    _fields_ = [
        ("struct_size", c_size_t), ("extension", c_void_p), ("size", c_int64),
        ("types", c_void_p), ("names", c_void_p), ("values", c_void_p),
    ]  # fmt: skip


class _Version(Structure):
    _fields_ = [
        ("struct_size", c_size_t), ("extension", c_void_p),
        ("major", c_int), ("minor", c_int),
    ]  # fmt: skip


class _Metadata(Structure):
    _fields_ = [
        ("struct_size", c_size_t), ("version", _Version), ("traits", c_uint32),
    ]  # fmt: skip


class _Extension(Structure):  # of which only the metadata's is known here
    _fields_ = [
        ("struct_size", c_size_t), ("type", c_int), ("next", c_void_p),
        ("metadata", POINTER(_Metadata)),
    ]  # fmt: skip


class _ErrorArguments(Structure):
    _fields_ = [
        ("struct_size", c_size_t), ("extension", c_void_p),
        ("message", ctypes.c_char_p), ("code", c_int),
    ]  # fmt: skip


_ErrorCreate = ctypes.CFUNCTYPE(c_void_p, POINTER(_ErrorArguments))


class _Api(Structure):
    _fields_ = [
        ("struct_size", c_size_t), ("extension", c_void_p), ("version", _Version),
        ("internal", c_void_p), ("error_create", _ErrorCreate),
    ]  # fmt: skip


class _Frame(Structure):
    _fields_ = [
        ("struct_size", c_size_t), ("extension", POINTER(_Extension)),
        ("api", POINTER(_Api)), ("context", c_void_p), ("stage", c_int),
        ("operands", _Buffers), ("results", _Buffers), ("attributes", _Attributes),
    ]  # fmt: skip


_Handler = ctypes.CFUNCTYPE(c_void_p, POINTER(_Frame))


def _handle(function: HostFunction, at: Any) -> int | None:
    """Answers one call by XLA: returns no error, or the address of one."""
    frame = at.contents
    if frame.extension and frame.extension.contents.type == _METADATA:
        found = frame.extension.contents.metadata.contents
        found.version.major, found.version.minor = _API_VERSION
        found.traits = 0
        return None
    if frame.stage != _EXECUTE:
        return None
    try:
        if _interrupted.is_set():
            raise KeyboardInterrupt
        operands = _arrays(frame.operands)
        for operand in operands:
            operand.flags.writeable = False
        given = function(*operands, **_numbers(frame.attributes))
        for result, value in zip(_arrays(frame.results), given, strict=True):
            np.copyto(result, value, casting="no")
        if _interrupted.is_set():
            raise KeyboardInterrupt
    except KeyboardInterrupt:
        _interrupted.clear()
        return _error(frame, INTERRUPTED, _ERROR_CANCELLED)
    except BaseException:  # none may pass through XLA
        return _error(frame, traceback.format_exc(), _ERROR_INTERNAL)
    return None


_interrupted = threading.Event()  # Ctrl-C came while XLA waited for a host function


def _on_interrupt(number: int, frame: FrameType | None) -> None:
    """Takes Ctrl-C: as Python does, but inside `_handle`, where it has to wait.

    An exception on the way into or out of a call by XLA, where nothing can catch it,
    would leave the call without an answer: the process then hangs or dies.
    """
    step = frame
    while step is not None:
        if step.f_code is _handle.__code__:
            _interrupted.set()
            return
        step = step.f_back
    signal.default_int_handler(number, frame)


if (
    threading.current_thread() is threading.main_thread()
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, _on_interrupt)


def _arrays(buffers: _Buffers) -> list[np.ndarray]:
    return [_array(at) for at in _words(buffers.buffers, buffers.size)]


def _array(address: int) -> np.ndarray:
    """Returns a view of a buffer; XLA may give one of no elements no address."""
    _, _, code, data, rank, dims = _read(_BUFFER, address)
    shape, dtype = _words(dims, rank), np.dtype(_DTYPES[code])
    size = dtype.itemsize * math.prod(shape)
    if size == 0:
        return np.empty(shape, dtype)
    memory = (ctypes.c_uint8 * size).from_address(data)
    return np.frombuffer(memoryview(memory), dtype).reshape(shape)


def _numbers(attributes: _Attributes) -> dict[str, int]:
    names, values = (
        _words(table, attributes.size)
        for table in (attributes.names, attributes.values)
    )
    found = {}
    for name, value in zip(names, values, strict=True):
        text = ctypes.string_at(*_read(_SPAN, name)).decode()
        _, number = _read(_SCALAR, value)
        (found[text],) = _words(number, 1)
    return found


def _read(record: struct.Struct, address: int) -> tuple[Any, ...]:
    return record.unpack(ctypes.string_at(address, record.size))


def _words(address: int | None, count: int) -> tuple[int, ...]:
    """Returns 64-bit integers or addresses that lie side by side."""
    if not count or address is None:
        return ()
    return struct.unpack(f"@{count}q", ctypes.string_at(address, 8 * count))


def _error(frame: _Frame, text: str, code: int) -> int | None:
    arguments = _ErrorArguments(
        struct_size=ctypes.sizeof(_ErrorArguments), message=text.encode(), code=code
    )
    return frame.api.contents.error_create(ctypes.byref(arguments))
