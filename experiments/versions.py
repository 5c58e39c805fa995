"""The versions behind a row of results: what computes, and the Python that runs it."""

import importlib.metadata
import platform

PACKAGES = ("ataa-jax", "embreex", "jax", "jaxlib", "numpy", "pillow", "trimesh")


def here() -> str:
    """Returns "python 3.…, ataa-jax …, …": the versions installed here."""
    parts = [f"python {platform.python_version()}"]
    parts += [f"{name} {importlib.metadata.version(name)}" for name in PACKAGES]
    return ", ".join(parts)
