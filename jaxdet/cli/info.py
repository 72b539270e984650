"""``jaxdet info``: what is in a log, and what a run would use of it and why."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from jaxdet.cli.settings import defaults, given
from jaxdet.config import Config, GroundConfig
from jaxdet.errors import JaxdetError
from jaxdet.io.options import LogOptions

if TYPE_CHECKING:
    from jaxdet.io import LogFiles

Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]

DESCRIPTION = """\
Says what is in logs: topics and rates, the calibration and the floor that were found, what a
run would use and why, and whether the file is whole. Takes the flags of jaxdet run for reading.

Example:
  jaxdet info drive.mcap
"""


@dataclass(frozen=True)
class InfoCommand:
    """What ``jaxdet info`` takes."""

    logs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="LOG...")]
    """MCAP files, folders (searched for .mcap) or globs."""
    config: Annotated[str | None, tyro.conf.arg(metavar="FILE")] = None
    """TOML file, as for jaxdet run."""
    json: Flag = False
    """Print JSON."""
    ground: GroundConfig = field(default_factory=GroundConfig)
    log: LogOptions = field(default_factory=LogOptions)


def main(args: list[str]) -> int:
    """Runs the command; returns the exit code."""
    config, log_options, _ = defaults(args)
    missing: Any = tyro.MISSING
    start = InfoCommand(missing, ground=config.ground, log=log_options)
    command = tyro.cli(
        InfoCommand, args=args, default=start, prog="jaxdet info", description=DESCRIPTION
    )
    from jaxdet.io import find_logs
    from jaxdet.io.results import to_json

    failed, found = 0, []
    for files in find_logs(given(command.logs)):
        try:
            about = describe(files, Config(ground=command.ground), command.log)
        except JaxdetError as error:
            failed += 1
            about = {"log": files.name, "error": str(error)}
            print(f"jaxdet: error: {error}", file=sys.stderr)
        found.append(about)
        if not command.json and "error" not in about:
            print("\n".join(tree(about)))
    if command.json:
        print(to_json({"logs": found}), end="")
    return 1 if failed else 0


def describe(files: "LogFiles", config: Config, options: LogOptions) -> dict[str, Any]:
    """All that is known of a log, as JSON has it.

    Raises:
        JaxdetError: The log can't be used.
    """
    from jaxdet.engine import decide_planes, plain
    from jaxdet.io import open_log

    with open_log(files, options) as log:
        planes = decide_planes(log, config, "reference")
        about = {
            "log": log.name,
            "paths": files.paths,
            "frames": log.num_frames,
            "description": log.description,
            "calibration": log.calibration,
            "ground": planes.records,
            "warnings": planes.warnings,
        }
    return plain(about)


def tree(value: dict[str, Any], depth: int = 0) -> Iterator[str]:
    """Nested mappings and lists as indented lines; what is empty is left out."""
    pad = "  " * depth
    for key, item in value.items():
        name = str(key).replace("_", " ")
        if item in (None, "", [], {}):
            continue
        if isinstance(item, dict):
            yield f"{pad}{name}:"
            yield from tree(item, depth + 1)
        elif isinstance(item, list) and any(isinstance(part, dict | list) for part in item):
            yield f"{pad}{name}:"
            yield from _items(item, depth + 1)
        elif isinstance(item, list) and all(isinstance(part, str) for part in item):
            lines = item if len(item) > 1 else [f"{name}: {item[0]}"]
            yield from [f"{pad}{name}:"] * (len(item) > 1)
            yield from (f"{pad}{'  ' * (len(item) > 1)}{line}" for line in lines)
        else:
            yield f"{pad}{name}: {_text(item)}"


def _items(items: list[Any], depth: int) -> Iterator[str]:
    pad = "  " * depth
    for item in items:
        if isinstance(item, dict):
            parts = ((k, v) for k, v in item.items() if v not in (None, "", [], {}))
            yield f"{pad}- " + ", ".join(f"{k.replace('_', ' ')} {_text(v)}" for k, v in parts)
        else:
            yield f"{pad}- {_text(item)}"


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return " ".join(_text(part) for part in value)
    if isinstance(value, dict):
        return "; ".join(f"{k} {_text(v)}" for k, v in value.items())
    return str(value)
