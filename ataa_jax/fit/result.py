"""A fit's file: parameters that `--params` reads, and where they come from.

Stages' tables hold the numbers, `[choices.segmentation]` the switches they need, and
`[fit]` the versions, scenes, budget and scores; of a capture, `capture` says what stood
in for rays. No time, host or path: the same recordings and seed give the same bytes.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w

from ataa_jax import files, parameters, segmentation
from ataa_jax.errors import InputError
from ataa_jax.fit.fitting import Fitted, Standing, versions

_DIGITS = 5  # of an SSIM; a fit's noise is larger
_HEADER = "// {name}, fitted by ataa_jax for {budget:g} rays a pixel\n"


def table(fitted: Fitted, scenes: dict[str, str]) -> dict[str, Any]:
    """Returns a fit as nested tables.

    Args:
        fitted: the fit.
        scenes: content hash by the recordings' names.
    """
    numbers = parameters.table(fitted.params)
    own = {"count_limit", *(q.removeprefix("taa.") for q in fitted.options.quantities)}
    options = dataclasses.asdict(fitted.options)
    height, width = fitted.size
    return {
        "budget": fitted.options.budget,
        "segmentation": numbers["segmentation"],
        "taa": {key: n for key, n in numbers["taa"].items() if key in own},
        "resolve": numbers["resolve"],
        "choices": {"segmentation": parameters.switches(fitted.config)},
        "fit": {
            **{key: _plain(value) for key, value in options.items()},
            "size": f"{width}x{height}",
            "frames": fitted.frames,
            "evaluations": fitted.evaluations,
            "relaxed_evaluations": fitted.relaxed_evaluations,
            "notes": fitted.notes,
            "versions": versions(),
            "scene": [_scene(each, scenes) for each in fitted.standings],
            "held_out": [_scene(each, scenes) for each in fitted.held_out],
        },
    }


def _scene(standing: Standing, scenes: dict[str, str]) -> dict[str, Any]:
    own = dataclasses.asdict(standing)
    captured = own.pop("captured")
    row: dict[str, Any] = {
        key: value if isinstance(value, str) else round(float(value), _DIGITS)
        for key, value in own.items()
    }
    row["oracle_efficiency"] = round(float(standing.efficiency), 3)
    row["closed"] = round(float(standing.closed), 3)
    row["content"] = scenes.get(standing.scene, "")
    if captured is not None:
        del captured["notes"]  # the fit's own notes hold them
        row["capture"] = captured
    return row


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def write(fitted: Fitted, scenes: dict[str, str], file: Path) -> None:
    """Writes the file, all of it or nothing."""
    files.write_text(file, tomli_w.dumps(table(fitted, scenes)))


Language = Literal["hlsl", "glsl", "json"]


def export(given: dict[str, Any], language: str, name: str) -> str:
    """Returns a parameter file's segmentation as constants for an engine.

    Args:
        given: the file's tables, see `parameters.read`.
        language: hlsl, glsl or json.
        name: of the file, told in a comment.

    Raises:
        InputError: an unknown language, or numbers that cannot be read.
    """
    if language not in ("hlsl", "glsl", "json"):
        raise InputError(f"--to must be hlsl, glsl or json, not '{language}'")
    where = f"parameter file {name}"
    params, config = parameters.segmentation_of(given, where)
    constants = _constants(params, config)
    if language == "json":
        return json.dumps(constants, indent=2) + "\n"
    kind = "static const {type} " if language == "hlsl" else "const {type} "
    lines = [_HEADER.format(name=name, budget=given.get("budget", float("nan")))]
    for key, value in constants.items():
        if isinstance(value, bool):
            text, type_ = str(value).lower(), "bool"
        elif isinstance(value, int):
            text, type_ = str(value), "int"
        else:
            text, type_ = _float(value, language), "float"
        lines.append(f"{kind.format(type=type_)}ATAA_{key.upper()} = {text};\n")
    return "".join(lines)


def _constants(
    params: segmentation.Params, config: segmentation.Config
) -> dict[str, float | int | bool]:
    """Returns what a shader needs: weights already over their sum, 0 where off."""
    found: dict[str, float | int | bool] = {}
    own = parameters.plain(params)
    terms = [n.removesuffix("_weight") for n in own if n.endswith("_weight")]
    on = [term for term in terms if getattr(config, f"use_{term}")]
    total = sum(own[f"{term}_weight"] for term in on) or 1.0
    found["reading_sum"] = config.reading == "sum"
    found["threshold"] = own["threshold"]
    for term in terms:
        weight = own[f"{term}_weight"] / total if term in on else 0.0
        found[f"{term}_weight"] = float(np.float32(weight))
        if term in on and f"{term}_threshold" in own:
            found[f"{term}_threshold"] = own[f"{term}_threshold"]
    for key in (
        "response_contrast", "luminance_floor", "disocclusion_px",
        "disocclusion_relative", "depth_relative", "reset_px", "hold",
    ):  # fmt: skip
        found[key] = own[key]
    return found


def _float(value: float, language: str) -> str:
    text = repr(float(str(np.float32(value))))
    return f"{text}f" if language == "hlsl" else text
