"""Logs of ``io_helpers`` in the schemas of Foxglove, protobuf and JSON."""

import base64
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_INFO,
    COLOR_K,
    COLOR_SIZE,
    DEPTH,
    DEPTH_FRAME,
    DEPTH_INFO,
    DEPTH_K,
    DEPTH_SIZE,
    SECOND,
    START,
    T_DEPTH_COLOR,
    LogFile,
    Scene,
    matrix9,
)


def write_foxglove(path: Path, scene: Scene, form: str, pose: bool = False) -> Path:
    """Write the log of :func:`write_log` in the schemas of Foxglove; ``form`` is proto or json."""
    with LogFile(path) as log:
        put = put_proto if form == "proto" else put_json
        cameras = (
            (COLOR_INFO, COLOR_SIZE, COLOR_K, COLOR_FRAME),
            (DEPTH_INFO, DEPTH_SIZE, DEPTH_K, DEPTH_FRAME),
        )
        for topic, size, K, frame in cameras:
            fields = {"frame_id": frame, "width": size[0], "height": size[1]}
            fields |= {"distortion_model": "plumb_bob", "D": [0.0] * 5, "K": matrix9(K)}
            put(log, topic, CameraCalibration, fields, START)
        t, q = (_named(item) for item in T_DEPTH_COLOR)
        edge = {"parent_frame_id": DEPTH_FRAME, "child_frame_id": COLOR_FRAME}
        put(log, "/tf", FrameTransform, edge | {"translation": t, "rotation": q}, START)
        for color, depth, at, depth_at in zip(*scene, strict=True):
            put(log, DEPTH, RawImage, _raw_image(depth, "16UC1", DEPTH_FRAME), int(depth_at))
            put(log, COLOR, RawImage, _raw_image(color, "rgb8", COLOR_FRAME), int(at))
            if pose:
                where = {"position": t, "orientation": q}
                put(log, "/pose", PoseInFrame, {"frame_id": "map", "pose": where}, int(at))
    return path


def _named(values: Any) -> dict[str, float]:
    return dict(zip("xyzw", (float(value) for value in values), strict=False))


def _raw_image(pixels: np.ndarray, encoding: str, frame: str) -> dict[str, Any]:
    height, width = pixels.shape[:2]
    fields = {"frame_id": frame, "width": width, "height": height, "encoding": encoding}
    return fields | {"step": pixels.nbytes // height, "data": pixels.tobytes()}


def put_proto(log: LogFile, topic: str, kind: Any, fields: dict[str, Any], at: int) -> None:
    message = kind(**fields)
    message.timestamp.FromNanoseconds(at)
    log.proto(topic, message, at)


def put_json(log: LogFile, topic: str, kind: Any, fields: dict[str, Any], at: int) -> None:
    fields = {
        name: base64.b64encode(value).decode() if isinstance(value, bytes) else value
        for name, value in fields.items()
    }
    sec, nsec = divmod(at, SECOND)
    stamped = {"timestamp": {"sec": sec, "nsec": nsec}, **fields}
    log.json(topic, kind.DESCRIPTOR.full_name, stamped, at)
