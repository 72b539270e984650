"""``Detector``: obstacle detection in frames in memory, singly or in batches."""

from jaxdet.detector.detector import Detector
from jaxdet.detector.result import BatchResult, FrameResult, FreeFloorLine, Obstacle

__all__ = ["BatchResult", "Detector", "FrameResult", "FreeFloorLine", "Obstacle"]
