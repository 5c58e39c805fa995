"""`ataa verify`: does the package compute here what it computed where it was made?"""

import typer
from rich.console import Console

from ataa_jax.cli import given, terminal


def verify(traceback: given.Traceback = False) -> None:
    """Renders the golden sequences, and tells how they differ from those kept."""
    from ataa_jax import verify as golden

    with terminal.progress() as report:
        count = len(golden.SEQUENCES)
        done = iter(range(count))
        found = golden.verify(lambda name: report(name, next(done), count))
    console = Console(soft_wrap=True, highlight=False)
    heads = ("Sequence", "Bits", "Largest", "Changed", "Other method", "Verdict")
    rows = [
        (
            each.name,
            "same" if each.same_bits else "differ",
            f"{each.largest}/255",
            f"{each.changed:.3%}",
            f"{each.other_method:.3%}",
            "holds" if each.holds else "fails",
        )
        for each in found
    ]
    console.print(terminal.table(heads, rows))
    made, here = golden.origin(), golden.here()
    console.print(
        f"\nChanged: pixels by more than 1/255, at most {golden.CHANGED:.1%}; other "
        f"method: at most {golden.OTHER_METHOD:.1%}. Rendered by {made['command']} on "
        f"{made['date']}."
    )
    for name, version in here.items():
        if made["versions"].get(name) != version:
            console.print(f"{name}: {made['versions'].get(name)} there, {version} here")
    if not all(each.holds for each in found):
        raise typer.Exit(1)
