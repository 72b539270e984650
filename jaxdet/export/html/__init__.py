"""``--to html``: a self-contained report for any browser, without a network."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxdet.errors import FrameStatus, JaxdetError
from jaxdet.export.html.choice import Key, choose
from jaxdet.export.html.collect import NEAR_M, LogFigures, collect
from jaxdet.export.html.images import frame_picture, read_picture
from jaxdet.export.html.maps import map_figure
from jaxdet.export.html.page import (
    FIRST_DATE_S,
    REASONS,
    SOURCES,
    about,
    changed_settings,
    given_options,
    page,
    run_lines,
)
from jaxdet.export.html.trajectories import track_rows
from jaxdet.io.options import LogOptions
from jaxdet.render.canvas import PALETTE
from jaxdet.results.summary import failure
from jaxdet.tracks.folder import lasting_map

if TYPE_CHECKING:
    from jaxdet.io import LogFiles
    from jaxdet.results.reading import ResultLog, Results

MOST_ROWS = 24
"""Maximum number of obstacles listed per frame; the nearest are listed."""
MOST_MAPS = 24
"""Maximum number of maps on the page; those of the logs with the most frames are shown."""
FRAME_COLUMNS = (
    *("stamp_ns", "status", "overflow", "drop_m", "floor_source", "floor_refused"),
    *("camera_height_m", "camera_pitch_rad", "camera_roll_rad"),
)
OBSTACLE_COLUMNS = (
    *("obstacle", "distance_m", "bottom_m", "top_m", "corners_ground", "num_points"),
)
CHUNK_FRAMES = 1 << 14
DIGITS = 6
"""Number of decimals of lengths in metres. It is the precision of float32, so that values rounded
further on the page agree with those in pictures."""


def export(results: "Results", output: Path, recordings: Mapping[str, "LogFiles"]) -> list[str]:
    """Write the report.

    The frames of a long log are grouped into a few hundred bins, each with its nearest obstacle;
    the gallery shows selected frames. So the file is small: 1 MB, plus 50 kB per picture.

    Args:
        results: Results.
        output: File.
        recordings: Logs of the results by name, from which pictures missing in the gallery are
            drawn; other logs are read from their original paths.

    Returns:
        A line for each log with frames that can't be drawn.
    """
    figures = collect(results, results.method.ground.max_depth_m)
    pictures = {
        (log.label, frame): path
        for log in results.logs
        for frame, path in results.pictures(log).items()
    }
    chosen = choose(figures, pictures)
    place = {log.label: number for number, log in enumerate(results.logs)}
    shown = _shown(results, chosen, place)
    for key, frame in shown.items():
        if key in pictures:
            frame |= frame_picture(read_picture(pictures[key]))
    undrawn = _draw(results, shown, recordings)
    entries = [_log(results, log, one) for log, one in zip(results.logs, figures, strict=True)]
    mapped = _mapped(results)
    for log, entry in zip(results.logs, entries, strict=True):
        if log.label in mapped:
            image = lasting_map(results, log)
            entry["map"] = map_figure(image) if image else None
    entries += [_failed(failure.summary) for failure in results.failed]
    frames = sum(log.num_frames for log in results.logs)
    settings = changed_settings(results.config, results.method)
    data = {
        "about": about(results.version, frames, [entry["begin"] or 0.0 for entry in entries]),
        "logs": entries,
        "frames": list(shown.values()),
        "reach": _reach(figures, shown.values()),
        "width": figures[0].width_m if figures else 1.0,
        "near": NEAR_M,
        "reasons": REASONS,
        "sources": SOURCES,
        "palette": ["#" + bytes(color).hex() for color in PALETTE],
        "undrawn": undrawn,
        "preset": results.config.get("preset") or "wheeled",
        "settings": settings + given_options(results.log_options, LogOptions()),
        "run": run_lines(results),
    }
    title = f"Obstacles in {results.logs[0].name}" if len(entries) == 1 and results.logs else ""
    title = title or f"Obstacles in {len(entries)} logs"
    output.write_text(page(title, data), encoding="utf-8")
    return [f"no pictures of some frames: {reason}" for reason in undrawn]


def _reach(figures: Sequence[LogFigures], shown: Iterable[Mapping[str, Any]]) -> int:
    """Return the maximum distance of the timelines [m], a common scale for all logs.

    It may exceed the maximum depth, as obstacles at the side are farther away than their depth.
    """
    drawn = [distance for one in figures for distance in one.timeline.nearest_m.tolist()]
    drawn += [frame["nearest"] for frame in shown if frame["nearest"] is not None]
    return math.ceil(max(filter(math.isfinite, [1.0, *drawn])))


def _draw(
    results: "Results",
    shown: Mapping[Key, dict[str, Any]],
    recordings: Mapping[str, "LogFiles"],
) -> list[str]:
    """Draw the frames that have a result but no picture.

    Returns:
        A line for each log that was not passed and can't be read at its original path.
    """
    undrawn = []
    for log in results.logs:
        wanted = [
            number
            for (label, number), frame in shown.items()
            if label == log.label and frame["status"] == FrameStatus.OK and not frame["picture"]
        ]
        if not wanted:
            continue
        from jaxdet.export.html.drawing import draw_again  # loads JAX
        from jaxdet.export.recordings import recorded

        try:
            files = recordings.get(log.name) or recorded(log)
            for number, picture in draw_again(results, log, files, wanted):
                shown[log.label, number].update(frame_picture(picture))
        except JaxdetError as error:
            if log.name in recordings:
                raise
            undrawn.append(str(error))
    return undrawn


def _mapped(results: "Results") -> set[str]:
    """Return the labels of the logs whose maps are shown on the page."""
    some = [log for log in results.logs if log.summary["map"]]
    some.sort(key=lambda log: -log.num_frames)
    return {log.label for log in some[:MOST_MAPS]}


def _log(results: "Results", log: "ResultLog", figures: LogFigures) -> dict[str, Any]:
    """Return the data of a log for the page, except its map."""
    line, start, stop = figures.timeline, figures.start_ns, figures.stop_ns
    bins, summary = slice(0, line.bins), log.summary
    nearest = _numbers(line.nearest_m[bins], DIGITS)
    least = int(np.argmin(line.nearest_m[bins])) if line.bins else 0
    has_obstacle = bool(line.bins) and nearest[least] is not None
    begin_s = start / 1e9 if start is not None else 0.0
    return {
        "log": log.label,
        "error": None,
        "frames": log.num_frames,
        "status": {k: n for k, n in summary["status"].items() if n},
        "obstacles": log.num_obstacles,
        "overflow": summary["overflow_frames"],
        "floorless": summary["floor_sources"].get("none", 0),
        "nearest": [nearest[least], int(line.frame[least])] if has_obstacle else None,
        "begin": round(begin_s, 3) if begin_s > FIRST_DATE_S else None,
        "duration": (stop - start) / 1e9 if start is not None and stop is not None else None,
        "stride": line.stride,
        "bins": {
            "nearest": nearest,
            "frame": line.frame[bins].tolist(),
            "time": _numbers((line.stamp_ns[bins] - (start or 0)) / 1e9, 2),
            "lost": line.lost[bins].tolist(),
            "most": line.most[bins].tolist(),
        },
        "per_frame": figures.per_frame.tolist(),
        "per_obstacle": figures.per_obstacle.tolist(),
        "near_frames": figures.near_frames.tolist(),
        "near_obstacles": figures.near_obstacles.tolist(),
        "floor": ", ".join(
            f"{SOURCES.get(name, name)} ({n:,})"
            for name, n in summary["floor_sources"].items()
            if n
        ),
        "warnings": summary["warnings"],
        "notes": summary.get("notes", []),
        "errors": summary["frame_errors"],
        "map": None,
        "map_file": summary["map"] and f"{log.folder.absolute().name}/map{log.suffix}",
        "tracks": track_rows(results, log, start or 0),
    }


def _failed(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return the data of a failed log, which is not in the tables."""
    nothing = dict.fromkeys(("nearest", "begin", "duration", "bins", "map", "map_file", "tracks"))
    nothing |= dict.fromkeys(("per_frame", "per_obstacle", "near_frames", "near_obstacles"))
    counts = dict.fromkeys(("frames", "obstacles", "overflow", "floorless"), 0)
    counts |= {"stride": 1, "status": {}}
    lines = {"floor": "", "warnings": entry["warnings"], "notes": [], "errors": []}
    return {"log": entry["log"], "error": failure(entry), **nothing, **counts, **lines}


