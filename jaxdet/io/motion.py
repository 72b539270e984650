"""Rigid motions over time: quaternions, matrices, and interpolation between samples."""

from array import array
from copy import copy

import numpy as np

from jaxdet.elementary import arctan2, dot, matmul, norm, sin
from jaxdet.io.messages import TransformMessage

MARGIN_S = 0.05
"""Maximum time before the first or after the last sample at which this sample is used [s]."""
MAX_GAP_S = 1.0
"""Maximum time between two samples for interpolation [s]."""


class MotionSamples:
    """Samples of the motion of one frame in another, in any order; 72 bytes per sample.

    Attributes:
        num_first: Number of samples from the first messages of their topic; they come first.
    """

    def __init__(self) -> None:
        self.num_first = 0
        self._stamps = array("q")
        self._log_times = array("q")
        self._values = array("d")
        self._in_order: tuple[np.ndarray, np.ndarray] | None = None

    def __len__(self) -> int:
        return len(self._stamps)

    def add(
        self,
        stamp_ns: int,
        translation: tuple[float, float, float],
        rotation: tuple[float, float, float, float],
        log_ns: int = 0,
        *,
        is_first: bool = False,
    ) -> None:
        """Add a sample.

        Args:
            stamp_ns: Header timestamp [ns].
            translation: Translation [m].
            rotation: Unit quaternion x y z w.
            log_ns: Log time [ns].
            is_first: Whether it is from one of the first messages of its topic.
        """
        self._in_order = None
        self.num_first += is_first
        self._stamps.append(stamp_ns)
        self._log_times.append(log_ns)
        self._values.extend(translation)
        self._values.extend(rotation)

    @property
    def values(self) -> np.ndarray:
        """Samples in order of arrival, ``(N, 7)`` float64: tx ty tz qx qy qz qw."""
        return np.array(self._values, np.float64).reshape(-1, 7)

    def is_constant(self) -> bool:
        """Return whether there are two or more samples, and all are equal."""
        values = self.values
        return len(values) > 1 and bool(np.allclose(values, values[0], rtol=0, atol=1e-9))

    def is_like(self, message: TransformMessage, number: int) -> bool:
        """Return whether a transform equals the sample with this number; -1: the last sample."""
        value = np.array([*message.translation, *message.rotation])
        known = self._values[7 * number : 7 * number + 7 or None]
        return bool(np.allclose(value, known, rtol=0, atol=1e-9))

    @property
    def stamps_ns(self) -> np.ndarray:
        """Timestamps in order of arrival, ``(N,)`` int64 [ns]."""
        return np.array(self._stamps, np.int64)

    @property
    def log_ns(self) -> np.ndarray:
        """Log times in order of arrival, ``(N,)`` int64 [ns]."""
        return np.array(self._log_times, np.int64)

    def with_stamps(self, stamps_ns: np.ndarray) -> "MotionSamples":
        """Return a copy with other timestamps, ``(N,)`` int64 [ns]."""
        found = copy(self)
        found._stamps, found._in_order = array("q", stamps_ns.tolist()), None
        return found

    def at(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Interpolate, see :func:`interpolate`; of samples with equal times, the last is used."""
        if self._in_order is None:
            stamps = self.stamps_ns
            order = np.argsort(stamps, kind="stable")
            last = np.append(np.diff(stamps[order]) > 0, True)[: len(order)]
            kept = order[last]
            self._in_order = stamps[kept], self.values[kept]
        return interpolate(stamps_ns, *self._in_order)


def interpolate(stamps_ns: np.ndarray, sample_ns: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Interpolate motions: linearly in translation, on the shortest arc in rotation (slerp).

    There is no extrapolation. Up to ``MARGIN_S`` beyond the ends the nearest sample is returned;
    farther away, and between samples more than ``MAX_GAP_S`` apart, the motion is unknown.

    Args:
        stamps_ns: Query times ``(F,)`` int64 [ns].
        sample_ns: Times of the samples ``(N,)`` int64, strictly increasing [ns].
        samples: Samples ``(N, 7)`` float64, tx ty tz [m] and unit quaternion qx qy qz qw.

    Returns:
        Motions ``(F, 4, 4)`` float64; NaN if unknown.
    """
    if not len(sample_ns):
        return np.full((len(stamps_ns), 4, 4), np.nan)
    margin = round(MARGIN_S * 1e9)
    known = (stamps_ns >= sample_ns[0] - margin) & (stamps_ns <= sample_ns[-1] + margin)
    wanted = np.clip(stamps_ns, sample_ns[0], sample_ns[-1])
    after = np.clip(np.searchsorted(sample_ns, wanted), 0, len(sample_ns) - 1)
    before = np.maximum(after - 1, 0)
    before = np.where(sample_ns[after] == wanted, after, before)
    span = sample_ns[after] - sample_ns[before]
    known &= span <= round(MAX_GAP_S * 1e9)
    share = (wanted - sample_ns[before]) / np.maximum(span, 1)
    first, second = samples[before], samples[after]
    translation = first[:, :3] + share[:, None] * (second[:, :3] - first[:, :3])
    rotation = _slerp(first[:, 3:], second[:, 3:], share)
    T = motion_matrix(translation, rotation)
    T[~known] = np.nan
    return T


def motion_matrix(translation: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    """Return ``(..., 4, 4)`` float64 matrices for translations ``(..., 3)`` [m] and quaternions.

    The quaternions ``(..., 4)`` are x y z w and need not have exactly unit length.
    """
    translation, q = np.asarray(translation, np.float64), np.asarray(quaternion, np.float64)
    x, y, z, w = np.moveaxis(q / norm(q)[..., None], -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    T = np.zeros((*q.shape[:-1], 4, 4))
    T[..., :3, :3] = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    T[..., :3, 3] = translation
    T[..., 3, 3] = 1
    return T


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """Convert rotation matrices to unit quaternions.

    The largest component is computed from the diagonal, to avoid division by small numbers
    (Shepperd 1978).

    Args:
        rotations: Rotation matrices ``(..., 3, 3)`` float64, NaN if unknown.

    Returns:
        Quaternions ``(..., 4)`` float64, x y z w with w at least 0; NaN if unknown.
    """
    R = rotations
    xx, yy, zz = R[..., 0, 0], R[..., 1, 1], R[..., 2, 2]
    x = R[..., 2, 1] - R[..., 1, 2], R[..., 1, 0] + R[..., 0, 1], R[..., 0, 2] + R[..., 2, 0]
    y = R[..., 0, 2] - R[..., 2, 0], x[1], R[..., 2, 1] + R[..., 1, 2]
    z = R[..., 1, 0] - R[..., 0, 1], x[2], y[2]
    # Row i is the quaternion times four times its component i.
    rows = [
        [1 + xx - yy - zz, x[1], x[2], x[0]],
        [x[1], 1 - xx + yy - zz, y[2], y[0]],
        [x[2], y[2], 1 - xx - yy + zz, z[0]],
        [x[0], y[0], z[0], 1 + xx + yy + zz],
    ]
    all_rows = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.argmax(np.diagonal(all_rows, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(all_rows, largest[..., None, None], axis=-2)[..., 0, :]
    q = q / norm(q)[..., None]
    return np.where(q[..., 3:] < 0, -q, q)


def inverse(T: np.ndarray) -> np.ndarray:
    """Return the inverse of rigid motions ``(..., 4, 4)``."""
    rotation = np.swapaxes(T[..., :3, :3], -1, -2)
    result = np.zeros_like(T)
    result[..., :3, :3] = rotation
    result[..., :3, 3] = -dot(rotation, T[..., None, :3, 3])
    result[..., 3, 3] = T[..., 3, 3]
    return result


def difference(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Return the distance [m] and the angle [rad] between two rigid motions ``(4, 4)``."""
    delta = matmul(inverse(first), second)
    skew = delta[:3, :3] - delta[:3, :3].T
    sine = norm([skew[2, 1], skew[0, 2], skew[1, 0]]) / 2
    angle = arctan2(sine, (np.trace(delta[:3, :3]) - 1) / 2)
    return float(norm(first[:3, 3] - second[:3, 3])), float(angle)


def _slerp(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    cosine = dot(first, second)
    second = np.where(cosine[:, None] < 0, -second, second)
    cosine = np.clip(np.abs(cosine), 0, 1)
    sine = np.sqrt((1 - cosine) * (1 + cosine))
    shares = np.stack([1 - share, share])
    curved = sin(shares * arctan2(sine, cosine)) / np.where(sine > 1e-6, sine, 1.0)
    weights = np.where(sine > 1e-6, curved, shares)[..., None]
    return weights[0] * first + weights[1] * second
