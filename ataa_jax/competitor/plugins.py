"""The package's material and direct light, as plugins of Mitsuba 3.

Mitsuba's own `principled` has another Fresnel term and another diffuse lobe than
glTF 2.0, its `mask` has no threshold, and neither its `direct` nor its `path`
integrator lets shadow rays through a mask. So that both renderers compute the same
integral, the BSDF below is `ataa_jax.material`'s, and the integrator casts the rays
that `ataa_jax.transport` and `ataa_jax.shading` cast. Everything else is Mitsuba's:
scene, ray tracing, textures, emitters, samplers, film, and the compiled kernels.

To be imported after `library.load` only: the classes belong to Mitsuba's variant.
"""

# ruff: noqa: ANN001, ANN201, ANN202, ANN204, ANN205 (Dr.Jit traces types of its own)

# `no_type_check` keeps the test suite's import hook away from what Dr.Jit traces.

from dataclasses import dataclass
from typing import Any, no_type_check

import drjit as dr
import mitsuba as mi
import numpy as np

from ataa_jax import types
from ataa_jax.material import MIN_ROUGHNESS
from ataa_jax.mipmap import decode_srgb
from ataa_jax.shading import MIN_SQUARED_DISTANCE, SHORT
from ataa_jax.surface import OFFSET

_MODES = {
    types.WRAP_REPEAT: dr.WrapMode.Repeat,
    types.WRAP_CLAMP: dr.WrapMode.Clamp,
    types.WRAP_MIRROR: dr.WrapMode.Mirror,
}


@dataclass
class Image:
    """Some channels of a texture's level 0, filtered bilinearly in linear light."""

    texture: Any  # mi.Texture2f16
    modes: tuple[int, int] | None  # of u and v, where they differ

    @staticmethod
    @no_type_check
    def of(texels, channels, srgb, modes):
        """Decodes and uploads texels.

        Args:
            texels: uint8 (h, w, 4), row 0 is v = 0.
            channels: the places of those to keep.
            srgb: RGB is sRGB-encoded; alpha never is.
            modes: how u and v wrap.
        """
        values = texels.astype(np.float32) / np.float32(255.0)
        if srgb:
            values[..., :3] = decode_srgb(values[..., :3])
        kept = np.ascontiguousarray(values[..., channels])
        mixed = modes[0] != modes[1]
        # Half floats hold 8-bit codes and their decoded values within 2^-12, as
        # Mitsuba's own `bitmap` stores them.
        texture = mi.Texture2f16(
            mi.TensorXf16(kept.astype(np.float16)),
            filter_mode=dr.FilterMode.Linear,
            wrap_mode=dr.WrapMode.Clamp if mixed else _MODES[modes[0]],
        )
        return Image(texture, modes if mixed else None)

    @no_type_check
    def __call__(self, uv, active):
        """Returns the channels at texture coordinates."""
        if self.modes:
            # Dr.Jit has one mode for both axes; the neighbour across a repeated
            # edge is lost, half a texel wide.
            uv = mi.Point2f(*map(_wrapped, uv, self.modes))
        return [mi.Float(c) for c in self.texture.eval(uv, active)]


@no_type_check
def _wrapped(u, mode):
    """Brings a coordinate into [0, 1]; see `texture`."""
    if mode == types.WRAP_REPEAT:
        return u - dr.floor(u)
    if mode == types.WRAP_MIRROR:
        return 1.0 - dr.abs(1.0 - 2.0 * (0.5 * u - dr.floor(0.5 * u)))
    return dr.clip(u, 0.0, 1.0)


@dataclass
class Row:
    """One line of `types.Materials`, with its images."""

    base_color: tuple[float, ...]  # linear RGB and alpha
    metallic: float
    roughness: float
    normal_scale: float
    cutoff: float | None  # None: not masked
    blended: bool
    transmission: float
    base_image: Image | None  # RGBA
    alpha_image: Image | None  # alpha alone, where masked
    metallic_roughness_image: Image | None  # green and blue: roughness, metallic
    normal_image: Image | None  # RGB


