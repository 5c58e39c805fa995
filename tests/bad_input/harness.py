"""Runs spoiled files through `ataa` in a process of its own, and judges what came."""

import json
import os
import select
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image

# After start-up and compilation, and in all: the bounds of a well-behaved reader.
SECONDS, MEGABYTES = 10.0, 2048
_PATIENCE = 180.0  # s, with compilation; then the process hangs
_FRESH = 250  # files; a process that keeps every program compiled grows
SIZE = (64, 36)


@dataclass
class Seen:
    """What one command did."""

    code: int | None  # None: the process died, or had to be killed
    err: str = ""
    # Of the processor, less what compilation took by the clock: other work on the
    # machine makes no file slow.
    seconds: float = 0.0
    megabytes: int = 0  # the process's peak
    trespasses: list[str] = field(default_factory=list)


class Reader:
    """Runs `ataa run` on files; use as a context."""

    def __init__(self, folder: Path, sound: Path) -> None:
        """Takes an empty folder, and a sound scene that every process starts with."""
        self.folder = folder
        self.sound = sound
        self.out = folder / "out" / "result"
        self.out.parent.mkdir(parents=True)
        # Where `../secret.png` leads from the scene's folder.
        self.bait = folder / "secret.png"
        Image.new("RGB", (4, 4)).save(self.bait)
        self.cache = folder / "cache"
        self.done = 0
        self.process: subprocess.Popen[str] | None = None

    def __enter__(self) -> "Reader":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Ends the process; the next command starts another."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None

    def run(self, scene: Path | str, *words: str) -> Seen:
        """Renders one frame of 64×36 without antialiasing.

        Args:
            scene: what to render.
            words: further options.
        """
        if self.done % _FRESH == 0:
            self.stop()
        self.done += 1
        if self.process is None:
            self._command(self.sound, ())
        return self._command(scene, words)

    def _command(self, scene: Path | str, words: tuple[str, ...]) -> Seen:
        shutil.rmtree(self.out.parent)
        self.out.parent.mkdir()
        size = f"{SIZE[0]}x{SIZE[1]}"
        given = ("run", str(scene), "--size", size, "--frames", "1", "--method", "none",
                 "--out", str(self.out), *words)  # fmt: skip
        programs = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(self.cache))
        written = [str(self.out.parent), str(self.cache), programs]
        answer = self._ask(
            {
                "words": given,
                "bait": [
                    os.path.realpath(self.bait),
                    "/etc/passwd",
                    "/dev/zero",
                ],
                "written": [os.path.realpath(each) for each in written],
            }
        )
        if answer is None:
            self.stop()
            return Seen(code=None)
        return Seen(**answer)

    def _ask(self, request: dict) -> dict | None:
        if self.process is None:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.bad_input.worker"],
                cwd=Path(__file__).parents[2],
                env={
                    **os.environ,
                    "ATAA_CACHE": str(self.cache),
                    "PYTHONDONTWRITEBYTECODE": "1",
                    "NUMBA_CACHE_DIR": str(self.cache / "numba"),
                },
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            assert self._line() == "ready\n"
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(request) + "\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            return None
        line = self._line()
        return json.loads(line) if line else None

    def _line(self) -> str:
        assert self.process is not None
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], _PATIENCE)
        return self.process.stdout.readline() if ready else ""

    def verdict(self, seen: Seen) -> tuple[str, str]:
        """Returns what a command ended in, and what was wrong with that, if anything.

        Returns:
            ("image" or "refused" or "broken", the fault or "").
        """
        image = self.out / "frames" / "0000.png"
        if seen.code is None:
            return "broken", "the process died or hung"
        if seen.trespasses:
            return "broken", "; ".join(seen.trespasses)
        if seen.seconds > SECONDS:
            return "broken", f"took {seen.seconds:.1f} s"
        if seen.megabytes > MEGABYTES:
            return "broken", f"took {seen.megabytes} MB"
        if seen.code == 0:
            if not image.is_file():
                return "broken", "exit code 0 without a picture"
            with Image.open(image) as picture:
                fault = "" if picture.size == SIZE else f"a picture of {picture.size}"
            return "broken" if fault else "image", fault
        lines = [each for each in seen.err.splitlines() if each.startswith("error: ")]
        if seen.code != 2 or "Traceback" in seen.err or len(lines) != 1:
            return "broken", f"exit code {seen.code}: {seen.err[-300:]}"
        if self.out.exists() or list(self.out.parent.iterdir()):
            return "broken", "left files behind"
        return "refused", ""
