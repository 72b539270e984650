"""Decompression bombs: small files that would take much memory or time to read."""

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    COLOR_K,
    COLOR_SIZE,
    DEPTH,
    DEPTH_FRAME,
    START,
    STORE,
    LogFile,
    make_scene,
    ros_compressed,
    ros_image,
    ros_info,
    write_calibration,
    write_images,
    write_log,
)
from tests.mcap_bytes import MAGIC, channel, chunk, end, message, record, schema, without_end

IMAGE, TF = "sensor_msgs/msg/Image", "tf2_msgs/msg/TFMessage"


def definition(name: str) -> bytes:
    return STORE.generate_msgdef(name, ros_version=2)[0].encode()


def records_after_a_log(path: Path, records: bytes) -> Path:
    """Write a log of three frames, followed by other ``records``."""
    plain = without_end(write_log(path, make_scene(3)))
    path.write_bytes(plain + records + end())
    return path


def schema_memory(path: Path) -> Path:
    """Write chunks of some kB, with a schema of 200 MiB in each."""
    large = bytes(200 << 20)
    parts = [chunk(schema(900 + i, IMAGE, large)) for i in range(1)]
    parts += [parts[0]] * 5
    return records_after_a_log(path, b"".join(parts))


def schema_text(path: Path) -> Path:
    """Write a definition of 16 MB, mostly spaces in comments and constants."""
    lines = b"uint8 a # " + b" " * (8 << 20) + b"\n" + b"uint8 A=1 \n" * (1 << 19)
    records = schema(900, IMAGE, lines) + channel(900, "/bomb", 900)
    return records_after_a_log(path, records + message(900, START, bytes(40)))


def schema_comment(path: Path) -> Path:
    """Write a definition of 1 MB, the maximum: a comment, which the parser searches for units."""
    lines = b"uint8 a # " + b" " * 1_000_000 + b"[\n"
    records = schema(900, IMAGE, lines) + channel(900, "/bomb", 900)
    return records_after_a_log(path, records + message(900, START, bytes(40)))


def schema_fields(path: Path) -> Path:
    """Write a definition of 900 kB with 100,000 fields."""
    lines = b"".join(b"uint8 a%d\n" % i for i in range(80_000))
    records = schema(900, IMAGE, lines) + channel(900, "/bomb", 900)
    return records_after_a_log(path, records + message(900, START, bytes(40)))


def many_topics(path: Path) -> Path:
    """Write 60,000 topics with an image each."""
    records = [schema(900, IMAGE, definition(IMAGE))]
    for i in range(2000, 62_000):
        records.append(channel(i, f"/t{i}", 900) + message(i, START, bytes(8)))
    return records_after_a_log(path, chunk(b"".join(records)))


def empty_images(path: Path) -> Path:
    """Write 3 million empty images in one chunk."""
    head = schema(900, IMAGE, definition(IMAGE)) + channel(900, "/bomb", 900)
    return records_after_a_log(path, chunk(head + message(900, START, b"") * 3_000_000))


def tiny_images(path: Path) -> Path:
    """Write a million images with timestamps but without pixels, on the colour topic of a log."""
    with LogFile(path) as log:
        write_calibration(log)
        write_images(log, make_scene(2))
        empty = ros_image(np.zeros((1, 1, 3), np.uint8), "rgb8", START, COLOR_FRAME)
        empty.width = empty.height = empty.step = 0
        empty.data = empty.data[:0]
        data = bytes(STORE.serialize_cdr(empty, IMAGE))
        log.raw("/bomb", "cdr", (IMAGE, "ros2msg", definition(IMAGE)), data, START)
    records = schema(900, IMAGE, definition(IMAGE)) + channel(900, COLOR, 900)
    many = message(900, START, data) * 1_000_000
    path.write_bytes(without_end(path) + chunk(records + many) + end())
    return path


def empty_transforms(path: Path) -> Path:
    """Write 3 million TF messages in one chunk."""
    head = schema(900, TF, definition(TF)) + channel(900, "/tf", 900)
    return records_after_a_log(path, chunk(head + message(900, START, bytes(8)) * 3_000_000))


def one_large_transform(path: Path) -> Path:
    """Write a TF message with a million transforms."""
    head = schema(900, TF, definition(TF)) + channel(900, "/tf", 900)
    body = b"\0\1\0\0" + struct.pack("<I", 1_000_000) + bytes(88_000_000)
    return records_after_a_log(path, chunk(head + message(900, START, body)))


def many_messages(path: Path) -> Path:
    """Write 4 million messages on a topic that is not used."""
    head = schema(900, "a/b", b"uint8 x") + channel(900, "/bomb", 900)
    return records_after_a_log(path, chunk(head + message(900, START, b"") * 4_000_000))


def empty_records(path: Path) -> Path:
    """Write a million empty records between the chunks."""
    return records_after_a_log(path, record(0x80, b"") * 1_000_000)


