"""Frames of a log whose colour images are read."""

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

import numpy as np

from jaxdet.config import Config
from jaxdet.types import Frames

if TYPE_CHECKING:
    from jaxdet.engine.settings import Observer


def method_frames(frames: Frames, config: Config) -> Frames:
    """Return frames with the images that the method reads.

    By default the method reads only depth. The preset ``paper`` reads colour too; if the log has no
    colour images, black ones are used, and its frames have the status ``no_color``.
    """
    if not config.cluster.points:
        return frames._replace(color=None)
    if frames.color is not None:
        return frames
    camera = frames.calibration.image
    black = np.zeros((len(frames.depth), camera.height, camera.width, 3), np.uint8)
    return frames._replace(color=black)


def shown_color(
    config: Config, observers: Iterable["Observer"], drawn: Collection[int]
) -> bool | Collection[int]:
    """Return the frames whose colour images are read.

    Args:
        config: Configuration; the preset ``paper`` reads all.
        observers: Observers; if one has a true attribute ``needs_color``, all images are read.
        drawn: Numbers of the frames in pictures.

    Returns:
        True for all frames, or their numbers.
    """
    if config.cluster.points or any(getattr(one, "needs_color", False) for one in observers):
        return True
    return drawn
