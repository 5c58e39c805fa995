"""Materials, samplers and images (glTF 2.0, sections 3.8 and 3.9)."""

import math
import warnings
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, UnidentifiedImageError

from ataa_jax import pyramids, types
from ataa_jax.gltf.container import Container, short
from ataa_jax.scene import MaterialSource, TextureSource

MAX_IMAGE_TEXELS = 1 << 26  # 8192 x 8192
MAX_TEXELS = 1 << 29  # of all textures together: 2 GiB as RGBA8

_WRAPS = {
    10497: types.WRAP_REPEAT,
    33071: types.WRAP_CLAMP,
    33648: types.WRAP_MIRROR,
}
_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class UvMap:
    """Which texture coordinates a material reads, and how they are transformed."""

    set: int = 0  # the n of TEXCOORD_n
    matrix: tuple[tuple[float, float, float], ...] = _IDENTITY  # on (u, v, 1)

    def apply(self, uv: np.ndarray) -> np.ndarray:
        """Returns the transformed coordinates, float32 (v, 2)."""
        if self.matrix == _IDENTITY:
            return uv
        matrix = np.array(self.matrix)
        return (uv @ matrix[:, :2].T + matrix[:, 2]).astype(np.float32)


@dataclass(frozen=True)
class Materials:
    """All materials of the file, glTF's default one last, and their textures."""

    sources: list[MaterialSource]
    textures: list[TextureSource]
    uv_maps: list[UvMap | None]  # per material; None: it has no texture


def read_materials(container: Container) -> Materials:
    """Reads every material and, on all cores, the images that they use."""
    pool = ThreadPoolExecutor()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow's: sizes are checked here
            library = _Library(container, pool)
            sources = []
            uv_maps = []
            for index, record in enumerate(container.items("materials")):
                where = f"materials[{index}]"
                source, uv_map = _material(container, library, record, where)
                sources.append(source)
                uv_maps.append(uv_map)
            textures = library.textures()
    finally:
        pool.shutdown(cancel_futures=True)
    sources.append(MaterialSource(name="default"))
    uv_maps.append(None)
    return Materials(sources, textures, uv_maps)


def _material(
    container: Container, library: "_Library", record: dict[str, Any], where: str
) -> tuple[MaterialSource, UvMap | None]:
    pbr = container.table(record, "pbrMetallicRoughness", where)
    pbr_where = f"{where}.pbrMetallicRoughness"
    name = container.string(record, "name", where) or where

    found: list[UvMap] = []

    def texture(owner: dict[str, Any], key: str, owner_where: str, srgb: bool) -> int:
        if key not in owner:
            return types.NO_TEXTURE
        info = container.table(owner, key, owner_where)
        at = f"{owner_where}.{key}"
        index = library.texture(info.get("index"), srgb, at)
        if index != types.NO_TEXTURE:
            found.append(_uv_map(container, info, at))
        return index

    base_color_texture = texture(pbr, "baseColorTexture", pbr_where, True)
    metallic_roughness_texture = texture(
        pbr, "metallicRoughnessTexture", pbr_where, False
    )
    normal_texture = texture(record, "normalTexture", where, False)
    emissive_texture = texture(record, "emissiveTexture", where, True)
    if len(set(found)) > 1:
        container.warn(
            f"material {short(name)}: its textures use different texture coordinates "
            "or transforms; those of the first are used for all"
        )

    alpha_mode = container.string(record, "alphaMode", where, "OPAQUE")
    if alpha_mode not in ("OPAQUE", "MASK", "BLEND"):
        raise container.fail(
            f"{where}.alphaMode is {short(alpha_mode)}, but must be OPAQUE, MASK or "
            "BLEND; correct it or re-export the file"
        )
    strength_record = container.extension(
        record, "KHR_materials_emissive_strength", where
    )
    strength = (
        1.0
        if strength_record is None
        else container.number(
            strength_record, "emissiveStrength", f"{where}.extensions", 1.0
        )
    )
    glass = container.extension(record, "KHR_materials_transmission", where) or {}
    glass_where = f"{where}.extensions.KHR_materials_transmission"
    transmission = container.number(glass, "transmissionFactor", glass_where, 0.0)
    if "transmissionTexture" in glass:
        container.warn(
            f"material {short(name)}: its transmission texture is not read; the "
            "factor holds everywhere"
        )
    emissive = container.numbers(record, "emissiveFactor", 3, where, (0.0, 0.0, 0.0))
    r, g, b, a = container.numbers(
        pbr, "baseColorFactor", 4, pbr_where, (1.0, 1.0, 1.0, 1.0)
    )
    normal = container.table(record, "normalTexture", where)
    source = MaterialSource(
        name=name,
        base_color=(_unit(r), _unit(g), _unit(b), _unit(a)),
        metallic=_unit(container.number(pbr, "metallicFactor", pbr_where, 1.0)),
        roughness=_unit(container.number(pbr, "roughnessFactor", pbr_where, 1.0)),
        emissive=(
            _radiance(emissive[0] * strength),
            _radiance(emissive[1] * strength),
            _radiance(emissive[2] * strength),
        ),
        normal_scale=container.number(normal, "scale", f"{where}.normalTexture", 1.0),
        alpha_mode=alpha_mode,
        alpha_cutoff=container.number(record, "alphaCutoff", where, 0.5),
        transmission=_unit(transmission),
        double_sided=record.get("doubleSided", False) is True,
        base_color_texture=base_color_texture,
        metallic_roughness_texture=metallic_roughness_texture,
        normal_texture=normal_texture,
        emissive_texture=emissive_texture,
    )
    return source, found[0] if found else None


