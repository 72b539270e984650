"""``jaxdet info``: describes a log, and what a run would use of it and why."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxdet.cli.flags import parse_flags, read_defaults
from jaxdet.cli.report import aligned, ground_text, many
from jaxdet.cli.terminal import SPINNER, tell
from jaxdet.config import Config, GroundConfig
from jaxdet.errors import CamerasError, ConfigError, JaxdetError, RescanError, printable
from jaxdet.io.options import LogOptions
from jaxdet.presets import DEFAULT_PRESET

if TYPE_CHECKING:
    from jaxdet.engine import Planes
    from jaxdet.io import Log, LogFiles
    from jaxdet.io.description import LogDescription, TopicDescription

_UNCOUNTED = "not counted; pass --check to count"

DESCRIPTION = """\
Describes logs: topics, rates, calibration, floor, and which topics and frames a run would use and
why; with --check, also whether the files are intact. Accepts the log flags of jaxdet run.

Example:
  jaxdet info drive.mcap
"""


COMMON = (
    "ground.camera_height_m",
    "ground.camera_pitch_rad",
    "ground.camera_roll_rad",
    "log.color",
    "log.depth",
    "log.color_from_depth",
)
"""Settings listed by ``--help``."""


@dataclass(frozen=True)
class InfoCommand:
    """Arguments of ``jaxdet info``."""

    logs: tuple[str, ...] = field(metadata={"positional": True, "takes": "LOG..."})
    """MCAP, .bag or .db3 files, folders of such files or of images, or globs."""
    preset: str = DEFAULT_PRESET
    """Initial configuration, as for jaxdet run."""
    config: Path | None = field(default=None, metadata={"takes": "FILE"})
    """TOML file or config.json, as for jaxdet run."""
    json: bool = False
    """Print JSON."""
    check: bool = False
    """Read whole logs: check every CRC, pair all frames, count all poses."""
    suggest_mask: Path | None = field(default=None, metadata={"takes": "FILE"})
    """Write a PNG for --log.mask, in which the robot's own body is black: everything above the
    floor that stays less than 1 m from the camera while the camera moves. Requires a log with one
    camera."""
    join: bool = True
    """Join split files into one log per recording."""
    ground: GroundConfig = field(default_factory=GroundConfig)
    log: LogOptions = field(default_factory=LogOptions)


def main(args: list[str]) -> int:
    """Run the command; return the exit code."""
    config, log_options, name = read_defaults(args)
    start = {"preset": name, "ground": config.ground, "log": log_options}
    command = parse_flags(InfoCommand, args, "jaxdet info", DESCRIPTION, COMMON, start)
    from jaxdet.engine.startup import use_warp_cache
    from jaxdet.io import find_logs
    from jaxdet.results.json_files import plain, to_json

    use_warp_cache()
    failed, found = 0, []
    options = replace(command.log, scan=command.log.scan or command.check)
    method = replace(config, ground=command.ground)
    todo = [(files, options) for files in reversed(find_logs(command.logs, join=command.join))]
    if command.suggest_mask:
        if len(todo) > 1:
            raise ConfigError(f"--suggest-mask takes one log, got {len(todo)}")
        return _suggest_mask(*todo[0], method, command.suggest_mask)
    while todo:
        files, options = todo.pop()
        try:
            with SPINNER.shown(f"reading {files.name}"):
                about, lines = describe(files, method, options)
        except CamerasError as error:
            cameras = reversed(error.cameras)
            todo += [(files, replace(options, camera=camera)) for camera in cameras]
        except JaxdetError as error:
            failed += 1
            camera = {"camera": options.camera} if options.camera else {}
            known = {"topics": plain(error.topics)} if error.topics else {}
            found.append({"log": files.name, **camera, **known, "error": str(error)})
            if error.topics and not command.json:
                print("\n".join([f"{files.name}: not usable", *_topic_lines(error.topics)]))
            tell(f"jaxdet: error: {error}")
        else:
            found.append(about)
            if not command.json:
                print("\n".join(lines))
    if command.json:
        print(to_json({"logs": found}), end="")
    return 1 if failed else 0


def _suggest_mask(files: "LogFiles", options: LogOptions, config: Config, path: Path) -> int:
    """Write a mask of the robot's own body, if any part of it is visible; return the exit code."""
    if path.suffix.lower() != ".png":
        problem = f"--suggest-mask {path} is not a .png file"
        raise ConfigError(problem, remedy="choose a name that ends with .png")
    import cv2
    import numpy as np

    from jaxdet.engine.floors import decide_planes
    from jaxdet.engine.own_body import NEAR_M, find_own_body
    from jaxdet.io import open_log
    from jaxdet.results.durable import write_whole

    with SPINNER.shown(f"reading {files.name}"), open_log(files, options) as log:
        body = find_own_body(log, config, decide_planes(log, config, "jax"))
    if not body.any():
        seen = f"no part of the robot is visible (nothing stays within {NEAR_M:g} m)"
        print(f"{log.label}: {seen}; no mask is needed")
        return 0
    write_whole(path, cv2.imencode(".png", np.where(body, 0, 255).astype(np.uint8))[1].tobytes())
    share = f"{100 * body.mean():.1f} % of the depth image"
    print(f"{log.label}: {share} may show the robot's own body; check {path}")
    camera = f"{log.camera}=" if log.label != log.name else ""
    print(f"to exclude it: --log.mask {camera}{path}")
    return 0


