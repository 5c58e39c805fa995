"""A look at depth's values alone, where the camera cannot tell what they are."""

import numpy as np

from ataa_jax.capture.evidence import Stills
from ataa_jax.capture.findings import ERROR, WARNING, Finding


def depth_range(stills: Stills, findings: list[Finding]) -> None:
    """Looks at the values where the camera could not tell."""
    if any(f.name.endswith("depth") for f in findings):
        return
    depth = np.concatenate([s.depth[stills.y, stills.x] for s in stills.frames])
    finite = depth[np.isfinite(depth)]
    if finite.size == 0:
        return
    kind = stills.capture.conventions.depth
    if kind in ("linear", "distance"):
        share = float(np.mean((finite >= 0.0) & (finite <= 1.0)))
        if share > 0.999 and float(np.mean(finite < 0.0)) == 0.0:
            findings.append(
                Finding(
                    WARNING,
                    "non-linear depth",
                    "",
                    f"depth was promised {kind}, but all values lie in [0, 1], as a "
                    "device's do",
                    'write depth = "device" or "device reversed" with near and far, '
                    "unless the whole scene is nearer than one unit",
                )
            )
        elif float(np.mean(finite < 0.0)) > 0.01:
            findings.append(
                Finding(
                    ERROR,
                    "negative depth",
                    "",
                    f"{np.mean(finite < 0.0):.0%} of the depths are negative",
                    "store the distance along the view axis, positive in front",
                )
            )
        return
    outside = float(np.mean((finite < -1e-3) | (finite > 1.001)))
    if outside > 0.001:
        findings.append(
            Finding(
                ERROR,
                "linear depth",
                "",
                f"depth was promised '{kind}', but {outside:.0%} of the values lie "
                "outside [0, 1]",
                'write depth = "linear"',
            )
        )
    else:
        _clustered(kind, finite, findings)


def _clustered(kind: str, finite: np.ndarray, findings: list[Finding]) -> None:
    """Surfaces lie near the far end of a device's depth, all but the nearest ones."""
    inner = finite[(finite > 0.0) & (finite < 1.0)]
    if inner.size == 0:
        return
    middle = float(np.median(inner))
    reversed_ = middle < 0.2
    if reversed_ != (kind == "device reversed") and (middle < 0.2 or middle > 0.8):
        seen = "device reversed" if reversed_ else "device"
        findings.append(
            Finding(
                WARNING,
                "reversed depth",
                "",
                f"depth was promised '{kind}', but the median of its values is "
                f"{middle:.3f}, as '{seen}' has it",
                f'write depth = "{seen}" (NSS: ReverseZ)',
            )
        )
