"""Preprocessed frames, the input of all methods, and conversion of labels to detections."""

from dataclasses import replace
from typing import Literal, NamedTuple

import cv2
import numpy as np

from jaxdet import reference
from jaxdet.camera import fixed_rays
from jaxdet.config import MAX_POINTS, Config, FeaturesConfig
from jaxdet.floor.plane import down_vector, forward_vector, plane_in_color
from jaxdet.pipeline import find_floors
from jaxdet.reference._rounding import lateral
from jaxdet.reference.paper._canny import canny, grey
from jaxdet.reference.paper._ground import above_floor
from jaxdet.types import (
    Calibration,
    Detections,
    Features,
    Frames,
    GroundPlane,
    Labels,
    Points,
)

GRID_COLUMNS = 80
"""Number of columns of the grid of pixels that are points in addition to the corners."""
Space = Literal["xz", "xyz", "frame", "image"]


class Frame(NamedTuple):
    """Frame after alignment, ground removal and feature extraction by the reference's stages."""

    color: np.ndarray
    """Image ``(H, W, 3)`` uint8, RGB."""
    z: np.ndarray
    """Depth image ``(H, W)`` uint16 in the colour camera, with the depth of the features [depth
    units].
    """
    keep: np.ndarray
    """Mask ``(H, W)`` bool of the pixels in range and above the floor."""
    features: Features
    """Features of the frame, ``B = 1``."""
    plane: GroundPlane
    """Floor relative to the colour camera, ``B = 1``."""
    calibration: Calibration


def prepare(frames: Frames, config: Config | None = None) -> list[Frame]:
    """Run the reference's stages before clustering on a batch, without padding frames.

    The floor of each frame is found as by :func:`jaxdet.detect`. Points are the default's corners,
    and a grid of pixels with ``GRID_COLUMNS`` columns, so that surfaces without corners have points
    too; both only where pixels are above the floor.

    Args:
        frames: Batch of frames with colour; ``plane`` is the prior of each frame's floor, or None
            for the configuration's.
        config: Range, floor and feature parameters.
    """
    config, calibration = config or Config(), frames.calibration
    assert frames.color is not None
    found = find_floors(frames, config, backend="reference").plane
    plane = color_plane(found, calibration)
    z = reference.paper.align(frames.depth, calibration).z
    keep = above_floor(z, plane, calibration, config)
    features = _points(frames.color, z, keep, calibration, config.features)
    return [
        Frame(
            frames.color[b],
            z[b],
            keep[b],
            Features(*(a[b : b + 1] for a in features)),
            GroundPlane(*(a[b : b + 1] for a in plane)),
            calibration,
        )
        for b in np.flatnonzero(frames.valid)
    ]


def color_plane(plane: GroundPlane, calibration: Calibration) -> GroundPlane:
    """Convert floors with ramps from the depth camera to the colour camera."""
    motion = calibration.color_from_depth
    if motion is None:
        return plane
    center = -motion.T[:3, :3].T @ motion.T[:3, 3]  # of the colour camera, seen from the depth one
    ahead = forward_vector(down_vector(plane.pitch, plane.roll)) @ center
    start, slope = plane.ramp_start - ahead, plane.ramp_slope
    return plane_in_color(plane, calibration)._replace(ramp_start=start, ramp_slope=slope)


