"""Logs of several cameras, composed from logs with one camera each."""

from collections.abc import Callable, Mapping
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer

NAMESPACE = "/camera/camera/"
"""Prefix of the topics of a simulated log."""


def join_cameras(
    logs: Mapping[str, Path],
    path: Path,
    late_ns: int = 0,
    without: Callable[[str], bool] = lambda topic: False,
) -> Path:
    """Write the cameras of several logs, under new names, and the other topics of the first log.

    Log times are delayed by ``late_ns``. Topics for which ``without`` returns True are left out.
    """
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "tests")
        for number, (name, log) in enumerate(logs.items()):
            schemas: dict[int, int] = {}
            channels: dict[int, int] = {}
            with log.open("rb") as file:
                for schema, channel, message in make_reader(file).iter_messages():
                    own = channel.topic.startswith(NAMESPACE)
                    if number and not own:
                        continue
                    topic = channel.topic.replace(NAMESPACE, f"/{name}/camera/")
                    if without(topic):
                        continue
                    if channel.id not in channels:
                        assert schema is not None
                        if schema.id not in schemas:
                            given = schema.name, schema.encoding, schema.data
                            schemas[schema.id] = writer.register_schema(*given)
                        given = topic, channel.message_encoding, schemas[schema.id]
                        channels[channel.id] = writer.register_channel(*given)
                    at = message.log_time + late_ns, message.data, message.publish_time
                    writer.add_message(channels[channel.id], *at)
        writer.finish()
    return path
