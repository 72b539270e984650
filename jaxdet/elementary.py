"""Elementary functions with bit-identical results on every machine.

NumPy, the C library and BLAS select their sine, logarithm, power or matrix product by the CPU's
features, and the variants differ in the last bits. All values that reach a table or a decision are
computed by these functions instead. They consist of comparisons, scaling by powers of two, and
float64 additions, subtractions, products, quotients and square roots in the written order, each
rounded to nearest (IEEE 754). NumPy evaluates one operation per call, so none are fused.

All functions accept numbers or arrays of any shape, and compute in float64.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

_HALF_PI = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
"""π/2 as a sum; the first two terms have 33 bits, so that products with numbers of
20 bits are exact."""
_FARTHEST = 2.0**20 * 1.57
"""Largest angle that :func:`sin_cos` reduces with full accuracy [rad]."""
_SIGNS = np.array([1.0, 1.0, -1.0, -1.0, 1.0])
"""Signs of the sine by quadrant; those of the cosine begin at the second entry."""
_PI_LOW = 1.2246467991473532e-16
"""π minus its float64 value."""
_LN2 = 0.6931471803691238, 1.9082149292705877e-10
"""ln 2 as a sum; the first term has 32 bits."""
_SIN = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(8, 0, -1))
_COS = tuple((-1) ** k / math.factorial(2 * k) for k in range(8, 1, -1))
_LOG = tuple(2 / (2 * k + 1) for k in range(10, 0, -1))


def sin(x: ArrayLike) -> np.ndarray:
    """Return the sine of angles [rad], within 1 ulp.

    Angles beyond 1.6 million are first reduced modulo the float64 value of 2π. The result is NaN
    for infinities, and 0 for zeros of both signs.

    Example:
        >>> sin([0.0, np.pi / 6, np.pi / 2]).round(15).tolist()
        [0.0, 0.5, 1.0]
    """
    return sin_cos(x)[0]


def cos(x: ArrayLike) -> np.ndarray:
    """Return the cosine of angles [rad], within 1.1 ulp, with the reduction of :func:`sin`."""
    return sin_cos(x)[1]


def sin_cos(x: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Return sine and cosine of angles [rad], with the accuracy and range of :func:`sin`.

    The angle is reduced to at most π/4 and kept as a sum of two numbers (Cody and Waite 1980). The
    Taylor series of both functions are evaluated at this sum.
    """
    x = np.asarray(x, np.float64)
    if not np.all(np.abs(x) <= _FARTHEST):
        finite = np.isfinite(x)
        near = np.where(finite, x, 0.0)
        both = sin_cos(np.where(np.abs(near) > _FARTHEST, np.fmod(near, 2 * np.pi), near))
        sine, cosine = (np.where(finite, values, np.nan) for values in both)
        return sine, cosine
    turns = np.rint(x * (2 / np.pi))
    rest, shift = x - turns * _HALF_PI[0], turns * _HALF_PI[1]
    high = rest - shift
    low = (rest - high) - shift - turns * _HALF_PI[2]
    angle = high + low
    low = (high - angle) + low

    square = angle * angle
    half = square / 2
    s = angle + (low * (1 - half) + angle * square * _polynomial(_SIN, square))
    c = 1 - half
    c = c + (((1 - c) - half) + (square * square * _polynomial(_COS, square) - angle * low))
    quarter = turns.astype(np.int64) & 3
    odd = quarter & 1 == 1
    return np.where(odd, c, s) * _SIGNS[quarter], np.where(odd, s, c) * _SIGNS[quarter + 1]


def arctangent(x: np.ndarray) -> np.ndarray:
    """Return the arc tangent of ``x >= 0``, any shape float64, within 2 ulp.

    The kernels use the same rational approximation (Cephes ``atan.c``, S. Moshier).

    Example:
        >>> float(arctangent(np.array([1.0]))[0] * 4)
        3.141592653589793
    """
    large, middle = x > 2.414213562373095, x > 0.66
    offset = np.where(large, np.pi / 2, np.where(middle, np.pi / 4, 0.0))
    above = np.where(large, -1.0, np.where(middle, x - 1.0, x))
    t = above / np.where(large, x, np.where(middle, x + 1.0, 1.0))
    z = t * t
    return offset + (t * (z * _polynomial(_ATAN_P, z) / _polynomial(_ATAN_Q, z)) + t)


_ATAN_P = (
    -8.750608600031904122785e-1,
    -1.615753718733365076637e1,
    -7.500855792314704667340e1,
    -1.228866684490136173410e2,
    -6.485021904942025371773e1,
)
_ATAN_Q = (
    1.0,
    2.485846490142306297962e1,
    1.650270098316988542046e2,
    4.328810604912902668951e2,
    4.853903996359136964868e2,
    1.945506571482613964425e2,
)


