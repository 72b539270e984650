"""Logs of depth cameras: recordings to arrays, and arrays to files.

``find_logs`` turns names of files and folders into logs, ``open_log`` reads the index and the first
messages of a log, and :class:`Log` reads its frames in batches. The names are loaded when they are
used, so that the options alone cost no import of a decoder.

From the bytes of files to frames, by module::

    files, splits                   paths -> the files of each log
      formats, container            a file of any format: chunks of MCAP records by position, and
                                      its index
        mcap_file, chunks             MCAP: mcap_index; if that is damaged, mcap_scan
        bag                           ROS 1
        message_file                  messages one by one: sqlite (ROS 2), image_folder
      file_index                    where every message is: arrays, the same for all formats, by
                                      the file's own index or rebuilt from all that is whole (walk)
      opening, indexed              messages by topic (records), the first of each decoded
                                      (contents); or all small ones and all stamps
      findings                      cameras, topics, calibration (intrinsics, extrinsics), poses,
                                      transforms, motion
      windows                       any range of frames: order, nearest colour, poses
                                      (motion_windows), calibration (validity)
    timeline.Window                 where the images of some frames lie
      reading, store                  chunks, each read and checked once, by threads
        raw_messages                  pixels that go straight into their arrays; transforms
        decode_messages               CDR, ROS 1, protobuf and JSON -> messages
        images, compressed            their pixels: raw, jpeg, png, rvl, zstd_images
        body_mask                     pixels of the robot itself, which are not measured
    log, batch                      arrays of images, stamps and poses, and the status of each
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jaxdet.errors import RescanError
    from jaxdet.io.batch import Batch, LogFrame
    from jaxdet.io.description import LogDescription
    from jaxdet.io.files import LogFiles, find_logs
    from jaxdet.io.log import Log
    from jaxdet.io.notes import Notes
    from jaxdet.io.opening import open_log
    from jaxdet.io.options import LogOptions

_MODULES = {
    "Batch": "io.batch",
    "Log": "io.log",
    "LogDescription": "io.description",
    "LogFiles": "io.files",
    "LogFrame": "io.batch",
    "LogOptions": "io.options",
    "Notes": "io.notes",
    "RescanError": "errors",
    "find_logs": "io.files",
    "open_log": "io.opening",
}
__all__ = [
    "Batch",
    "Log",
    "LogDescription",
    "LogFiles",
    "LogFrame",
    "LogOptions",
    "Notes",
    "RescanError",
    "find_logs",
    "open_log",
]


def __getattr__(name: str) -> Any:
    """Load a public name with its module."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"jaxdet.{_MODULES[name]}"), name)
