"""Checks of motion, depth and jitter: which reading agrees with images and camera."""

from dataclasses import dataclass, field, replace

import numpy as np

from ataa_jax.capture import checks_depth, evidence
from ataa_jax.capture.conventions import Conventions, Depth
from ataa_jax.capture.evidence import Stills
from ataa_jax.capture.findings import ERROR, NOTE, WARNING, Finding

# our choice: photometric errors differ by a few percent from filtering alone; a wrong
# sign or unit at least doubles them where anything moves.
_WORSE = 1.15
_PARTS = {
    "motion_sign": "sign",
    "motion_y": "y",
    "motion_axes": "axes",
    "motion_unit": "unit",
}
_NAMES = {
    "motion_sign": "motion sign",
    "motion_y": "flipped y",
    "motion_axes": "swapped axes",
    "motion_unit": "motion unit",
}


@dataclass
class Motion:
    """What was found, and the conventions that hold."""

    conventions: Conventions
    findings: list[Finding] = field(default_factory=list)
    facts: list[tuple[str, str]] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class _Geometry:
    """The depth reading that predicts the motion best, and by which motion reading."""

    kind: Depth
    far: float | None  # None: as stored
    down: float
    expected: list[np.ndarray | None]
    reading: Conventions
    residual: float  # px
    declared: float  # px, of the declared depth under its best motion reading
    size: float  # px, median length of the predicted motion
    precision: float  # px, what the storage resolves
    told: bool  # another reading of depth would have predicted another motion

    @property
    def decisive(self) -> bool:
        """Returns whether camera and depth explain the motion."""
        # Jitter left inside moves the median by up to a pixel.
        return self.residual < 0.25 * self.size and self.size > 0.05


def check(stills: Stills) -> Motion:
    """Infers the reading, compares it with the declared one, then looks closer."""
    declared = stills.capture.conventions
    result = Motion(_filled(declared))
    if sum(1 for _ in stills.pairs()) == 0:
        text = "there are no two frames in sequence"
        result.findings.append(
            Finding(NOTE, "one frame", "", text, "capture at least two frames")
        )
        return result
    geometry = _geometry(stills)
    _reading(stills, geometry, result)
    if geometry is not None and geometry.decisive:
        _depth(stills, geometry, result)
        geometry = replace(geometry, reading=result.conventions)
        wrong = _jitter_in_motion(stills, geometry, result)
        if not wrong:
            _off_by_one(stills, geometry, result)
        _dropped(stills, geometry, result)
    else:
        _without_camera(stills, result, known=geometry is not None)
    checks_depth.depth_range(stills, result.findings)
    return result


def _filled(conventions: Conventions) -> Conventions:
    """Returns the conventions with the package's own where the layout says nothing."""
    own = Conventions()
    return replace(
        conventions,
        motion_sign=conventions.motion_sign or own.motion_sign,
        motion_y=conventions.motion_y or own.motion_y,
        camera_y=conventions.camera_y or own.camera_y,
    )


def _depth_candidates(stills: Stills) -> list[tuple[Depth, float | None]]:
    declared = stills.capture.conventions.depth
    found: list[tuple[Depth, float | None]] = [(declared, None)]
    if declared in ("device", "device reversed"):
        found.append((declared, float("inf")))
    others: tuple[Depth, ...] = ("linear", "distance", "device", "device reversed")
    for kind in others:
        if kind != declared:
            found.append((kind, None))
            if kind.startswith("device"):
                found.append((kind, float("inf")))
    return found


