"""Obstacles of a live RGB-D camera.

The source is any iterator of colour (BGR) and depth images (uint16, aligned to colour).
``realsense`` is one for Intel's cameras: pip install pyrealsense2.
"""

import time
from collections.abc import Iterable, Iterator

import numpy as np

import jaxdet

Frame = tuple[np.ndarray, np.ndarray]


def watch(source: Iterable[Frame], detector: jaxdet.Detector, stop_at_m: float = 0.5) -> None:
    """Prints what is near, and how long finding it took."""
    for number, (color, depth) in enumerate(source):
        start = time.perf_counter()
        found = detector(color, depth)
        ms = 1000 * (time.perf_counter() - start)
        near = "nothing" if found.nearest_m is None else f"nearest {found.nearest_m:.2f} m"
        stop = found.nearest_m is not None and found.nearest_m < stop_at_m
        print(f"frame {number}: {len(found)} obstacles, {near}, {ms:.1f} ms{'  STOP' * stop}")


def realsense() -> tuple[np.ndarray, float, Iterator[Frame]]:
    """The camera matrix, metres in a unit of depth, and frames for ever."""
    import pyrealsense2 as rs

    pipeline, config = rs.pipeline(), rs.config()
    config.enable_stream(rs.stream.color, 640, 480, rs.format.bgr8, 30)
    config.enable_stream(rs.stream.depth, 640, 480, rs.format.z16, 30)
    profile = pipeline.start(config)
    camera = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
    unit = profile.get_device().first_depth_sensor().get_depth_scale()  # a D405 has 0.0001
    K = np.array([[camera.fx, 0, camera.ppx], [0, camera.fy, camera.ppy], [0, 0, 1]])

    def frames() -> Iterator[Frame]:
        align = rs.align(rs.stream.color)
        while True:
            both = align.process(pipeline.wait_for_frames())
            color, depth = both.get_color_frame(), both.get_depth_frame()
            yield np.asanyarray(color.get_data()), np.asanyarray(depth.get_data())

    return K, unit, frames()


if __name__ == "__main__":
    matrix, unit, source = realsense()
    detector = jaxdet.Detector(matrix, depth_unit_m=unit, color_order="bgr", config="d435")
    watch(source, detector)
