"""Export of results to formats of other programs; each format is a module imported on use.

A module ``NAME`` has a function ``export(results, output, recordings)``, which writes the new file
or folder ``output`` and may raise a :class:`jaxdet.errors.JaxdetError`. ``recordings`` are the logs
passed with ``--log``, by their names in the results. ``export`` returns a list with a line for each
omission, or None.
"""

import shlex
import shutil
import tempfile
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxdet.errors import ConfigError, InputError
from jaxdet.results.durable import writing

if TYPE_CHECKING:
    from jaxdet.export.nav2 import KnownMap
    from jaxdet.io import LogFiles
    from jaxdet.results.reading import Results


class Format(NamedTuple):
    """Description of a format."""

    writes: str
    """Contents of the output."""
    shown_by: str
    """Instruction to open the output; ``{}`` is its path, quoted in a shell command."""
    of_logs: str = ""
    """Contents that ``--log`` adds; empty if logs are not used."""
    extra: str = ""
    """Extra of jaxdet with the required packages; empty if they are always installed."""
    suffix: str = ""
    """Suffix of an output file; empty if the output is a folder."""

    def seen(self, output: Path) -> str:
        """Return the instruction to open an output."""
        name = str(output)
        if self.suffix and output.suffix.lower() != self.suffix:
            return f"{self.shown_by} (it may require the suffix {self.suffix})"
        if self.shown_by.startswith(("ros2 ", "rerun ")):
            name = shlex.quote(name)
        return self.shown_by.replace("{}", name)


FORMATS = {
    "foxglove": Format(
        "a folder: an MCAP file to open together with each log, and layouts",
        "drag {}/LOG.jaxdet.mcap and the log into Foxglove, and import {}/layout.json",
    ),
    "ros2": Format(
        "a folder: an MCAP file of ROS 2 messages per log",
        "ros2 bag play {}/LOG.jaxdet.mcap",
        "the points of obstacles",
    ),
    "nav2": Format(
        "a folder: a map per log for nav2's map_server (PGM and YAML)",
        "ros2 run nav2_map_server map_server --ros-args -p yaml_filename:={}/LOG.yaml",
    ),
    "html": Format(
        "an HTML page with figures, timelines, maps and pictures",
        "open it in a browser",
        "the logs, if they were moved, for pictures of frames",
        suffix=".html",
    ),
    "rerun": Format(
        "a folder: a recording (.rrd) per log for the Rerun viewer",
        "rerun {}/*.rrd",
        "images, depth and points",
        "rerun",
    ),
    "coco": Format(
        "a folder: images, with boxes and masks in COCO format",
        "pycocotools.coco.COCO('{}/annotations.json')",
        "the logs, if they were moved",
    ),
}


def export(
    results: "Results",
    to: str,
    output: Path,
    recordings: Mapping[str, "LogFiles"],
    known: "KnownMap | None" = None,
) -> list[str]:
    """Export results to another format, atomically.

    Args:
        results: Results of a run.
        to: One of :data:`FORMATS`.
        output: Output file or folder, see :class:`Format`.
        recordings: Logs of the results by name, see :func:`jaxdet.export.recordings.find`.
        known: Map to which ``nav2`` adds obstacles.

    Returns:
        A line for each omission, for instance of a log that was moved.

    Raises:
        ConfigError: The output exists, a package is missing, or logs or a map are passed to a
            format that does not use them.
        InputError: The output's folder is not writable, or the results lack data required by the
            format.
        OutputError: The disk is full or broken.
    """
    if recordings and not FORMATS[to].of_logs:
        problem = f"--to {to} does not use --log"
        raise ConfigError(problem, remedy="omit --log")
    if known is not None and to != "nav2":
        remedy = "use --to nav2, or jaxdet track --map before the export"
        raise ConfigError(f"--to {to} does not use --map", remedy=remedy)
    if FORMATS[to].suffix and output.is_dir():
        remedy = f"choose a file, such as {output / f'report{FORMATS[to].suffix}'}"
        raise ConfigError("expected a file, got a folder", path=str(output), remedy=remedy)
    if output.is_file() or (output.is_dir() and any(output.iterdir())):
        remedy = "choose another --output, or remove it"
        raise ConfigError("exists already", path=str(output), remedy=remedy)
    try:
        write: Callable[..., list[str] | None] = import_module(f"jaxdet.export.{to}").export
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("jaxdet"):
            raise
        package, extra = (error.name or "").split(".")[0], FORMATS[to].extra
        remedy = f"pip install 'jaxdet[{extra}]'" if extra else "reinstall jaxdet"
        raise ConfigError(f"--to {to} needs the package {package}", remedy=remedy) from error
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=".jaxdet-export-", dir=output.parent))
    except FileExistsError as error:
        raise InputError("expected a folder, got a file", path=str(output.parent)) from error
    except OSError as error:
        reason = f"can't be written to ({error.strerror})"
        raise InputError(reason, path=str(output.parent)) from error
    try:
        with writing(output):
            more = () if known is None else (known,)
            left_out = write(results, staging / "output", recordings, *more)
        if output.is_dir():
            output.rmdir()
        (staging / "output").rename(output)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return left_out or []
