"""Projection into the colour camera and lens models; every operation is rounded separately."""

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


def project_corners(
    x: np.ndarray, y: np.ndarray, units: np.ndarray, splat: SplatParameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Project points on depth rays into the colour image (Eq. 1-4), in float32.

    Args:
        x: x over z of the rays in the depth camera, ``(n,)`` float32.
        y: y over z, ``(n,)`` float32.
        units: Depth ``(n,)`` uint16 [depth units].
        splat: Constants of the alignment.

    Returns:
        Colour column and row, z in the colour camera [depth units], and whether the point is in
        front of the camera and inside the range of the lens model, each ``(n,)``.
    """
    f32, r, t = np.float32, splat.rotation, splat.translation
    depth = units.astype(f32) * splat.depth_unit
    px, py = depth * x, depth * y
    cx, cy, cz = (
        r[3 * i] * px + (r[3 * i + 1] * py + (r[3 * i + 2] * depth + t[i])) for i in range(3)
    )
    ahead = cz > 0
    cz = np.where(ahead, cz, f32(1))
    px, py, inside = project(cx / cz, cy / cz, splat)
    fx, fy, ppx, ppy = splat.pinhole
    column, fits_u = _to_int(px * fx + ppx + f32(0.5))
    row, fits_v = _to_int(py * fy + ppy + f32(0.5))
    z = np.minimum(cz / splat.depth_unit + f32(0.5), f32(65534)).astype(np.uint32)
    return column, row, z, ahead & inside & fits_u & fits_v


def _to_int(value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Round towards zero; also return whether the value is small enough to be near an image."""
    fits = np.abs(value) < np.float32(1 << 20)
    return np.where(fits, value, np.float32(0)).astype(np.int32), fits
