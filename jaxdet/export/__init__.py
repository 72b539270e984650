"""Results in the formats of other programs; each format is a module that is loaded when used.

A module ``NAME`` has ``export(results, output, recordings)``, which writes the file or folder
``output``, that is not there yet, and may raise a :class:`jaxdet.errors.JaxdetError`.
``recordings`` are the logs given with ``--log``, by their names in the results. It returns lines
about what is left out, or nothing.
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
    from jaxdet.io import LogFiles
    from jaxdet.results.reading import Results


class Format(NamedTuple):
    """What a format is for."""

    writes: str
    """What the output is."""
    shown_by: str
    """How another program opens it; ``{}`` is the output, as a shell takes it where it is a command
    of one."""
    of_logs: str = ""
    """What ``--log`` adds; empty: the logs aren't looked at."""
    extra: str = ""
    """The extra of jaxdet that its packages come with; empty: they are always there."""
    suffix: str = ""
    """Of a format that is a file; empty: it is a folder."""

    def seen(self, output: Path) -> str:
        """How another program opens an output."""
        name = str(output)
        if self.suffix and output.suffix.lower() != self.suffix:
            return f"{self.shown_by}, which may ask for a name that ends in {self.suffix}"
        if self.shown_by.startswith(("ros2 ", "rerun ")):
            name = shlex.quote(name)
        return self.shown_by.replace("{}", name)


FORMATS = {
    "foxglove": Format(
        "a folder: an MCAP file to open beside each log, and layouts",
        "drag {}/LOG.jaxdet.mcap and the log into Foxglove, and import {}/layout.json",
    ),
    "ros2": Format(
        "a folder: an MCAP file of ROS 2 messages for each log",
        "ros2 bag play {}/LOG.jaxdet.mcap",
        "the obstacles' own points",
    ),
    "nav2": Format(
        "a folder: a map of each log as nav2's map_server loads it (PGM and YAML)",
        "ros2 run nav2_map_server map_server --ros-args -p yaml_filename:={}/LOG.yaml",
    ),
    "html": Format(
        "a file: a page with figures, timelines, maps, pictures",
        "open it in a browser",
        "the logs, if they were moved: it draws frames of them",
        suffix=".html",
    ),
    "rerun": Format(
        "a folder: a recording (.rrd) of each log for the Rerun viewer",
        "rerun {}/*.rrd",
        "images, depth and points too",
        "rerun",
    ),
    "coco": Format(
        "a folder: images, and their boxes and masks as COCO has them",
        "pycocotools.coco.COCO('{}/annotations.json')",
        "the logs, if they were moved",
    ),
}


def export(
    results: "Results", to: str, output: Path, recordings: Mapping[str, "LogFiles"]
) -> list[str]:
    """Writes results in another format; whole, or nothing.

    Args:
        results: What a run wrote.
        to: One of :data:`FORMATS`.
        output: File or folder to write, see :class:`Format`.
        recordings: Logs of the results by name, see :func:`jaxdet.export.recordings.find`.

    Returns:
        Lines about what the format shows and is left out: its log is gone, or has none.

    Raises:
        ConfigError: The output is there already, a package is missing, or the format shows nothing
            of the logs that are given.
        InputError: The output's folder can't be written to, or what the format shows is not in the
            results.
        OutputError: The disk is full or broken.
    """
    if recordings and not FORMATS[to].of_logs:
        problem = f"--to {to} shows nothing of the logs themselves"
        raise ConfigError(problem, remedy="leave --log out")
    if FORMATS[to].suffix and output.is_dir():
        remedy = f"name a file, such as {output / f'report{FORMATS[to].suffix}'}"
        raise ConfigError("is a folder", path=str(output), remedy=remedy)
    if output.is_file() or (output.is_dir() and any(output.iterdir())):
        remedy = "give another --output, or remove it"
        raise ConfigError("is there already", path=str(output), remedy=remedy)
    try:
        write: Callable[..., list[str] | None] = import_module(f"jaxdet.export.{to}").export
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("jaxdet"):
            raise
        package, extra = (error.name or "").split(".")[0], FORMATS[to].extra
        remedy = f"pip install 'jaxdet[{extra}]'" if extra else "install jaxdet again"
        raise ConfigError(f"--to {to} needs the package {package}", remedy=remedy) from error
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=".jaxdet-export-", dir=output.parent))
    except FileExistsError as error:
        raise InputError("is a file, not a folder", path=str(output.parent)) from error
    except OSError as error:
        reason = f"can't be written to ({error.strerror})"
        raise InputError(reason, path=str(output.parent)) from error
    try:
        with writing(output):
            left_out = write(results, staging / "output", recordings)
        if output.is_dir():
            output.rmdir()
        (staging / "output").rename(output)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return left_out or []