def _geometry(stills: Stills) -> _Geometry | None:
    """Tries every reading of depth and motion against the camera."""
    if all(still.meta.pose is None for still in stills.frames):
        return None
    base = stills.capture.conventions
    downs = {"up": (1.0,), "down": (-1.0,), None: (1.0, -1.0)}[base.camera_y]
    tried = []
    for rank, (kind, far) in enumerate(_depth_candidates(stills)):
        for down in downs:
            expected = evidence.predictions(stills, kind, far, down)
            if all(p is None for p in expected):
                return None
            for reading in evidence.readings(base):
                residual = evidence.residuals(stills, reading, expected)
                tried.append(
                    (
                        float(np.median(residual)),
                        rank,
                        kind,
                        far,
                        down,
                        expected,
                        reading,
                    )
                )
    least = min(t[0] for t in tried)
    precision = _precision(stills)
    own = min((t for t in tried if t[1] == 0), key=lambda t: t[0])
    # The declared depth is kept unless another explains the motion three times better.
    best = own
    if own[0] > 3.0 * least + precision:
        best = min(tried, key=lambda t: t[0])
    ranks = {t[1] for t in tried}
    each = [min(t[0] for t in tried if t[1] == rank) for rank in ranks]
    told = max(each) > 3.0 * least + precision
    residual, _, kind, far, down, expected, reading = best
    lengths = [np.linalg.norm(p, axis=-1) for p in expected if p is not None]
    size = float(np.nanmedian(np.concatenate(lengths)))
    return _Geometry(
        kind, far, down, expected, reading, residual, own[0], size, precision, told
    )


def _precision(stills: Stills) -> float:
    """Returns the error that the storage of the motion leaves, px.

    Half floats resolve 2⁻¹¹ of a value: a hundredth of a pixel of 20. What single
    floats leave comes from the engine's own arithmetic.
    """
    stored = np.concatenate([evidence.stored_motion(stills, s) for s in stills.frames])
    stored = stored[np.isfinite(stored)]
    half = np.array_equal(stored.astype(np.float16).astype(np.float64), stored)
    return 0.03 if half else 0.003


def _reading(stills: Stills, geometry: _Geometry | None, result: Motion) -> None:
    """Compares the declared sign, axes and unit with those that reproject best."""
    declared = stills.capture.conventions
    options = evidence.readings(declared)
    errors = {r: evidence.photometric(stills, r) for r in options}
    means = {r: float(np.mean(e)) for r, e in errors.items()}
    still = float(np.mean(evidence.photometric(stills, None)))
    fits = options
    if geometry is not None and geometry.decisive:
        rest = {
            r: float(np.median(evidence.residuals(stills, r, geometry.expected)))
            for r in options
        }
        limit = max(2.0 * geometry.residual, geometry.residual + geometry.precision)
        fits = [r for r in options if rest[r] <= limit]
    best = min(fits, key=lambda r: means[r])
    allowed = [r for r in options if _agrees(r, declared)]
    own = min(allowed, key=lambda r: (r not in fits, means[r]))
    result.facts += [
        ("reprojection error, no motion", f"{still:.2f} / 255"),
        ("reprojection error, as declared", f"{means[own]:.2f} / 255"),
        ("reprojection error, best reading", f"{means[best]:.2f} / 255"),
    ]
    if geometry is not None:
        result.facts += [
            ("motion of still things, median", f"{geometry.size:.3f} px"),
            ("its difference from the stored motion", f"{geometry.residual:.3f} px"),
        ]
        if not geometry.told:
            word = "not confirmed: a camera that stands or only turns tells nothing"
            result.facts.append(("depth", word))
    settled = own
    by_camera = own not in fits
    votes = np.mean(errors[own] > errors[best] * _WORSE)
    by_image = means[own] > _WORSE * means[best] and votes >= 0.75
    if by_camera or (by_image and means[best] < still):
        settled = best
        number = f"error {means[best]:.2f} against {means[own]:.2f} of 255"
        if by_camera and geometry is not None:
            number += f", camera and depth agree to {geometry.residual:.3f} px"
        _contradict(declared, own, best, number, result)
    elif _explains_nothing(stills, means[own], still):
        result.findings.append(
            Finding(
                WARNING,
                "motion explains nothing",
                "",
                f"along the motion vectors the previous frame differs by "
                f"{means[own]:.2f} / 255, without them by {still:.2f}",
                "check that moving objects and the camera write motion vectors",
            )
        )
    result.conventions = replace(
        result.conventions,
        motion_sign=settled.motion_sign,
        motion_y=settled.motion_y,
        motion_axes=settled.motion_axes,
        motion_unit=settled.motion_unit,
    )
    _say_inferred(declared, result)


def _explains_nothing(stills: Stills, moved: float, still: float) -> bool:
    """Returns whether the motion is no help; one sample a pixel is too noisy to say."""
    measurable = all(s.reference is not None for s in stills.frames)
    return measurable and moved > 0.98 * still and still > 4.0