class GltfBsdf(mi.BSDF):
    """Lambert plus GGX as `material.brdf`; masks and layers by null transmission."""

    @no_type_check
    def __init__(self, row) -> None:
        """Takes a `Row`."""
        super().__init__(mi.Properties("gltf"))
        self.row = row
        flags = mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
        flags = flags | mi.BSDFFlags.BackSide
        if row.cutoff is not None or row.blended:
            flags = flags | mi.BSDFFlags.Null
        self.m_components = [flags]
        self.m_flags = flags

    @no_type_check
    def eval(self, ctx, si, wo, active=True):
        """Returns opacity · BRDF · cosine toward `wo`; both sides are alike."""
        row = self.row
        view, light = si.to_world(si.wi), si.to_world(wo)
        base, opacity, metallic, roughness = self._textured(si, active)
        geometric, smooth = _sides(si, view)
        normal = self._bent(si, geometric, smooth, active)
        cos_light = dr.dot(normal, light)
        lit = active & (cos_light > 0.0) & (dr.dot(geometric, light) > 0.0)
        diffuse = base * (1.0 - metallic) * (1.0 - row.transmission)
        f0 = (base - 0.04) * metallic + 0.04
        value = _brdf(normal, view, light, diffuse, f0, dr.square(roughness))
        if row.blended:
            value = value * opacity
        return dr.select(lit, value * cos_light, 0.0)

    @no_type_check
    def eval_null_transmission(self, si, active=True):
        """Returns the share of light that goes straight on, by colour."""
        row = self.row
        if row.cutoff is not None:
            opacity = mi.Float(row.base_color[3])
            if row.alpha_image is not None:
                opacity = opacity * row.alpha_image(si.uv, active)[0]
            solid = opacity >= row.cutoff
            return mi.Color3f(dr.select(solid, 0.0, 1.0))
        if not row.blended:
            return mi.Color3f(0.0)
        base, opacity, metallic, _ = self._textured(si, active)
        view = si.to_world(si.wi)
        _, smooth = _sides(si, view)
        cos_view = dr.clip(dr.dot(smooth, view), 0.0, 1.0)
        passed = row.transmission * (1.0 - _schlick(0.04, cos_view))
        return (1.0 - opacity) + base * ((1.0 - metallic) * opacity * passed)

    @no_type_check
    def sample(self, ctx, si, sample1, sample2, active=True):
        """Samples nothing: the light is direct, and lights have no extent."""
        return mi.BSDFSample3f(), mi.Color3f(0.0)

    @no_type_check
    def pdf(self, ctx, si, wo, active=True):
        """Returns 0; see `sample`."""
        return mi.Float(0.0)

    @no_type_check
    def eval_pdf(self, ctx, si, wo, active=True):
        """Returns both."""
        return self.eval(ctx, si, wo, active), mi.Float(0.0)

    def to_string(self) -> str:
        """Names the plugin."""
        return "GltfBsdf[]"

    @no_type_check
    def _textured(self, si, active):
        """Returns base colour, opacity, metallic and roughness at a point."""
        row = self.row
        base, opacity = mi.Color3f(row.base_color[:3]), mi.Float(row.base_color[3])
        if row.base_image is not None:
            *color, alpha = row.base_image(si.uv, active)
            base, opacity = base * mi.Color3f(color), opacity * alpha
        metallic, roughness = mi.Float(row.metallic), mi.Float(row.roughness)
        if row.metallic_roughness_image is not None:
            green, blue = row.metallic_roughness_image(si.uv, active)
            roughness, metallic = roughness * green, metallic * blue
        roughness = dr.clip(roughness, MIN_ROUGHNESS, 1.0)
        return base, opacity, dr.clip(metallic, 0.0, 1.0), roughness

    @no_type_check
    def _bent(self, si, geometric, smooth, active):
        """Bends the interpolated normal; see `material` for the sign of green."""
        if self.row.normal_image is None:
            return smooth
        x, y, z = (2.0 * c - 1.0 for c in self.row.normal_image(si.uv, active))
        scale = self.row.normal_scale
        tangent, bitangent = dr.normalize(si.dp_du), dr.normalize(si.dp_dv)
        bent = dr.normalize(
            tangent * (x * scale) - bitangent * (y * scale) + smooth * z
        )
        return dr.select(dr.dot(bent, geometric) > 0.0, bent, smooth)