def arctan2(y: ArrayLike, x: ArrayLike) -> np.ndarray:
    """Return the angle of vectors ``(x, y)`` from the x axis, from -π to π [rad], within 2 ulp.

    Signed zeros, infinities and NaN are treated as by :func:`numpy.arctan2`.

    Example:
        >>> arctan2([1.0, 0.0, -0.0], [1.0, -1.0, -1.0]).tolist()
        [0.7853981633974483, 3.141592653589793, -3.141592653589793]
    """
    y, x = np.asarray(y, np.float64), np.asarray(x, np.float64)
    rise, run = np.abs(y), np.abs(x)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        slope = rise / run
    # the quotient is NaN if both are 0 or infinite
    slope = np.where(rise == run, np.where(rise > 0, 1.0, 0.0), slope)
    angle = arctangent(slope)
    return np.copysign(np.where(np.signbit(x), np.pi - (angle - _PI_LOW), angle), y)


def hypot(x: ArrayLike, y: ArrayLike) -> np.ndarray:
    """Return the length of vectors ``(x, y)``, within 1 ulp, without intermediate overflow.

    Example:
        >>> hypot([3.0, 3e300], [4.0, 4e300]).tolist()
        [5.0, 5e+300]
    """
    x, y = np.asarray(x, np.float64), np.asarray(y, np.float64)
    with np.errstate(over="ignore"):
        square = x * x + y * y
    if np.all((square > 2.0**-900) & (square < 2.0**1000)):  # nearly always: needs no scaling
        return np.sqrt(square)
    x, y = np.abs(x), np.abs(y)
    most = np.maximum(x, y)
    scale = np.where(most > 2.0**500, 2.0**-600, np.where(most < 2.0**-500, 2.0**600, 1.0))
    x, y = x * scale, y * scale
    return np.sqrt(x * x + y * y) / scale


def log(x: ArrayLike) -> np.ndarray:
    """Return the natural logarithm, within 1 ulp; -infinity for 0, NaN for negative numbers.

    The logarithm of the fraction ``1 + f`` between √½ and √2 is a series in ``s = f / (2 + f)``.

    Example:
        >>> log([1.0, 2.0, 0.0]).tolist()
        [0.0, 0.6931471805599453, -inf]
    """
    x = np.asarray(x, np.float64)
    regular = (x > 0) & (x < np.inf)
    fraction, exponent = np.frexp(np.where(regular, x, 1.0))
    low = fraction < math.sqrt(0.5)
    f = np.where(low, 2 * fraction, fraction) - 1
    k = np.where(low, exponent - 1, exponent).astype(np.float64)
    s, half = f / (2 + f), f * f / 2
    square = s * s
    tail = s * (half + square * _polynomial(_LOG, square)) + k * _LN2[1]
    result = k * _LN2[0] - ((half - tail) - f)
    return np.where(regular, result, np.where(x == 0, -np.inf, np.where(x > 0, np.inf, np.nan)))


def dot(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Return the scalar product along the last axis, summed from the first component on."""
    a, b = np.asarray(a), np.asarray(b)
    total = a[..., 0] * b[..., 0]
    for i in range(1, a.shape[-1]):
        total = total + a[..., i] * b[..., i]
    return total


def norm(a: ArrayLike) -> np.ndarray:
    """Return the Euclidean norm along the last axis, by :func:`dot`."""
    return np.sqrt(dot(a, a))


def matmul(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """Return the product of matrices ``(..., N, K)`` and ``(..., K, M)``, summed in order of K.

    Example:
        >>> matmul([[1.0, 2.0], [3.0, 4.0]], [[1.0, 0.0], [0.0, -1.0]]).tolist()
        [[1.0, -2.0], [3.0, -4.0]]
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    total = a[..., :, :1] * b[..., :1, :]
    for i in range(1, a.shape[-1]):
        total = total + a[..., :, i : i + 1] * b[..., i : i + 1, :]
    return total


def mean(values: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray:
    """Return the mean along the first axis, optionally weighted, summed from the first value on.

    Args:
        values: Values ``(N, ...)``, ``N`` at least 1.
        weights: Weights ``(N,)``, not all 0.
    """
    values = np.asarray(values, np.float64)
    if weights is None:
        return np.add.accumulate(values, axis=0)[-1] / len(values)
    weights = np.asarray(weights, np.float64)
    shape = (-1,) + (1,) * (values.ndim - 1)
    total = np.add.accumulate(weights.reshape(shape) * values, axis=0)[-1]
    return total / np.add.accumulate(weights)[-1]


def median(values: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the median, for an even count the mean of both middle values; never a negative zero.

    Zeros of both signs compare equal, so which of them is in the middle depends on NumPy's sorting
    algorithm; the sign is therefore removed.
    """
    return np.median(values, axis=axis) + 0.0


def _polynomial(coefficients: tuple[float, ...], x: np.ndarray) -> np.ndarray:
    """Evaluate a polynomial by Horner's rule, with the highest-order coefficient first."""
    value = coefficients[0] * x + coefficients[1]
    for c in coefficients[2:]:
        value = value * x + c
    return value