def describe(
    files: "LogFiles", config: Config, options: LogOptions
) -> tuple[dict[str, Any], list[str]]:
    """Describe a camera of a log, as a JSON-compatible dict and as lines of text.

    Raises:
        CamerasError: The log has several cameras, and none is selected.
        JaxdetError: The log is not usable.
    """
    from jaxdet.engine.floors import decide_planes
    from jaxdet.io import open_log
    from jaxdet.results.json_files import plain

    try:
        with open_log(files, options) as log:
            planes = decide_planes(log, config, "jax")
            about = {
                "log": log.name,
                "camera": log.camera,
                "frames": log.num_frames,
                "description": log.description,
                "calibration": log.calibration,
                "ground": planes.records,
                "warnings": planes.warnings,
            }
            return plain(about), list(_lines(log.label, log.description, planes, _color(log)))
    except RescanError:  # as in a run, the index is rebuilt
        if options.scan:
            raise
    return describe(files, config, replace(options, scan=True))


def _color(log: "Log") -> str:
    """Return a text on the frames that have colour, or the reason why no frame has colour."""
    if log.color_problem:
        return f"{log.color_problem}; pictures show depth"
    pairing = log.description.pairing
    return pairing.text if pairing else _UNCOUNTED


def _lines(label: str, about: "LogDescription", planes: "Planes", color: str) -> Iterator[str]:
    yield f"{label}: {many(about.num_frames, 'frame')} in {about.duration_s:.2f} s"
    files = [f"{printable(str(file.path))}: {file.text}" for file in about.integrity]
    yield from _section("files", files)
    yield from _topic_lines(about.topics)
    yield from _section("cameras", about.cameras)
    yield from _section("used", about.choices)
    yield from _section("part", [about.part])
    yield from _section("colour", [color])
    extrinsics = f"depth to colour: {about.extrinsics_source}" if about.extrinsics_source else ""
    yield from _section("calibration", [*about.calibration, extrinsics])
    messages = [record.message for record in planes.records[:1] if record.source == "estimate"]
    yield from _section("ground", [ground_text(planes.records), *messages, about.base_source])
    known = "" if about.num_poses is None else f"known for {about.num_poses} frames"
    yield from _section("poses", [about.pose_source, known])
    yield from _section("warnings", [*about.warnings, *planes.warnings])
    yield from _section("notes", about.notes)


def _section(name: str, lines: Sequence[str]) -> Iterator[str]:
    shown = [line for line in lines if line]
    if shown:
        yield f"{name}"
        yield from (f"  {line}" for line in shown)


def _topic_lines(topics: Sequence["TopicDescription"]) -> list[str]:
    rows = [
        (
            topic.topic,
            topic.schema,
            topic.image_encoding or topic.message_encoding,
            f"{topic.num_messages}",
            f"{topic.rate_hz:.1f} Hz" if topic.rate_hz else "",
            f"<- {topic.chosen_as}" if topic.chosen_as else topic.problem,
        )
        for topic in topics
    ]
    return list(_section("topics", aligned(rows, right=(3, 4))))