def _shown(
    results: "Results", chosen: Mapping[Key, Sequence[str]], place: Mapping[str, int]
) -> dict[Key, dict[str, Any]]:
    """Return the data of the chosen frames for the page, except their pictures."""
    frames: dict[Key, dict[str, Any]] = {}
    for log in results.logs:
        wanted = np.array([frame for name, frame in chosen if name == log.label], np.int64)
        if not wanted.size:
            continue
        reasons = dict(_reasons(log.summary["frame_errors"]))
        begin = passed = 0
        for chunk in results.chunks(log, FRAME_COLUMNS, OBSTACLE_COLUMNS, CHUNK_FRAMES):
            numbers = chunk.frames["frame"].to_numpy()
            begin = begin if passed else chunk.frames["stamp_ns"][0].as_py()
            for row in np.flatnonzero(np.isin(numbers, wanted)).tolist():
                values = chunk.frames.slice(row, 1).to_pylist()[0]
                first, last = chunk.first[row : row + 2].tolist()
                own = chunk.obstacles.slice(first, last - first)
                distances = own["distance_m"].to_numpy()
                listed = np.sort(np.argsort(distances, kind="stable")[:MOST_ROWS])
                parts = own.take(listed).to_pylist()
                key = log.label, values["frame"]
                frames[key] = _frame(values, parts, begin) | {
                    "log": place[log.label],
                    "place": passed + row,
                    "kinds": chosen[key],
                    "reason": reasons.get(values["frame"], ""),
                    "nearest": next(iter(_numbers(np.sort(distances)[:1], DIGITS)), None),
                }
            passed += len(numbers)
    return frames


