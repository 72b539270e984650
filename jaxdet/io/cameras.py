"""Cameras of a log, and the selection of the camera to read."""

from collections.abc import Mapping
from typing import NamedTuple

from jaxdet.errors import CalibrationError, CamerasError, TopicError, printable
from jaxdet.io.calibration import calibrate
from jaxdet.io.contents import LogContents
from jaxdet.io.options import LogOptions
from jaxdet.io.topics import Choice, choose_topics

_OF_ONE = ("color_info", "depth_info", "color_from_depth", "color_intrinsics", "depth_intrinsics")
_OF_ONE += ("camera_frame",)
"""Options that apply to a single camera."""


class Cameras(NamedTuple):
    """Cameras of a log, by name in alphabetical order."""

    complete: Mapping[str, Choice]
    """Topics of the usable cameras; the calibration of a log's only camera was not checked."""
    incomplete: Mapping[str, TopicError | CalibrationError]
    """Errors of the cameras whose calibration or choice of topics is incomplete; empty if the log
    has only one camera."""
    unreadable: Mapping[str, TopicError]
    """Errors of the cameras whose depth can't be read, whatever the flags."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all cameras whose depth can be read."""
        return tuple(sorted({**self.complete, **self.incomplete}))

    @property
    def left_out(self) -> dict[str, TopicError | CalibrationError]:
        """Errors of all unusable cameras, by name in alphabetical order."""
        return dict(sorted({**self.incomplete, **self.unreadable}.items()))

    def chosen(self, options: LogOptions, path: str) -> Choice:
        """Return the topics of the camera selected by the user, or of the only usable one.

        Raises:
            CamerasError: There are several cameras, and none is selected.
            TopicError: The camera does not exist or has several possible depth topics, or a flag
                applies to one of several cameras.
            CalibrationError: The camera has no valid calibration.
        """
        wanted = options.camera or "".join(list(self.complete or self.incomplete)[:1])
        if wanted in self.left_out:
            raise self.left_out[wanted]
        if wanted not in self.complete:
            names = ", ".join(self.names)
            remedy = f"set --camera to one of: {names}"
            raise TopicError(f"unknown camera {wanted!r}", path=path, remedy=remedy)
        if options.camera or len(self.complete) == 1:
            return self.complete[wanted]
        given = [name for name in _OF_ONE if getattr(options, name) is not None]
        if given:
            flag = f"--log.{given[0].replace('_', '-')}"
            names = ", ".join(self.names)
            problem = f"{flag} applies to one camera, but the log has several ({names})"
            raise TopicError(problem, path=path, remedy="choose one with --camera")
        raise CamerasError(tuple(self.complete), path=path)

    @property
    def lines(self) -> tuple[str, ...]:
        """Descriptions of the cameras for users; empty if there is only one."""
        found = {
            name: ", ".join(dict.fromkeys(filter(None, (item.depth, item.color))))
            for name, item in self.complete.items()
        }
        found |= {name: f"not used: {error.problem}" for name, error in self.left_out.items()}
        return tuple(
            printable(f"{name}: {found[name]}") for name in sorted(found) if len(found) > 1
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the unusable cameras."""
        return tuple(
            f"camera {printable(name)} is left out: {e}" for name, e in self.left_out.items()
        )


def find_cameras(contents: LogContents, options: LogOptions) -> Cameras:
    """Find the cameras of a log; if there are several, check their calibrations.

    Raises:
        TopicError: The log has no depth topic, or several possible ones of its only camera.
    """
    complete: dict[str, Choice] = {}
    incomplete: dict[str, TopicError | CalibrationError] = {}
    found, unreadable = choose_topics(contents, options)
    for name, choice in found.items():
        try:
            if isinstance(choice, TopicError):
                raise choice
            if len(found) > 1:
                calibrate(contents.of_camera(choice.depth), choice, options)
            complete[name] = choice
        except (TopicError, CalibrationError) as error:
            incomplete[name] = error
    return Cameras(complete, incomplete, unreadable)
