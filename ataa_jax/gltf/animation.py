"""Animation of node transforms (glTF 2.0, section 3.11 and appendix C)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ataa_jax.gltf import accessors
from ataa_jax.gltf.container import Container, short

_PATHS = {"translation": "VEC3", "rotation": "VEC4", "scale": "VEC3"}


@dataclass(frozen=True)
class Pose:
    """Translation, rotation (x, y, z, w) and scale of a node."""

    translation: np.ndarray  # float64 (3,)
    rotation: np.ndarray  # float64 (4,), unit
    scale: np.ndarray  # float64 (3,)

    def matrix(self) -> np.ndarray:
        """Returns parent_from_local, float64 (4, 4)."""
        x, y, z, w = self.rotation
        result = np.eye(4)
        result[:3, :3] = self.scale * np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        result[:3, 3] = self.translation
        return result


@dataclass(frozen=True)
class Channel:
    """One animated property of one node."""

    path: str  # translation, rotation or scale
    interpolation: str  # STEP, LINEAR or CUBICSPLINE
    times: np.ndarray  # float64 (k,), seconds
    values: np.ndarray  # float64 (k, c); CUBICSPLINE: (k, 3, c), in, value, out

    def is_constant(self) -> bool:
        """Whether the property keeps one value, up to float32 rounding."""
        values = self.values
        if self.interpolation == "CUBICSPLINE":
            values = values[:, 1]
            if len(values) > 1 and self.values[:, [0, 2]].any():
                return False
        spread = np.ptp(values, axis=0).max()
        return bool(spread <= 1e-6 * np.abs(values).max())

    def sample(self, time: float) -> np.ndarray:
        """Returns the value at `time`, held before the first and after the last key."""
        k = int(np.searchsorted(self.times, time, side="right")) - 1
        cubic = self.interpolation == "CUBICSPLINE"
        keys = self.values[:, 1] if cubic else self.values
        if k < 0 or k >= len(keys) - 1 or self.interpolation == "STEP":
            return self._proper(keys[max(k, 0)])
        step = self.times[k + 1] - self.times[k]
        s = (time - self.times[k]) / step  # step > 0: equal keys are never straddled
        if cubic:
            # Appendix C.5: a Hermite spline whose tangents are per second.
            s2, s3 = s * s, s * s * s
            value = (
                (2 * s3 - 3 * s2 + 1) * keys[k]
                + (s3 - 2 * s2 + s) * step * self.values[k, 2]
                + (3 * s2 - 2 * s3) * keys[k + 1]
                + (s3 - s2) * step * self.values[k + 1, 0]
            )
            return self._proper(value)
        if self.path == "rotation":
            return _slerp(keys[k], keys[k + 1], s)
        return (1 - s) * keys[k] + s * keys[k + 1]

    def _proper(self, value: np.ndarray) -> np.ndarray:
        return unit_quaternion(value) if self.path == "rotation" else value


def unit_quaternion(value: np.ndarray) -> np.ndarray:
    """Returns a quaternion of length 1; zero becomes no rotation."""
    length = np.linalg.norm(value)
    if not 1e-12 < length < np.inf:
        return np.array([0.0, 0.0, 0.0, 1.0])
    return value / length


def _slerp(a: np.ndarray, b: np.ndarray, s: float) -> np.ndarray:
    """Interpolates along the shorter arc (appendix C.4)."""
    a, b = unit_quaternion(a), unit_quaternion(b)
    cosine = float(a @ b)
    if cosine < 0:
        b, cosine = -b, -cosine
    if cosine > 1 - 1e-9:  # the sines below vanish; the chord equals the arc
        return unit_quaternion((1 - s) * a + s * b)
    angle = np.arccos(cosine)
    return (np.sin((1 - s) * angle) * a + np.sin(s * angle) * b) / np.sin(angle)


@dataclass(frozen=True)
class Animation:
    """The channels that are played, by node."""

    channels: dict[int, list[Channel]]
    duration: float  # seconds, the last key of all

    def pose(self, node: int, rest: Pose, time: float) -> Pose:
        """Returns a node's pose at `time`; what no channel drives stays at rest."""
        values = {c.path: c.sample(time) for c in self.channels.get(node, [])}
        return Pose(
            values.get("translation", rest.translation),
            values.get("rotation", rest.rotation),
            values.get("scale", rest.scale),
        )

    def moves(self, node: int) -> bool:
        """Whether any channel changes the node's own transform."""
        return self.duration > 0 and any(
            not c.is_constant() for c in self.channels.get(node, [])
        )