def _points(
    color: np.ndarray,
    z: np.ndarray,
    keep: np.ndarray,
    calibration: Calibration,
    config: FeaturesConfig,
) -> Features:
    """Return corners, then a grid of pixels with equal spacing, both only above the floor."""
    batch, height, width = keep.shape
    step = max(1, round(width / GRID_COLUMNS))
    v, u = np.mgrid[step // 2 : height : step, step // 2 : width : step].reshape(2, -1)
    uv = np.zeros((2, batch, config.max_corners + u.size), np.int32)
    valid = np.zeros(uv.shape[1:], bool)
    for b in range(batch):
        corners = _corners(color[b], keep[b], config)
        uv[:, b, : len(corners)], valid[b, : len(corners)] = corners.T, True
    uv[:, :, config.max_corners :] = np.stack([u, v])[:, None]
    u, v = uv
    frame = np.arange(batch)[:, None]
    valid[:, config.max_corners :] = keep[frame, v, u][:, config.max_corners :]
    depth = np.where(valid, z[frame, v, u], 0).astype(np.int32)
    x, y = (lateral(ray[v, u], depth) for ray in fixed_rays(calibration.image))
    return Features(u, v, x, y, depth, valid, valid, overflow=np.zeros(batch, bool))


def _corners(color: np.ndarray, keep: np.ndarray, config: FeaturesConfig) -> np.ndarray:
    """Return column and row ``(n, 2)`` of OpenCV's corners above the floor."""
    edges = canny(grey(color), config.canny_low, config.canny_high)
    selection = config.max_corners, config.quality_level, config.min_distance
    found = cv2.goodFeaturesToTrack(edges, *selection, mask=keep.astype(np.uint8))
    return np.zeros((0, 2), np.int32) if found is None else found[:, 0].astype(np.int32)


def points_of(frame: Frame, space: Space = "xz") -> np.ndarray:
    """Return the features above the floor, ``(n, 2)`` x z or ``(n, 3)`` x y z [m]."""
    features, kept = frame.features, frame.features.kept[0]
    axes = (features.x, features.z) if space == "xz" else (features.x, features.y, features.z)
    return np.stack([a[0, kept] for a in axes], axis=-1) * frame.calibration.depth_unit


def ordered(labels: np.ndarray, z: np.ndarray, x: np.ndarray, min_points: int) -> np.ndarray:
    """Remove clusters that are too small and number the others like :mod:`jaxdet`, for all methods.

    Args:
        labels: Labels ``(n,)`` integer, negative = noise.
        z: Forward coordinates ``(n,)``.
        x: Lateral coordinates ``(n,)``.
        min_points: Clusters of this many points or fewer become noise.

    Returns:
        Labels ``(n,)`` int32, in the order of the clusters' smallest z, then smallest x; -1 =
        noise.
    """
    out = np.full(len(labels), -1, np.int32)
    names, sizes = np.unique(labels[labels >= 0], return_counts=True)
    sets = [np.flatnonzero(labels == name) for name in names[sizes > min_points]]
    sets.sort(key=lambda s: (z[s].min(), x[s].min()))
    for number, members in enumerate(sets):
        out[members] = number
    return out


def labels_at(image: np.ndarray, u: np.ndarray, v: np.ndarray, tolerance: int = 2) -> np.ndarray:
    """Return the label of each feature in a label image.

    Args:
        image: Labels ``(H, W)`` int32, -1 = none.
        u: Columns ``(n,)`` of the features.
        v: Rows ``(n,)`` of the features.
        tolerance: A feature on a pixel without label gets the nearest label that is at most this
            many rows and columns away [pixel].

    Returns:
        Labels ``(n,)`` int32.
    """
    reach = np.arange(-tolerance, tolerance + 1)
    dv, du = (a.ravel() for a in np.meshgrid(reach, reach, indexing="ij"))
    order = np.argsort(du * du + dv * dv, kind="stable")
    padded = np.pad(image, tolerance, constant_values=-1)
    around = padded[v[:, None] + dv[order] + tolerance, u[:, None] + du[order] + tolerance]
    first = np.argmax(around >= 0, axis=1)
    return np.take_along_axis(around, first[:, None], 1)[:, 0].astype(np.int32)


def detections_of(frame: Frame, labels: np.ndarray, config: Config) -> Detections:
    """Convert labels of one frame to detections, with outlines by the reference's last stage.

    Args:
        frame: The frame.
        labels: Labels ``(n,)`` integer of its ``n`` features above the floor.
        config: Configuration of the minimum size and the outlines.
    """
    features = frame.features
    kept = features.kept[0]
    full = np.full(features.z.shape, -1, np.int32)
    z, x = features.z[0, kept], features.x[0, kept]
    full[0, kept] = ordered(labels, z, x, config.cluster.min_points)
    number = (full.max(axis=1, initial=-1) + 1).astype(np.int32)
    roomy = replace(config, features=replace(config.features, max_corners=MAX_POINTS))
    unit, marked = frame.calibration.depth_unit, Labels(full, number)
    obstacles = reference.paper.footprint(features, marked, frame.plane, unit, roomy)
    return Detections(
        number,
        features.overflow,
        np.array([frame.keep.any()]),
        obstacles,
        points=Points(features, marked),
    )
