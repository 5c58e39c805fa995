"""The golden sequences: read whole, compared rightly, held to by another process."""

import os
import subprocess
import sys

import numpy as np
import pytest

from ataa_jax import cli, types, verify

CODE = (
    "from ataa_jax import verify\n"
    "found = [verify.compare(n, verify.render(n), verify.read(n)) for n in {names}]\n"
    "assert all(each.holds for each in found), found\n"
    "print(found)\n"
)


@pytest.fixture
def golden():
    return verify.read("wires")


@pytest.mark.parametrize("name", verify.SEQUENCES)
def test_a_golden_sequence_is_whole_and_shows_taa_and_rays(name):
    golden = verify.read(name)
    assert golden.image.shape == (verify.FRAMES, *verify.SIZE, 3)
    assert golden.method.shape == (verify.FRAMES, *verify.SIZE)
    assert len(golden.digest) == 64
    shown = {types.METHOD_TAA, types.METHOD_ATAA}
    assert shown <= set(np.unique(golden.method[1:]).tolist())
    assert golden.image.std() > 10.0


def test_equal_renderings_do_not_differ(golden):
    found = verify.compare("wires", golden, golden)
    assert found.same_bits
    assert (found.largest, found.changed, found.other_method) == (0, 0.0, 0.0)
    assert found.holds


def test_what_differs_is_counted(golden):
    image = golden.image.copy()
    image[0, :2] ^= 4  # two rows of 54 in one frame of six
    method = golden.method.copy()
    method[1, 0] = method[1, 0] + 1
    other = verify.Rendered(image, method, "other")
    found = verify.compare("wires", other, golden)
    assert not found.same_bits
    assert found.largest == 4
    assert found.changed == pytest.approx(2 / 54 / 6)
    assert found.other_method == pytest.approx(1 / 54 / 6)
    far = verify.Rendered(image ^ 4, method, "far")
    assert not verify.compare("wires", far, golden).holds


def test_the_command_tells_each_sequence_and_fails_with_one(capsys, monkeypatch):
    monkeypatch.setattr(verify, "render", verify.read)
    assert cli.main(["verify"]) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in verify.SEQUENCES)
    assert "holds" in told
    assert "fails" not in told
    golden = verify.read("wires")
    broken = verify.Rendered(255 - golden.image, golden.method, "broken")
    monkeypatch.setattr(verify, "render", lambda name: broken)
    assert cli.main(["verify"]) == 1
    assert "fails" in capsys.readouterr().out


def rendered_elsewhere(names: list[str], home: str | None, flags: str) -> str:
    """Renders in another process, with XLA's flags and a home for Embree's settings."""
    environment = {**os.environ, "XLA_FLAGS": flags}
    if home is not None:
        environment["HOME"] = home
    done = subprocess.run(
        [sys.executable, "-c", CODE.format(names=names)],
        env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_another_process_renders_the_golden_wires():
    assert "wires" in rendered_elsewhere(["wires"], None, "")


@pytest.mark.hard
@pytest.mark.parametrize("isa", ["AVX2", "SSE4_2"])
def test_a_lesser_instruction_set_renders_them_within_the_tolerance(tmp_path, isa):
    # Embree reads its settings from a file in the home folder.
    embree = {"AVX2": "avx2", "SSE4_2": "sse4.2"}[isa]
    (tmp_path / ".embree4").write_text(f"isa={embree}\n")
    flags = f"--xla_cpu_max_isa={isa}"
    rendered_elsewhere(list(verify.SEQUENCES), str(tmp_path), flags)
