"""Simulated logs with exact truth: a robot with a RealSense-like camera in a furnished room.

>>> from jaxdet.sim import SimConfig, simulate
>>> frame = next(simulate(SimConfig(scene="single_box", width=64, height=48)))
>>> frame.color.shape, frame.depth.dtype
((48, 64, 3), dtype('uint16'))

``write_log(path, SimConfig(...))`` makes a ROS 2 MCAP file of it, ``load_truth(path)`` reads the
truth beside it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.sim.config import SimConfig
    from jaxdet.sim.frames import SimFrame, simulate
    from jaxdet.sim.record import write_log
    from jaxdet.sim.scenes import SCENES, load_scene
    from jaxdet.sim.sensor import DepthSensor
    from jaxdet.sim.truth import Truth, load_obstacle_ids, load_truth, truth_path

_HOMES = {
    "SCENES": "scenes",
    "DepthSensor": "sensor",
    "SimConfig": "config",
    "SimFrame": "frames",
    "Truth": "truth",
    "load_obstacle_ids": "truth",
    "load_scene": "scenes",
    "load_truth": "truth",
    "simulate": "frames",
    "truth_path": "truth",
    "write_log": "record",
}

__all__ = [
    "SCENES",
    "DepthSensor",
    "SimConfig",
    "SimFrame",
    "Truth",
    "load_obstacle_ids",
    "load_scene",
    "load_truth",
    "simulate",
    "truth_path",
    "write_log",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
