"""Errors for users: each names the input, the problem and the remedy."""

import difflib
from collections.abc import Iterable
from enum import StrEnum
from typing import Any


def printable(text: str) -> str:
    r"""Escape unprintable characters of a name, for terminals, tables and JSON.

    Control characters and line breaks are escaped, as are bytes of file names that are not UTF-8
    (lone surrogates in Python).

    >>> printable("a\x1b[31m\n\udcff")
    'a\\x1b[31m\\n\\xff'
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else _escaped(char) for char in text)


def _escaped(char: str) -> str:
    if "\udc80" <= char <= "\udcff":
        return f"\\x{ord(char) - 0xDC00:02x}"
    return char.encode("unicode_escape").decode("ascii")


def meant(word: str, known: Iterable[str]) -> str:
    """Return ``did you mean X? `` if a known word is similar, else an empty string."""
    near = difflib.get_close_matches(word, list(known), 1)
    return f"did you mean {near[0]}? " if near else ""


class JaxdetError(Exception):
    """Base class of all expected errors; the message is a single line.

    Args:
        problem: Description of the problem, in one clause.
        path: File or folder concerned.
        topic: Topic or argument concerned.
        remedy: Action for the user, for instance the flag that supplies a missing value.
    """

    topics: tuple[Any, ...] = ()
    """Topics of the log that caused the error, if they are known; ``jaxdet info`` lists them."""

    def __init__(self, problem: str, *, path: str = "", topic: str = "", remedy: str = "") -> None:
        self.problem, self.path, self.topic, self.remedy = problem, path, topic, remedy
        where = ": ".join(printable(part) for part in (path, topic) if part)
        text = f"{where}: {problem}" if where else problem
        text = f"{text}; {remedy}" if remedy else text
        super().__init__(printable(" ".join(text.split()) if "\n" in text else text))

    def add_remedy(self, remedy: str) -> None:
        """Append a further remedy or note."""
        self.remedy = f"{self.remedy}; {remedy}" if self.remedy else remedy
        self.args = (printable(f"{self.args[0]}; {remedy}"),)

    def __reduce__(self) -> tuple:
        """Make subclasses with other constructors picklable."""
        return _restored, (type(self), self.args, vars(self))


def _restored(kind: type[JaxdetError], args: tuple, state: dict) -> JaxdetError:
    error = kind.__new__(kind, *args)
    vars(error).update(state)
    return error


class InputError(JaxdetError):
    """A log, a file or an argument is unreadable or invalid."""


class ChunkMemoryError(InputError):
    """A chunk needs more memory than this process may use; fewer workers get more memory each."""


class TopicError(JaxdetError):
    """Required topics are missing or ambiguous."""


class CamerasError(TopicError):
    """A log has several cameras and none was selected.

    Args:
        cameras: Names of the usable cameras.
        path: Log.
    """

    def __init__(self, cameras: tuple[str, ...], *, path: str = "") -> None:
        problem = f"the log has several cameras: {', '.join(cameras)}"
        super().__init__(problem, path=path, remedy="choose one with --camera")
        self.cameras = cameras


class CalibrationError(JaxdetError):
    """A calibration is missing, unknown or inconsistent."""


class TransformError(CalibrationError):
    """The transforms read so far do not connect two frames; later transforms in the log may."""


class ConfigError(JaxdetError):
    """A configuration value is out of range or unknown."""


class ResultsError(ConfigError):
    """The output folder already contains results of another run.

    Args:
        path: Output folder.
        log: Folder of a log in it.
        reason: Difference between that run and this one.
    """

    def __init__(self, path: str, log: str, *, reason: str) -> None:
        remedy = "choose another --output, or pass --overwrite to replace them"
        super().__init__(f"holds results of {log}, but {reason}", path=path, remedy=remedy)


class RescanError(JaxdetError):
    """A log contradicts its index; a complete scan (``--log.scan``) can read it."""

    def __init__(self, problem: str, *, path: str = "", topic: str = "") -> None:
        super().__init__(problem, path=path, topic=topic, remedy="pass --log.scan")


class OutputError(JaxdetError):
    """Results can't be written: the disk is full or the folder read-only. This ends the run."""


class WorkerError(JaxdetError):
    """A worker process ended or failed unexpectedly."""


class WorkerStartError(WorkerError):
    """Worker processes can't be started. This ends the run, as the logs are not the cause."""


class Interrupted(KeyboardInterrupt):
    """A signal ended the run. The message is a line that explains how to resume.

    Args:
        signal: Signal number.
        text: Message.
    """

    def __init__(self, signal: int, text: str = "interrupted") -> None:
        super().__init__(text)
        self.signal = signal


class FrameError(JaxdetError):
    """A frame is unusable; it gets ``status``, and the run continues."""

    def __init__(self, problem: str, *, status: "FrameStatus", **where: str) -> None:
        super().__init__(problem, **where)
        self.status = status


class FrameStatus(StrEnum):
    """Outcome of a frame, i.e. of a depth image (column ``status`` of the results)."""

    OK = "ok"
    """Processed; its obstacle rows are complete."""
    NO_DEPTH = "no_depth"
    """The depth image has no measurement in range."""
    NO_COLOR = "no_color"
    """Preset ``paper``: no usable colour image has a timestamp near enough."""
    DECODE_ERROR = "decode_error"
    """The depth image could not be decoded."""
    BAD_CALIBRATION = "bad_calibration"
    """The image size or the calibration of the frame contradicts the log's calibration."""
    WORKER_CRASHED = "worker_crashed"
    """The process that worked on the frame, and on frames next to it, died twice."""
    TIMEOUT = "timeout"
    """The process that worked on the frame twice made no progress within the time limit."""
