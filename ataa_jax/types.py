"""The records that flow between the stages, and the meaning of every axis letter.

Axis letters used in every annotation of the package:

- ``h w``: image rows (0 at the top) and columns; pixel centres lie at +0.5;
- ``n``: a batch of rays, hits or pixels;
- ``t``: triangles; ``m``: materials; ``k``: textures; ``l``: lights;
- ``g``: rigid groups, parts of the scene that move as one body (group 0 is static).

Spaces: *group* (a rigid group's own), *world* (right-handed, glTF: +y up), *view*
(camera looks down −z), *pixel* (x right, y down). Colours are linear,
scene-referred radiance unless a name says otherwise. Matrices are named
``target_from_source``.
"""

import equinox as eqx
from jaxtyping import Array, Bool, Float, Int, UInt

# Antialiasing methods stored in the low half of the mask (paper, section 3).
METHOD_FXAA = 0
METHOD_TAA = 1
METHOD_ATAA = 2

# Why a pixel got its method: bits of `Segmentation.why`.
WHY_OFF_SCREEN = 1  # no previous position: outside the previous view, or new frame
WHY_DISOCCLUDED = 2  # previous motion (or depth) at the reprojected pixel disagrees
WHY_HELD = 4  # the classification history holds the pixel
WHY_LUMINANCE = 8  # temporal change of luminance: this term alone passes
WHY_DEPTH = 16  # Sobel of inverse depth: this term alone passes
WHY_OVER_BUDGET = 32  # asked for rays, but the frame's ray budget was spent
WHY_RESET = 64  # motion changed significantly: classification history was reset
# Criteria beyond the paper's, off by default: this term alone passes.
WHY_NORMAL = 128  # angle between normals in the 3×3
WHY_OBJECT = 256  # edge between objects
WHY_MATERIAL = 512  # edge between materials
WHY_SPREAD = 1024  # luminance varies in the 3×3 as it did not in the history
WHY_RESPONSE = 2048  # TAA's result is far from the history it read
WHY_LAYERS = 4096  # two surfaces are seen that move apart, one through the other

NO_TEXTURE = -1
LIGHT_DIRECTIONAL = 0
LIGHT_POINT = 1
LIGHT_SPOT = 2
WRAP_REPEAT = 0
WRAP_CLAMP = 1
WRAP_MIRROR = 2


class Geometry(eqx.Module):
    """Every triangle of the scene, unindexed, in the space of its rigid group."""

    position: Float[Array, "t 3 3"]  # (triangle, corner, xyz), group space
    normal: Float[Array, "t 3 3"]  # unit, group space, per corner
    uv: Float[Array, "t 3 2"]  # glTF: v down, (0, 0) is the first texel's corner
    material: Int[Array, " t"]
    object: Int[Array, " t"]  # id of the node instance the triangle belongs to
    group: Int[Array, " t"]


class Materials(eqx.Module):
    """GlTF metallic-roughness materials; texture ids are NO_TEXTURE where absent."""

    base_color: Float[Array, "m 4"]  # linear, multiplies the texture
    metallic: Float[Array, " m"]
    roughness: Float[Array, " m"]
    emissive: Float[Array, "m 3"]
    normal_scale: Float[Array, " m"]
    alpha_cutoff: Float[Array, " m"]
    alpha_masked: Bool[Array, " m"]
    blended: Bool[Array, " m"]  # something shows through: alpha below 1, transmission
    transmission: Float[Array, " m"]  # KHR_materials_transmission's factor
    mirror: Bool[Array, " m"]  # smooth enough, somewhere, for a reflection ray
    double_sided: Bool[Array, " m"]
    base_color_texture: Int[Array, " m"]
    metallic_roughness_texture: Int[Array, " m"]
    normal_texture: Int[Array, " m"]
    emissive_texture: Int[Array, " m"]


class Textures(eqx.Module):
    """All mip pyramids in one flat array of 8-bit RGBA texels.

    A texel is ``r | g << 8 | b << 16 | a << 24``. Row 0 of an image is v = 0.
    Levels beyond a texture's last repeat its last.
    """

    texels: UInt[Array, " n"]  # uint32
    level_offset: Int[Array, "k levels"]  # index of the level's first texel
    level_height: Int[Array, "k levels"]
    level_width: Int[Array, "k levels"]
    level_count: Int[Array, " k"]
    wrap_u: Int[Array, " k"]
    wrap_v: Int[Array, " k"]
    srgb: Bool[Array, " k"]  # RGB is sRGB-encoded (alpha never is)


