"""`ataa fit` and `ataa export`: files out, and clear words for mistakes."""

import inspect

import pytest

from ataa_jax import cli, pipeline
from ataa_jax.cli import fit_commands, given


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--budget", "0"], "budget above 0"),
        (["--budget", "9"], "at most 8"),
        (["--terms", "magic"], "unknown term"),
        (["--terms", ""], "at least one term"),
        (["--solver", "newton"], "--solver must be one of"),
        (["--reading", "both"], "--reading must be one of"),
        (["--frames", "0"], "--frames must be at least 1"),
        (["-o", "p.json"], "must be a .toml file"),
        (["--size", "8x8"], "at least 11 pixels a side"),
    ],
)
def test_mistakes_are_one_line_and_nothing_is_written(
    options, word, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("ATAA_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    small = ["--frames", "1", "--lead-in", "0", "--reference-samples", "1"]
    assert cli.main(["fit", "builtin", *small, *options]) == cli.BAD_INPUT
    captured = capsys.readouterr()
    assert word in captured.err
    assert captured.err.count("\n") == 1
    assert not list(tmp_path.glob("*.toml"))
    assert not list(tmp_path.glob("*.json"))


def test_the_commands_default_budget_is_the_pipelines():
    # Written out there: the commands' help must not wait for JAX.
    default = inspect.signature(fit_commands.fit).parameters["budget"].default
    assert default == pipeline.BUDGET
    assert f"{pipeline.BUDGET:g} unless" in given.Budget.__metadata__[0].help
