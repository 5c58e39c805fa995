"""Writing results: whole folders or nothing, and bytes that depend on the input alone.

A command renders into a hidden folder inside the output folder; only when it is
complete are the files moved to their places, and what an earlier run had left there is
removed. `MANIFEST.txt` lists what a run wrote, so that a later run knows what is its
own; a folder that holds other files and no manifest is refused. A process that is
killed leaves the hidden folder behind: the same command finds it there and goes on (see
`journal`), any other begins anew.

No file carries a time, a host or a path: equal input gives equal bytes.
"""

import csv
import errno
import io
import itertools
import os
import shutil
import subprocess
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import filelock
import numpy as np
from PIL import Image

from ataa_jax.errors import InputError

MANIFEST = "MANIFEST.txt"
JOURNAL = ".journal"
LOCK = ".lock"
_PARTIAL = ".ataa-partial"

# A full disk, a user's share of it, a process's limit.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# Only to be read, no leave, a file in the place of a folder or the reverse.
_NO_PLACE = (
    *(errno.EROFS, errno.EACCES, errno.EPERM),
    *(errno.EEXIST, errno.ENOTDIR, errno.EISDIR),
)

Cell = str | int | float


@contextmanager
def output_folder(out: Path, *, resume: bool = False) -> Iterator[Path]:
    """Yields a folder to write into, whose files appear in `out` when all is done.

    Args:
        out: where the results shall lie; made if absent.
        resume: leave what a killed process left in the hidden folder; whoever asks for
            this keeps a `journal` there.

    Yields:
        A hidden folder inside `out`, removed with all its files if the block fails.

    Raises:
        InputError: `out` cannot be written, holds files that no earlier run wrote, or
            is being written by another process.
    """
    for folder in (out, *out.parents):
        if folder.exists() and not folder.is_dir():
            raise InputError(
                f"output folder {out} cannot be written, for {folder} is a file; give "
                "a new or empty folder with --out"
            )
    missing = [folder for folder in (out, *out.parents) if not folder.exists()]
    partial = out / _PARTIAL
    try:
        out.mkdir(parents=True, exist_ok=True)
        _refuse_foreign(out)
        partial.mkdir(exist_ok=True)
        lock = filelock.FileLock(partial / LOCK)
        lock.acquire(blocking=False)
    except filelock.Timeout:
        raise InputError(
            f"output folder {out} is being written by another process; wait for it, or "
            "give another with --out"
        ) from None
    except OSError as error:
        raise InputError(
            f"output folder {out} cannot be written ({error.strerror}); give another "
            "with --out"
        ) from None
    try:
        if not resume:
            empty(partial)
        yield partial
        _publish(partial, out)
    except OSError as error:
        if reason := _unwritable(error):
            raise InputError(
                f"output folder {out} cannot be written: {reason}, or give another "
                "with --out"
            ) from error
        raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        lock.release()
        for folder in missing:  # deepest first; only those that stayed empty
            with suppress(OSError):
                folder.rmdir()


def empty(partial: Path) -> None:
    """Removes all but the lock from a hidden folder."""
    for each in partial.iterdir():
        if each.is_dir():
            shutil.rmtree(each)
        elif each.name != LOCK:
            each.unlink()


def _refuse_foreign(out: Path) -> None:
    held = [
        entry for entry in sorted(out.iterdir()) if not entry.name.startswith(_PARTIAL)
    ]
    if held and not (out / MANIFEST).is_file():
        raise InputError(
            f"output folder {out} holds files of another origin, {held[0].name} among "
            "them; give an empty or a new folder with --out"
        )


def _publish(partial: Path, out: Path) -> None:
    """Removes what an earlier run wrote, then moves the new files into place.

    The manifest comes first, and lists both: a process killed in between leaves whole
    files that a later run knows to be its own.
    """
    written = sorted(
        file.relative_to(partial).as_posix()
        for file in partial.rglob("*")
        if file.is_file() and file.name != LOCK and JOURNAL not in file.parts
    )
    old = [name for name in _listed(out) if name not in written]
    write_text(out / MANIFEST, "".join(f"{name}\n" for name in [*written, *old]))
    for name in old:
        (out / name).unlink(missing_ok=True)
        for folder in (out / name).parents:
            if folder == out:
                break
            with suppress(OSError):
                folder.rmdir()
    for name in written:
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (partial / name).replace(out / name)
    write_text(out / MANIFEST, "".join(f"{name}\n" for name in written))


