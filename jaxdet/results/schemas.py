"""Columns of the tables of results, each with its unit and description."""

from typing import NamedTuple

import pyarrow as pa


class _Column(NamedTuple):
    name: str
    type: pa.DataType
    unit: str
    """``m``, ``rad``, ``ns``, ``pixel``; empty where there is none."""
    description: str
    nullable: bool = False


def _item(kind: pa.DataType) -> pa.Field:
    return pa.field("item", kind, nullable=False)


def _schema(*columns: _Column) -> pa.Schema:
    return pa.schema(
        [
            pa.field(c.name, c.type, c.nullable, {"unit": c.unit, "description": c.description})
            for c in columns
        ]
    )


_STRING, _BOOL = pa.string(), pa.bool_()
_I8, _I32, _I64 = pa.int8(), pa.int32(), pa.int64()
_F32, _F64 = pa.float32(), pa.float64()
_LIST = pa.list_(_item(_F32))

FRAMES_SCHEMA = _schema(
    _Column("log", _STRING, "", "name of the log"),
    _Column("camera", _STRING, "", "name of the camera"),
    _Column("frame", _I64, "", "number of the depth image in the log, from 0"),
    _Column("stamp_ns", _I64, "ns", "header stamp of the depth image"),
    _Column("color_stamp_ns", _I64, "ns", "header stamp of its colour image", True),
    _Column("log_time_ns", _I64, "ns", "when the log received the depth image", True),
    _Column("status", _STRING, "", "ok, or why the frame has no result"),
    _Column("num_obstacles", _I32, "", "rows of the frame in obstacles.parquet"),
    _Column("overflow", _BOOL, "", "obstacles may be lost: too many surfaces, or paper's corners"),
    _Column("camera_height_m", _F32, "m", "optical centre above the floor used", True),
    _Column("camera_pitch_rad", _F32, "rad", "downward tilt of the camera", True),
    _Column("camera_roll_rad", _F32, "rad", "clockwise turn, seen from behind the camera", True),
    _Column(
        "camera_frame",
        _STRING,
        "",
        "frame_id of the camera that lengths refer to (depth; paper: colour)",
        True,
    ),
    _Column("world_frame", _STRING, "", "frame_id of the frame that poses are in", True),
    _Column(
        "camera_position_world", pa.list_(_item(_F64), 3), "m", "x y z of the optical centre", True
    ),
    _Column(
        "camera_orientation_world",
        pa.list_(_item(_F64), 4),
        "",
        "unit quaternion x y z w, w >= 0, that turns the optical frame's axes into the world's",
        True,
    ),
    _Column("floor_source", _STRING, "", "where the floor comes from"),
    _Column("floor_refused", _STRING, "", "why the frame's own depth did not decide", True),
    _Column(
        "free_bearing_rad", _LIST, "rad", "free floor: bearing of a ray, clockwise, 0 ahead", True
    ),
    _Column("free_from_m", _LIST, "m", "where it begins, from the camera's foot", True),
    _Column("free_to_m", _LIST, "m", "where it ends, from the camera's foot", True),
    _Column(
        "free_end",
        pa.list_(_item(_I8)),
        "",
        "what ends it: 0 not known, 1 an obstacle or what is above the step, 2 a drop, 3 the range",
        True,
    ),
    _Column("drop_m", _F32, "m", "distance of the nearest drop on the floor", True),
)
"""``frames.parquet``: one row for each depth image of each log, also without a result."""