def _unit(value: float) -> float:
    return min(max(value, 0.0), 1.0)


def _radiance(value: float) -> float:
    return min(max(value, 0.0), 1e30)  # stays finite in float32


def _uv_map(container: Container, info: dict[str, Any], where: str) -> UvMap:
    uv_set = container.integer(info, "texCoord", where, 0)
    transform = container.extension(info, "KHR_texture_transform", where)
    if transform is None:
        return UvMap(uv_set)
    where = f"{where}.extensions.KHR_texture_transform"
    uv_set = container.integer(transform, "texCoord", where, uv_set)
    tx, ty = container.numbers(transform, "offset", 2, where, (0.0, 0.0))
    sx, sy = container.numbers(transform, "scale", 2, where, (1.0, 1.0))
    angle = container.number(transform, "rotation", where, 0.0)
    c, s = math.cos(angle), math.sin(angle)
    # The extension's T R S; with v down, R turns counter-clockwise as it is seen.
    return UvMap(uv_set, ((c * sx, s * sy, tx), (-s * sx, c * sy, ty)))


_Key = tuple[str, Any]  # where an image is stored
_Use = tuple[_Key, bool, int, int]  # and how it is read: encoding, wrap modes


class _Library:
    """Textures by what makes them differ, and images by where they are stored."""

    def __init__(self, container: Container, pool: ThreadPoolExecutor) -> None:
        self._container = container
        self._pool = pool
        self._indices: dict[_Use, int] = {}
        self._images: dict[_Key, tuple[str, bytes]] = {}
        self._pyramids: dict[tuple[_Key, bool], Future[pyramids.Pyramid]] = {}
        self._sizes: dict[_Key, tuple[int, int]] = {}
        self._texels = 0  # of all textures: an image may be read in several ways

    def textures(self) -> list[TextureSource]:
        """Returns all that were asked for, once their images are there."""
        found = []
        for key, srgb, wrap_u, wrap_v in self._indices:  # in the order of their places
            try:
                pyramid = self._pyramids[key, srgb].result()
            except MemoryError:
                raise
            except Exception as error:  # decoders raise whatever they like
                if isinstance(error, OSError) and error.errno is not None:
                    raise  # the system's: no decoder's
                where, _ = self._images[key]
                raise self._container.fail(_undecodable(where, error)) from None
            texture = TextureSource(pyramid.texels, srgb, wrap_u, wrap_v, pyramid)
            found.append(texture)
        return found

    def texture(self, index: Any, srgb: bool, user: str) -> int:
        """Returns the place in `textures()` of ``textures[index]`` of the file."""
        container = self._container
        record = container.item("textures", index, user)
        where = f"textures[{index}]"
        if "source" not in record:
            container.warn(
                f"{where} has no PNG or JPEG image; the materials that use it are "
                "drawn without"
            )
            return types.NO_TEXTURE
        key = self._image(record["source"], where)
        if (key, srgb) not in self._pyramids:
            data = self._images[key][1]
            self._pyramids[key, srgb] = self._pool.submit(pyramids.load, data, srgb)
        use = (key, srgb, *self._wraps(record, where))
        if use not in self._indices:
            self._count(key)
        return self._indices.setdefault(use, len(self._indices))

    def _wraps(self, record: dict[str, Any], where: str) -> tuple[int, int]:
        if "sampler" not in record:
            return types.WRAP_REPEAT, types.WRAP_REPEAT
        container = self._container
        sampler = container.item("samplers", record["sampler"], where)
        where = f"samplers[{record['sampler']}]"
        wraps = []
        for key in ("wrapS", "wrapT"):
            code = container.integer(sampler, key, where, 10497)
            if code not in _WRAPS:
                raise container.fail(
                    f"{where}.{key} is {code}, but must be 10497, 33071 or 33648; "
                    "re-export the file"
                )
            wraps.append(_WRAPS[code])
        return wraps[0], wraps[1]

    def _image(self, index: Any, user: str) -> _Key:
        """Fetches an image, unless it is there; returns what it is known by."""
        container = self._container
        record = container.item("images", index, user)
        where = f"images[{index}]"
        if "uri" in record:
            key = ("uri", container.string(record, "uri", where))
        elif "bufferView" in record:
            view = record["bufferView"]
            container.check_index(
                view,
                len(container.items("bufferViews")),
                f"{where} refers to bufferViews[{short(view)}]",
            )
            key = ("view", view)
        else:
            raise container.fail(
                f"{where} has neither `uri` nor `bufferView`; re-export the file"
            )
        if key not in self._images:
            if key[0] == "uri":
                data = container.fetch(key[1], where)
            else:
                data = bytes(container.view(key[1], where)[0])
            self._sizes[key] = self._check(data, where)
            self._images[key] = where, data
        return key

    def _check(self, data: bytes, where: str) -> tuple[int, int]:
        """Refuses what is no image, or too large a one; its texels are not read."""
        container = self._container
        try:
            width, height = pyramids.open_image(data).size
        except Exception as error:  # decoders raise whatever they like
            raise container.fail(_undecodable(where, error)) from None
        if width * height > MAX_IMAGE_TEXELS:
            raise container.fail(
                f"{where} is {width}x{height} texels, beyond the {MAX_IMAGE_TEXELS} "
                "of an image; scale it down"
            )
        return width, height

    def _count(self, key: _Key) -> None:
        """Counts an image's texels once more, and refuses too many."""
        width, height = self._sizes[key]
        self._texels += width * height
        if self._texels > MAX_TEXELS:
            raise self._container.fail(
                f"{self._images[key][0]} is {width}x{height} texels, with which all "
                f"textures together are beyond {MAX_TEXELS}; scale the images down"
            )


def _undecodable(where: str, error: Exception) -> str:
    reason = str(error)
    if isinstance(error, UnidentifiedImageError):
        reason = "not recognized"  # Pillow's own words name a Python object
    elif isinstance(error, Image.DecompressionBombError):
        reason = f"larger than {MAX_IMAGE_TEXELS} texels"
    return (
        f"{where} is not a readable PNG or JPEG ({reason or type(error).__name__}); "
        "save the image again"
    )
