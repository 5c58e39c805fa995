"""Lambert plus GGX for one point and one light, float64, from the glTF appendix."""

import math

import numpy as np


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
    nh, hv = float(normal @ half), float(half @ view)
    if nl <= 0 or nv <= 0:
        return np.zeros(3)
    f0 = 0.04 * (1 - metallic) + base * metallic
    fresnel = f0 + (1 - f0) * (1 - hv) ** 5
    d = alpha**2 / (math.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)
    lambda_l = nl * math.sqrt(nv**2 * (1 - alpha**2) + alpha**2)
    lambda_v = nv * math.sqrt(nl**2 * (1 - alpha**2) + alpha**2)
    visibility = 0.5 / (lambda_l + lambda_v)
    diffuse = base * (1 - metallic) / math.pi
    return (diffuse * (1 - fresnel) + fresnel * d * visibility) * nl
