__all__ = [
    "D435_LIKE",
    "DISTANCES_M",
    "EDGE_BEARINGS_RAD",
    "FAMILIES",
    "HARD_FAMILIES",
    "LIGHTS",
    "SCENES",
    "ColorSensor",
    "DepthSensor",
    "FloorTruth",
    "PixelKind",
    "Rendering",
    "Scene",
    "SimConfig",
    "SimFrame",
    "Truth",
    "floor_edge",
    "floor_truth",
    "frame_truth",
    "load_depths",
    "load_drivable",
    "load_obstacle_ids",
    "load_scene",
    "load_truth",
    "make_scene",
    "read_scene",
    "sample_frames",
    "simulate",
    "to_camera",
    "truth_path",
    "write_log",
    "write_scene",
]

from .config import SimConfig
from .drivable import EDGE_BEARINGS_RAD, FloorTruth, floor_edge, floor_truth
from .exposure import LIGHTS, ColorSensor
from .families import DISTANCES_M, FAMILIES, HARD_FAMILIES, make_scene
from .frames import SimFrame, simulate
from .record import write_log
from .render import PixelKind, Rendering
from .sampling import sample_frames
from .scene import Scene
from .scenefile import read_scene, write_scene
from .scenes import SCENES, load_scene
from .stereo import D435_LIKE, DepthSensor
from .truth import (
    Truth,
    frame_truth,
    load_depths,
    load_drivable,
    load_obstacle_ids,
    load_truth,
    to_camera,
    truth_path,
)
