"""Clustering of points into obstacles: the paper's method, step by step."""

from jaxdet.config import Config
from jaxdet.floor.plane import depth_range, plane_in_color
from jaxdet.reference.paper._cluster import cluster
from jaxdet.reference.paper._features import features
from jaxdet.reference.paper._footprint import footprint
from jaxdet.reference.paper._ground import ground
from jaxdet.types import Detections, Frames, GroundPlane, Points


def detect(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Detect corners, drop those on the floor, cluster the others by gaps and measure the clusters.

    Args:
        frames: ``B`` frames with colour; their ``plane`` is not used.
        plane: Floor of each frame.
        config: Configuration of the method; ``cluster.points`` is True.
    """
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    plane = plane_in_color(plane, calibration)
    assert frames.color is not None
    corners = features(frames.color, frames.depth, calibration, config.features)
    corners = ground(corners, plane, calibration, config)
    labels = cluster(corners, unit, config)
    obstacles = footprint(corners, labels, plane, unit, config)
    nearest, farthest = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    in_range = (frames.depth >= nearest) & (frames.depth <= farthest)
    return Detections(
        labels.num_obstacles,
        corners.overflow,
        in_range.any(axis=(1, 2)),
        obstacles,
        points=Points(corners, labels),
    )
