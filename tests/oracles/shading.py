"""Light at one point in float64: glTF's BRDF, punctual lights, ambient sky."""

import math

import numpy as np

from ataa_jax import types

# A normal map may lean a normal away from the viewer or the light; cosines in the
# BRDF's denominators are floored here, as the shading code's are.
_MIN_COSINE = 1e-4

# Karis, "Physically based shading on mobile": the fit of the environment BRDF.
_C0 = np.array([-1.0, -0.0275, -0.572, 0.022])
_C1 = np.array([1.0, 0.0425, 1.04, -0.04])


def reflect(
    base: np.ndarray,
    metallic: float,
    roughness: float,
    normal: np.ndarray,
    view: np.ndarray,
    light: np.ndarray,
) -> np.ndarray:
    """Returns brdf times the cosine of the light; all directions are unit."""
    alpha = max(roughness, 0.045) ** 2
    half = (view + light) / np.linalg.norm(view + light)
    nl, nv = float(normal @ light), float(normal @ view)
    if nl <= 0:
        return np.zeros(3)
    cosine = nl
    nl, nv = max(nl, _MIN_COSINE), max(nv, _MIN_COSINE)
    nh, hv = max(float(normal @ half), 0.0), float(half @ view)
    f0 = 0.04 * (1 - metallic) + base * metallic
    fresnel = f0 + (1 - f0) * (1 - hv) ** 5
    d = alpha**2 / (math.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)
    lambda_l = nl * math.sqrt(nv**2 * (1 - alpha**2) + alpha**2)
    lambda_v = nv * math.sqrt(nl**2 * (1 - alpha**2) + alpha**2)
    visibility = 0.5 / (lambda_l + lambda_v)
    diffuse = base * (1 - metallic) / math.pi
    return (diffuse * (1 - fresnel) + fresnel * d * visibility) * cosine


def incident(
    lights: types.Lights, index: int, point: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray]:
    """Returns the direction to a light, its distance, and its normal irradiance."""
    kind = int(lights.kind[index])
    intensity = np.asarray(lights.intensity[index], np.float64)
    travel = np.asarray(lights.direction[index], np.float64)
    if kind == types.LIGHT_DIRECTIONAL:
        return -travel, math.inf, intensity
    offset = np.asarray(lights.position[index], np.float64) - point
    distance = float(np.linalg.norm(offset))
    toward = offset / distance
    strength = 1.0 / distance**2
    reach = float(lights.range[index])
    strength *= min(max(1.0 - (distance / reach) ** 4, 0.0), 1.0)
    if kind == types.LIGHT_SPOT:
        inner, outer = float(lights.cos_inner[index]), float(lights.cos_outer[index])
        cosine = float(-toward @ travel)
        strength *= min(max((cosine - outer) / (inner - outer), 0.0), 1.0) ** 2
    return toward, distance, intensity * strength


def sky(sky: types.Sky, unit: np.ndarray) -> np.ndarray:
    """Returns the gradient's radiance: square root upwards, twice as steep down."""
    zenith, horizon, ground = _gradient(sky)
    if unit[1] >= 0:
        share = math.sqrt(min(unit[1], 1.0))
        return (1 - share) * horizon + share * zenith
    share = min(-2.0 * unit[1], 1.0)
    return (1 - share) * horizon + share * ground


def ambient(
    sky_light: types.Sky,
    base: np.ndarray,
    metallic: float,
    roughness: float,
    normal: np.ndarray,
    view: np.ndarray,
) -> np.ndarray:
    """Returns the sky's light as a surface reflects it, and that of what hides it."""
    zenith, horizon, ground = _gradient(sky_light)
    upward = 0.5 + 0.5 * normal[1]
    mean = (1 - upward) * ground + upward * (zenith + horizon) / 2
    cos_view = max(float(normal @ view), _MIN_COSINE)
    mirrored = 2 * cos_view * normal - view
    sharp = sky(sky_light, mirrored / np.linalg.norm(mirrored))
    r = roughness * _C0 + _C1
    a004 = min(r[0] * r[0], 2.0 ** (-9.28 * cos_view)) * r[0] + r[1]
    scale, bias = np.array([-1.04, 1.04]) * a004 + r[2:]
    specular = (0.04 * (1 - metallic) + base * metallic) * scale + bias
    diffuse = base * (1 - metallic)
    blurred = (1 - roughness) * sharp + roughness * mean
    seen = diffuse * mean + specular * blurred
    bounce = np.asarray(sky_light.bounce, np.float64)
    return float(sky_light.visibility) * seen + diffuse * bounce


def _gradient(sky: types.Sky) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    zenith, horizon, ground = (
        np.asarray(part, np.float64) for part in (sky.zenith, sky.horizon, sky.ground)
    )
    return zenith, horizon, ground
