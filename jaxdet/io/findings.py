"""All that is found in a log's index before an image is decoded."""

from typing import NamedTuple

import numpy as np

from jaxdet.io.calibration import Calibrated, calibrate
from jaxdet.io.index import LogIndex
from jaxdet.io.options import LogOptions
from jaxdet.io.poses import Base, Poses, find_base, find_poses
from jaxdet.io.timeline import Timeline, make_timeline
from jaxdet.io.topics import Choice, choose_topics


class Findings(NamedTuple):
    """Topics, calibration, frames, floor and poses."""

    choice: Choice
    calibrated: Calibrated
    timeline: Timeline
    base: Base
    poses: Poses

    @property
    def stamps_ns(self) -> np.ndarray:
        """``(F,)`` int64, colour stamps [ns]."""
        return self.timeline.color.stamps_ns

    @property
    def depth_stamps_ns(self) -> np.ndarray:
        """``(F,)`` int64, stamp of each colour frame's depth frame [ns], -1 = unpaired."""
        partner = self.timeline.pairing.depth_of_color
        stamps = np.append(self.timeline.depth.stamps_ns, -1)
        return stamps[partner]

    @property
    def unpaired_depth_ns(self) -> np.ndarray:
        """``(U,)`` int64, stamps of the depth frames without a colour frame [ns]."""
        return self.timeline.depth.stamps_ns[self.timeline.pairing.unpaired_depth]


def find(index: LogIndex, options: LogOptions, path: str) -> Findings:
    """What the log holds.

    Raises:
        TopicError: No or several topics can be colour or depth.
        CalibrationError: A part of the calibration is missing, unknown or contradictory.
    """
    choice = choose_topics(index, options, path)
    calibrated = calibrate(index, choice, options, path)
    color, depth = index.streams[choice.color], index.streams[choice.depth]
    timeline = make_timeline(color, depth, options.pair_tolerance_s)
    frame = calibrated.color_frame
    base = find_base(index, options, frame, path)
    poses = find_poses(index, options, frame, base.frame, timeline.color.stamps_ns, path)
    return Findings(choice, calibrated, timeline, base, poses)
