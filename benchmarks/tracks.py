"""``python -m benchmarks tracks``: evaluate tracks of simulated logs against the ground truth.

The scenes contain walking people and crossing carts (the family ``moving``). MOTA, MOTP and IDF1
are computed by ``motmetrics`` over all required objects. As in MOTChallenge, tracks of objects that
need not be found (walls, hedges, objects out of range or hardly visible) are ignored.
"""

import json
import shutil
import time
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import motmetrics
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.engine import run
from jaxdet.io import find_logs
from jaxdet.results.manifest import write_manifest
from jaxdet.sim import SimConfig, Truth, load_scene, load_truth, write_log
from jaxdet.sim.robot import pose_at, velocity_at
from jaxdet.sim.scene import Model
from jaxdet.tracks import track_results
from jaxdet.tracks.folder import LINKS, TRACKS

MATCH_M = 0.5
"""Maximum distance of a track from the centre of its object [m]."""
MIN_PIXELS = 400
"""Objects with fewer visible pixels, at 640 columns, need not be found."""
RANGE_M = (0.15, 4.0)
LONG_M = 1.6
"""Longer objects (hedges) need not be found, because their visible part has no defined centre
[m]."""
MERGED_M = 0.15
"""An outline contains an object if the object's centre is inside or at most this far away [m]."""


@dataclass(frozen=True)
class Options:
    """Evaluate the tracks of simulated logs, and time the tracking."""

    seeds: tuple[int, int] = (3000, 3020)
    """First seed, and the one after the last."""
    frames: int = 150
    """Frames of each log."""
    rate_hz: float = 15.0
    """Frames per second."""
    width: int = 640
    """Width of the images; the height is three quarters of it [pixel]."""
    depth_error: float = 0.0
    """Scale of the depth errors; 1: those of a real camera."""
    folder: Path = Path("out/tracks")
    """Folder of logs and results; existing ones are reused."""


class Score(NamedTuple):
    """Evaluation of a log."""

    mot: motmetrics.MOTAccumulator
    speed_errors: list[float]
    """Speed errors of moving objects, in each frame that shows them [m/s]."""
    standing_errors: list[float]
    """Speed errors of static objects [m/s]."""
    off: list[tuple[float, float, float]]
    """For each frame and object with a single outline: distance between the centres of outline and
    visible part, of visible part and whole object, and of outline and whole object [m]."""
    missed: Counter
    """Number of frames in which an object has no track, by cause."""


def main(options: Options) -> int:
    """Run the benchmark; return the exit code."""
    names = _simulate(options)
    results = options.folder / "results"
    if not (results / "run.json").exists():
        logs = find_logs([str(options.folder / f"{name}.mcap") for name in names])
        run(logs, results, "wheeled", pictures=0)
    track_results(results)
    scores = {name: _score(_Log(options, results, name)) for name in names}
    print(_table(scores))
    speed = np.concatenate([s.speed_errors for s in scores.values()])
    standing = np.concatenate([s.standing_errors for s in scores.values()])
    missed = sum((s.missed for s in scores.values()), Counter())
    print(
        f"\nspeed error, moving: mean {speed.mean():.3f} m/s, median {np.median(speed):.3f}, "
        f"90th percentile {np.quantile(speed, 0.9):.3f}; static: mean {standing.mean():.4f}"
    )
    parts = np.mean([part for s in scores.values() for part in s.off], axis=0)
    print(
        f"mean distance of centres: outline and visible part {parts[0]:.3f} m, visible part and "
        f"whole object {parts[1]:.3f} m, outline and whole object {parts[2]:.3f} m"
    )
    print("missed frames: " + ", ".join(f"{n} {why}" for why, n in missed.most_common()))
    print(f"{_rate(options, results):,.0f} frames/s of a long log, tables read, linked and written")
    return 0


def _simulate(options: Options) -> list[str]:
    options.folder.mkdir(parents=True, exist_ok=True)
    names = []
    for seed in range(*options.seeds):
        path = options.folder / f"m{seed}.mcap"
        names.append(path.stem)
        if not path.exists():
            config = _config(options, seed)
            write_log(path, config)
    return names


def _config(options: Options, seed: int) -> SimConfig:
    size = options.width, options.width * 3 // 4
    return SimConfig(
        "moving",
        options.frames,
        seed,
        options.rate_hz,
        *size,
        camera_height_m=0.5,
        depth_error=options.depth_error,
    )


def _rate(options: Options, results: Path) -> float:
    """Return the rate of tracking a log of 20,000 frames, with file access [frames/s]."""
    folder, repeats = options.folder / "long", 20_000 // max(1, _rows(results, "frames")) + 1
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    first = min(results.glob("*/manifest.json")).parent  # its name is that of all rows
    shutil.copy(first / "config.json", folder)
    count = {name: _write_long(results, folder, name, repeats) for name in ("frames", "obstacles")}
    summary = json.loads((first / "summary.json").read_text())
    one = {**summary["logs"][0], **count, "map": None, "pictures": []}
    (folder / "summary.json").write_text(json.dumps({**summary, **count, "logs": [one]}))
    write_manifest(folder, {"log": summary["logs"][0]["log"], "inputs": []})
    times = []
    for _ in range(5):
        start = time.perf_counter()
        track_results(folder)
        times.append(time.perf_counter() - start)
    return count["frames"] / min(times)


