"""Lens models in the alignment's arithmetic: every operation rounded on its own."""

import numpy as np

from jaxdet.camera import SplatParameters
from jaxdet.types import Distortion

f32, f64 = np.float32, np.float64


def project(
    x: np.ndarray, y: np.ndarray, splat: SplatParameters
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distorts rays by the colour camera's model.

    Args:
        x: ``(n,)`` float32, x over z.
        y: ``(n,)`` float32, y over z.
        splat: The alignment's constants.

    Returns:
        Distorted ``x`` and ``y``, and whether the ray is inside the model's range.
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
    """Kannala-Brandt: the radius becomes ``theta (1 + k1 theta^2 + ...)``, in float64."""
    x, y = x.astype(f64), y.astype(f64)
    r = np.sqrt(x * x + y * y)
    theta = arctangent(r)
    t2 = theta * theta
    bent = theta * (f64(1) + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    scale = np.where(r > 1e-9, bent / np.where(r > 1e-9, r, f64(1)), f64(1))
    return (x * scale).astype(f32), (y * scale).astype(f32)


def arctangent(x: np.ndarray) -> np.ndarray:
    """Arc tangent of ``x >= 0`` from the four operations alone, within 2e-16 relative.

    Library functions differ in the last bit between processors; this rational approximation
    (Cephes ``atan.c``, S. Moshier) does not.

    Example:
        >>> float(arctangent(np.array([1.0]))[0] * 4)
        3.141592653589793
    """
    large, middle = x > 2.414213562373095, x > 0.66
    offset = np.where(large, np.pi / 2, np.where(middle, np.pi / 4, 0.0))
    safe = np.where(large, x, f64(1))
    t = np.where(large, f64(-1) / safe, np.where(middle, (x - f64(1)) / (x + f64(1)), x))
    z = t * t
    p = -8.750608600031904122785e-1
    for c in _ATAN_P:
        p = p * z + c
    q = z + _ATAN_Q[0]
    for c in _ATAN_Q[1:]:
        q = q * z + c
    return offset + (t * (z * p / q) + t)


_ATAN_P = (
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_ATAN_Q = (
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)
