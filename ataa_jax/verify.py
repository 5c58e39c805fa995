"""Golden sequences: small ones kept with the package, rendered anew and compared.

Three short sequences of ATAA 8x at 96×54 call for most of what the package does: the
built-in garden house on a walk, wires thinner than a pixel, a reflection that moves in
a mirror. `golden/golden.toml` tells by which command, versions and processor they were
rendered; `experiments/golden.py` renders them.
"""

import hashlib
import io
import platform
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata, resources
from pathlib import Path

import jax
import numpy as np

from ataa_jax import cache, files, paths, pipeline, sampling, segmentation
from ataa_jax import world as worlds
from ataa_jax.builtin import failures

SIZE = (54, 96)
FRAMES = 6
# Golden name → what is rendered; a letter is a case of `builtin.failures`.
SEQUENCES = {"garden-house": "builtin", "wires": "d", "moving-reflection": "h"}
PACKAGES = ("ataa-jax", "jax", "jaxlib", "numpy", "embreex", "numba", "scikit-image")

# Another instruction set rounds otherwise. Where a score lies within the last bits of
# the threshold or of the budget's last place, a pixel changes its method, and with it
# its colour. AVX2 gave the same bits as AVX-512, SSE4.2 (no fused multiply-add) steps
# of 1/255 and the same methods. our choice: one pixel in a thousand may differ by more.
CHANGED = 0.001  # of the pixels, by more than one 8-bit step
OTHER_METHOD = 0.001  # of the pixels


@dataclass(frozen=True)
class Rendered:
    """A sequence's frames."""

    image: np.ndarray  # uint8 (frames, h, w, 3), sRGB
    method: np.ndarray  # uint8 (frames, h, w), METHOD_*
    digest: str  # of the float images and the packed masks


@dataclass(frozen=True)
class Difference:
    """How a sequence rendered here differs from the golden one."""

    name: str
    same_bits: bool
    largest: int  # of all channels, in 8-bit steps
    changed: float  # share of pixels that differ by more than one step
    other_method: float  # share of pixels that another method drew

    @property
    def holds(self) -> bool:
        """Whether the difference is within the stated tolerance."""
        return self.changed <= CHANGED and self.other_method <= OTHER_METHOD


def render(name: str) -> Rendered:
    """Renders one of `SEQUENCES` with the default preset."""
    what = SEQUENCES[name]
    if what == worlds.BUILTIN:
        world = worlds.load(what, size=SIZE)
        path = paths.load("walk")
    else:
        case = failures.case(what)
        world, path = worlds.prepare(case.build(), size=SIZE), case.path
    shot = worlds.sequence(world, path, SIZE)
    config, params = pipeline.preset(
        "tuned", world.scene, SIZE, samples=8, selection=shot.effects
    )
    jitter = sampling.halton_jitter(
        config.taa.jitter_length, centred=config.taa.jitter_centred
    )
    state = pipeline.init(SIZE)
    digest = hashlib.sha256()
    images, methods = [], []
    for index in range(FRAMES):
        output, state = pipeline.stages(
            state, shot.inputs(index, jitter[index]), params,
            scene=world.scene, tracer=world.tracer, config=config,
        )  # fmt: skip
        image, mask = np.asarray(output.image), np.asarray(output.segmentation.mask)
        digest.update(image.tobytes() + mask.tobytes())
        images.append(np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8))
        method, _ = segmentation.unpack_mask(output.segmentation.mask)
        methods.append(np.asarray(method).astype(np.uint8))
    return Rendered(np.stack(images), np.stack(methods), digest.hexdigest())


def compare(name: str, found: Rendered, golden: Rendered) -> Difference:
    """Returns how two renderings of a sequence differ."""
    step = np.abs(found.image.astype(int) - golden.image.astype(int)).max(axis=-1)
    return Difference(
        name=name,
        same_bits=found.digest == golden.digest,
        largest=int(step.max()),
        changed=float(np.mean(step > 1)),
        other_method=float(np.mean(found.method != golden.method)),
    )


def verify(progress: Callable[[str], None] = lambda text: None) -> list[Difference]:
    """Renders all golden sequences and compares them with the package's own.

    Args:
        progress: told the name of each before it is rendered.
    """
    differences = []
    for name in SEQUENCES:
        progress(name)
        differences.append(compare(name, render(name), read(name)))
    return differences


def read(name: str) -> Rendered:
    """Reads a golden sequence."""
    folder = Path(str(resources.files("ataa_jax") / "golden"))
    held = cache.read_all(folder / f"{name}.npz")
    assert held is not None, f"the package lacks golden/{name}.npz"
    digest = origin()["digests"][name]
    return Rendered(held["image"], held["method"], digest)


def write(folder: Path, name: str, golden: Rendered) -> None:
    """Writes a golden sequence; its digest belongs into `golden.toml`."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, image=golden.image, method=golden.method)
    files.write_bytes(folder / f"{name}.npz", buffer.getvalue())


def origin() -> dict:
    """Returns what `golden.toml` tells: command, date, versions, digests."""
    file = resources.files("ataa_jax") / "golden" / "golden.toml"
    return tomllib.loads(file.read_text(encoding="utf-8"))


def here() -> dict[str, str]:
    """Returns the versions that a rendering here is made by."""
    versions = {name: metadata.version(name) for name in PACKAGES}
    return {
        **versions,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "device": jax.devices()[0].device_kind,
    }
