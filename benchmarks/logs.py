"""``python -m benchmarks.logs LOG``: reading all images of a ROS 2 log, beside ``mcap_ros2``."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from mcap_ros2.reader import read_ros2_messages

from benchmarks.run import timed
from jaxdet.io import open_log


class Topics(NamedTuple):
    """The image topics used."""

    color: str
    depth: str


def main(log: tyro.conf.Positional[Path], seconds: float = 20.0, batch_size: int = 16) -> None:
    """Checks that both readers give the same images, then times them in turns.

    Ours opens the log first, which reads it through: every chunk's CRC is checked, frames are
    paired, calibration and poses are found. The peer decodes the image messages in log order.

    Args:
        log: With ``rgb8`` and ``16UC1`` images, as ``jaxdet sim`` writes them.
        seconds: How long both are repeated, at least five times.
        batch_size: Frames read at a time.
    """
    with open_log(str(log)) as opened:
        frames = opened.num_frames
        chosen = {topic.chosen_as: topic.topic for topic in opened.description.topics}
    topics = Topics(chosen["color"], chosen["depth"])
    _check(log, topics, batch_size)
    functions = {
        "open": lambda: open_log(str(log)).close(),
        "open and read": lambda: sum(1 for _ in ours(log, batch_size)),
        "mcap_ros2": lambda: sum(1 for _ in theirs(log, topics)),
    }
    found = dict(zip(functions, timed(list(functions.values()), seconds), strict=True))
    for name, one in found.items():
        wall, spread, cpu = (1e3 * s / frames for s in (one.median, one.spread, one.cpu))
        print(f"{name:<14} {wall:.2f} ± {spread:.2f} ms/frame, CPU {cpu:.2f}")
    ratio = found["mcap_ros2"].median / found["open and read"].median
    print(f"log.vs_mcap_ros2 {ratio:.2f} x, {frames} frames, batches of {batch_size}")


def ours(log: Path, batch_size: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Colour and depth of each frame."""
    with open_log(str(log)) as opened:
        for batch in opened.batches(batch_size):
            for row in range(len(batch.status)):
                yield batch.frames.color[row], batch.frames.depth[row]


def theirs(log: Path, topics: Topics) -> Iterator[tuple[str, np.ndarray]]:
    """Topic and image of each message, as a script of a few lines reads them."""
    for item in read_ros2_messages(log, topics=list(topics)):
        image = item.ros_msg
        shape = (image.height, image.width)
        if item.channel.topic == topics.color:
            yield topics.color, np.frombuffer(image.data, np.uint8).reshape(*shape, 3)
        else:
            yield topics.depth, np.frombuffer(image.data, np.uint16).reshape(shape)


def _check(log: Path, topics: Topics, batch_size: int) -> None:
    waiting: dict[str, list[np.ndarray]] = {topic: [] for topic in topics}
    messages = theirs(log, topics)
    for number, pair in enumerate(ours(log, batch_size)):
        for topic, image in zip(topics, pair, strict=True):
            while not waiting[topic]:
                found, other = next(messages)
                waiting[found].append(other)
            np.testing.assert_array_equal(
                image, waiting[topic].pop(0), f"frame {number} of {topic}"
            )


if __name__ == "__main__":
    tyro.cli(main, prog="python -m benchmarks.logs")
