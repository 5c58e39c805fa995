"""The command line's part for the cache folder: `ataa cache show` and `clear`."""

import typer
from rich.console import Console

from ataa_jax import programs
from ataa_jax.cli import terminal

app = typer.Typer(no_args_is_help=True, help="What is kept from run to run.")


@app.command()
def show() -> None:
    """Tells where the cache is, and how much it holds."""
    console = Console(highlight=False, soft_wrap=True)
    console.print(f"{programs.folder()} (set ATAA_CACHE to have it elsewhere)")
    rows = [
        (programs.KINDS[kind], f"{count:,} files", f"{size / 2**20:,.1f} MB")
        for kind, (count, size) in programs.contents().items()
    ]
    console.print(terminal.table((), rows, right=(1, 2)))


@app.command()
def clear() -> None:
    """Removes all of it; everything is made anew when it is needed."""
    before = _bytes()
    programs.clear()
    Console(highlight=False, soft_wrap=True).print(
        f"Removed {(before - _bytes()) / 2**20:,.1f} MB from {programs.folder()}"
    )


def _bytes() -> int:
    return sum(size for _, size in programs.contents().values())