@no_type_check
def _sides(si, view):
    """Returns geometric and interpolated normal, both turned to the viewer."""
    geometric = dr.select(dr.dot(si.n, view) < 0.0, -si.n, si.n)
    smooth = si.sh_frame.n
    return geometric, dr.select(dr.dot(smooth, geometric) < 0.0, -smooth, smooth)


@no_type_check
def _schlick(f0, cosine):
    grazing = 1.0 - cosine
    return f0 + (1.0 - f0) * (dr.square(dr.square(grazing)) * grazing)


@no_type_check
def _brdf(normal, view, light, diffuse, f0, alpha):
    """Evaluates `material.brdf`'s equations."""
    half = dr.normalize(view + light)
    cos_light = dr.maximum(dr.dot(normal, light), 1e-4)
    cos_view = dr.maximum(dr.dot(normal, view), 1e-4)
    cos_half = dr.clip(dr.dot(normal, half), 0.0, 1.0)
    a2 = dr.square(alpha)
    across = dr.cross(normal, half)
    bend = dr.maximum(dr.dot(across, across) + dr.square(cos_half) * a2, 1e-30)
    distribution = a2 / (dr.pi * dr.square(bend))
    visibility = 0.5 / (
        cos_light * dr.sqrt(dr.square(cos_view) * (1.0 - a2) + a2)
        + cos_view * dr.sqrt(dr.square(cos_light) * (1.0 - a2) + a2)
    )
    fresnel = _schlick(f0, dr.clip(dr.dot(view, half), 0.0, 1.0))
    return diffuse * (1.0 - fresnel) * dr.inv_pi + fresnel * (distribution * visibility)


class Lamp(mi.Emitter):
    """A point or spot light with KHR_lights_punctual's range and cone.

    Mitsuba's `point` and `spot` have no range, and its spot fades linearly.
    """

    @no_type_check
    def __init__(self, position, direction, intensity, reach, cosines) -> None:
        """Takes world positions and directions.

        Args:
            position: of the light.
            direction: unit, the way the light travels.
            intensity: linear RGB.
            reach: distance at which it ends, may be inf.
            cosines: of the inner and outer cone's angle; None: it shines all round.
        """
        super().__init__(mi.Properties("lamp"))
        self.m_flags = mi.EmitterFlags.DeltaPosition
        self.position, self.direction = mi.Point3f(position), mi.Vector3f(direction)
        self.intensity, self.reach = mi.Color3f(intensity), mi.Float(reach)
        self.cosines = cosines

    @no_type_check
    def sample_direction(self, it, sample, active=True):
        """Returns the way to the light, and `shading`'s irradiance across it."""
        offset = self.position - it.p
        squared = dr.maximum(dr.squared_norm(offset), MIN_SQUARED_DISTANCE)
        found = dr.zeros(mi.DirectionSample3f)
        found.p, found.time = self.position, it.time
        found.pdf, found.delta, found.emitter = 1.0, True, mi.EmitterPtr(self)
        found.dist = dr.sqrt(squared)
        found.d = offset / found.dist
        window = dr.square(squared / dr.square(self.reach))
        strength = dr.clip(1.0 - window, 0.0, 1.0) / squared
        if self.cosines is not None:
            inner, outer = self.cosines
            cosine = -dr.dot(found.d, self.direction)
            cone = dr.clip((cosine - outer) / max(inner - outer, 1e-3), 0.0, 1.0)
            strength = strength * dr.square(cone)
        return found, dr.select(active, self.intensity * strength, 0.0)

    @no_type_check
    def pdf_direction(self, it, ds, active=True):
        """Returns 0: no other way leads to a point."""
        return mi.Float(0.0)

    @no_type_check
    def eval(self, si, active=True):
        """Returns 0: a point is not seen."""
        return mi.Color3f(0.0)

    @no_type_check
    def bbox(self):
        """Returns the light's place."""
        return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(*self.position.numpy().flat))

    def to_string(self) -> str:
        """Names the plugin."""
        return "Lamp[]"


