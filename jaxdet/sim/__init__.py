"""Simulated logs with exact truth: a robot with a RealSense-like camera among obstacles.

>>> from jaxdet.sim import SimConfig, simulate
>>> frame = next(simulate(SimConfig(scene="single_box", width=64, height=48)))
>>> frame.color.shape, frame.depth.dtype
((48, 64, 3), dtype('uint16'))

``write_log(path, SimConfig(...))`` makes a ROS 2 MCAP file of it, ``load_truth(path)`` reads the
truth beside it. ``sample_frames("mixed", seed=0, count=100, light="dim")`` draws single frames of a
family of scenes, ``frame_truth(frame)`` has their truth.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.sim.config import SimConfig
    from jaxdet.sim.exposure import LIGHTS, ColorSensor
    from jaxdet.sim.families import DISTANCES_M, FAMILIES, make_scene
    from jaxdet.sim.frames import SimFrame, simulate
    from jaxdet.sim.record import write_log
    from jaxdet.sim.render import PixelKind, Rendering
    from jaxdet.sim.sampling import sample_frames
    from jaxdet.sim.scene import Scene
    from jaxdet.sim.scenefile import read_scene, write_scene
    from jaxdet.sim.scenes import SCENES, load_scene
    from jaxdet.sim.sensor import DepthSensor
    from jaxdet.sim.truth import (
        Truth,
        frame_truth,
        load_depths,
        load_obstacle_ids,
        load_truth,
        to_camera,
        truth_path,
    )

_HOMES = {
    "DISTANCES_M": "families",
    "FAMILIES": "families",
    "LIGHTS": "exposure",
    "SCENES": "scenes",
    "ColorSensor": "exposure",
    "DepthSensor": "sensor",
    "PixelKind": "render",
    "Rendering": "render",
    "Scene": "scene",
    "SimConfig": "config",
    "SimFrame": "frames",
    "Truth": "truth",
    "frame_truth": "truth",
    "load_depths": "truth",
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
    "DISTANCES_M",
    "FAMILIES",
    "LIGHTS",
    "SCENES",
    "ColorSensor",
    "DepthSensor",
    "PixelKind",
    "Rendering",
    "Scene",
    "SimConfig",
    "SimFrame",
    "Truth",
    "frame_truth",
    "load_depths",
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