def empty_records_inside(path: Path) -> Path:
    """Write 4 million empty records in a chunk."""
    return records_after_a_log(path, chunk(record(0x80, b"") * 4_000_000))


def summary_bomb(path: Path) -> Path:
    """Write a summary of a million empty records."""
    data = without_end(write_log(path, make_scene(3)))
    summary = record(0x80, b"") * 1_000_000
    start = len(data) + 13
    foot = record(15, bytes(4)) + summary + record(2, struct.pack("<QQI", start, 0, 0)) + MAGIC
    path.write_bytes(data + foot)
    return path


def many_chunk_indexes(path: Path) -> Path:
    """Write a summary of a million chunk indexes, of chunks that do not exist."""
    data = without_end(write_log(path, make_scene(3)))
    start = len(data) + 13
    with path.open("wb") as file:
        file.write(data + record(15, bytes(4)))
        for number in range(1_000_000):
            index = struct.pack("<QQQQIQIQQ", number, number, number, 99, 0, 0, 0, 50, number)
            file.write(record(8, index))
        file.write(record(2, struct.pack("<QQI", start, 0, 0)) + MAGIC)
    return path


def rvl(path: Path, size: tuple[int, int], stream: bytes) -> Path:
    """Write depth images whose RVL header states ``size``, in a log of small images."""
    scene = make_scene(2)
    with LogFile(path) as log:
        write_calibration(log)
        for color, at in zip(scene.color, scene.color_ns.tolist(), strict=True):
            head = struct.pack("<iffII", 0, 0, 0, *size)
            image = ros_compressed(head + stream, "16UC1; compressedDepth rvl", at, COLOR_FRAME)
            log.ros(DEPTH + "/compressedDepth", image, at)
            log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
    return path


def rvl_tail(path: Path) -> Path:
    """Write RVL images of the right size, each with 200 MB of data."""
    return rvl(path, (32, 24), bytes(200 << 20))


def rvl_pixels(path: Path) -> Path:
    """Write RVL depth of 5700x5700 pixels in runs of one pixel."""
    return rvl(path, (5700, 5700), b"\x11" * (5700 * 5700))


def image_pixels(path: Path) -> Path:
    """Write images that state 5700x5700 pixels but contain one, and a calibration of that size."""
    with LogFile(path) as log:
        log.ros("/cam/color/camera_info", ros_info((5700, 5700), COLOR_K, START, "a"), START)
        for at in range(START, START + 40):
            for topic, form in ((COLOR, "rgb8"), ("/cam/aligned_depth_to_color/image", "16UC1")):
                image = ros_image(np.zeros((1, 1, 3), np.uint8), form, at, "a")
                image.width = image.height = 5700
                log.ros(topic, image, at)
    return path


def deep_json(path: Path) -> Path:
    """Write an image in JSON that is 500,000 arrays deep."""
    with LogFile(path) as log:
        write_calibration(log)
        write_images(log, make_scene(2))
        log.raw("/bomb", "json", ("foxglove.RawImage", "jsonschema", b"{}"), b"[" * 500_000, START)
    return path


def wide_json(path: Path) -> Path:
    """Write an image in JSON of 60 MB of empty objects."""
    with LogFile(path) as log:
        write_calibration(log)
        write_images(log, make_scene(2))
        data = b"[" + b"{}," * 20_000_000 + b"{}]"
        log.raw("/bomb", "json", ("foxglove.RawImage", "jsonschema", b"{}"), data, START)
    return path


def jpeg_scans(path: Path) -> Path:
    """Write a progressive JPEG with a thousand scans over every pixel."""
    import cv2

    scene = make_scene(1)
    image = np.full((COLOR_SIZE[1], COLOR_SIZE[0], 3), 90, np.uint8)
    data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    first = data.rindex(b"\xff\xda")
    many = data[:first] + data[first:-2] * 100_000 + b"\xff\xd9"
    with LogFile(path) as log:
        write_calibration(log)
        at = int(scene.color_ns[0])
        log.ros(COLOR + "/compressed", ros_compressed(many, "jpeg", at, COLOR_FRAME), at)
        log.ros(DEPTH, ros_image(scene.depth[0], "16UC1", at, DEPTH_FRAME), at)
    return path


BOMBS: dict[str, Callable[[Path], Path]] = {
    make.__name__: make
    for make in (
        schema_memory,
        schema_text,
        schema_comment,
        schema_fields,
        many_topics,
        empty_images,
        tiny_images,
        empty_transforms,
        one_large_transform,
        many_messages,
        empty_records,
        empty_records_inside,
        summary_bomb,
        many_chunk_indexes,
        rvl_tail,
        rvl_pixels,
        image_pixels,
        deep_json,
        wide_json,
        jpeg_scans,
    )
}
