"""Columns of ``tracks.parquet`` and ``track_links.parquet``."""

import pyarrow as pa


def _field(name: str, kind: pa.DataType, unit: str, text: str, nullable: bool = False) -> pa.Field:
    return pa.field(name, kind, nullable, {"unit": unit, "description": text})


_STRING, _I32, _I64, _F32 = pa.string(), pa.int32(), pa.int64(), pa.float32()


def _list(kind: pa.DataType) -> pa.DataType:
    return pa.list_(pa.field("item", kind, nullable=False))


TRACKS_SCHEMA = pa.schema(
    [
        _field("log", _STRING, "", "name of the log"),
        _field("camera", _STRING, "", "name of the camera"),
        _field("track", _I32, "", "number in the log and camera, from 0, by its first obstacle"),
        _field("in_world", pa.bool_(), "", "path in the world, else in the camera's ground frame"),
        _field("first_frame", _I64, "", "frame that shows it first"),
        _field("last_frame", _I64, "", "and last"),
        _field("first_stamp_ns", _I64, "ns", "stamp of its first frame"),
        _field("last_stamp_ns", _I64, "ns", "stamp of its last frame"),
        _field("num_frames", _I64, "", "frames that show it"),
        _field("num_obstacles", _I64, "", "its rows in obstacles.parquet"),
        _field("moving", pa.bool_(), "", "whether it moves in its path's frame, else it stands"),
        _field("mean_speed_mps", _F32, "m/s", "mean of its frames, 0 where it stands"),
        _field("max_speed_mps", _F32, "m/s", "greatest of them"),
        _field("length_m", _F32, "m", "longer side of its outline, median"),
        _field("width_m", _F32, "m", "shorter side, median"),
        _field("top_m", _F32, "m", "highest point above the floor, median", True),
        _field(
            "path", _list(pa.float64()), "m",
            "middle of its outline, x and y in turn: a point for each frame from the first to the "
            "last, shown or not; one point where it stands",
        ),
        _field(
            "speed_mps", _list(_F32), "m/s", "speed in each of these frames; one value likewise"
        ),
    ]
)  # fmt: skip
"""``tracks.parquet``: one row per track."""

LINKS_SCHEMA = pa.schema(
    [
        _field("log", _STRING, "", "name of the log"),
        _field("camera", _STRING, "", "name of the camera"),
        _field("frame", _I64, "", "number of the depth image in the log"),
        _field("obstacle", _I32, "", "label in the frame"),
        _field("track", _I32, "", "number of its track; null where it is in none", True),
    ]
)
"""``track_links.parquet``: one row per row of ``obstacles.parquet``, in the same order."""
