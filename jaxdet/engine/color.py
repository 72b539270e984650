"""Frames of a log whose colour images are read."""

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

from jaxdet.config import Config
from jaxdet.errors import CalibrationError
from jaxdet.types import Frames

if TYPE_CHECKING:
    from jaxdet.engine.plan import Observer
    from jaxdet.io import Log


def check_color(log: "Log", config: Config) -> None:
    """Refuse a log whose colour the preset ``paper`` can't use.

    Raises:
        CalibrationError: It is the preset ``paper``, and the colour camera is not calibrated.
    """
    if config.cluster.points and log.color_problem:
        remedy = "another preset reads depth alone"
        raise CalibrationError(log.color_problem, path=log.name, remedy=remedy)


def method_frames(frames: Frames, config: Config) -> Frames:
    """Return frames without colour images, which only the preset ``paper`` reads."""
    return frames if config.cluster.points else frames._replace(color=None)


def shown_color(
    config: Config, observers: Iterable["Observer"], drawn: Collection[int]
) -> bool | Collection[int]:
    """Return the frames whose colour images are read.

    Args:
        config: The preset ``paper`` reads all.
        observers: One with a true attribute ``needs_color`` is passed all.
        drawn: Numbers of the frames that pictures show.

    Returns:
        True for all frames, or their numbers.
    """
    if config.cluster.points or any(getattr(one, "needs_color", False) for one in observers):
        return True
    return drawn
