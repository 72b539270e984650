"""``python -m benchmarks.log_copies FOLDER LOG...``: copy logs without colour.

A copy contains neither colour images nor the CameraInfo of the colour camera, like a log of a depth
camera. It has the name of the log and is written to FOLDER.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

IMAGES = ("Image", "CompressedImage", "CameraInfo")
COLOR = ("/color/", "/rgb/")
"""Parts of the names of colour topics and their CameraInfo."""


def copy_without_color(log: Path, target: Path) -> None:
    """Copy an MCAP file without its colour messages."""
    with log.open("rb") as source, target.open("wb") as sink:
        writer = Writer(sink, compression=CompressionType.ZSTD)
        writer.start("ros2", "jaxdet benchmarks")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            is_image = schema is not None and schema.name.rpartition("/")[2] in IMAGES
            if is_image and any(part in channel.topic for part in COLOR):
                continue
            if channel.id not in channels:
                number = 0
                if schema is not None:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, dict(channel.metadata)
                )
            times = message.log_time, message.publish_time
            own = channels[channel.id]
            writer.add_message(own, times[0], message.data, times[1], message.sequence)
        writer.finish()


def main(arguments: Sequence[str]) -> None:
    """Write the copies."""
    if len(arguments) < 2:
        sys.exit("usage: python -m benchmarks.log_copies FOLDER LOG...")
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    for log in map(Path, arguments[1:]):
        copy_without_color(log, folder / log.name)


if __name__ == "__main__":
    main(sys.argv[1:])
