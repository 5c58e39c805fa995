"""Finds the test scenes that are too large for the repository."""

import os
from pathlib import Path

import pytest


def scene_path(name):
    """Returns the path of a scene such as ``sponza.glb``, or skips the test."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "scenes"
    folder = Path(os.environ.get("ATAA_SCENES", beside))
    path = folder / name
    if not path.is_file():
        pytest.skip(f"{path} is not there; set ATAA_SCENES to the folder of {name}")
    return path
