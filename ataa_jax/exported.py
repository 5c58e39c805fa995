"""Stages as JAX lowered them, kept on disk for the next process.

JAX keeps compiled programs (`programs.keep`), but finds one only after it has traced
and lowered the Python code again: seconds a stage, on one core. What it lowered is kept
here, by the package's sources, the shapes and the choices that made it; a later process
reads it and goes straight to the compiled program. The bits that come out are the same.
"""

import functools
import hashlib
import importlib
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, ParamSpec, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax import core, export
from jax._src import lru_cache

from ataa_jax import cache, hostcall, programs

P = ParamSpec("P")
R = TypeVar("R")

# our choice: of some 100 kB each.
_LIMIT_BYTES = 64 << 20

# JAX's flags under which a kept program would not do, and those that change it.
_PREVENTING = ("jax_debug_nans", "jax_debug_infs", "jax_disable_jit")
_FOLDER = "jax_compilation_cache_dir"
_SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision")


def jit(
    *static: str, donate: tuple[str, ...] = ()
) -> "Callable[[Callable[P, R]], Exported[P, R]]":
    """Decorates a pure function as `jax.jit` does, and keeps what was lowered.

    Nothing is kept, or read, before `programs.keep`, on devices other than the CPU,
    while JAX looks for NaNs or traces the call itself, and for operands that are not
    numbers: then it is `jax.jit`.

    Args:
        static: names of keyword arguments that change the program; their `repr` must
            tell all that does.
        donate: names of arguments whose memory the results may take.
    """

    def decorate(function: Callable[P, R]) -> Exported[P, R]:
        return Exported(function, static, donate)

    return decorate


class Exported(Generic[P, R]):
    """A jitted function whose lowered programs outlive the process."""

    def __init__(
        self,
        function: Callable[P, R],
        static: tuple[str, ...],
        donate: tuple[str, ...],
    ) -> None:
        self.jitted = jax.jit(function, static_argnames=static, donate_argnames=donate)
        self._static = static
        self._donate = donate
        self._names = tuple(inspect.signature(function).parameters)
        self._programs: dict[Any, tuple[Callable[..., Any], Any]] = {}
        functools.update_wrapper(self, function)

    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R:
        """Calls the program, kept or not."""
        if not _useful():
            return self.jitted(*args, **kwargs)
        operands = {k: v for k, v in kwargs.items() if k not in self._static}
        leaves, tree = jax.tree.flatten((args, operands))
        if not all(map(_concrete, leaves)) or _traced():
            return self.jitted(*args, **kwargs)
        choices = {k: v for k, v in kwargs.items() if k in self._static}
        shapes = tuple(map(jax.typeof, leaves))
        key = (tree, shapes, tuple(choices.items()), _settings())
        if key not in self._programs:
            self._programs[key] = self._program(leaves, tree, shapes, choices)
        run, structure = self._programs[key]
        return jax.tree.unflatten(structure, run(*leaves))

    def __getattr__(self, name: str) -> Any:
        """Returns what `jax.jit` offers, such as `lower`."""
        return getattr(self.jitted, name)

    def _program(
        self, leaves: list[Any], tree: Any, shapes: Any, choices: dict[str, Any]
    ) -> tuple[Callable[..., Any], Any]:
        """Returns the program and the structure of its result, read or made."""
        name = f"{self.__module__}.{self.__qualname__}"
        text = f"{cache.package_hash()} {name} {tree} {shapes} {choices} {_settings()}"
        digest = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
        place = _beside()
        assert place is not None
        _keep_whole()
        file = place / "traced" / f"{digest}.npz"
        found = _read(file)
        if found is None:
            found = self._made(leaves, tree, choices)
            program, structure = found
            held = {
                "program": np.frombuffer(bytes(program.serialize()), np.uint8),
                "structure": np.frombuffer(
                    json.dumps(_described(structure)).encode(), np.uint8
                ),
            }
            cache.write(file, held, _LIMIT_BYTES)
        program, structure = found
        # Its results belong to the device. Were its operands left to choose, as those
        # of a first frame may be, they would make other programs.
        here = jax.sharding.SingleDeviceSharding(jax.devices()[0])
        donated = self._donated(leaves, tree)
        run = jax.jit(program.call, in_shardings=here, donate_argnums=donated)
        return run, jax.tree.structure(structure)

    def _donated(self, leaves: list[Any], tree: Any) -> tuple[int, ...]:
        """Returns the places, among the flat arrays, whose memory is given away."""
        args, operands = jax.tree.unflatten(tree, range(len(leaves)))
        named = {**dict(zip(self._names, args, strict=False)), **operands}
        return tuple(jax.tree.leaves([named[name] for name in self._donate]))

    def _made(
        self, leaves: list[Any], tree: Any, choices: dict[str, Any]
    ) -> tuple[export.Exported, Any]:
        """Traces and lowers the function over flat lists of arrays."""
        results = []

        def flat(*arrays: jax.Array) -> list[jax.Array]:
            args, operands = jax.tree.unflatten(tree, arrays)
            result = self.jitted(*args, **operands, **choices)
            found, structure = jax.tree.flatten(result)
            results.append(jax.tree.unflatten(structure, [0] * len(found)))
            return found

        flat.__name__ = self.__name__  # as profilers and logs are to call it
        unstable = [export.DisabledSafetyCheck.custom_call(n) for n in hostcall.names()]
        lower = export.export(
            jax.jit(flat), platforms=["cpu"], disabled_checks=unstable
        )
        return lower(*leaves), results[0]