def _rows(results: Path, name: str) -> int:
    return sum(pq.read_metadata(path).num_rows for path in results.glob(f"*/{name}.parquet"))


def _read(results: Path, name: str, **how: Any) -> pa.Table:
    """Read a table of all logs."""
    paths = sorted(results.glob(f"*/{name}"))
    return pa.concat_tables([pq.read_table(path, **how) for path in paths])


def _write_long(results: Path, folder: Path, name: str, repeats: int) -> int:
    """Write all logs repeatedly as one long log; return the number of rows."""
    table = _read(results, f"{name}.parquet")
    frames = _read(results, "frames.parquet", columns=["log", "frame", "stamp_ns"])
    logs = frames["log"].unique().to_pylist()
    length = int(frames["frame"].to_numpy().max()) + 1
    step = int(np.diff(frames["stamp_ns"].to_numpy()[:2])[0])
    of = np.array([logs.index(log) for log in table["log"].to_pylist()], np.int64)
    frame = of * length + table["frame"].to_numpy()
    first = table.schema.get_field_index
    with pq.ParquetWriter(folder / f"{name}.parquet", table.schema, compression="zstd") as file:
        for k in range(repeats):
            number = frame + k * len(logs) * length
            part = table.set_column(
                first("log"), table.schema.field("log"), [[logs[0]] * len(frame)]
            )
            part = part.set_column(first("frame"), table.schema.field("frame"), [number])
            stamp = 10**18 + number * step
            part = part.set_column(first("stamp_ns"), table.schema.field("stamp_ns"), [stamp])
            file.write_table(part)
        about = pq.read_metadata(next(results.glob(f"*/{name}.parquet"))).metadata
        file.add_key_value_metadata({k: v for k, v in about.items() if k.startswith(b"jaxdet")})
    return repeats * table.num_rows


