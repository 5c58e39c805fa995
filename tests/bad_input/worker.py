"""A process that runs `ataa` on one file after another and watches what it does.

Reads one JSON request a line: `words` for the command line, `out` its folder, `allowed`
folders. Answers each with one JSON line; see `harness.Seen`.
"""

import contextlib
import io
import json
import os
import sys
import time
from pathlib import Path

os.environ["JAX_PLATFORMS"] = "cpu"

import jax

_compiling = 0.0
_trespasses: list[str] = []
_watch: dict[str, list[str]] = {}
_PROGRAMS = ("ffmpeg", "uname")  # writes the video; the platform module asks
# Changes of folders: of each path they name, its place and its folder descriptor's.
_CHANGES = {
    "os.mkdir": ((0, 2),),
    "os.rename": ((0, 2), (1, 3)),
    "os.remove": ((0, 1),),
    "os.rmdir": ((0, 1),),
    "os.link": ((1, 3),),
    "os.symlink": ((1, 2),),
    "os.chmod": ((0, 2),),
}
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


def _compiled(event: str, seconds: float, **_: object) -> None:
    global _compiling
    if event.startswith("/jax/core/compile"):
        _compiling += seconds


def _audit(event: str, arguments: tuple) -> None:
    if not _watch:
        return
    if event.startswith("socket.connect"):
        _trespasses.append(f"connects to {arguments[1]}")
    elif event in ("os.system", "subprocess.Popen"):
        if not Path(str(arguments[0])).name.startswith(_PROGRAMS):
            _trespasses.append(f"{event} {arguments[:1]}")
    elif event == "open" and isinstance(arguments[0], str | bytes):
        path = os.path.realpath(os.fsdecode(arguments[0]))
        flags = arguments[2] if isinstance(arguments[2], int) else 0
        if any(path.startswith(each) for each in _watch["bait"]):
            _trespasses.append(f"opens {path}")
        elif flags & _WRITES and not _may_change(path):
            _trespasses.append(f"writes {path}")
    elif event in _CHANGES:
        for name, descriptor in _CHANGES[event]:
            path = _entry(arguments[name], arguments[descriptor])
            if not _may_change(path):
                _trespasses.append(f"{event} {path}")


def _may_change(path: str) -> bool:
    return any(path.startswith(each) for each in _watch["written"])


def _entry(name: str | bytes, descriptor: int) -> str:
    """Returns the path of a folder's entry; a link there is not followed."""
    given = os.fsdecode(name).rstrip("/")
    if descriptor != -1:
        given = os.path.join(os.readlink(f"/proc/self/fd/{descriptor}"), given)
    return os.path.join(os.path.realpath(os.path.dirname(given)), Path(given).name)


def main() -> None:
    from ataa_jax import cli, memory

    jax.monitoring.register_event_duration_secs_listener(_compiled)
    sys.addaudithook(_audit)
    answers = sys.__stdout__
    assert answers is not None
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        _trespasses.clear()
        out, err = io.StringIO(), io.StringIO()
        before, start = _compiling, time.process_time()
        # The programs' folder and its lock files are the cache's own.
        _watch.update(bait=request["bait"], written=[*request["written"], "/dev/null"])
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = cli.main(request["words"])
        finally:
            _watch.clear()
        whole = time.process_time() - start
        answer = {
            "code": code,
            "err": err.getvalue()[-4000:],
            "seconds": whole - (_compiling - before),
            "megabytes": memory.peak() >> 20,
            "trespasses": _trespasses[:5],
        }
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