def _agrees(reading: Conventions, declared: Conventions) -> bool:
    """Returns whether a reading is what was declared, where anything was."""
    return all(
        getattr(declared, name) in (None, getattr(reading, name)) for name in _PARTS
    )


def _contradict(
    declared: Conventions,
    own: Conventions,
    best: Conventions,
    number: str,
    result: Motion,
) -> None:
    for name, part in _PARTS.items():
        promised, seen = getattr(own, name), getattr(best, name)
        if promised == seen or getattr(declared, name) is None:
            continue
        label = _NAMES[name]
        if name == "motion_unit" and seen == "half px":
            label = "half-resolution motion"
        result.findings.append(
            Finding(
                ERROR,
                label,
                "",
                f"the metadata say {part} '{promised}', but '{seen}' reprojects best: "
                f"{number}",
                f'set {name} = "{seen}", or write the vectors as the metadata say',
            )
        )


def _say_inferred(declared: Conventions, result: Motion) -> None:
    for name, part in _PARTS.items():
        if getattr(declared, name) is None:
            value = getattr(result.conventions, name)
            result.facts.append((f"motion {part}, inferred", str(value)))


def _depth(stills: Stills, geometry: _Geometry, result: Motion) -> None:
    """Says when another reading of depth explains the motion better."""
    declared = stills.capture.conventions.depth
    if (geometry.kind, geometry.far) == (declared, None):
        return
    number = (
        f"camera and depth then predict the motion to {geometry.residual:.3f} px, "
        f"as declared to {geometry.declared:.3f} px"
    )
    seen = geometry.kind
    if geometry.kind == declared:
        name, remedy = "infinite far plane", "write far = inf (NSS: CameraFarPlane −1)"
        text = f"the far plane is infinite where {_far(stills)} was promised: {number}"
    elif {seen, declared} == {"device", "device reversed"}:
        name = "reversed depth"
        remedy = f'write depth = "{seen}" (NSS: ReverseZ), or store it the other way'
        text = f"depth is '{seen}' where '{declared}' was promised: {number}"
    else:
        name, remedy = "non-linear depth", f'write depth = "{seen}", or store it so'
        text = f"depth is '{seen}' where '{declared}' was promised: {number}"
    result.findings.append(Finding(ERROR, name, "", text, remedy))


def _far(stills: Stills) -> str:
    return f"one at {stills.frames[0].meta.far:g}"


def _changes(stills: Stills) -> list[np.ndarray]:
    whole = replace(stills.capture, first=0)
    return [
        np.zeros(2) if k == 0 else whole.jitter_change(k).astype(np.float64)
        for k in range(len(stills.frames))
    ]


def _jitter_in_motion(stills: Stills, geometry: _Geometry, result: Motion) -> bool:
    """Says when the stored motion follows the jitter, by camera and depth."""
    found = evidence.offsets(stills, geometry.reading, geometry.expected)
    changes = _changes(stills)
    pairs = [
        (f, c)
        for f, c in zip(found, changes, strict=True)
        if f is not None and np.linalg.norm(f) < 1.5  # more than any jitter's change
    ]
    if not pairs:
        return False
    k = evidence.slope([f for f, _ in pairs], [c for _, c in pairs])
    return _judge_jitter(stills, k, "by camera and depth", result)


def _judge_jitter(stills: Stills, k: float, how: str, result: Motion) -> bool:
    if np.isnan(k):
        return False
    result.facts.append(("share of the jitter inside the motion", f"{k:.2f} ({how})"))
    declared = stills.capture.conventions.motion_jittered
    if (abs(k) > 0.5) == declared:
        return False
    if declared:
        name, text = (
            "no jitter in motion",
            "the metadata say the motion holds the jitter",
        )
        remedy = "set motion_jittered = false"
    else:
        name, text = "jitter in motion", "the metadata say the motion is without jitter"
        remedy = (
            "set motion_jittered = true, or take the jitter out of both projections "
            "before the motion is computed"
        )
    text += f", but it follows the jitter's change by a factor of {k:.2f} ({how})"
    result.findings.append(Finding(ERROR, name, "", text, remedy))
    return True