class Lights(eqx.Module):
    """KHR_lights_punctual: lux for directional, candela for point and spot lights."""

    kind: Int[Array, " l"]
    position: Float[Array, "l 3"]  # world
    direction: Float[Array, "l 3"]  # world, unit, the way the light travels
    intensity: Float[Array, "l 3"]  # colour times intensity
    range: Float[Array, " l"]  # scene units; inf: no cut-off
    cos_inner: Float[Array, " l"]  # spot cone; ignored for other kinds
    cos_outer: Float[Array, " l"]
    casts: Bool[Array, " l"]  # shadows; False: the light passes through everything


class Sky(eqx.Module):
    """A vertical gradient: ambient light, and the background."""

    zenith: Float[Array, " 3"]  # radiance straight up
    horizon: Float[Array, " 3"]
    ground: Float[Array, " 3"]  # radiance straight down
    visibility: Float[Array, ""]  # share of the sky that surfaces see, in [0, 1]
    bounce: Float[Array, " 3"]  # radiance of the surroundings that hide the rest


class Scene(eqx.Module):
    """What the shading code reads; Embree's own copy lives in `embree.Tracer`."""

    geometry: Geometry
    materials: Materials
    textures: Textures
    lights: Lights
    sky: Sky


class Camera(eqx.Module):
    """A pinhole camera; the image's aspect ratio comes from its size in pixels."""

    world_from_view: Float[Array, "4 4"]  # rigid: rotation and translation only
    tan_half_fov_y: Float[Array, ""]


class FrameInputs(eqx.Module):
    """Everything about one frame that is neither scene, state nor parameter."""

    camera: Camera
    previous_camera: Camera
    world_from_group: Float[Array, "g 3 4"]
    previous_world_from_group: Float[Array, "g 3 4"]
    jitter: Float[Array, " 2"]  # pixels from the pixel centre, x right, y down
    cut: Bool[Array, ""]  # True: nothing of the history may be used


class Rays(eqx.Module):
    """Secondary rays that shading cast."""

    shadow: Int[Array, " l"]  # by light
    reflection: Int[Array, ""]
    layer: Int[Array, ""]  # on through transparent surfaces, to the eye or to a light


class Hits(eqx.Module):
    """What rays met. A miss has triangle −1 and distance inf."""

    distance: Float[Array, " n"]  # in units of the ray direction's length
    triangle: Int[Array, " n"]
    barycentric: Float[Array, "n 2"]  # weights of corners 1 and 2


class GBuffer(eqx.Module):
    """What a rasterizer leaves beside the colour, one sample a pixel, jittered."""

    depth: Float[Array, "h w"]  # linear, along −z of the view, scene units; sky inf
    # Previous − current position, px, jitter removed; at most 4·max(h, w) a component.
    motion: Float[Array, "h w 2"]
    # The point was in front of the previous camera, and the pixel's centre + motion
    # lies inside the image.
    motion_valid: Bool[Array, "h w"]
    normal: Float[Array, "h w 3"]  # world, unit, interpolated, no normal map; sky 0
    object: Int[Array, "h w"]  # −1: sky
    material: Int[Array, "h w"]  # −1: sky
    # Where a transparent layer lies before the surface that the buffers above tell of,
    # or that surface is a layer: the motion of what else is seen there, as `motion`,
    # and its weight in the composite, in [0, 1]. Only the criterion "layers" reads
    # them, and only for it are they drawn.
    second_motion: Float[Array, "h w 2"] | None = None
    second_share: Float[Array, "h w"] | None = None


class History(eqx.Module):
    """What one frame hands to the next: the composite and the G-buffer beside it."""

    color: Float[Array, "h w 3"]  # linear radiance: TAA, traced or raw, never FXAA
    depth: Float[Array, "h w"]
    motion: Float[Array, "h w 2"]
    count: Float[Array, "h w"]  # frames accumulated in the pixel, for the 1/(n+1) blend
    valid: Bool[Array, ""]  # False: first frame, cut, or change of size


class Classification(eqx.Module):
    """The packed mask of the last frame: method low 16 bits, frames to hold high 16."""

    mask: UInt[Array, "h w"]  # uint32


class State(eqx.Module):
    """All that a frame reads from the frames before it."""

    history: History
    classification: Classification


class Segmentation(eqx.Module):
    """The mask, and why."""

    mask: UInt[Array, "h w"]  # uint32: method low 16 bits, classification history high
    why: UInt[Array, "h w"]  # WHY_* bits; uint16, for the optional criteria have theirs
    score: Float[Array, "h w"]  # in [0, 1]; the larger, the more it asks for rays
    luminance: Float[Array, "h w"]  # the temporal luminance term, in [0, 1]
    depth: Float[Array, "h w"]  # the Sobel term, in [0, 1]
