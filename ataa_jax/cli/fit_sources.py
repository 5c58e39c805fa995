"""What `ataa fit` is given to fit to: scenes along camera paths, and captures.

As in `cli`: JAX is imported inside. Captures are read and checked first: they fix the
size and the rays a traced pixel of everything that is rendered beside them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ataa_jax import capture_commands
from ataa_jax.cli.terminal import Report
from ataa_jax.errors import InputError

if TYPE_CHECKING:
    from ataa_jax import world
    from ataa_jax.capture import Capture
    from ataa_jax.fit import Recording
    from ataa_jax.jobs import Crew

SIZE, REFERENCE_SAMPLES = (180, 320), 64


@dataclass(frozen=True)
class Asked:
    """The options that decide recordings; None: not given."""

    size: tuple[int, int] | None  # height, width
    motion: str | None
    frames: int
    lead_in: int
    reference_samples: int | None


@dataclass(frozen=True)
class Plan:
    """What will be recorded, and how."""

    texts: tuple[str, ...]  # as given, what is held out last
    captures: dict[str, tuple["Capture", int]]  # by text; with the frames to score
    asked: Asked
    size: tuple[int, int]
    samples: int  # rays a traced pixel

    @property
    def steps(self) -> int:
        """Frames to record in all."""
        rendered = self.asked.frames + self.asked.lead_in
        each = (self.captures.get(text) for text in self.texts)
        return sum(c[1] + c[0].first if c else rendered for c in each)

    @property
    def renders(self) -> bool:
        """Whether any scene is among what is given."""
        return len(self.captures) < len(set(self.texts))


def plan(
    texts: tuple[str, ...],
    asked: Asked,
    report: Callable[[str], None] = lambda text: None,
) -> Plan:
    """Reads and checks the captures among what is given, before anything is rendered.

    Args:
        texts: scenes with their paths, and folders of captures.
        asked: the options.
        report: told which capture is looked at.

    Raises:
        InputError: a capture that is none, contradicts itself or has no reference; one
            of another size than the others or `--size`; or options that none of what
            is given can take.
    """
    size, captures = asked.size, {}
    for text in dict.fromkeys(texts):
        if not _captured(text):
            continue
        report(f"checking {text}")
        captures[text] = _believed(text, asked)
    if len(captures) == len(set(texts)):
        _refuse_options(asked)
    samples = 8
    if captures:
        from ataa_jax import fit as fits

        size = _common_size(captures, size)
        samples = fits.rays_of([capture for capture, _ in captures.values()])
    return Plan(
        texts=texts,
        captures=captures,
        asked=asked,
        size=size or SIZE,
        samples=samples,
    )


def record(
    planned: Plan, report: Report, crew: "Crew | None" = None
) -> Iterator[tuple["Recording", str]]:
    """Records one after the other.

    Args:
        planned: what.
        report: told of every frame.
        crew: workers that render the frames of scenes beforehand.

    Yields:
        (Recording, hash of its content); no two of one name.
    """
    done, total = 0, planned.steps

    def step(text: str) -> None:
        nonlocal done
        done += 1
        report(text, done, total)

    taken: dict[str, int] = {}
    for text in planned.texts:
        report(f"loading {text}", done, total)
        captured = planned.captures.get(text)
        if captured is None:
            made, content = _rendered(text, planned, step, crew)
        else:
            made, content = _read(*captured, planned, step)
        taken[made.name] = taken.get(made.name, 0) + 1
        if taken[made.name] > 1:  # files of one name in two folders
            made = replace(made, name=f"{made.name} ({taken[made.name]})")
        yield made, content


def _captured(text: str) -> bool:
    """Returns whether a text names a capture.

    Raises:
        InputError: it does, and a camera path with it.
    """
    if capture_commands.given(text):
        return True
    place, at, path = text.rpartition("@")
    if at and capture_commands.given(place):
        raise InputError(
            f"a capture has its own camera; leave out '@{path}' after {place}"
        )
    return False


def _believed(text: str, asked: Asked) -> tuple["Capture", int]:
    found, frames = capture_commands.believed(text, asked.frames, asked.lead_in)
    capture = replace(found.capture, notes=capture_commands.told(found))
    if capture.reference_samples is None:
        raise InputError(
            f"capture {text} has no reference to fit against; capture one, or fit to "
            "another"
        )
    return capture, frames


def _refuse_options(asked: Asked) -> None:
    """Refuses what only a scene could heed."""
    if asked.motion is not None:
        raise InputError("a capture has its own camera; leave out --motion")
    if asked.reference_samples is not None:
        raise InputError("a capture has its own reference; leave out "
                         "--reference-samples")  # fmt: skip


def _common_size(
    captures: dict[str, tuple["Capture", int]], size: tuple[int, int] | None
) -> tuple[int, int]:
    """Returns the captures' one size, which must be that of `--size`, if given."""
    wanted, who = size, "--size asks for"
    for text, (capture, _) in captures.items():
        if wanted is None:
            wanted, who = capture.size, f"{text} has"
        elif capture.size != wanted:
            (h, w), (height, width) = capture.size, wanted
            raise InputError(
                f"capture {text} has {w}x{h} pixels where {who} {width}x{height}; fit "
                "to captures of one size, and leave out --size: scenes beside them "
                "are rendered at theirs"
            )
    assert wanted is not None
    return wanted


def _read(
    capture: "Capture", frames: int, planned: Plan, step: Callable[[str], None]
) -> tuple["Recording", str]:
    from ataa_jax import cache
    from ataa_jax import fit as fits

    made = fits.record_capture(
        capture, frames=frames, samples=planned.samples, progress=step
    )
    return made, cache.content_hash(made.frames)


def _rendered(
    text: str, planned: Plan, step: Callable[[str], None], crew: "Crew | None"
) -> tuple["Recording", str]:
    from ataa_jax import fit as fits
    from ataa_jax import paths
    from ataa_jax import world as worlds

    asked = planned.asked
    scene, _, camera = text.partition("@")
    source = worlds.read(scene, planned.size)
    known = [each.name for each in source.cameras]
    path = paths.load(camera or "walk", asked.motion, known)
    world = worlds.prepare(source, camera=path.camera, size=planned.size)
    shot = worlds.sequence(world, path, planned.size)
    samples = asked.reference_samples or REFERENCE_SAMPLES
    if crew is not None:
        _beforehand(crew, scene, shot, planned, samples, step)
    made = fits.record(
        shot,
        frames=asked.frames,
        lead_in=asked.lead_in,
        samples=planned.samples,
        reference_samples=samples,
        progress=step if crew is None else lambda text: None,
    )
    return made, world.content_hash


def _beforehand(
    crew: "Crew",
    scene: str,
    shot: "world.Sequence",
    planned: Plan,
    reference_samples: int,
    step: Callable[[str], None],
) -> None:
    """Has workers render what a recording reads."""
    from ataa_jax import jobs

    asked = planned.asked
    what = jobs.Records(
        lead_in=asked.lead_in,
        samples=planned.samples,
        reference_samples=reference_samples,
    )
    told = 0

    def progress(done: int, total: int) -> None:
        nonlocal told
        for frame in range(told, done):
            step(f"recording {shot.world.name}, {frame + 1} of {total} frames")
        told = done

    frames = range(-asked.lead_in, asked.frames)
    jobs.fill(crew, jobs.task(scene, shot, what, frames), progress)
