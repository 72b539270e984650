"""Obstacles made of points: the paper's method, step by step."""

from jaxdet.config import Config
from jaxdet.floor.plane import plane_in_color
from jaxdet.reference._align import align
from jaxdet.reference._cluster import cluster
from jaxdet.reference._features import features
from jaxdet.reference._footprint import footprint
from jaxdet.reference._ground import ground
from jaxdet.types import Detections, Frames, GroundPlane, Points


def clusters(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Align depth, drop the floor, find corners, cluster them by gaps and outline the clusters.

    Args:
        frames: ``B`` frames with colour; their ``plane`` is not used.
        plane: Floor of each frame.
        config: Configuration of the method; ``cluster.points`` is True.
    """
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    plane = plane_in_color(plane, calibration)
    keep = ground(align(frames.depth, calibration), plane, calibration, config)
    assert frames.color is not None
    corners = features(frames.color, keep, calibration, config.features)
    labels = cluster(corners, unit, config)
    obstacles = footprint(corners, labels, plane, unit, config)
    return Detections(
        labels.num_obstacles,
        corners.overflow,
        keep.has_depth,
        obstacles,
        points=Points(corners, labels),
    )