class _Log:
    """Ground truth and tracks of a log."""

    def __init__(self, options: Options, results: Path, name: str) -> None:
        config = _config(options, int(name[1:]))
        self.truth: Truth = load_truth(options.folder / f"{name}.mcap")
        self.scene = load_scene("moving", config.seed)
        self.rate_hz = options.rate_hz
        self.pixels = MIN_PIXELS * (options.width / 640) ** 2
        here: Any = [("log", "=", name)]
        self.tracks = _read(results, TRACKS, filters=here).to_pylist()
        columns = ["frame", "corners_world"]
        rows = _read(results, "obstacles.parquet", columns=columns, filters=here)
        links = _read(results, LINKS, columns=["track"], filters=here)
        self.outlines: dict[int, list[np.ndarray]] = {}
        self.outlines_of: dict[tuple[int, int | None], list[np.ndarray]] = {}
        """Outlines by frame and track."""
        frames, corners = (rows[c].to_pylist() for c in columns)
        for frame, ring, track in zip(frames, corners, links["track"].to_pylist(), strict=True):
            outline = np.array(ring, np.float32).reshape(4, 2)
            self.outlines.setdefault(frame, []).append(outline)
            self.outlines_of.setdefault((frame, track), []).append(outline)

    @cached_property
    def motion(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres ``(F, J, 2)`` [m] and speeds ``(F, J)`` [m/s] of all objects."""
        place = self.truth.box_world[:, :, :4, :2].mean(axis=2).astype(np.float64)
        speed = np.zeros(place.shape[:2])
        for j, thing in enumerate(self.scene.objects):
            if isinstance(thing, Model) and thing.path is not None:
                for frame in range(len(place)):
                    pose = pose_at(thing.path, frame / self.rate_hz)
                    place[frame, j] = pose.x, pose.y
                    speed[frame, j] = abs(velocity_at(thing.path, frame / self.rate_hz)[0])
        return place, speed

    @cached_property
    def required(self) -> np.ndarray:
        """Whether each object must be found in a frame, ``(F, J)`` bool."""
        truth = self.truth
        box = truth.box_world[:, :, :4, :2].astype(np.float64)
        sides = np.linalg.norm(box - np.roll(box, 1, axis=2), axis=-1).max(axis=(0, 2))
        near = (truth.nearest_m >= RANGE_M[0]) & (truth.nearest_m <= RANGE_M[1])
        seen = (truth.visible_pixels >= self.pixels) & near & (truth.height_m > 0.05)
        return seen & ~truth.is_wall & (sides <= LONG_M) & ~self._inside

    @property
    def _inside(self) -> np.ndarray:
        """Whether each object is inside of a taller one, ``(J,)`` bool, so no image shows both."""
        things = self.scene.objects
        stand = [j for j, o in enumerate(things) if not isinstance(o, Model) or o.path is None]
        box, high = self.truth.box_world[0, :, :4, :2], self.truth.box_world[0, :, :, 2].max(axis=1)
        inside = np.zeros(len(things), bool)
        for i in stand:
            middle = box[i].mean(axis=0)
            inside[i] = any(
                high[j] > high[i] and _distance(box[j], middle) < 0 for j in stand if j != i
            )
        return inside

    def there(self, frame: int) -> tuple[list[int], np.ndarray, np.ndarray]:
        """Return the tracks of a frame, their positions ``(K, 2)`` and speeds ``(K,)``."""
        found, places, speeds = [], [], []
        for k, track in enumerate(self.tracks):
            if track["first_frame"] <= frame <= track["last_frame"]:
                i = frame - track["first_frame"] if track["moving"] else 0
                found.append(k)
                places.append(track["path"][2 * i : 2 * i + 2])
                speeds.append(track["speed_mps"][i])
        return found, np.array(places).reshape(-1, 2), np.array(speeds)

    @cached_property
    def in_sight(self) -> np.ndarray:
        """Centres of the visible parts of all objects, ``(F, J, 2)`` [m]."""
        camera = self.truth.T_world_camera
        forward = camera[:, :2, 2] / np.linalg.norm(camera[:, :2, 2], axis=1, keepdims=True)
        right = np.stack([forward[:, 1], -forward[:, 0]], axis=1)
        middle = (self.truth.ground_min + self.truth.ground_max)[..., None] / 2.0
        shift = middle[:, :, 0] * right[:, None] + middle[:, :, 1] * forward[:, None]
        return camera[:, None, :2, 3] + shift

    def off(self, frame: int, j: int, track: int) -> tuple[float, float, float] | None:
        """Return the distances of :attr:`Score.off`, None unless the track has a single outline."""
        outlines = self.outlines_of.get((frame, track), [])
        if len(outlines) != 1:
            return None
        outline = outlines[0].mean(axis=0)
        shown, whole = self.in_sight[frame, j], self.motion[0][frame, j]
        found = (outline - shown, shown - whole, outline - whole)
        first, second, both = (float(np.hypot(*way)) for way in found)
        return first, second, both

    def ignored(self, frame: int, place: np.ndarray) -> bool:
        """Return whether a track is at an object that need not be found."""
        return any(
            _distance(self.truth.footprint_world[frame, j], place) < MATCH_M
            for j in np.flatnonzero(~self.required[frame])
        )

    def cause(self, frame: int, j: int) -> str:
        """Return why an object has no track in a frame."""
        place = self.motion[0][frame]
        holding = [o for o in self.outlines.get(frame, ()) if _distance(o, place[j]) < MERGED_M]
        if not holding:
            return "not detected"
        others = np.flatnonzero(self.truth.visible_pixels[frame] > 0)
        if any(_distance(o, place[i]) < 0 for o in holding for i in others if i != j):
            return "merged with another object"
        return "detected, not in a track"


def _distance(outline: np.ndarray, place: np.ndarray) -> float:
    """Return the distance of a point from an outline ``(V, 2)``, negative inside [m]."""
    corners = outline[~np.isnan(outline[:, 0])].astype(np.float32)
    return -cv2.pointPolygonTest(corners[:, None], (float(place[0]), float(place[1])), True)


def _score(log: _Log) -> Score:
    accumulator = motmetrics.MOTAccumulator()
    score = Score(accumulator, [], [], [], Counter())
    place, speed = log.motion
    fast: dict[tuple[int, int], float] = {}
    for frame in range(len(log.truth.stamp_ns)):
        things = np.flatnonzero(log.required[frame])
        tracks, places, speeds = log.there(frame)
        away = np.linalg.norm(place[frame, things][:, None] - places[None], axis=-1)
        away[away > MATCH_M] = np.nan
        alone = np.isnan(away).all(axis=0)
        kept = [i for i in range(len(tracks)) if not (alone[i] and log.ignored(frame, places[i]))]
        numbers = [tracks[i] for i in kept]
        fast |= {(frame, tracks[i]): float(speeds[i]) for i in kept}
        accumulator.update(things.tolist(), numbers, away[:, kept], frameid=frame)
    events: Any = accumulator.mot_events.reset_index()
    for event in events.itertuples():
        if event.Type in ("MATCH", "SWITCH"):
            j = int(event.OId)
            error = abs(fast[event.FrameId, int(event.HId)] - speed[event.FrameId, j])
            thing = log.scene.objects[j]
            moves = isinstance(thing, Model) and thing.path is not None
            if (off := log.off(event.FrameId, j, int(event.HId))) is not None:
                score.off.append(off)
            (score.speed_errors if moves else score.standing_errors).append(error)
        elif event.Type == "MISS":
            score.missed[log.cause(event.FrameId, int(event.OId))] += 1
    return score


def _table(scores: dict[str, Score]) -> str:
    metrics = [
        "num_frames",
        "num_objects",
        "mota",
        "motp",
        "idf1",
        "num_misses",
        "num_false_positives",
        "num_switches",
        "num_fragmentations",
    ]
    found = motmetrics.metrics.create().compute_many(
        [s.mot for s in scores.values()], names=list(scores), metrics=metrics, generate_overall=True
    )
    return found.to_string(float_format=lambda value: f"{value:.3f}")
