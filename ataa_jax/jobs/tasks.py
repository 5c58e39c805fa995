"""What workers are asked for: frames of a sequence, by the cache files they fill.

A task holds no arrays: a worker loads the scene itself. The name of a frame's file in
the cache is a hash of all that decides the frame, so a worker whose name for it is not
the one that is asked for would render something else, and refuses.
"""

import socket
import threading
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from ataa_jax import cache as caches
from ataa_jax import color as colors
from ataa_jax import effects, paths, programs, reference
from ataa_jax import world as worlds
from ataa_jax.errors import InputError
from ataa_jax.fit import recording
from ataa_jax.world import Sequence


@dataclass(frozen=True)
class References:
    """Supersampled references, see `reference.reference`."""

    samples: int
    average: colors.Average = "tonemap"
    limit_bytes: int = reference.CACHE_LIMIT_BYTES  # what the cache keeps of them

    def file(self, shot: Sequence, frame: int) -> Path:
        """Returns where the cache keeps a frame's."""
        return reference.cache_file(shot, frame, self.samples, self.average)

    def render(self, shot: Sequence, frame: int) -> None:
        """Puts a frame's into the cache."""
        reference.reference(shot, frame, self.samples, average=self.average)


@dataclass(frozen=True)
class Records:
    """Records of frames for a fit, see `fit.record`; frames count from −`lead_in`."""

    lead_in: int
    samples: int
    reference_samples: int
    preset: str = "tuned"
    limit_bytes: int = recording.CACHE_LIMIT_BYTES  # what the cache keeps of them

    def file(self, shot: Sequence, frame: int) -> Path:
        """Returns where the cache keeps a frame's."""
        return self._recorder(shot).cache_file(frame)

    def render(self, shot: Sequence, frame: int) -> None:
        """Puts a frame's into the cache."""
        self._recorder(shot).record(frame)

    def _recorder(self, shot: Sequence) -> recording.Recorder:
        return recording.Recorder.of(
            shot,
            lead_in=self.lead_in,
            samples=self.samples,
            reference_samples=self.reference_samples,
            preset=self.preset,
        )


@dataclass(frozen=True)
class View:
    """What another process needs to load a sequence, and to know it for the same."""

    scene: str  # `builtin`, or the absolute name of a file
    path: paths.CameraPath
    size: tuple[int, int]  # height, width
    wish: effects.Wish
    content_hash: str  # of the world
    code: str  # the package's sources, and the versions of what computes
    processor: str  # see `programs.vectors`


@dataclass(frozen=True)
class Task:
    """Frames of one sequence."""

    view: View
    what: References | Records
    frames: tuple[int, ...]
    names: tuple[str, ...]  # a file a frame, relative to the cache folder

    def part(self, chosen: slice) -> "Task":
        """Returns the task of some of the frames."""
        return replace(self, frames=self.frames[chosen], names=self.names[chosen])

    def __str__(self) -> str:
        first, last = self.frames[0], self.frames[-1]
        which = f"frame {first}" if first == last else f"frames {first} to {last}"
        return f"{which} of {self.view.scene}"


def task(scene: str, shot: Sequence, what: References | Records, frames: range) -> Task:
    """Returns the task of rendering frames of a sequence.

    Args:
        scene: what the sequence's world was loaded from, see `world.load`.
        shot: the sequence.
        what: is rendered of each frame.
        frames: their indices.
    """
    names = [what.file(shot, frame) for frame in frames]
    return Task(
        view=View(
            scene=scene if scene == worlds.BUILTIN else str(Path(scene).resolve()),
            path=shot.path,
            size=shot.size,
            wish=shot.world.wish,
            content_hash=shot.world.content_hash,
            code=caches.package_hash(),
            processor=programs.vectors(),
        ),
        what=what,
        frames=tuple(frames),
        names=tuple(x.relative_to(caches.folder()).as_posix() for x in names),
    )


def missing(wanted: Task) -> Task:
    """Returns the task of the frames that the cache lacks."""
    lacking = [
        (frame, name)
        for frame, name in zip(wanted.frames, wanted.names, strict=True)
        if not (caches.folder() / name).is_file()
    ]
    return replace(
        wanted,
        frames=tuple(frame for frame, _ in lacking),
        names=tuple(name for _, name in lacking),
    )


_one_at_a_time = threading.Lock()  # a frame takes all threads that a process may use


def perform(given: Task) -> None:
    """Renders a task's frames into this process's cache; those it has, it keeps.

    The world that was rendered last is kept for the next task.

    Raises:
        InputError: what this process would render is not what was asked for, or the
            scene cannot be read here.
        OSError: the cache cannot be written.
    """
    with _one_at_a_time:
        _check_computer(given.view)
        shot = _load(given.view)
        here = shot.world.content_hash
        for frame, name in zip(given.frames, given.names, strict=True):
            file = given.what.file(shot, frame)
            if file != caches.folder() / name:
                same = here == given.view.content_hash
                raise InputError(
                    f"{_where()} {given.view.scene} "
                    + ("moves otherwise" if same else "holds another scene")
                    + " than here; copy the same files there"
                )
            given.what.render(shot, frame)
            if not file.is_file():
                raise OSError(f"{_where()} nothing can be written to {file.parent}")


def send(given: Task) -> dict[str, bytes]:
    """Performs a task and returns its files by name; errors as of `perform`."""
    perform(given)
    return {name: (caches.folder() / name).read_bytes() for name in given.names}


def receive(given: Task, files: dict[str, bytes]) -> None:
    """Puts the files of a task, rendered elsewhere, into this process's cache.

    Raises:
        InputError: they are not exactly those that the task names.
    """
    if files.keys() != set(given.names):
        odd = sorted(files.keys() ^ set(given.names))[0]
        raise InputError(
            f"a worker answered {given} with other files than were asked for, '{odd}' "
            "among them; use only workers that you trust"
        )
    for name in given.names:
        caches.store(caches.folder() / name, files[name], given.what.limit_bytes)


def _check_computer(wanted: View) -> None:
    """Refuses a view that was made by another program or another kind of machine."""
    if wanted.code != caches.package_hash():
        raise InputError(
            f"{_where()} another version of ataa_jax, JAX or NumPy is installed than "
            "here; install the same in both places"
        )
    if wanted.processor != programs.vectors():
        raise InputError(
            f"{_where()} the processor is of another kind than here, and the last bits "
            "of results would differ; use workers of one kind"
        )


@lru_cache(maxsize=1)  # sequences come one after the other
def _load(wanted: View) -> Sequence:
    world = worlds.load(
        wanted.scene, camera=wanted.path.camera, size=wanted.size, wish=wanted.wish
    )
    return worlds.sequence(world, wanted.path, wanted.size)


def _where() -> str:
    return f"on worker {socket.gethostname()}"
