"""librealsense's ``rs.align`` run offline, through its software device.

Follows librealsense's example ``align-with-software-device.py``.
"""

import itertools
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from jaxdet.types import Calibration, Distortion, Intrinsics

rs: Any = import_module("pyrealsense2")

_MODELS = {
    Distortion.NONE: rs.distortion.none,
    Distortion.INVERSE_BROWN_CONRADY: rs.distortion.inverse_brown_conrady,
}


def align(depth: np.ndarray, calibration: Calibration) -> np.ndarray:
    """Return one depth image ``(Hd, Wd)`` uint16 aligned to colour, ``(H, W)`` uint16."""
    return aligned(aligner(), framesets(depth[None], calibration))[0]


def aligner() -> Callable[[Any], Any]:
    """Return librealsense's block for alignment; it keeps its tables from frame to frame."""
    return rs.align(rs.stream.color).process


def aligned(process: Callable[[Any], Any], pairs: list[Any]) -> np.ndarray:
    """Return the result of :func:`framesets` aligned to colour, ``(B, H, W)`` uint16."""
    return np.stack([process(pair).get_depth_frame().get_data() for pair in pairs])


def framesets(depth: np.ndarray, calibration: Calibration) -> list[Any]:
    """Return depth images ``(B, Hd, Wd)`` uint16, each paired with a black colour image."""
    device = rs.software_device()
    sensors = device.add_sensor("Depth"), device.add_sensor("Color")
    sensors[0].add_read_only_option(rs.option.depth_units, calibration.depth_unit)
    profiles = [
        _add_stream(sensors[0], rs.stream.depth, 1, calibration.depth, rs.format.z16, 2),
        _add_stream(sensors[1], rs.stream.color, 2, calibration.color, rs.format.rgb8, 3),
    ]
    motion = rs.extrinsics()
    motion.rotation = np.reshape(calibration.color_from_depth.rotation, (3, 3)).T.ravel().tolist()
    motion.translation = list(calibration.color_from_depth.translation)
    profiles[0].register_extrinsics_to(profiles[1], motion)
    device.create_matcher(rs.matchers.default)
    syncer = rs.syncer()
    black = np.zeros((calibration.color.height, calibration.color.width, 3), np.uint8)
    for sensor, profile in zip(sensors, profiles, strict=True):
        sensor.open(profile)
        sensor.start(syncer)
    numbers = itertools.count(1)

    def send(*images: np.ndarray) -> Any:
        for number in itertools.islice(numbers, 9):
            for sensor, profile, image in zip(sensors, profiles, images, strict=True):
                sensor.on_video_frame(_frame(image, profile, calibration.depth_unit, number))
            pair = syncer.wait_for_frames()
            if pair.size() == 2 and pair.get_depth_frame().get_frame_number() == number:
                pair.keep()
                return pair
        raise RuntimeError("the syncer returned no pair of images")

    try:
        return [send(image, black) for image in depth]
    finally:
        for sensor in sensors:
            sensor.stop()
            sensor.close()


def _add_stream(sensor, kind, uid, camera: Intrinsics, form, bpp):
    intrinsics = rs.intrinsics()
    intrinsics.width, intrinsics.height = camera.width, camera.height
    intrinsics.fx, intrinsics.fy = camera.fx, camera.fy
    intrinsics.ppx, intrinsics.ppy = camera.cx, camera.cy
    intrinsics.model = _MODELS[camera.distortion]
    intrinsics.coeffs = [*camera.coefficients, *[0.0] * (5 - len(camera.coefficients))]
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid, stream.fps = kind, 0, uid, 30
    stream.width, stream.height, stream.bpp, stream.fmt = camera.width, camera.height, bpp, form
    stream.intrinsics = intrinsics
    return rs.video_stream_profile(sensor.add_video_stream(stream))


def _frame(image: np.ndarray, profile, depth_unit: float, number: int):
    frame = rs.software_video_frame()
    frame.pixels = np.ascontiguousarray(image)
    frame.stride, frame.bpp = image.strides[0], image.strides[1]
    frame.timestamp, frame.domain = 33.0 * number, rs.timestamp_domain.system_time
    frame.frame_number, frame.profile = number, profile
    frame.depth_units = depth_unit
    return frame
