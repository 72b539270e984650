"""Image readers of other libraries: they decode each image and discard it.

Each takes the topics to read: only depth, as the default method, or colour and depth.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from jaxdet.cores import cores

Images = Iterator[tuple[str, np.ndarray]]
"""Topic and image of each message."""


def mcap_ros2(log: Path, topics: Sequence[str]) -> Images:
    """Read in a loop over ``mcap-ros2-support``."""
    with log.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(topics=list(topics)):
            yield channel.topic, image(message)


def rosbags(log: Path, topics: Sequence[str]) -> Images:
    """Read in a loop over ``rosbags``."""
    with AnyReader([log], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        wanted = [item for item in reader.connections if item.topic in topics]
        for connection, _, data in reader.messages(connections=wanted):
            yield connection.topic, image(reader.deserialize(data, connection.msgtype))


def threads(log: Path, topics: Sequence[str]) -> Images:
    """Read with ``mcap`` and decode in a pool with one thread per core and a short queue."""
    factory = DecoderFactory()
    waiting: deque[tuple[str, Future[np.ndarray]]] = deque()
    with log.open("rb") as file, ThreadPoolExecutor(cores()) as pool:
        for schema, channel, message in make_reader(file).iter_messages(topics=list(topics)):
            decode = factory.decoder_for(channel.message_encoding, schema)
            assert decode is not None
            waiting.append((channel.topic, pool.submit(_decoded, decode, message.data)))
            if len(waiting) > 4 * cores():
                topic, future = waiting.popleft()
                yield topic, future.result()
        for topic, future in waiting:
            yield topic, future.result()


Read = Callable[[Path, Sequence[str]], Images]

PEERS: dict[str, Read] = {
    "mcap_ros2": mcap_ros2,
    "rosbags": rosbags,
    "threads": threads,
}


def _decoded(decode: Callable[[bytes], Any], data: bytes) -> np.ndarray:
    return image(decode(data))


def image(message: Any) -> np.ndarray:
    """Return the pixels of an Image or a CompressedImage; compressed ones are decoded by OpenCV."""
    if hasattr(message, "encoding"):
        dtype, shape = (np.uint8, (-1, 3)) if message.encoding == "rgb8" else (np.uint16, (-1,))
        pixels = np.frombuffer(message.data, dtype)
        return pixels.reshape(message.height, message.width, *shape[1:])
    data = np.frombuffer(message.data, np.uint8)
    if "jpeg" in message.format:
        return _opencv(data, cv2.IMREAD_COLOR_RGB)
    if "png" in message.format:
        return _opencv(data[12:], cv2.IMREAD_UNCHANGED)
    width, height = data[12:20].view("<u4").tolist()
    return rvl(data[20:], height, width)


def _opencv(data: np.ndarray, mode: int) -> np.ndarray:
    pixels = cv2.imdecode(data, mode)
    assert pixels is not None
    return pixels


def rvl(data: np.ndarray, height: int, width: int) -> np.ndarray:
    """Decode an RVL stream to ``(height, width)`` uint16; only the runs are found in a loop."""
    numbers = _numbers(data)
    pixels = np.zeros(height * width, np.int64)
    counts, starts, at, position = [], [], 0, 0
    while position < len(pixels):
        zeros, filled = int(numbers[at]), int(numbers[at + 1])
        position += zeros
        counts.append(filled)
        starts.append((position, at + 2))
        position += filled
        at += 2 + filled
    count, start = np.array(counts), np.array(starts)
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    code = numbers[np.repeat(start[:, 1], count) + within]
    pixels[np.repeat(start[:, 0], count) + within] = np.cumsum((code >> 1) ^ -(code & 1))
    return pixels.astype(np.uint16).reshape(height, width)


def _numbers(data: np.ndarray) -> np.ndarray:
    """Return all numbers of a stream; the zero padding at its end results in extra numbers."""
    words = data.reshape(-1, 4)[:, ::-1].reshape(-1)
    nibbles = np.stack([words >> 4, words & 15], axis=1).reshape(-1)
    last = np.flatnonzero(nibbles < 8)
    first = np.concatenate([[0], last[:-1] + 1])
    length = last - first + 1
    numbers = (nibbles[first] & 7).astype(np.int64)
    for place in range(1, int(length.max())):
        long = np.flatnonzero(length > place)
        numbers[long] |= (nibbles[first[long] + place] & 7).astype(np.int64) << (3 * place)
    return numbers
