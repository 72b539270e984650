"""Reading and writing of depth camera logs.

``find_logs`` finds the logs in files and folders, ``open_log`` reads the index and the first
messages of a log, and :class:`Log` reads its frames in batches. Names are imported on first use,
so that ``LogOptions`` alone imports no decoder.

The modules, from files to frames::

    files, splits                   paths -> the files of each log
      formats, container            a file of any format: its index, and chunks of MCAP records by
                                      position
        mcap_file, chunks             MCAP: mcap_index; if that is damaged, mcap_scan
        bag                           ROS 1
        message_file                  single messages: sqlite (ROS 2), image_folder
      file_index                    positions of all messages as arrays, in the same form for all
                                      formats; from the file's own index, or rebuilt (walk)
      opening, indexed              messages by topic (records); the first of each topic are decoded
                                      (contents), or all small messages and all timestamps
      findings                      cameras, topics, calibration (intrinsics, extrinsics), poses,
                                      transforms, motion
      windows                       any range of frames: order, nearest colour image, poses
                                      (motion_windows), calibration (validity)
    timeline.Window                 positions of the images of some frames
      reading, store                  chunks, each read and checked once, in threads
        raw_messages                  raw pixels, copied directly into arrays; transforms
        decode_messages               CDR, ROS 1, protobuf and JSON -> messages
        images, compressed            their pixels: raw, jpeg, png, rvl, zstd_images
        body_mask                     mask of the robot's own body
    log, batch                      arrays of images, timestamps and poses, and each frame's status
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
