"""Lens models in the arithmetic of the alignment: every operation is rounded separately."""

import numpy as np

from jaxdet.camera import SplatParameters
from jaxdet.elementary import arctangent
from jaxdet.types import Distortion

f32, f64 = np.float32, np.float64


def project(
    x: np.ndarray, y: np.ndarray, splat: SplatParameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distort rays by the lens model of the colour camera.

    Args:
        x: x over z, ``(n,)`` float32.
        y: y over z, ``(n,)`` float32.
        splat: Constants of the alignment.

    Returns:
        Distorted ``x`` and ``y``, and whether the ray is inside the range of the model.
    """
    r2 = x * x + y * y
    inside = r2 <= splat.max_r2
    if splat.model is Distortion.NONE:
        return x, y, inside
    x, y, r2 = (np.where(inside, a, f32(0)) for a in (x, y, r2))
    if splat.model is Distortion.EQUIDISTANT:
        return *_equidistant(x, y, splat.lens.astype(f64)), inside
    k, two = splat.lens, f32(2)
    radial = f32(1) + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    if splat.model is Distortion.RATIONAL:
        radial = radial / (f32(1) + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
    xy = two * (x * y)
    dx = x * radial + (k[2] * xy + k[3] * (r2 + two * (x * x)))
    dy = y * radial + (k[3] * xy + k[2] * (r2 + two * (y * y)))
    return dx, dy, inside


def _equidistant(x: np.ndarray, y: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Apply Kannala-Brandt: the radius becomes ``theta (1 + k1 theta^2 + ...)``, in float64."""
    x, y = x.astype(f64), y.astype(f64)
    r = np.sqrt(x * x + y * y)
    theta = arctangent(r)
    t2 = theta * theta
    bent = theta * (f64(1) + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    scale = np.where(r > 1e-9, bent / np.where(r > 1e-9, r, f64(1)), f64(1))
    return (x * scale).astype(f32), (y * scale).astype(f32)
