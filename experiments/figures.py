"""Draws the experiments' plots without a display, and saves them."""

from pathlib import Path

import matplotlib as mpl
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

mpl.use("Agg")


def save(figure: Figure, file: Path, dpi: int = 80) -> None:
    """Writes a plot, whose bytes do not tell what version drew it, and closes it."""
    figure.savefig(file, dpi=dpi, metadata={"Software": None})
    plt.close(figure)
