"""Results folders of any size with invented numbers, in the format of a run."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxdet.config import Config
from jaxdet.engine.process_log import write_failure
from jaxdet.errors import printable
from jaxdet.io import LogOptions
from jaxdet.results.json_files import write_json
from jaxdet.results.manifest import write_manifest
from jaxdet.results.names import log_name
from jaxdet.results.record import digest, make_record
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.summary import LogSummary, Summary
from jaxdet.results.tables import Tables
from jaxdet.results.writer import TableWriter
from jaxdet.types import Calibration, Intrinsics

LOST = ("no_color", "decode_error")
START_NS = 1_700_000_000_000_000_000
STEP_NS = 33_000_000
DELAY_NS = 5_000_000


def make_results(folder: Path, logs: Mapping[str, int], config: Config | None = None) -> Path:
    """Write results of logs with given numbers of frames, one in 50 lost, one in 200 overflowing.

    A frame has up to 4 obstacles at distances up to 6 m. An additional log has failed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    method = config or Config()
    how = {"backend": "jax", "pictures": 8, "map": True, "observers": {}}
    record = make_record(method, LogOptions(), "wheeled", **how)
    about = {name: record["about"][name] for name in ("jaxdet", "source", "versions")}
    about |= {"run": digest(record), "inputs": []}
    write_json(folder / "run.json", record)
    for seed, (given, count) in enumerate(logs.items()):
        name = printable(given)  # escaped as by find_logs
        _make_log(folder / log_name(name), name, count, seed, record["config"], about)
    failed = LogSummary("torn", ("/nowhere/torn.mcap",), error="torn: no <b>images</b> in it")
    (folder / "torn").mkdir()
    write_failure(folder / "torn", about, [failed])
    return folder


def _make_log(folder: Path, name: str, count: int, seed: int, config: Any, about: Any) -> None:
    folder.mkdir()
    summary = Summary("jax", 16, seconds=12.5)
    one = LogSummary(name, (f"/nowhere/{name}.mcap",), camera="front")
    one.file_name = log_name(name)
    one.calibration = Calibration(Intrinsics(640, 480, 600.0, 600.0, 320.0, 240.0))
    one.frame_errors.append(f"frame 7: {name} isn't what it was")
    summary.logs.append(one)
    with TableWriter(folder) as writer:
        for start in range(0, count, 1 << 15):
            stop = min(count, start + (1 << 15))
            frames, obstacles = _rows(name, start, stop, np.random.default_rng([seed, start]))
            corners = np.zeros((len(obstacles["log"]), 8))
            one.count(frames, obstacles | {"corners_ground": corners})
            writer.add(Tables(_table(frames, FRAMES_SCHEMA), _table(obstacles, OBSTACLES_SCHEMA)))
        writer.close(config, summary.to_dict())
    write_json(folder / "config.json", {**config, "batch_size": 16})
    write_json(folder / "summary.json", summary.to_dict())
    write_manifest(folder, {**about, "log": name})


def _rows(name: str, start: int, stop: int, rng: np.random.Generator) -> tuple[Any, Any]:
    n = np.arange(start, stop)
    good = rng.random(n.size) > 0.02
    count = np.where(good, rng.integers(0, 5, n.size), 0)
    frame, first = np.repeat(n, count), np.repeat(np.cumsum(count) - count, count)
    log, total = np.full(n.size, name, object), int(count.sum())
    frames = {
        "log": log,
        "camera": np.full(n.size, "front", object),
        "frame": n,
        "stamp_ns": START_NS + n * STEP_NS,
        "log_time_ns": START_NS + n * STEP_NS + DELAY_NS,
        "status": np.where(good, "ok", np.array(LOST, object)[n % 2]),
        "num_obstacles": count,
        "overflow": good & (rng.random(n.size) < 0.005),
        "camera_height_m": np.where(good, 0.5, np.nan),
        "camera_pitch_rad": np.full(n.size, np.nan),
        "camera_roll_rad": np.full(n.size, np.nan),
        "camera_orientation_world": np.ma.array(np.full((n.size, 4), np.nan), mask=True),
        "floor_source": np.full(n.size, "frame", object),
        "floor_refused": np.ma.masked_all(n.size, object),
    }
    obstacles = {
        "log": np.full(total, name, object),
        "camera": np.full(total, "front", object),
        "frame": frame,
        "stamp_ns": START_NS + frame * STEP_NS,
        "obstacle": np.arange(total) - first,
        "distance_m": rng.uniform(0.2, 6, total).astype(np.float32),
    }
    return frames, obstacles


def _table(columns: Mapping[str, Any], schema: pa.Schema) -> pa.Table:
    """Return a table; missing columns are null if the schema allows it, otherwise zero or empty."""
    rows = len(columns["log"])
    return pa.Table.from_arrays([_column(columns, f, rows) for f in schema], schema=schema)


def _column(columns: Mapping[str, Any], field: pa.Field, rows: int) -> pa.Array:
    values = columns.get(field.name)
    if isinstance(values, np.ma.MaskedArray) or (values is None and field.nullable):
        return pa.nulls(rows, field.type)
    if values is not None:
        return pa.array(values, field.type, from_pandas=True)
    if pa.types.is_fixed_size_list(field.type):
        zeros = pa.array(np.zeros(rows * field.type.list_size), field.type.value_type)
        return pa.FixedSizeListArray.from_arrays(zeros, type=field.type)
    return pa.array(["" if pa.types.is_string(field.type) else 0] * rows, field.type)
