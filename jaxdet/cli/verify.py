"""``jaxdet verify``: checks that results are complete, unchanged and reproducible."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from jaxdet.cli.flags import parse_flags
from jaxdet.cli.report import many
from jaxdet.cli.terminal import SPINNER
from jaxdet.errors import ConfigError, printable

if TYPE_CHECKING:
    from jaxdet.verify import Report

DESCRIPTION = """\
Checks results: each file against its checksum in the manifest.json of its log; order, references
and completeness of the tables; tracks, by linking the obstacles again; timestamps and poses of all
frames against the logs; and a sample of frames per log, whose rows the NumPy reference must
reproduce byte for byte. The logs are expected where the run found them. Prints a line per problem;
the exit code is 1 if there is one.

Examples:
  jaxdet verify results
  jaxdet verify results --against moved/drive.mcap --sample 100
"""


@dataclass(frozen=True)
class VerifyCommand:
    """Arguments of ``jaxdet verify``."""

    results: Path = field(metadata={"positional": True, "takes": "RESULTS"})
    """Folder written by jaxdet run, or the folder of one log in it."""
    against: tuple[str, ...] = field(default=(), metadata={"takes": "LOG..."})
    """Current paths of the logs: MCAP files, folders or globs."""
    sample: int = 8
    """Number of frames per log to compute again, evenly spaced; 0 disables this."""
    json: bool = False
    """Print the report as JSON, and nothing else."""


def main(args: list[str]) -> int:
    """Run the command; return the exit code."""
    command = parse_flags(VerifyCommand, args, "jaxdet verify", DESCRIPTION)
    if command.sample < 0:
        raise ConfigError("--sample must be at least 0 frames")
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
    """Return the report as lines of text."""
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
        return [*lines, f"no problems, but {left} frames were not compared with their logs"]
    return [*lines, "no problems found"]
