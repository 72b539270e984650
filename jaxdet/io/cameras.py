"""The cameras of a log, and the one that is read."""

from collections.abc import Mapping
from typing import NamedTuple

from jaxdet.errors import CalibrationError, CamerasError, TopicError, printable
from jaxdet.io.calibration import calibrate
from jaxdet.io.contents import LogContents
from jaxdet.io.options import LogOptions
from jaxdet.io.topics import Choice, choose_topics

_OF_ONE = ("color_info", "depth_info", "color_from_depth", "color_intrinsics", "depth_intrinsics")
_OF_ONE += ("camera_frame",)
"""Options that hold for one camera only."""


class Cameras(NamedTuple):
    """The cameras of a log by name, in order."""

    complete: Mapping[str, Choice]
    """With depth and its calibration."""
    incomplete: Mapping[str, TopicError | CalibrationError]
    """What the others lack; empty if there is one camera."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of all."""
        return tuple(sorted({**self.complete, **self.incomplete}))

    def chosen(self, options: LogOptions, path: str) -> Choice:
        """Return the camera that the user wants, or the only one that can be used.

        Raises:
            CamerasError: There are several.
            TopicError: There is none of this name, or several of its topics qualify.
            CalibrationError: What it lacks.
        """
        wanted = options.camera or "".join(list(self.complete or self.incomplete)[:1])
        if wanted in self.incomplete:
            raise self.incomplete[wanted]
        if wanted not in self.complete:
            names = ", ".join(self.names)
            remedy = f"--camera can be: {names}"
            raise TopicError(f"there is no camera {wanted!r}", path=path, remedy=remedy)
        if options.camera or len(self.complete) == 1:
            return self.complete[wanted]
        given = [name for name in _OF_ONE if getattr(options, name) is not None]
        if given:
            flag = f"--log.{given[0].replace('_', '-')}"
            problem = f"the log has several cameras ({', '.join(self.names)}), {flag} is of one"
            raise TopicError(problem, path=path, remedy="choose it with --camera")
        raise CamerasError(tuple(self.complete), path=path)

    @property
    def lines(self) -> tuple[str, ...]:
        """The cameras for a person; empty if there is one."""
        found = {
            name: ", ".join(dict.fromkeys(filter(None, (item.depth, item.color))))
            for name, item in self.complete.items()
        }
        found |= {name: f"not used: {error.problem}" for name, error in self.incomplete.items()}
        return tuple(printable(f"{name}: {found[name]}") for name in self.names if len(found) > 1)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is to be said of those that are not complete."""
        return tuple(
            f"camera {printable(name)} is left out: {e}" for name, e in self.incomplete.items()
        )


def find_cameras(contents: LogContents, options: LogOptions) -> Cameras:
    """Return the cameras of a log; if there are several, with their calibration checked.

    Raises:
        TopicError: No or several topics can be depth of the only camera.
    """
    complete: dict[str, Choice] = {}
    incomplete: dict[str, TopicError | CalibrationError] = {}
    found = choose_topics(contents, options)
    for name, choice in found.items():
        try:
            if isinstance(choice, TopicError):
                raise choice
            if len(found) > 1:
                calibrate(contents.of_camera(choice.depth), choice, options)
            complete[name] = choice
        except (TopicError, CalibrationError) as error:
            incomplete[name] = error
    return Cameras(complete, incomplete)
