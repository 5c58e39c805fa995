"""A capture is checked before it is believed: what contradicts it, and how to mend it.

Every finding names what was promised, what the images say, a number, and a remedy. An
*error* contradicts the metadata, and no frame is computed from it; a *warning* tells
what may be as it should; a *note* what nobody can tell.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from ataa_jax.capture import (
    checks_frames,
    checks_images,
    checks_motion,
    disocclusion,
    evidence,
    exr,
)
from ataa_jax.capture.findings import ERROR, NOTE, WARNING, Finding
from ataa_jax.capture.record import Capture
from ataa_jax.errors import InputError

__all__ = ["ERROR", "NOTE", "WARNING", "Finding", "Report", "check", "refuse"]


@dataclass(frozen=True)
class Report:
    """All findings, and the conventions by which the capture is read."""

    capture: Capture  # with what its layout left open filled in
    findings: list[Finding]
    facts: list[tuple[str, str]]  # what was measured, name and value

    @property
    def errors(self) -> list[Finding]:
        """Returns what forbids to go on."""
        return [finding for finding in self.findings if finding.severity == ERROR]


def check(
    capture: Capture,
    *,
    progress: Callable[[str, int, int], None] = lambda text, done, total: None,
) -> Report:
    """Looks for contradictions between a capture's metadata and its images.

    Args:
        capture: what to look at.
        progress: told what is done.

    Returns:
        The report; its capture has motion sign and orientation filled in where the
        layout does not state them.
    """
    progress("looking at the files", 0, 3)
    findings = [*capture.contradictions, *_files(capture)]
    if any(finding.severity == ERROR for finding in findings):
        return Report(capture, findings, [])
    progress("reading the frames", 1, 3)
    try:
        findings += checks_frames.check(capture)
        stills = evidence.gather(capture)
    except InputError as error:
        remedy = "capture the frame again"
        found = Finding(ERROR, "damaged file", "", str(error), remedy)
        return Report(capture, [*findings, found], [])
    progress("measuring motion", 2, 3)
    stills, facts = checks_images.settle_jitter(stills)
    capture = stills.capture
    findings += checks_images.check(stills)
    motion = checks_motion.check(stills)
    settled = replace(capture, conventions=motion.conventions)
    findings = _without_echoes([*findings, *motion.findings])
    facts = [*facts, *motion.facts]
    if not any(finding.severity == ERROR for finding in findings):
        new, told = disocclusion.check(settled)
        findings, facts = [*findings, *new], [*facts, *told]
    return Report(settled, findings, facts)


# What else a mistake may look like: a wrong jitter bends the predicted motion a little,
# and a frozen frame does not show its own jitter.
_ECHOES = {
    "jitter sign": {"off by one frame"},
    "missing jitter": {"off by one frame"},
    "frozen frame": {"jitter sign", "missing jitter", "off by one frame"},
}


def _without_echoes(found: list[Finding]) -> list[Finding]:
    """Leaves out what only follows from another finding."""
    echoes = set().union(*(_ECHOES.get(finding.name, set()) for finding in found))
    return [finding for finding in found if finding.name not in echoes]


def refuse(report: Report) -> None:
    """Stops at errors.

    Raises:
        InputError: names the first, and how many more there are.
    """
    if not report.errors:
        return
    first, rest = report.errors[0], len(report.errors) - 1
    more = f" (and {rest} more; 'ataa check' lists all)" if rest else ""
    raise InputError(f"capture {report.capture.folder}: {first.sentence}{more}")


def _files(capture: Capture) -> list[Finding]:
    """Looks at every file's header: missing ones, and changes of size."""
    findings = []
    for index, frame in enumerate(capture.frames):
        where = f"frame {frame.number}"
        for kind, layer in frame.layers.items():
            ratio = capture.reference_ratio if kind == "reference" else 1
            expected = (capture.size[0] * ratio, capture.size[1] * ratio)
            try:
                file = exr.inside(capture.folder, layer.file)
                if not file.is_file():
                    findings.append(_missing(where, layer.file))
                    break
                seen = exr.look(file)[0].size
            except InputError as error:
                findings.append(
                    Finding(
                        ERROR, "damaged file", where, str(error), "capture it again"
                    )
                )
                break
            if seen != expected:
                findings.append(_resized(where, kind, seen, expected, first=index == 0))
                break
    return findings


def _missing(where: str, file: str) -> Finding:
    return Finding(
        ERROR,
        "dropped frame",
        where,
        f"{file} is missing",
        "capture the sequence again, or take the frame out of the metadata and mark "
        "the one after it as a cut",
    )


def _resized(
    where: str,
    kind: str,
    seen: tuple[int, int],
    expected: tuple[int, int],
    *,
    first: bool,
) -> Finding:
    half = seen[0] * 2 == expected[0] and seen[1] * 2 == expected[1]
    text = (
        f"{kind} is {seen[1]}×{seen[0]} pixels where {expected[1]}×{expected[0]} were "
        "promised"
    )
    if kind == "motion" and half:
        return Finding(
            ERROR,
            "half-resolution motion",
            where,
            text,
            "write motion vectors at the colour's resolution, one a pixel",
        )
    return Finding(
        ERROR,
        "wrong resolution" if first else "resolution change",
        where,
        text,
        "turn dynamic resolution off and capture all images of all frames at one size",
    )