def _frame(row: Mapping[str, Any], parts: list[dict[str, Any]], begin: int) -> dict[str, Any]:
    """Return the data of a frame from its rows."""

    def degrees(name: str) -> float | None:
        return None if row[name] is None else float(np.degrees(row[name]))

    return {
        "frame": row["frame"],
        "time": round((row["stamp_ns"] - begin) / 1e9, 3),
        "stamp": str(row["stamp_ns"]),
        "status": row["status"],
        "count": row["num_obstacles"],
        "overflow": row["overflow"],
        "drop": row["drop_m"],
        "height": row["camera_height_m"],
        "pitch": degrees("camera_pitch_rad"),
        "roll": degrees("camera_roll_rad"),
        "source": row["floor_source"],
        "refused": row["floor_refused"],
        "rows": [_obstacle(part) for part in parts],
        "outlines": [[round(value, 2) for value in part["corners_ground"]] for part in parts],
        "picture": None,
        "size": None,
    }


def _obstacle(part: Mapping[str, Any]) -> list[Any]:
    """Return label; distance, bottom, top, width and depth of the outline [m]; number of cells."""
    corners = np.reshape(part["corners_ground"], (4, 2))
    wide, deep = (float(np.hypot(*(corners[i + 1] - corners[i]))) for i in (0, 1))
    metres = (part["distance_m"], part["bottom_m"], part["top_m"], wide, deep)
    rounded = [None if value is None else round(value, DIGITS) for value in metres]
    return [part["obstacle"], *rounded, part["num_points"]]


def _reasons(errors: Sequence[str]) -> list[tuple[int, str]]:
    """Split the lines of frame errors into frame numbers and reasons."""
    split = (line.removeprefix("frame ").partition(": ") for line in errors)
    return [(int(number), text) for number, _, text in split if number.isdigit()]


def _numbers(values: np.ndarray, digits: int) -> list[float | None]:
    """Return values for JSON; infinite ones are null."""
    return [round(v, digits) if np.isfinite(v) else None for v in values.tolist()]
