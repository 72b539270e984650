"""The errors a user can meet: each names the input, what is wrong and what to do."""

import difflib
from collections.abc import Iterable
from enum import StrEnum
from typing import Any


def printable(text: str) -> str:
    r"""A name from a file or of one, fit for a terminal, a table and JSON.

    Control characters, line breaks and what else is not printable become escapes, as do bytes of
    file names that are not UTF-8 (which Python has as lone surrogates).

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
    """``did you mean X? `` where a known word is near, else nothing."""
    near = difflib.get_close_matches(word, list(known), 1)
    return f"did you mean {near[0]}? " if near else ""


class JaxdetError(Exception):
    """Base of every error raised on purpose; its text is one line for the user.

    Args:
        problem: What is wrong, in one clause.
        path: The file or folder it is about.
        topic: The topic it is about.
        remedy: What the user can do, for instance the flag that supplies what is missing.
    """

    topics: tuple[Any, ...] = ()
    """Of the log that it is about, where these are known (``jaxdet info`` shows them)."""

    def __init__(self, problem: str, *, path: str = "", topic: str = "", remedy: str = "") -> None:
        self.problem, self.path, self.topic, self.remedy = problem, path, topic, remedy
        where = ": ".join(printable(part) for part in (path, topic) if part)
        text = f"{where}: {problem}" if where else problem
        text = f"{text}; {remedy}" if remedy else text
        super().__init__(printable(" ".join(text.split()) if "\n" in text else text))

    def add_remedy(self, remedy: str) -> None:
        """Says what else the user can do, or should know."""
        self.remedy = f"{self.remedy}; {remedy}" if self.remedy else remedy
        self.args = (printable(f"{self.args[0]}; {remedy}"),)

    def __reduce__(self) -> tuple:
        """Whatever a kind of error is made from, it arrives whole in another process."""
        return _restored, (type(self), self.args, vars(self))


def _restored(kind: type[JaxdetError], args: tuple, state: dict) -> JaxdetError:
    error = kind.__new__(kind, *args)
    vars(error).update(state)
    return error


class InputError(JaxdetError):
    """A log or file can't be read or is not what it should be."""


class ChunkMemoryError(InputError):
    """A chunk takes more memory than this process may give it; with fewer workers it has more."""


class TopicError(JaxdetError):
    """The topics that the job needs are missing or ambiguous."""


class CamerasError(TopicError):
    """A log has several cameras and none was chosen.

    Args:
        cameras: Their names, of those that can be used.
        path: The log.
    """

    def __init__(self, cameras: tuple[str, ...], *, path: str = "") -> None:
        problem = f"the log has several cameras: {', '.join(cameras)}"
        super().__init__(problem, path=path, remedy="choose one with --camera")
        self.cameras = cameras


class CalibrationError(JaxdetError):
    """A calibration is missing, unknown or contradicts itself."""


class TransformError(CalibrationError):
    """The transforms that were looked at don't join two frames; others of the log might."""


class ConfigError(JaxdetError):
    """A configuration value is out of its range or unknown."""


class ResultsError(ConfigError):
    """The output folder holds results already.

    Args:
        path: The folder.
        file: One of them.
        same: Whether they are what the run would make.
        reason: Why not, where that is known.
    """

    def __init__(self, path: str, file: str, *, same: bool, reason: str = "") -> None:
        remedy = "give another --output, or --overwrite to replace them"
        problem = f"holds results already ({file})" + (f", but {reason}" if reason else "")
        super().__init__(problem, path=path, remedy=remedy)
        self.same = same


class RescanError(JaxdetError):
    """A log is not as its index lets expect; read as a whole (``--log.scan``) it can be used."""

    def __init__(self, problem: str, *, path: str = "", topic: str = "") -> None:
        super().__init__(problem, path=path, topic=topic, remedy="read it with --log.scan")


class OutputError(JaxdetError):
    """Results can't be written: the disk is full, or the folder read-only. It ends the run."""


class WorkerError(JaxdetError):
    """A worker process ended, or failed in a way that nobody foresaw."""


class Interrupted(KeyboardInterrupt):
    """A signal ended the run; its text is one line that says how to go on.

    Args:
        signal: Number of the signal.
        text: The line.
    """

    def __init__(self, signal: int, text: str = "interrupted") -> None:
        super().__init__(text)
        self.signal = signal


class FrameError(JaxdetError):
    """One frame can't be used; the run goes on and the frame gets ``status``."""

    def __init__(self, problem: str, *, status: "FrameStatus", **where: str) -> None:
        super().__init__(problem, **where)
        self.status = status


class FrameStatus(StrEnum):
    """What became of a frame, a depth image (the ``status`` column of the results)."""

    OK = "ok"
    """Detected; the obstacle rows are complete."""
    NO_DEPTH = "no_depth"
    """The depth image has no measurement in range, so nothing can be detected."""
    NO_COLOR = "no_color"
    """Preset ``paper``: no colour image near enough in time can be used."""
    DECODE_ERROR = "decode_error"
    """The depth image could not be decoded."""
    BAD_CALIBRATION = "bad_calibration"
    """The image size or the calibration of this frame contradicts the log's calibration."""
    WORKER_CRASHED = "worker_crashed"
    """The processes that worked on this frame and its neighbours died, twice."""
    TIMEOUT = "timeout"
    """They made no progress, twice."""
