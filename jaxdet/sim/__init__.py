"""Simulated logs with exact ground truth: a robot with a RealSense-like camera among obstacles.

>>> from jaxdet.sim import SimConfig, simulate
>>> frame = next(simulate(SimConfig(scene="single_box", width=64, height=48)))
>>> frame.color.shape, frame.depth.dtype
((48, 64, 3), dtype('uint16'))

``write_log(path, SimConfig(...))`` writes a ROS 2 MCAP file, ``load_truth(path)`` reads its ground
truth. ``sample_frames("mixed", seed=0, count=100, light="dim")`` draws single frames of a family of
scenes, ``frame_truth(frame)`` returns their ground truth, ``floor_truth(frame)`` the drivable
floor. ``sample_frames("corridor", 0, 100, depth_error=1.0, mount_pitch_error_rad=0.01)`` is harder:
walls in range, depth errors of a real camera, an error of the mount in TF.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.sim.config import SimConfig
    from jaxdet.sim.drivable import EDGE_BEARINGS_RAD, FloorTruth, floor_edge, floor_truth
    from jaxdet.sim.exposure import LIGHTS, ColorSensor
    from jaxdet.sim.families import DISTANCES_M, FAMILIES, HARD_FAMILIES, make_scene
    from jaxdet.sim.frames import SimFrame, simulate
    from jaxdet.sim.record import write_log
    from jaxdet.sim.render import PixelKind, Rendering
    from jaxdet.sim.sampling import sample_frames
    from jaxdet.sim.scene import Scene
    from jaxdet.sim.scenefile import read_scene, write_scene
    from jaxdet.sim.scenes import SCENES, load_scene
    from jaxdet.sim.stereo import D435_LIKE, DepthSensor
    from jaxdet.sim.truth import (
        Truth,
        frame_truth,
        load_depths,
        load_drivable,
        load_obstacle_ids,
        load_truth,
        to_camera,
        truth_path,
    )

_HOMES = {
    "D435_LIKE": "stereo",
    "DISTANCES_M": "families",
    "EDGE_BEARINGS_RAD": "drivable",
    "FAMILIES": "families",
    "FloorTruth": "drivable",
    "HARD_FAMILIES": "families",
    "LIGHTS": "exposure",
    "SCENES": "scenes",
    "ColorSensor": "exposure",
    "DepthSensor": "stereo",
    "PixelKind": "render",
    "Rendering": "render",
    "Scene": "scene",
    "SimConfig": "config",
    "SimFrame": "frames",
    "Truth": "truth",
    "floor_edge": "drivable",
    "floor_truth": "drivable",
    "frame_truth": "truth",
    "load_depths": "truth",
    "load_drivable": "truth",
    "load_obstacle_ids": "truth",
    "load_scene": "scenes",
    "load_truth": "truth",
    "make_scene": "families",
    "read_scene": "scenefile",
    "sample_frames": "sampling",
    "simulate": "frames",
    "to_camera": "truth",
    "truth_path": "truth",
    "write_log": "record",
    "write_scene": "scenefile",
}

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


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