def _off_by_one(stills: Stills, geometry: _Geometry, result: Motion) -> None:
    """Says when a neighbouring frame's motion fits this frame's camera better."""
    reading, expected = geometry.reading, geometry.expected
    own = float(np.median(evidence.residuals(stills, reading, expected)))
    for offset in (-1, 1):
        other = evidence.residuals(stills, reading, expected, offset)
        if other.size < 2:
            continue
        rest = float(np.median(other))
        if own > geometry.precision and rest < own / 3.0:
            word = "later" if offset > 0 else "earlier"
            result.findings.append(
                Finding(
                    ERROR,
                    "off by one frame",
                    "",
                    f"the motion belongs to another frame: that of one frame {word} "
                    f"agrees with the camera to {rest:.3f} px, its own to {own:.3f} px",
                    "store each frame's motion with that frame",
                )
            )
            return


def _dropped(stills: Stills, geometry: _Geometry, result: Motion) -> None:
    """Says where the camera went k times as far as the motion vectors do."""
    found = {}
    for number, p in enumerate(geometry.expected):
        if p is None:
            continue
        stored = evidence.stored_motion(stills, stills.frames[number])
        m = evidence.motion_px(stored, geometry.reading, stills.capture.size)
        use = np.linalg.norm(p, axis=-1) > 0.3
        if use.sum() >= 16:
            along = np.sum(m[use] * p[use], axis=-1) / np.sum(p[use] ** 2, axis=-1)
            found[number] = float(np.nanmedian(along))
    usual = float(np.median(list(found.values()))) if found else float("nan")
    for number, share in found.items():
        if len(found) >= 3 and 0.05 < share < 0.65 and usual > 0.8:
            frame = stills.frames[number].meta.number
            result.findings.append(
                Finding(
                    ERROR,
                    "dropped frame",
                    f"before frame {frame}",
                    f"the motion spans {share:.2f} of the camera's step since the "
                    f"frame before; {1.0 / share - 1.0:.0f} are missing",
                    "capture the sequence again, or mark this frame as a cut",
                )
            )


def _without_camera(stills: Stills, result: Motion, *, known: bool) -> None:
    """The same questions by the images alone, where the camera does not help."""
    if known:
        text = "camera and depth do not predict the motion under any reading"
        moved = any(f.severity == ERROR for f in result.findings)
        whole = evidence.photometric(stills, result.conventions)
        still = evidence.photometric(stills, None)
        if not moved and np.mean(still) > 1.5 * np.mean(whole):
            result.findings.append(
                Finding(
                    WARNING,
                    "camera disagrees",
                    "",
                    text,
                    "check view matrix, field of view and depth; antialiasing needs "
                    "only the motion, but depth steers the mask",
                )
            )
    found, changes = [], []
    # One sample a pixel is too noisy to show a shift of a fraction of a pixel.
    jittered = any(still.reference is None for still in stills.frames)
    for then, now in stills.pairs():
        stored = evidence.stored_motion(stills, now)
        m = evidence.motion_px(stored, result.conventions, stills.capture.size)
        s = evidence.shift(
            then.luma, now.luma, stills.x, stills.y, m.astype(np.float64)
        )
        j_now = np.asarray(now.meta.jitter or (0.0, 0.0))
        j_then = np.asarray(then.meta.jitter or (0.0, 0.0))
        change = j_now - j_then
        found.append(-s)
        changes.append(change)
    if not jittered:
        _judge_jitter(stills, evidence.slope(found, changes), "by the images", result)
    own = evidence.photometric(stills, result.conventions)
    for offset in (-1, 1):
        other = evidence.photometric(stills, result.conventions, offset)
        count = min(own.size, other.size)
        if count >= 2 and own[:count].mean() > 1.25 * other[:count].mean():
            result.findings.append(
                Finding(
                    ERROR,
                    "off by one frame",
                    "",
                    f"the motion of the frame {'after' if offset > 0 else 'before'} "
                    f"reprojects better: {other.mean():.2f} against {own.mean():.2f} "
                    "of 255",
                    "store each frame's motion with that frame",
                )
            )
            break
