"""Obstacles made of points: the paper's method, step by step."""

from jaxdet.config import Config
from jaxdet.reference._align import align
from jaxdet.reference._cluster import cluster
from jaxdet.reference._features import features
from jaxdet.reference._footprint import footprint
from jaxdet.reference._ground import ground
from jaxdet.types import Detections, Frames, GroundPlane


def clusters(frames: Frames, plane: GroundPlane, config: Config) -> Detections:
    """Aligns, drops the floor, finds corners, clusters them by gaps and outlines the clusters.

    Args:
        frames: ``B`` of them; their ``plane`` is not used.
        plane: The floor of each frame.
        config: The method; ``cluster.points`` is on.
    """
    calibration, unit = frames.calibration, frames.calibration.depth_unit
    keep = ground(align(frames.depth, calibration), plane, calibration, config)
    points = features(frames.color, keep, calibration, config.features)
    labels = cluster(points, unit, config)
    obstacles = footprint(points, labels, plane, unit, config)
    return Detections(points, labels, obstacles, keep.has_depth)
