"""Stage 1, align: depth to colour (Eq. 1-4)."""

import numpy as np

from jaxdet.camera import corner_rays, splat_parameters
from jaxdet.reference._lens import project_corners
from jaxdet.types import AlignedDepth, Calibration

NOTHING = np.uint32(0xFFFFFFFF)


def align(depth: np.ndarray, calibration: Calibration) -> AlignedDepth:
    """Project each depth pixel into the colour image; the nearest wins (Eq. 1-4).

    Every depth pixel with a measurement ``Z`` is back-projected with the ray of its corner
    (Eq. 1), moved by ``T_color_depth`` (Eq. 2, 3) and projected (Eq. 4):

        P_dc = Z K_d^-1 P_uv,   P_cc = R P_dc + t,   P_uv^c = K_c (P_cc / Z_cc)

    in float32, every operation rounded separately, so that the pixels equal ``rs.align`` of
    librealsense 2.59. If colour has a higher resolution than depth, the pixel covers the rectangle
    between the projections of its upper left and lower right corners; otherwise only the pixel of
    the upper left corner. Points behind the colour camera are dropped.

    Args:
        depth: Depth images ``(B, Hd, Wd)`` uint16 [depth units], 0 = no measurement.
        calibration: Calibration of the log. Depth that is already aligned is passed through.

    Returns:
        Depth of the nearest hit in the depth camera and its z in the colour camera (on a tie of
        depths the smaller z; at most 65534), both 0 for pixels without a hit.

    Example:
        >>> from jaxdet.types import Extrinsics, Intrinsics
        >>> camera = Intrinsics(4, 3, 2.0, 2.0, 1.5, 1.0)
        >>> still = Extrinsics((1, 0, 0, 0, 1, 0, 0, 0, 1), (0.0, 0.0, 0.0))
        >>> depth = np.zeros((1, 3, 4), np.uint16)
        >>> depth[0, 1, 1:3] = 900, 700
        >>> align(depth, Calibration(camera, camera, still)).depth[0].tolist()
        [[0, 0, 0, 0], [0, 900, 700, 0], [0, 0, 0, 0]]
    """
    if calibration.is_aligned:
        return AlignedDepth(depth, depth)
    keys = np.stack([_align_frame(image, calibration) for image in depth])
    keys = np.where(keys == NOTHING, np.uint32(0), keys)
    return AlignedDepth((keys >> 16).astype(np.uint16), (keys & 0xFFFF).astype(np.uint16))


def _align_frame(depth: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Return the smallest key ``depth << 16 | z`` of each pixel of a frame, ``(H, W)`` uint32."""
    splat = splat_parameters(calibration)
    color = calibration.image
    x, y = corner_rays(calibration.depth)
    v, u = np.nonzero(depth)
    units = depth[v, u]
    left, top, z, seen = project_corners(x[v, u], y[v, u], units, splat)
    right, bottom = left, top
    if splat.fills_corners:
        right, bottom, _, seen_1 = project_corners(x[v + 1, u + 1], y[v + 1, u + 1], units, splat)
        seen &= seen_1
    seen &= (right >= 0) & (bottom >= 0) & (left < color.width) & (top < color.height)
    key = (units.astype(np.uint32) << 16) | z
    keys = np.full((color.height, color.width), NOTHING)
    spans = left, right, top, bottom, key
    _splat(keys, *(a[seen] for a in spans))
    return keys


def _splat(
    keys: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    top: np.ndarray,
    bottom: np.ndarray,
    key: np.ndarray,
) -> None:
    """Lower ``keys`` to ``key`` in each rectangle, inclusive, clipped to the image."""
    height, width = keys.shape
    left, top = np.maximum(left, 0), np.maximum(top, 0)
    right, bottom = np.minimum(right, width - 1), np.minimum(bottom, height - 1)
    for dv in range(int((bottom - top).max(initial=-1)) + 1):
        for du in range(int((right - left).max(initial=-1)) + 1):
            hit = (top + dv <= bottom) & (left + du <= right)
            np.minimum.at(keys, (top[hit] + dv, left[hit] + du), key[hit])