OBSTACLES_SCHEMA = _schema(
    _Column("log", _STRING, "", "name of the log"),
    _Column("camera", _STRING, "", "name of the camera"),
    _Column("frame", _I64, "", "number of the depth image in the log, from 0"),
    _Column("stamp_ns", _I64, "ns", "header stamp of the depth image"),
    _Column(
        "obstacle",
        _I32,
        "",
        "label in the frame from 0, by its least measured depth; those of the free floor last",
    ),
    _Column("num_points", _I32, "", "its depth cells; in the preset paper its corners"),
    _Column(
        "evidence",
        _STRING,
        "",
        "what shows it: surface, free_floor (a notch in the free floor) or corners (preset paper)",
    ),
    _Column("box_image", _STRING, "", "image that its box is in: color or depth"),
    _Column("u_min", _I32, "pixel", "first column of its box, null outside of the image", True),
    _Column("u_max", _I32, "pixel", "last column", True),
    _Column("v_min", _I32, "pixel", "first row", True),
    _Column("v_max", _I32, "pixel", "last row", True),
    _Column("x_min", _F32, "m", "left side, in the camera's optical frame"),
    _Column("x_max", _F32, "m", "right side"),
    _Column("y_min", _F32, "m", "upper side; y points down"),
    _Column("y_max", _F32, "m", "lower side"),
    _Column("z_min", _F32, "m", "near side"),
    _Column("z_max", _F32, "m", "far side"),
    _Column("x", _F32, "m", "centroid, right"),
    _Column("y", _F32, "m", "centroid, down"),
    _Column("z", _F32, "m", "centroid, forward"),
    _Column("vertices", _I8, "", "1 where a vertex stands out towards the camera, else 0"),
    _Column(
        "corners_ground",
        pa.list_(_item(_F32), 8),
        "m",
        "rectangle on the floor, which may leave out single cells: right and forward of the "
        "camera in turn, A, B, beyond B, beyond A",
    ),
    _Column(
        "corners_world",
        pa.list_(_item(_F64), 8),
        "m",
        "the same in the world, x and y in turn; null without a pose or a floor level in it",
        True,
    ),
    _Column(
        "distance_m",
        _F32,
        "m",
        "on the floor, from below the camera to the nearest point of the contour; null without a "
        "floor",
        True,
    ),
    _Column("bottom_m", _F32, "m", "its lowest cell above the floor", True),
    _Column("top_m", _F32, "m", "its highest cell above the floor", True),
    _Column("contour", _LIST, "m", "visible edge on the floor, right and forward in turn", True),
)
"""``obstacles.parquet``: one row for each obstacle."""

_LOOKS = (
    _Column(
        "persistence",
        _F32,
        "",
        "of the frames that measure its place since it was found there, the share that show an "
        "obstacle",
        True,
    ),
    _Column("floor_seen", _F32, "", "share of these frames that show floor there", True),
)

TRACKS_SCHEMA = _schema(
    _Column("log", _STRING, "", "name of the log"),
    _Column("camera", _STRING, "", "name of the camera"),
    _Column("track", _I32, "", "number in the log and camera, from 0, by its first obstacle"),
    _Column("in_world", _BOOL, "", "path in the world, else in the camera's ground frame"),
    _Column("first_frame", _I64, "", "frame that shows it first"),
    _Column("last_frame", _I64, "", "and last"),
    _Column("first_stamp_ns", _I64, "ns", "stamp of its first frame"),
    _Column("last_stamp_ns", _I64, "ns", "stamp of its last frame"),
    _Column("num_frames", _I64, "", "frames that show it"),
    _Column("num_obstacles", _I64, "", "its rows in obstacles.parquet"),
    _Column("moving", _BOOL, "", "whether it moves in its path's frame, else it stands"),
    _Column("mean_speed_mps", _F32, "m/s", "mean of its frames, 0 where it stands"),
    _Column("max_speed_mps", _F32, "m/s", "greatest of them"),
    _Column("length_m", _F32, "m", "longer side of its outline, median"),
    _Column("width_m", _F32, "m", "shorter side, median"),
    _Column("top_m", _F32, "m", "highest point above the floor, median", True),
    _Column(
        "path",
        pa.list_(_item(_F64)),
        "m",
        "middle of its outline, x and y in turn: a point for each frame from the first to the "
        "last, shown or not; one point where it stands",
    ),
    _Column("speed_mps", _LIST, "m/s", "speed in each of these frames; one value if stationary"),
    *_LOOKS,
    _Column("in_map", _BOOL, "", "most of its obstacles are in the map that was given", True),
)
"""``tracks.parquet``: one row per track."""

LINKS_SCHEMA = _schema(
    _Column("log", _STRING, "", "name of the log"),
    _Column("camera", _STRING, "", "name of the camera"),
    _Column("frame", _I64, "", "number of the depth image in the log"),
    _Column("obstacle", _I32, "", "label in the frame"),
    _Column("track", _I32, "", "number of its track; null where it is in none", True),
    *_LOOKS,
    _Column("in_map", _BOOL, "", "it stands on something of the map that was given", True),
)
"""``track_links.parquet``: one row per row of ``obstacles.parquet``, in the same order."""

DICTIONARIES = [
    *("log", "camera", "status", "camera_frame", "world_frame", "floor_source", "floor_refused"),
    *("box_image", "evidence"),
]
"""Columns with few different values, which are stored with a dictionary."""