def _listed(out: Path) -> list[str]:
    """Returns the files of an earlier run, leaving out names that leave the folder."""
    try:
        names = (out / MANIFEST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return []
    inside = out.resolve()
    return [
        name for name in names if name and (out / name).resolve().is_relative_to(inside)
    ]


@contextmanager
def atomic(file: Path) -> Iterator[Path]:
    """Yields a temporary name beside `file` that becomes `file` if the block succeeds.

    The name keeps the suffix, by which some writers choose their format.

    Raises:
        InputError: the disk is full, or nothing may be written there.
    """
    part = file.with_name(f".{file.stem}.part{file.suffix}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        yield part
        part.replace(file)
    except Exception as error:
        if reason := _unwritable(error):
            raise InputError(
                f"{file.name} cannot be written: {reason}, or write elsewhere"
            ) from error
        raise
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def check_writable(file: Path) -> None:
    """Refuses a file that cannot be written, before the work that fills it.

    Raises:
        InputError: it is a folder, or its own folder cannot be made or written to.
    """
    folder = next(each for each in file.absolute().parents if each.exists())
    reason = ""
    if file.is_dir():
        reason = "it is a folder"
    elif not folder.is_dir():
        reason = f"{folder} is a file"
    elif not os.access(folder, os.W_OK | os.X_OK):
        reason = f"nothing can be written to {folder}"
    if reason:
        raise InputError(f"{file} cannot be written, for {reason}; give another file")


def _unwritable(error: Exception) -> str:
    """Returns why nothing can be written and what to do, if that is the trouble.

    The encoders of videos and of OpenEXR tell no error number, but its text.
    """
    number = error.errno if isinstance(error, OSError) else None
    if number in _NO_PLACE:
        return f"{error}; make it writable"
    for each in _NO_ROOM:
        if number == each or (number is None and os.strerror(each) in str(error)):
            return f"{os.strerror(each)}; free some room"
    return ""


def read_toml(file: Path, what: str) -> dict[str, Any]:
    """Reads a TOML file.

    Args:
        file: where from.
        what: what it is, for messages: "camera path".

    Raises:
        InputError: it cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{what} {file} cannot be read ({error.strerror}); give the name of an "
            "existing TOML file"
        ) from None
    except RecursionError:
        raise InputError(f"{what} {file} is nested too deeply") from None
    except ValueError as error:  # of TOML, or of UTF-8
        raise InputError(f"{what} {file} is not valid TOML: {error}") from None


def write_text(file: Path, text: str) -> None:
    """Writes UTF-8 text with Unix line ends."""
    with atomic(file) as part:
        part.write_bytes(text.encode("utf-8"))


def write_bytes(file: Path, data: bytes) -> None:
    """Writes bytes."""
    with atomic(file) as part:
        part.write_bytes(data)


def write_csv(
    file: Path, header: Sequence[str], rows: Iterable[Sequence[Cell]]
) -> None:
    """Writes a CSV table; numbers must come formatted where their digits matter."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_text(file, buffer.getvalue())


def png(image: np.ndarray | Image.Image) -> bytes:
    """Encodes 8-bit RGB, RGBA or grey as PNG, without any metadata."""
    picture = image if isinstance(image, Image.Image) else Image.fromarray(image)
    buffer = io.BytesIO()
    # Level 6 takes twice as long for 6 % of the size, level 9 eight times.
    picture.save(buffer, "PNG", compress_level=3)
    return buffer.getvalue()


def write_png(file: Path, image: np.ndarray | Image.Image) -> None:
    """Writes 8-bit RGB, RGBA or grey as PNG."""
    write_bytes(file, png(image))


def write_exr(file: Path, color: np.ndarray) -> None:
    """Writes linear radiance as a ZIP-compressed OpenEXR file.

    Args:
        file: where to.
        color: (h, w, 3), linear with the primaries of sRGB; stored as 32-bit floats.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {"RGB": np.ascontiguousarray(color, np.float32)}
    with atomic(file) as part, OpenEXR.File(header, channels) as image:
        image.write(str(part))


def write_video(file: Path, frames: Iterable[np.ndarray], fps: float) -> None:
    """Writes frames as H.264 in MP4, bit-exact for one version of the encoder.

    Odd sizes are padded by a row or a column of black, as 4:2:0 chroma asks for.

    Args:
        file: where to.
        frames: uint8 (h, w, 3), at least one, all of one size.
        fps: frames a second.
    """
    import imageio_ffmpeg

    iterator = iter(frames)
    first = next(iterator)
    size = f"{first.shape[1]}x{first.shape[0]}"
    # Not imageio_ffmpeg's own writer: it forks, which a process that runs JAX must not.
    with atomic(file) as part:
        command = [
            imageio_ffmpeg.get_ffmpeg_exe(),
            *("-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size),
            *("-r", f"{fps:g}", "-i", "-", "-an", "-c:v", "libx264", "-crf", "14"),
            *("-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2,format=yuv420p", "-threads", "1"),
            *("-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"),
            *("-movflags", "+faststart", str(part)),
        ]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, process_group=0
        ) as process:
            assert process.stdin is not None
            assert process.stderr is not None
            with suppress(BrokenPipeError), process.stdin as pipe:
                for frame in itertools.chain([first], iterator):
                    pipe.write(np.ascontiguousarray(frame).data)
            problem = process.stderr.read().decode(errors="replace").strip()
        if process.returncode:
            raise OSError(f"the video encoder failed: {problem}")


def decimals(value: float, digits: int) -> str:
    """Formats a number for a file: fixed digits, `nan` and `inf` as such, never −0."""
    text = f"{value:.{digits}f}"
    return text.lstrip("-") if float(text) == 0.0 else text