@functools.cache
def _keep_whole() -> None:
    """Has JAX write its files as `cache` does.

    JAX 0.10 writes in place: a process that is killed in it, or a full disk, leaves a
    part behind that every later process stumbles over and none replaces.
    """

    def put(self: Any, key: str, value: bytes) -> None:
        file = self.path / f"{key}{lru_cache._CACHE_SUFFIX}"
        if self.eviction_enabled or not isinstance(file, Path):
            in_place(self, key, value)
        elif not file.exists():
            cache.write_whole(file, lambda stream: stream.write(value))

    in_place = lru_cache.LRUCache.put
    lru_cache.LRUCache.put = put


def _useful() -> bool:
    return (
        programs.kept()
        and _beside() is not None
        and jax.default_backend() == "cpu"
        and jax.device_count() == 1
        and not any(getattr(jax.config, flag) for flag in _PREVENTING)
    )


def _beside() -> Path | None:
    """Returns where JAX keeps what it compiled, if it does."""
    place = getattr(jax.config, _FOLDER)
    return Path(place) if place else None


def _concrete(leaf: Any) -> bool:
    kinds = (jax.Array, np.ndarray, int, float)
    return isinstance(leaf, kinds) and not isinstance(leaf, core.Tracer)


def _traced() -> bool:
    """Returns whether a transformation stages out what is called here."""
    return isinstance(jax.lax.full((), 0), core.Tracer)


def _settings() -> str:
    """Returns what of JAX's configuration changes a program."""
    return f"{[getattr(jax.config, flag) for flag in _SETTINGS]}"


def _read(file: Any) -> tuple[export.Exported, Any] | None:
    """Returns a kept program and its result's structure; None: none, or damaged."""
    held = cache.read_all(file)
    if held is None or not {"program", "structure"} <= held.keys():
        return None
    try:
        structure = _rebuilt(json.loads(held["structure"].tobytes()))
        return export.deserialize(bytearray(held["program"].tobytes())), structure
    except Exception:  # whatever a reader of damaged bytes stumbles over
        return None


def _described(tree: Any) -> Any:
    """Tells a result's structure as JSON; leaves are 0."""
    if tree is None or isinstance(tree, int):
        return tree
    if isinstance(tree, (tuple, list)):
        return [type(tree).__name__, [_described(part) for part in tree]]
    if not isinstance(tree, eqx.Module):
        raise TypeError(f"a stage returns arrays, tuples or modules, not {type(tree)}")
    parts = {name: _described(part) for name, part in vars(tree).items()}
    return {
        "module": type(tree).__module__,
        "class": type(tree).__name__,
        "parts": parts,
    }


def _rebuilt(described: Any) -> Any:
    """Makes of `_described` what it was of."""
    if described is None or isinstance(described, int):
        return described
    if isinstance(described, list):
        kind, parts = described
        found = [_rebuilt(part) for part in parts]
        return tuple(found) if kind == "tuple" else found
    if not described["module"].startswith("ataa_jax."):
        raise ValueError(f"{described['module']} is not of the package")
    module = importlib.import_module(described["module"])
    made = object.__new__(getattr(module, described["class"]))
    for name, part in described["parts"].items():
        object.__setattr__(made, name, _rebuilt(part))
    return made
