"""``jaxdet verify``: whether results are whole, unchanged, of their logs and right."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.report import many
from jaxdet.cli.spinner import SPINNER
from jaxdet.errors import ConfigError, printable

if TYPE_CHECKING:
    from jaxdet.verify import Report

DESCRIPTION = """\
Checks results: every file against its checksum in the manifest.json of its log; the tables, which
must be in order, belong together and have a row for every frame; tracks, which linking the
obstacles once more must give again; stamps and poses of all frames against the logs; and of each
log some frames, whose rows the NumPy reference must find again, byte for byte. The logs are looked
for where the run found them. Says a line for each thing that is not as it should be, and ends with
exit code 1 where there is one.

Examples:
  jaxdet verify results
  jaxdet verify results --against moved/drive.mcap --sample 100
"""


@dataclass(frozen=True)
class VerifyCommand:
    """What ``jaxdet verify`` takes."""

    results: Path = field(metadata={"positional": True, "takes": "RESULTS"})
    """Folder that jaxdet run wrote, or that of one log in it."""
    against: tuple[str, ...] = field(default=(), metadata={"takes": "LOG..."})
    """Where the logs are now: MCAP files, folders or globs."""
    sample: int = 8
    """Frames of each log that are computed again, spread evenly; 0: none."""
    json: bool = False
    """Print what was found as JSON, and nothing else."""


def main(args: list[str]) -> int:
    """Runs the command; returns the exit code."""
    command = parse_flags(VerifyCommand, args, "jaxdet verify", DESCRIPTION)
    if command.sample < 0:
        raise ConfigError("--sample is a number of frames, at least 0")
    with SPINNER.shown("checking"):
        from jaxdet.verify import verify

        report = verify(command.results, command.against, command.sample)
    if command.json:
        found = asdict(report) | {"findings": [f._asdict() for f in report.findings]}
        print(json.dumps(found, indent=2))
    else:
        print("\n".join(map(printable, report_lines(report))))
    return 1 if report.findings else 0


def report_lines(report: "Report") -> list[str]:
    """Return the lines of the report for people."""
    lines = [str(finding) for finding in report.findings]
    lines += [f"note: {note}" for note in report.notes]
    lines.append(
        f"{report.files} files, {report.frames} frames and {report.obstacles} obstacles read, "
        f"{report.linked} linked again, "
        f"{report.frames_of_logs} frames compared with their logs, "
        f"{report.frames_again} computed again"
    )
    if count := len(report.findings):
        return [*lines, many(count, "finding")]
    if left := report.frames - report.frames_of_logs:
        return [*lines, f"nothing wrong, but {left} frames were not compared with their logs"]
    return [*lines, "all as it should be"]
