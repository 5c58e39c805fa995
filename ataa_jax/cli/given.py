"""What the commands are given: their options, told once, and checks of the texts."""

from pathlib import Path
from typing import Annotated

import typer

from ataa_jax.errors import InputError

MAX_SIDE = 16384

Scene = Annotated[
    str,
    typer.Argument(
        metavar="SCENE", help="A .glb, .gltf or mesh file, or the word 'builtin'."
    ),
]
Size = Annotated[str, typer.Option(metavar="WxH", help="Image size in pixels.")]
Frames = Annotated[int, typer.Option(help="Frames to render, at least 1.")]
Methods = Annotated[
    list[str] | None,
    typer.Option(
        "--method",
        help="Method, or several with commas or by repeating: none, fxaa, taa, ataa2, "
        "ataa4, ataa8, ssaa2 … ssaa16; taa_ue4 and ataa8_ue4 use the literature's "
        "constants. All by default.",
    ),
]
Method = Annotated[
    str, typer.Option(help="none, fxaa, taa, ataa2, ataa4, ataa8, ssaa2 … ssaa16.")
]
CameraOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="A camera of the scene, a kind of path (still, pan, orbit, dolly, walk), "
        "CAMERA:KIND, or a TOML file as in data/. A walk by default. The exact name of "
        "a camera comes first; CAMERA:KIND splits at the last colon.",
    ),
]
Motion = Annotated[
    str | None,
    typer.Option(
        metavar="SPEED",
        help="typical (1 % of the width a frame), rapid (10 %), or a share such as "
        "0.02.",
    ),
]
ParamsOption = Annotated[
    Path | None,
    typer.Option(
        "--params",
        metavar="FILE",
        help="TOML with numbers in place of the tuned preset's.",
    ),
]
Out = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Where results go; new or empty.")
]
Budget = Annotated[
    float | None,
    typer.Option(
        help="Sparse rays a pixel of the frame, or inf; 0.48 unless --params says."
    ),
]
Against = Annotated[
    str | None,
    typer.Option(
        metavar="mitsuba",
        help="Measure brute force instead, under one directional light: Mitsuba 3 at "
        "8 samples a pixel beside SSAA 8x and ATAA 8x.",
    ),
]
Effects = Annotated[
    str | None,
    typer.Option(
        "--effects",
        metavar="NAMES",
        help="Effects in place of those that the scene calls for: names with commas, "
        "no-NAME to leave one out, or all. `ataa info` lists them.",
    ),
]
ReferenceSamples = Annotated[int, typer.Option(help="Samples a pixel of the truth.")]
LeadIn = Annotated[int, typer.Option(help="Frames before the first that is kept.")]
Preset = Annotated[str, typer.Option(help="Constants: tuned, paper or ue4.")]
Jobs = Annotated[
    int,
    typer.Option(
        metavar="N",
        help="Processes that render references and recordings beforehand; results "
        "do not depend on it. One that dies is replaced.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="A Dask scheduler, such as tcp://host:8786, whose workers do so instead: "
        "with the same ataa_jax, and the scene under the same name. Needs "
        r"'ataa-jax\[dask]'.",  # the bracket escaped: it would be rich's markup
    ),
]
Traceback = Annotated[
    bool, typer.Option("--traceback", help="Show where an error came from.")
]


def size_of(text: str) -> tuple[int, int]:
    """Returns (height, width) of a text such as 640x360."""
    parts = text.lower().replace("×", "x").split("x")
    if len(parts) == 2 and all(part.isdecimal() and len(part) < 6 for part in parts):
        width, height = (int(part) for part in parts)
        if 1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE:
            return height, width
    raise InputError(
        f"--size must be WIDTHxHEIGHT with 1 to {MAX_SIDE} pixels a side, such as "
        f"640x360, not '{text}'"
    )


def at_least(name: str, value: int, least: int) -> None:
    """Refuses a value of an option that is too small."""
    if value < least:
        raise InputError(f"{name} must be at least {least}, not {value}")
