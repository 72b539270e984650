"""Detect obstacles in the images of a live depth camera.

The source is any iterator of depth images (uint16). :func:`realsense` returns one for Intel's
cameras; it needs ``pip install pyrealsense2``.
"""

import time
from collections.abc import Iterable, Iterator

import numpy as np

import jaxdet


def watch(source: Iterable[np.ndarray], detector: jaxdet.Detector, stop_at_m: float = 0.5) -> None:
    """Print the distance of the nearest obstacle and the processing time of each image."""
    for number, depth in enumerate(source):
        start = time.perf_counter()
        found = detector(depth)
        ms = 1000 * (time.perf_counter() - start)
        near = "nothing" if found.nearest_m is None else f"nearest {found.nearest_m:.2f} m"
        stop = found.nearest_m is not None and found.nearest_m < stop_at_m
        print(f"frame {number}: {len(found)} obstacles, {near}, {ms:.1f} ms{'  STOP' * stop}")


def realsense() -> tuple[np.ndarray, float, Iterator[np.ndarray]]:
    """Return the camera matrix, the depth unit [m], and an endless iterator of depth images."""
    import pyrealsense2 as rs

    pipeline, config = rs.pipeline(), rs.config()
    config.enable_stream(rs.stream.depth, 640, 480, rs.format.z16, 30)
    profile = pipeline.start(config)
    camera = profile.get_stream(rs.stream.depth).as_video_stream_profile().get_intrinsics()
    unit = profile.get_device().first_depth_sensor().get_depth_scale()  # a D405 has 0.0001
    K = np.array([[camera.fx, 0, camera.ppx], [0, camera.fy, camera.ppy], [0, 0, 1]])

    def frames() -> Iterator[np.ndarray]:
        while True:
            yield np.asanyarray(pipeline.wait_for_frames().get_depth_frame().get_data())

    return K, unit, frames()


if __name__ == "__main__":
    matrix, unit, source = realsense()
    watch(source, jaxdet.Detector(matrix, depth_unit_m=unit, config="d435"))
