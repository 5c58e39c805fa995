"""Accessors: typed arrays inside buffers (glTF 2.0, section 3.6.2)."""

from typing import Any

import numpy as np

from ataa_jax.errors import InputError
from ataa_jax.gltf.container import Container

_DTYPES = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
_WIDTHS = {
    "SCALAR": 1,
    "VEC2": 2,
    "VEC3": 3,
    "VEC4": 4,
    "MAT2": 4,
    "MAT3": 9,
    "MAT4": 16,
}
# An accessor without a buffer view is zeros that no file size bounds, so it gets a
# bound of its own.
MAX_COUNT = 1 << 26


def read(
    container: Container, index: Any, user: str, kinds: tuple[str, ...]
) -> np.ndarray:
    """Returns an accessor as its own component type, sparse entries applied.

    Args:
        container: The file.
        index: Which accessor.
        user: The place that asked, for messages.
        kinds: The types that make sense there, such as ``("VEC3",)``.

    Returns:
        (count,) for SCALAR, else (count, components); matrices are column-major.
        Never a view of the buffer; normalized integers stay integers.

    Raises:
        InputError: anything about it is wrong.
    """
    record = container.item("accessors", index, user)
    where = f"accessors[{index}]"
    dtype, kind = _layout(container, record, where)
    if kind not in kinds:
        raise container.fail(
            f"{user} needs {' or '.join(kinds)} but {where} is {kind}; re-export the "
            "file"
        )
    count = container.integer(record, "count", where)
    if count == 0:
        raise container.fail(f"{where} has count 0; re-export the file")
    if "bufferView" in record:
        offset = container.integer(record, "byteOffset", where, 0)
        values = _strided(
            container, record["bufferView"], offset, count, dtype, kind, where
        )
    else:
        _check_count(container, count, _WIDTHS[kind], where)
        values = np.zeros((count, _WIDTHS[kind]), dtype)
    if "sparse" in record:
        _apply_sparse(container, record, values, dtype, kind, where)
    return values[:, 0] if kind == "SCALAR" else values


def read_float(
    container: Container, index: Any, user: str, kinds: tuple[str, ...]
) -> np.ndarray:
    """Returns an accessor as float32; normalized integers become [0, 1] or [−1, 1]."""
    values = read(container, index, user, kinds)
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    if container.item("accessors", index, user).get("normalized", False) is True:
        scaled = values.astype(np.float32) / np.float32(np.iinfo(values.dtype).max)
        return np.maximum(scaled, np.float32(-1.0))  # −128 and −127 are both −1
    return values.astype(np.float32)


def read_finite(
    container: Container, index: Any, user: str, kinds: tuple[str, ...]
) -> np.ndarray:
    """Returns what `read_float` does, refusing NaN and infinity."""
    values = read_float(container, index, user, kinds)
    if not np.isfinite(values).all():
        raise container.fail(
            f"{user} (accessors[{index}]) holds NaN or infinite values; repair the "
            "model and export it again"
        )
    return values


def read_indices(container: Container, index: Any, user: str) -> np.ndarray:
    """Returns an accessor of unsigned integers as int64."""
    values = read(container, index, user, ("SCALAR",))
    if values.dtype.kind != "u":
        raise container.fail(
            f"{user} (accessors[{index}]) must hold unsigned integers, not "
            f"{values.dtype.name}; re-export the file"
        )
    return values.astype(np.int64)


def _layout(
    container: Container, record: dict[str, Any], where: str
) -> tuple[np.dtype, str]:
    component = container.integer(record, "componentType", where)
    if component not in _DTYPES:
        raise container.fail(
            f"{where}.componentType is {component}, which glTF 2.0 does not define; "
            "re-export the file"
        )
    kind = container.string(record, "type", where)
    if kind not in _WIDTHS:
        raise container.fail(
            f"{where}.type is {kind!r}, which glTF 2.0 does not define; re-export the "
            "file"
        )
    return _DTYPES[component], kind


def _check_count(container: Container, count: int, width: int, where: str) -> None:
    if count * width > MAX_COUNT:
        raise container.fail(
            f"{where} asks for {count} elements, more than the {MAX_COUNT} numbers an "
            "accessor may hold here; split the mesh"
        )


def _columns(dtype: np.dtype, kind: str) -> tuple[np.ndarray, int]:
    """Returns each component's byte within an element, and the element's size.

    Columns of matrices begin at multiples of 4 bytes, which pads small components.
    """
    width = _WIDTHS[kind]
    if not kind.startswith("MAT"):
        return np.arange(width) * dtype.itemsize, width * dtype.itemsize
    rows = int(kind[3])
    column = -(-rows * dtype.itemsize // 4) * 4
    at = [c * column + r * dtype.itemsize for c in range(rows) for r in range(rows)]
    return np.array(at), rows * column


def _strided(
    container: Container,
    view: Any,
    offset: int,
    count: int,
    dtype: np.dtype,
    kind: str,
    where: str,
) -> np.ndarray:
    """Copies (count, components) out of a buffer view."""
    data, stride = container.view(view, where)
    at, size = _columns(dtype, kind)
    step = stride or size
    if step < size:
        raise container.fail(
            f"{where} has elements of {size} bytes but a byteStride of {stride}; "
            "re-export the file"
        )
    end = offset + step * (count - 1) + size
    if end > len(data):
        raise container.fail(
            f"{where} ({count} elements) needs {end} bytes but its buffer view holds "
            f"{len(data)}; the file is damaged, export it again"
        )
    # A view as wide as the last component read, so that the last stride's padding
    # need not exist in the buffer.
    if len(at) * dtype.itemsize == size:
        packed = np.ndarray(
            (count, len(at)), dtype, data, offset, (step, dtype.itemsize)
        )
        return packed.copy()
    planes = [np.ndarray((count,), dtype, data, offset + int(a), (step,)) for a in at]
    return np.stack(planes, axis=1)


def _apply_sparse(
    container: Container,
    record: dict[str, Any],
    values: np.ndarray,
    dtype: np.dtype,
    kind: str,
    where: str,
) -> None:
    """Overwrites the sparse entries of `values`."""
    where = f"{where}.sparse"
    sparse = container.table(record, "sparse", where.removesuffix(".sparse"))
    count = container.integer(sparse, "count", where)
    if count == 0 or count > len(values):
        raise container.fail(
            f"{where}.count is {count}, but must be from 1 to {len(values)}; re-export "
            "the file"
        )
    which = container.table(sparse, "indices", where)
    index_dtype = _DTYPES.get(
        container.integer(which, "componentType", f"{where}.indices")
    )
    if index_dtype is None or index_dtype.kind != "u":
        raise container.fail(
            f"{where}.indices must be unsigned integers; re-export the file"
        )
    offset = container.integer(which, "byteOffset", f"{where}.indices", 0)
    at = _strided(
        container,
        which.get("bufferView"),
        offset,
        count,
        index_dtype,
        "SCALAR",
        f"{where}.indices",
    )[:, 0].astype(np.int64)
    if at.max() >= len(values):
        raise _sparse_range(container, where, int(at.max()), len(values))
    source = container.table(sparse, "values", where)
    values[at] = _strided(
        container,
        source.get("bufferView"),
        container.integer(source, "byteOffset", f"{where}.values", 0),
        count,
        dtype,
        kind,
        f"{where}.values",
    )


def _sparse_range(
    container: Container, where: str, index: int, count: int
) -> InputError:
    return container.fail(
        f"{where}.indices reaches {index}, but the accessor has {count} elements; "
        "re-export the file"
    )