class DirectLight(mi.SamplingIntegrator):
    """Direct light with one shadow ray a surface; rays go on through what is clear."""

    @no_type_check
    def __init__(self, solid, clear, layered) -> None:
        """Takes the surfaces that hide everything, and the others, as two scenes.

        One occlusion test settles most shadow rays; only what gets past the solid
        surfaces is walked from one clear surface to the next, as `shading` does it.

        Args:
            solid: a scene.
            clear: a scene; None: all surfaces are solid.
            layered: some surface lets a share of light through, and not just holes.
        """
        super().__init__(mi.Properties("direct_light"))
        self.solid, self.clear, self.layered = solid, clear, layered

    @no_type_check
    def sample(self, scene, sampler, ray, medium=None, active=True):
        """Returns the radiance along rays; black where they meet nothing."""
        ray, active = mi.Ray3f(ray), mi.Bool(active)

        def step(ray, color, passed, active):
            ray, si = self._surface(scene, ray, active)
            active = active & si.is_valid()
            color = color + passed * self._light(scene, sampler, si, active)
            if self.layered:
                behind = si.bsdf().eval_null_transmission(si, active)
                passed = passed * behind
                active = active & dr.any(passed > 0.0)
            return _onward(ray, si), color, passed, active

        state = ray, mi.Color3f(0.0), mi.Color3f(1.0), active
        if self.layered:
            _, color, _, _ = dr.while_loop(state, lambda *s: s[-1], step)
        else:
            _, color, _, _ = step(*state)
        return color, mi.Bool(True), []

    @no_type_check
    def _surface(self, scene, ray, active):
        """Returns the first surface that is no hole, and the ray's rest toward it."""

        def step(ray, met, active):
            found = scene.ray_intersect_preliminary(ray, True, active=active)
            met = dr.select(active, found, met)
            si, behind = _behind(found, ray, active & found.is_valid())
            hole = active & found.is_valid() & dr.all(behind == 1.0)
            return dr.select(hole, _onward(ray, si), ray), met, hole

        if self.clear is None:
            met = scene.ray_intersect_preliminary(ray, True, active=active)
        else:
            state = ray, dr.zeros(mi.PreliminaryIntersection3f), active
            ray, met, _ = dr.while_loop(state, lambda *s: s[-1], step)
        return ray, met.compute_surface_interaction(ray, mi.RayFlags.All, active)

    @no_type_check
    def _light(self, scene, sampler, si, active):
        """Returns the light of one emitter that a surface sends back, else 0."""
        toward, weight = scene.sample_emitter_direction(
            si, sampler.next_2d(active), False, active
        )
        wo = si.to_local(toward.d)
        value = si.bsdf().eval(mi.BSDFContext(), si, wo, active) * weight
        lit = active & dr.any(value > 0.0)
        ray = mi.Ray3f(_lifted(si, toward.d), toward.d)
        ray.maxt = toward.dist * (1.0 - SHORT)
        lit = lit & ~self.solid.ray_test(ray, lit)
        if self.clear is not None:
            value = value * self._passed(ray, lit)
        return dr.select(lit, value, 0.0)

    @no_type_check
    def _passed(self, ray, active):
        """Returns the product of the clear surfaces' shares along shadow rays."""

        def step(ray, passed, active):
            found = self.clear.ray_intersect_preliminary(ray, True, active=active)
            active = active & found.is_valid()
            si, behind = _behind(found, ray, active)
            passed = dr.select(active, passed * behind, passed)
            active = active & dr.any(passed > 0.0)
            return _onward(ray, si), passed, active

        state = ray, mi.Color3f(1.0), active
        _, passed, _ = dr.while_loop(state, lambda *s: s[-1], step)
        return passed


@no_type_check
def _behind(found, ray, active):
    """Returns a surface, as far as it is needed, and what it shows of light behind."""
    flags = mi.RayFlags.UV | mi.RayFlags.ShadingFrame
    si = found.compute_surface_interaction(ray, flags, active)
    bsdf = si.bsdf()
    clear = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
    return si, bsdf.eval_null_transmission(si, clear)


@no_type_check
def _lifted(si, direction):
    """Returns where a ray leaves a surface; see `surface.lifted`."""
    side = dr.select(dr.dot(si.n, direction) < 0.0, -1.0, 1.0)
    return si.p + si.n * (side * OFFSET * dr.max(dr.abs(si.p)))


@no_type_check
def _onward(ray, si):
    """Returns the ray's rest beyond a surface."""
    onward = mi.Ray3f(_lifted(si, ray.d), ray.d)
    onward.maxt = ray.maxt - dr.select(si.is_valid(), si.t, 0.0)
    return onward
