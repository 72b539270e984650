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

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
