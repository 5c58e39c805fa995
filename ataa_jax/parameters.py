"""Parameters as TOML: what a fit found, or a user's own numbers.

A file holds only what it changes; all else keeps the preset's value. Tables are the
stages, keys the fields of their `Params`:

    budget = 0.5           # rays a pixel of the frame

    [taa]
    count_limit = 4

    [segmentation]
    threshold = 0.08

    [choices.segmentation] # switches of its `Config`
    use_response = true

    [fit]                  # where the numbers come from; not read
"""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import tomli_w

from ataa_jax import files, pipeline, segmentation
from ataa_jax.errors import InputError
from ataa_jax.pipeline import Params


def load(file: Path, params: Params) -> Params:
    """Returns parameters with the file's numbers in place of the given ones.

    Args:
        file: TOML, see the module.
        params: the preset's.

    Raises:
        InputError: see `read` and `override`.
    """
    return override(params, read(file), f"parameter file {file}")


def read(file: Path) -> dict[str, Any]:
    """Returns a file's tables, not yet checked against any parameters.

    Raises:
        InputError: the file cannot be read or is not TOML.
    """
    return files.read_toml(file, "parameter file")


def override(params: Params, table: dict[str, Any], where: str) -> Params:
    """Returns parameters with a table's numbers in place of the given ones.

    Args:
        params: the preset's.
        table: stages, and in them fields; what it does not name stays.
        where: named in errors.

    Raises:
        InputError: an unknown name, or something else than finite numbers of the
            parameter's shape (`budget` may be inf).
    """
    numbers = {name: value for name, value in table.items() if name not in _OTHER}
    return _override(params, numbers, where, "")


def choices(
    table: dict[str, Any], config: segmentation.Config, where: str
) -> segmentation.Config:
    """Returns the segmentation's choices with a table's in place of the given ones.

    Raises:
        InputError: an unknown name, or something else than the choice's values.
    """
    stages = table.get("choices", {})
    if not isinstance(stages, dict) or set(stages) - {"segmentation"}:
        raise InputError(f"{where}: 'choices' must be [choices.segmentation]")
    given = stages.get("segmentation", {})
    if not isinstance(given, dict):
        raise InputError(f"{where}: 'choices.segmentation' must be a table")
    known = switches(config)
    for name, value in given.items():
        full = f"choices.segmentation.{name}"
        if name not in known:
            raise InputError(
                f"{where} has the unknown key '{full}'; known are {', '.join(known)}"
            )
        allowed = _TEXTS.get(name, (True, False))
        if type(value) is not type(allowed[0]) or value not in allowed:
            words = ", ".join(str(word).lower() for word in allowed)
            raise InputError(f"{where}: '{full}' must be one of {words}, not {value!r}")
    return replace(config, **given)


def switches(config: segmentation.Config) -> dict[str, Any]:
    """Returns the segmentation's choices by name."""
    return asdict(config)


def segmentation_of(
    table: dict[str, Any], where: str
) -> tuple[segmentation.Params, segmentation.Config]:
    """Returns the segmentation stage that a file's tables describe.

    Raises:
        InputError: see `override` and `choices`.
    """
    config, params = pipeline.preset("tuned", None, (1, 1))
    return (
        override(params, table, where).segmentation,
        choices(table, config.segmentation, where),
    )


# Tables that hold no numbers: switches, and where a fit's numbers come from.
_OTHER = ("choices", "fit")
_TEXTS: dict[str, tuple[str, ...]] = {
    "reading": ("sum", "either"),
    "disocclusion": ("pixel", "neighbourhood"),
}


def save(params: Params, file: Path) -> None:
    """Writes every parameter, so that `load` gives back the same bits."""
    files.write_text(file, tomli_w.dumps(table(params)))


def plain(module: eqx.Module) -> dict[str, Any]:
    """Returns a stage's parameters as plain numbers."""
    return table(module)


def table(module: eqx.Module) -> dict[str, Any]:
    """Returns a module as nested tables; numbers come before tables, as TOML asks."""
    leaves, tables = {}, {}
    for name, value in _fields(module).items():
        if isinstance(value, eqx.Module):
            tables[name] = table(value)
        else:
            leaves[name] = _plain(np.asarray(value))
    return {**leaves, **tables}


def _plain(array: np.ndarray) -> Any:
    if array.ndim > 0:
        return [_plain(item) for item in array]
    if np.issubdtype(array.dtype, np.floating):
        # The shortest decimals that read back as the same float32.
        return float(str(array))
    return array.item()


def _override(module: Any, table: dict[str, Any], where: str, path: str) -> Any:
    fields = _fields(module)
    for name, value in table.items():
        full = f"{path}{name}"
        if name not in fields:
            raise InputError(
                f"{where} has the unknown key '{full}'; known are "
                f"{', '.join(f'{path}{known}' for known in fields)}"
            )
        old = fields[name]
        if isinstance(old, eqx.Module):
            if not isinstance(value, dict):
                raise InputError(f"{where}: '{full}' must be a table, as in [{full}]")
            new = _override(old, value, where, f"{full}.")
        else:
            new = _leaf(old, value, where, full)
        module = eqx.tree_at(lambda m, name=name: getattr(m, name), module, new)
    return module


def _leaf(old: Any, value: object, where: str, name: str) -> Any:
    shape, dtype = np.shape(old), np.asarray(old).dtype
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        array = None
    boolean = isinstance(value, bool | str | dict)
    if array is None or boolean or array.shape != shape:
        wanted = "a number" if not shape else f"{shape[0]} numbers in brackets"
        raise InputError(f"{where}: '{name}' must be {wanted}, not {value!r}")
    if np.any(np.isnan(array)) or (name != "budget" and not np.all(np.isfinite(array))):
        raise InputError(f"{where}: '{name}' must be finite, not {value!r}")
    if name != "raster.mip_bias" and np.any(array < 0.0):
        raise InputError(f"{where}: '{name}' must be at least 0, not {value!r}")
    if np.issubdtype(dtype, np.integer) and np.any(array != np.round(array)):
        raise InputError(f"{where}: '{name}' must be a whole number, not {value!r}")
    return jnp.asarray(array.astype(dtype))


def _fields(module: eqx.Module) -> dict[str, Any]:
    names = module.__dataclass_fields__
    return {name: getattr(module, name) for name in names}
