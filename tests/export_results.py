"""Results for the tests of exports: small simulated logs, and rows made by hand."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxdet.io import LogOptions
from jaxdet.presets import preset
from jaxdet.results.free_floor import RAY_RAD
from jaxdet.results.json_files import write_json
from jaxdet.results.manifest import write_manifest
from jaxdet.results.occupancy import MapImage, save_map
from jaxdet.results.rows import Lists
from jaxdet.results.summary import LogSummary, Summary
from jaxdet.results.tables import Tables
from jaxdet.results.writer import TableWriter
from jaxdet.sim import SimConfig, write_log
from tests.runs import run_log

START_NS = 1_700_000_000_000_000_000


def sim_log(path: Path, **options: Any) -> Path:
    """Write a simulated log of a driving robot, so that poses of frames differ."""
    given = {"frames": 6, "width": 160, "height": 120, "rate_hz": 2.0, "start_ns": START_NS}
    write_log(path, SimConfig(**(given | options)))
    return path


def run(log: Path, output: Path, name: str = "wheeled", options: LogOptions | None = None) -> Path:
    """Run a log and return its results."""
    backend = "reference" if name == "paper" else "jax"  # its program takes seconds to compile
    how = {"backend": backend, "pictures": 1, "preset": name}
    run_log(log, output, preset(name), log=options, **how)
    return output


def by_hand(folder: Path, frames: list[tuple], ends: int = 0) -> Path:
    """Write results of a camera at the origin of the world, 1 m up, that looks along X.

    Args:
        folder: Folder of the results.
        frames: For each frame: the centres of obstacles, right and forward [m], each 0.2 m wide;
            the forward distance up to which floor is free [m], in rays up to 26 degrees to each
            side; and optionally columns that replace those of the tables, by name.
        ends: Kind of end of the free floor, ``free_end``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with TableWriter(folder) as writer:
        for number, (places, free_m, *other) in enumerate(frames):
            frame, obstacles = _rows(number, places, free_m, ends)
            for columns in (frame, obstacles):
                columns |= {k: v for more in other for k, v in more.items() if k in columns}
            writer.add(Tables.of(frame, obstacles))
        ones = np.ones((80, 80), np.int32)
        image = MapImage(ones, ones, (-1.0, -2.0), 0.05, np.zeros((len(frames), 2)))
        save_map(folder / "map.npz", image)
        total = sum(len(frame[0]) for frame in frames)
        log = LogSummary("hand", ("hand.mcap",), camera="camera", file_name="hand", map="map")
        log.frames, log.obstacles = len(frames), total
        config = {"surface": {"cell_rad": 0.1}, "log": {}}
        summary = Summary("reference", 16, [log]).to_dict()
        writer.close(config, summary)
    write_json(folder / "config.json", config)
    write_json(folder / "summary.json", summary)
    write_manifest(folder, {"log": "hand", "inputs": []})
    return folder


def _rows(number: int, places: list, free_m: float, end: int) -> tuple[dict, dict]:
    count = len(places)
    bearing = np.arange(-105, 106) * RAY_RAD
    free = {"free_bearing_rad": bearing, "free_from_m": 0 * bearing + 0.3}
    free["free_to_m"] = free_m / np.cos(bearing)

    def one(values: Any) -> Lists:
        values = np.asarray(values)
        return Lists.of_lengths(values, np.array([values.size]), np.array([False]))

    frame = {
        "log": np.array(["hand"], object),
        "camera": np.array(["camera"], object),
        "frame": np.array([number]),
        "stamp_ns": np.array([START_NS + number * 10**8]),
        "color_stamp_ns": np.array([START_NS + number * 10**8]),
        "log_time_ns": np.array([START_NS + number * 10**8]),
        "status": np.array(["ok"], object),
        "num_obstacles": np.array([count]),
        "overflow": np.array([False]),
        "camera_height_m": np.array([1.0]),
        "camera_pitch_rad": np.array([0.0]),
        "camera_roll_rad": np.array([0.0]),
        "camera_frame": np.array(["optical"], object),
        "world_frame": np.array(["map"], object),
        "camera_position_world": np.array([[0.0, 0.0, 1.0]]),
        "camera_orientation_world": np.array([[-0.5, 0.5, -0.5, 0.5]]),
        "floor_source": np.array(["frame"], object),
        "floor_refused": np.ma.array(["far"], mask=[True], dtype=object),
        "free_end": one(np.full(bearing.size, end, np.int8)),
        "drop_m": np.array([np.nan]),
        **{name: one(values.astype(np.float32)) for name, values in free.items()},
    }
    middle = np.reshape(places, (-1, 1, 2))
    square = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
    ground = middle + square
    world = np.stack([ground[..., 1], -ground[..., 0]], axis=-1)
    near = (middle + [[-0.1, -0.1], [0.0, -0.1], [0.1, -0.1]]).astype(np.float32)
    zeros = np.zeros(count)
    obstacles = {name: zeros.astype(np.int32) for name in ("num_points", "vertices")}
    obstacles |= {name: zeros.astype(np.int32) for name in ("u_min", "u_max", "v_min", "v_max")}
    obstacles |= {f"{a}{end}": zeros for a in "xyz" for end in ("", "_min", "_max")}
    obstacles |= {
        "log": np.full(count, "hand", object),
        "camera": np.full(count, "camera", object),
        "frame": np.full(count, number),
        "stamp_ns": np.full(count, START_NS + number * 10**8),
        "obstacle": np.arange(count, dtype=np.int32),
        "box_image": np.full(count, "depth", object),
        "evidence": np.full(count, "surface", object),
        "vertices": zeros.astype(np.int8),
        "corners_ground": ground.reshape(-1, 8).astype(np.float32),
        "corners_world": world.reshape(-1, 8).astype(np.float32),
        "distance_m": np.linalg.norm(middle[:, 0], axis=1),
        "bottom_m": zeros,
        "top_m": zeros + 0.5,
        "contour": Lists.of_lengths(near.ravel(), np.full(count, 6), np.zeros(count, bool)),
    }
    return frame, obstacles