def read_animation(container: Container) -> Animation:
    """Reads all animations and plays them together, from the same start.

    Exporters write one animation an object, or several takes of the same objects. An
    animation that drives a property which an earlier one drives is another take, and
    is left out with a warning.
    """
    channels: dict[int, list[Channel]] = {}
    taken: set[tuple[int, str]] = set()
    duration = 0.0
    skipped = []
    for index, record in enumerate(container.items("animations")):
        where = f"animations[{index}]"
        found = _channels(container, record, where)
        keys = [(node, channel.path) for node, channel in found]
        if len(set(keys)) < len(keys):
            raise container.fail(
                f"{where} drives the same property of a node twice; re-export the file"
            )
        if taken.intersection(keys):
            skipped.append(container.string(record, "name", where) or where)
            continue
        taken.update(keys)
        for node, channel in found:
            channels.setdefault(node, []).append(channel)
            duration = max(duration, float(channel.times[-1]))
    if skipped:
        container.warn(
            "animations that move the same nodes as an earlier one are not played: "
            + ", ".join(skipped)
        )
    return Animation(channels, duration)


def _channels(
    container: Container, record: dict[str, Any], where: str
) -> list[tuple[int, Channel]]:
    samplers = container.records(record, "samplers", where)
    nodes = container.items("nodes")
    cache: dict[tuple[int, str], tuple[str, np.ndarray, np.ndarray]] = {}
    result = []
    for index, channel in enumerate(container.records(record, "channels", where)):
        at = f"{where}.channels[{index}]"
        target = container.table(channel, "target", at)
        path = container.string(target, "path", f"{at}.target")
        if path not in _PATHS:
            container.warn(f"animation of {short(path)} is ignored")
            continue
        if "node" not in target:
            continue  # "the channel SHOULD be ignored"
        node = container.check_index(
            target["node"], len(nodes), f"{at} refers to nodes[{short(target['node'])}]"
        )
        if "matrix" in nodes[node]:
            container.warn(
                f"nodes[{node}] has a matrix, which cannot be animated; its animation "
                "is ignored"
            )
            continue
        sampler = container.check_index(
            channel.get("sampler"),
            len(samplers),
            f"{at} refers to samplers[{short(channel.get('sampler'))}]",
        )
        key = (sampler, path)
        if key not in cache:
            cache[key] = _sampler(
                container, samplers[sampler], path, f"{where}.samplers[{sampler}]"
            )
        result.append((node, Channel(path, *cache[key])))
    return result


def _sampler(
    container: Container, record: dict[str, Any], path: str, where: str
) -> tuple[str, np.ndarray, np.ndarray]:
    """Returns interpolation, times and values."""
    interpolation = container.string(record, "interpolation", where, "LINEAR")
    if interpolation not in ("STEP", "LINEAR", "CUBICSPLINE"):
        raise container.fail(
            f"{where}.interpolation is {short(interpolation)}, but must be STEP, "
            "LINEAR or CUBICSPLINE; re-export the file"
        )
    times = accessors.read_finite(
        container, record.get("input"), f"{where}.input", ("SCALAR",)
    ).astype(np.float64)
    if times[0] < 0 or (np.diff(times) < 0).any():
        raise container.fail(
            f"{where}.input must hold times that start at 0 or later and increase; "
            "re-export the file"
        )
    values = accessors.read_finite(
        container, record.get("output"), f"{where}.output", (_PATHS[path],)
    ).astype(np.float64)
    a_key = 3 if interpolation == "CUBICSPLINE" else 1
    if len(values) != a_key * len(times):
        raise container.fail(
            f"{where}.output holds {len(values)} values for {len(times)} keys, but "
            f"{interpolation} needs {a_key * len(times)}; re-export the file"
        )
    if a_key == 3:
        values = values.reshape(len(times), 3, -1)
    return interpolation, times, values
