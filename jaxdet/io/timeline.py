"""The frames of a log in time: order, pairs, and where each image lies."""

from typing import NamedTuple

import numpy as np

from jaxdet.io.container import Location
from jaxdet.io.messages import Kind
from jaxdet.io.pairing import Pairing, pair
from jaxdet.io.streams import ImageStream
from jaxdet.io.topics import printable


class FrameTable(NamedTuple):
    """The messages of one stream in the order of their stamps."""

    stamps_ns: np.ndarray
    """``(N,)`` int64, header stamps, or log times where the header stamps are all zero."""
    file: np.ndarray
    """``(N,)`` int64, number of the log's file."""
    decoder: np.ndarray
    """``(N,)`` int64, number of the stream's decoder."""
    place: np.ndarray
    """``(N, 3)`` int64, as :class:`jaxdet.io.container.Location`."""

    def location(self, number: int) -> Location:
        """Where a frame's message lies in its file."""
        return Location(*(int(value) for value in self.place[number]))


class Timeline(NamedTuple):
    """Colour and depth frames in order, and their pairs."""

    color: FrameTable
    depth: FrameTable
    pairing: Pairing
    warnings: tuple[str, ...]


def make_timeline(color: ImageStream, depth: ImageStream, tolerance_s: float) -> Timeline:
    """Orders and pairs the frames.

    The order is by header stamp, then log time, then place in the files. Where all stamps of a
    stream are zero, log times stand for the stamps of both, with a warning. The two images of
    an RGBD message are a pair whatever their stamps.
    """
    warnings = []
    zero = [s for s in (color, depth) if len(s) and not s.column("stamp").any()]
    if zero:
        text = "header stamps are all zero; log times are used for colour and depth"
        warnings.append(f"{printable(zero[0].topic)}: {text}")
    same = color is depth and color.kind is Kind.RGBD
    color_table = _table(color, "log_time" if zero else "stamp", warnings)
    if same:
        numbers = np.arange(len(color))
        stamps = "log_time" if zero else "depth_stamp"
        order = _order(color, "log_time" if zero else "stamp")
        depth_table = color_table._replace(stamps_ns=color.column(stamps)[order])
        empty = np.zeros(0, np.int64)
        return Timeline(color_table, depth_table, Pairing(numbers, empty), tuple(warnings))
    depth_table = _table(depth, "log_time" if zero else "stamp", warnings)
    pairing = pair(color_table.stamps_ns, depth_table.stamps_ns, tolerance_s)
    return Timeline(color_table, depth_table, pairing, tuple(warnings))


def _order(stream: ImageStream, stamps: str) -> np.ndarray:
    return np.lexsort((stream.column("log_time"), stream.column(stamps)))


def _table(stream: ImageStream, stamps: str, warnings: list[str]) -> FrameTable:
    order = _order(stream, stamps)
    ordered = stream.column(stamps)[order]
    topic = printable(stream.topic)
    backward = int((np.diff(stream.column(stamps)) < 0).sum())
    double = int((np.diff(ordered) == 0).sum())
    zeros = int((ordered == 0).sum())
    if backward:
        warnings.append(f"{topic}: {backward} stamps run backward; frames are ordered by stamp")
    if double:
        warnings.append(f"{topic}: {double} stamps occur twice")
    if zeros:
        warnings.append(f"{topic}: {zeros} header stamps are zero")
    place = [stream.column(name)[order] for name in ("chunk", "offset", "size")]
    return FrameTable(
        ordered,
        stream.column("file")[order],
        stream.column("decoder")[order],
        np.stack(place, axis=1) if len(order) else np.zeros((0, 3), np.int64),
    )
