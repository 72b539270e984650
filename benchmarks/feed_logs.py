"""Logs of one simulated drive in common recording formats."""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import simplejpeg

from jaxdet.io.writer import Compression, Ros2LogWriter
from jaxdet.io.writer_cdr import header
from jaxdet.sim import SimConfig, SimFrame, simulate
from jaxdet.sim.config import calibration_of
from jaxdet.sim.record import COLOR_FRAME, DEPTH_FRAME, NAMESPACE, static_transforms

CONFIG = SimConfig(scene="demo", frames=16)
"""Simulated scene; its frames are repeated, because the simulator is slower than the code under
test."""
_PERIOD_NS = 33_333_333
_DEPTH_HEAD = struct.Struct("<iff")


class Form(NamedTuple):
    """Format of a log."""

    color: str
    """Encoding of colour, ``rgb8`` or ``jpeg``."""
    depth: str
    """Encoding of depth, ``16UC1``, ``png`` or ``rvl``."""
    compression: Compression


FORMS = {
    "raw": Form("rgb8", "16UC1", "none"),
    "lz4": Form("rgb8", "16UC1", "lz4"),
    "zstd": Form("rgb8", "16UC1", "zstd"),
    "jpeg_png": Form("jpeg", "png", "none"),
    "jpeg_rvl": Form("jpeg", "rvl", "none"),
}


class Topics(NamedTuple):
    """Topics of the images of a log format."""

    color: str
    depth: str


def topics_of(form: Form) -> Topics:
    """Return the topic names used by ``image_transport``."""
    color, depth = f"{NAMESPACE}/color/image_raw", f"{NAMESPACE}/depth/image_rect_raw"
    if form.color == "jpeg":
        return Topics(f"{color}/compressed", f"{depth}/compressedDepth")
    return Topics(color, depth)


def drive() -> list[SimFrame]:
    """Return the frames that all logs repeat."""
    return list(simulate(CONFIG))


def write(path: Path, form: Form, frames: list[SimFrame], count: int) -> None:
    """Write ``count`` frames at 30 Hz; depth is stamped one millisecond before colour."""
    calibration, topics = calibration_of(CONFIG), topics_of(form)
    assert calibration.color is not None
    payloads = [tuple(_payloads(form, frame)) for frame in frames]
    with Ros2LogWriter(path, form.compression) as log:
        log.write_transforms(CONFIG.start_ns, static_transforms(CONFIG, calibration), static=True)
        for number in range(count):
            stamp = CONFIG.start_ns + number * _PERIOD_NS
            for name, at, frame_id, camera in (
                ("color", stamp, COLOR_FRAME, calibration.color),
                ("depth", stamp - 1_000_000, DEPTH_FRAME, calibration.depth),
            ):
                log.write_camera_info(f"{NAMESPACE}/{name}/camera_info", at, frame_id, camera)
            color, depth = payloads[number % len(payloads)]
            depth(log, topics.depth, stamp - 1_000_000, DEPTH_FRAME)
            color(log, topics.color, stamp, COLOR_FRAME)


Put = Callable[[Ros2LogWriter, str, int, str], None]
"""Function that writes an image, with arguments log, topic, stamp [ns] and frame."""


def _payloads(form: Form, frame: SimFrame) -> Iterator[Put]:
    """Yield functions that write the colour and the depth image, each encoded once."""
    assert frame.depth is not None
    if form.color == "jpeg":
        data = simplejpeg.encode_jpeg(frame.color, quality=90, colorsubsampling="420")
        yield _compressed("rgb8; jpeg compressed bgr8", data)
    else:
        yield _raw(frame.color, form.color)
    head = _DEPTH_HEAD.pack(0, 0.0, 0.0)
    if form.depth == "png":
        data = cv2.imencode(".png", frame.depth, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
        yield _compressed("16UC1; compressedDepth png", head + data)
    elif form.depth == "rvl":
        size = struct.pack("<II", *frame.depth.shape[::-1])
        yield _compressed("16UC1; compressedDepth rvl", head + size + encode_rvl(frame.depth))
    else:
        yield _raw(frame.depth, form.depth)


def _raw(pixels: np.ndarray, encoding: str) -> Put:
    return lambda log, topic, stamp, frame: log.write_image(topic, stamp, frame, pixels, encoding)


def _compressed(form: str, data: bytes) -> Put:
    def put(log: Ros2LogWriter, topic: str, stamp: int, frame: str) -> None:
        message = {"header": header(stamp, frame), "format": form, "data": data}
        log.write(topic, stamp, "sensor_msgs/CompressedImage", message)

    return put


def encode_rvl(depth: np.ndarray) -> bytes:
    """Encode an image ``(H, W)`` uint16 as an RVL stream."""
    pixels = depth.reshape(-1).astype(np.int64)
    filled = pixels > 0
    values = pixels[filled]
    steps = np.diff(values, prepend=0)
    codes = np.where(steps < 0, -2 * steps - 1, 2 * steps)
    edges = np.flatnonzero(np.diff(filled, prepend=False, append=False)).tolist()
    numbers, at, taken = [], 0, 0
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        numbers += [np.array([first - at, end - first]), codes[taken : taken + end - first]]
        at, taken = end, taken + end - first
    if at < len(pixels):
        numbers.append(np.array([len(pixels) - at, 0]))
    return _nibbles(np.concatenate(numbers))


def _nibbles(numbers: np.ndarray) -> bytes:
    """Pack numbers into words of eight nibbles."""
    lengths = np.ones(len(numbers), np.int64)
    for place in range(1, 11):
        lengths += numbers >= 8**place
    ends = np.cumsum(lengths)
    nibbles = np.zeros(-(-int(ends[-1]) // 8) * 8, np.uint32)
    for place in range(int(lengths.max())):
        there = lengths > place
        more = np.where(lengths[there] > place + 1, 8, 0)
        nibbles[(ends - lengths)[there] + place] = numbers[there] >> 3 * place & 7 | more
    words = nibbles.reshape(-1, 8) << np.arange(28, -1, -4, dtype=np.uint32)
    return words.sum(axis=1, dtype=np.uint32).astype("<u4").tobytes()
