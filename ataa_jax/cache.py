"""The cache folder: arrays that are dear to make, by the content that decides them.

A file is whole or not there, and one that is damaged or of another shape counts as not
there. A key should hold `code_hash` of the modules that made the arrays, and `computer`
where their last bits depend on it, so that an old cache is never believed.
"""

import hashlib
import inspect
import os
import tempfile
import weakref
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path
from types import ModuleType
from typing import IO, Any, TypeVar

import jax
import numpy as np

from ataa_jax import programs
from ataa_jax.programs import folder, prune

__all__ = [
    "code_hash",
    "computer",
    "content_hash",
    "folder",
    "package_hash",
    "read",
    "read_all",
    "store",
    "write",
    "write_whole",
]

Tree = TypeVar("Tree")

_COMPUTING = ("jax", "jaxlib", "numpy", "embreex")

_LARGE_BYTES = 1 << 20  # our choice: under it a hash takes a millisecond


@cache
def code_hash(*modules: ModuleType) -> str:
    """Hashes the sources of modules; of a package, all its files."""
    digest = hashlib.blake2b(digest_size=16)
    for module in modules:
        file = Path(inspect.getfile(module))
        parts = sorted(file.parent.glob("*.py")) if file.stem == "__init__" else [file]
        for part in parts:
            digest.update(part.read_bytes())
    return digest.hexdigest()


@cache
def package_hash() -> str:
    """Hashes all sources of the package, and names the versions of what computes."""
    digest = hashlib.blake2b(digest_size=16)
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(file.read_bytes())
    return f"{digest.hexdigest()} jax {jax.__version__} numpy {np.__version__}"


@cache
def computer() -> str:
    """Names what decides the last bits of a result besides the sources.

    The versions of what computes, and the processor's vector instructions.
    """
    versions = " ".join(f"{name} {metadata.version(name)}" for name in _COMPUTING)
    return f"{versions} {programs.vectors()}"


def content_hash(tree: Any) -> str:
    """Hashes every array of a tree, with its shape and type."""
    digest = hashlib.blake2b(digest_size=20)
    for leaf in jax.tree.leaves(tree):
        digest.update(_array_hash(leaf))
    return digest.hexdigest()


_known: dict[int, tuple[weakref.ref[jax.Array], bytes]] = {}


def know(array: jax.Array, origin: bytes) -> None:
    """Has an array hashed by what it was made of, which is less to read.

    Args:
        array: as it was made; how it lies in memory is no part of its hash.
        origin: decides every element, and is the same wherever the array is made.
    """
    _keep_hash(array, hashlib.blake2b(origin, digest_size=32).digest())


def _keep_hash(array: jax.Array, digest: bytes) -> None:
    key = id(array)
    _known[key] = weakref.ref(array, lambda _: _known.pop(key, None)), digest


def _array_hash(leaf: Any) -> bytes:
    """Hashes one array; a large one of JAX's, which cannot change, only once."""
    held = _known.get(id(leaf))
    if held is not None and held[0]() is leaf:
        return held[1]
    array = np.asarray(leaf)
    # SHA-256, which processors have instructions for: twice as fast as BLAKE2.
    digest = hashlib.sha256(f"{array.shape} {array.dtype}".encode())
    digest.update(np.ascontiguousarray(array).reshape(-1).view(np.uint8).data)
    found = digest.digest()
    if isinstance(leaf, jax.Array) and leaf.nbytes >= _LARGE_BYTES:
        _keep_hash(leaf, found)
    return found


def read(file: Path, like: Tree) -> Tree | None:
    """Returns the tree of arrays in a file, or None where it is missing or misfit.

    Args:
        file: an ``.npz`` that `write` made.
        like: a tree of arrays, or their shapes and types, that it must have.
    """
    paths, structure = jax.tree_util.tree_flatten_with_path(like)
    held = read_all(file)
    if held is None or not held.keys() >= {_name(path) for path, _ in paths}:
        return None
    found = [held[_name(path)] for path, _ in paths]
    for array, (_, wanted) in zip(found, paths, strict=True):
        if array.shape != wanted.shape or array.dtype != wanted.dtype:
            return None
    return jax.tree.unflatten(structure, found)


def read_all(file: Path) -> dict[str, np.ndarray] | None:
    """Returns every array in a file by name; None where it is missing or damaged."""
    try:
        # Opened here: numpy leaves a damaged file open.
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except Exception:  # whatever a reader of damaged bytes stumbles over
        return None


def write(file: Path, tree: Any, limit_bytes: int | None = None) -> None:
    """Writes a tree of arrays atomically; one that cannot be written is no error.

    Args:
        file: an ``.npz``.
        tree: the arrays.
        limit_bytes: of all files in its folder; the oldest go first. None: no limit.
    """
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    arrays = {_name(path): np.asarray(leaf) for path, leaf in paths}
    _put(
        file,
        lambda stream: np.savez(stream, allow_pickle=False, **arrays),
        limit_bytes,
    )


def store(file: Path, data: bytes, limit_bytes: int) -> None:
    """Writes the bytes of a file that `write` made elsewhere, as `write` does.

    Args:
        file: an ``.npz``.
        data: all of it; `read` tells whether they are whole.
        limit_bytes: of all files in its folder; the oldest go first.
    """
    _put(file, lambda stream: stream.write(data), limit_bytes)


def _put(
    file: Path, fill: Callable[[IO[bytes]], object], limit_bytes: int | None
) -> None:
    try:
        write_whole(file, fill)
        if limit_bytes is not None:
            prune(file.parent, limit_bytes)
    except OSError:
        return


def write_whole(file: Path, fill: Callable[[IO[bytes]], object]) -> None:
    """Makes a file, and its folder, that is never there in part.

    Raises:
        OSError: it cannot be written.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=file.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            fill(stream)
        Path(name).replace(file)
    finally:  # a full disk leaves no part of a file behind
        Path(name).unlink(missing_ok=True)


def _name(path: Any) -> str:
    return jax.tree_util.keystr(path, simple=True, separator="/") or "array"
