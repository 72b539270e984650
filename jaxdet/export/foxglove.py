"""Scenes for Foxglove: an MCAP file to open together with each log, and layouts.

Obstacles are in the optical frame of the depth camera (of the colour camera in the preset
``paper``), the map is in the world frame, and a transform adds the floor frame of the camera (x
right, y forward, z up). Each message replaces the previous one, so that seeking works.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.ArrowPrimitive_pb2 import ArrowPrimitive
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Grid_pb2 import Grid as GridMessage
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point2_pb2 import Point2
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextAnnotation_pb2 import TextAnnotation
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer

from jaxdet.export.shapes import (
    Row,
    T_camera_floor,
    T_world_camera,
    box,
    camera_name,
    contour,
    corners,
    floor_name,
    heights,
    label,
    number_of,
    quaternion,
    topic,
)
from jaxdet.export.sidecar import sidecar_frames, sidecars
from jaxdet.io import LogFiles
from jaxdet.io.writer import Transform
from jaxdet.render.canvas import color_of
from jaxdet.results.map_file import FREE, OCCUPIED, Grid
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.tables import Frame, Mover

SCENE, BOXES, MAP, TF = "obstacles", "boxes", "map", "tf"
"""Topics, see :func:`jaxdet.export.shapes.topic`."""

_TEXT = Color(r=1.0, g=1.0, b=1.0, a=1.0)
_DARK = Color(r=0.0, g=0.0, b=0.0, a=0.6)
_CELL_COLORS = {OCCUPIED: (200, 40, 40, 200), FREE: (160, 190, 170, 110)}
"""Colours of cells (RGBA); unknown cells are transparent."""
_ABOUT = ("obstacle", "track", "distance_m", "bottom_m", "top_m", "num_points")
"""Columns shown for a selected obstacle."""
HEAD_M = 0.15
"""Length of an arrow's head [m]."""
PATH_POINTS = 300
"""Maximum number of trajectory points shown per track; the latest ones are kept."""
TEXT_PX, LINE_PX = 14.0, 18.0
"""Font size and line height of a label in the image [pixel]."""
_CELL_FIELDS = ("red", "green", "blue", "alpha")


def export(results: Results, output: Path, recordings: Mapping[str, LogFiles]) -> None:
    """Write ``LOG.jaxdet.mcap`` of each log and ``layout.json`` into a folder.

    A log with other topics or frames has its own layout, ``LOG.layout.json``.

    Args:
        results: Results of a run.
        output: Folder.
        recordings: Unused.
    """
    cameras: dict[str, list[tuple[ResultLog, str]]] = {}
    for log, path in sidecars(results, output):
        with path.open("wb") as stream, Writer(stream) as writer:
            follow = _write_log(writer, results, log)
        cameras.setdefault(log.name, []).append((log, follow))
    common = layout(next(iter(cameras.values()), []))
    _write_layout(output / "layout.json", common)
    for each in cameras.values():
        own, name = layout(each), each[0][0].file_name.partition("@")[0]
        if own != common:
            _write_layout(output / f"{name}.layout.json", own)


def _write_layout(path: Path, content: Mapping[str, Any]) -> None:
    text = json.dumps(content, indent=2, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def _write_log(writer: Writer, results: Results, log: ResultLog) -> str:
    """Write the messages of a log; return the frame that the view follows, world or floor frame."""
    follow = ""
    for sequence, entry in enumerate(sidecar_frames(results, log)):
        frame, at = entry.frame, entry.log_time_ns
        follow = follow or frame.row["world_frame"] or floor_name(frame.row)
        messages = {
            TF: tf_message(frame.row["stamp_ns"], entry.transforms),
            SCENE: scene(frame),
            BOXES: annotations(frame),
        }
        if entry.grid is not None:
            messages[MAP] = grid_message(entry.grid, frame.row)
        for name, message in messages.items():
            writer.write_message(topic(log, name), message, at, at, sequence)
    return follow


def tf_message(stamp_ns: int, transforms: Sequence[Transform]) -> FrameTransforms:
    """Return transforms as a message, with the timestamp of a depth image."""
    stamp = _stamp(stamp_ns)
    return FrameTransforms(
        transforms=[
            FrameTransform(
                timestamp=stamp,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_point(T[:3, 3]),
                rotation=_pose(T).orientation,
            )
            for parent, child, T in transforms
        ]
    )


def scene(frame: Frame) -> SceneUpdate:
    """Return the obstacles and trajectories of a frame; they replace those of earlier frames."""
    stamp = _stamp(frame.row["stamp_ns"])
    gone = SceneEntityDeletion(timestamp=stamp, type=SceneEntityDeletion.ALL)
    T = T_camera_floor(frame.row)
    pose = _pose(T)
    entities = [_entity(frame.row, obstacle, T, pose) for obstacle in frame.obstacles]
    placed = T_world_camera(frame.row) is not None
    moving = (track for track in frame.tracks if track.moving and (placed or not track.in_world))
    entities += [_trajectory(frame.row, track) for track in moving]
    return SceneUpdate(deletions=[gone], entities=_named_apart(entities))


def _named_apart(entities: list[SceneEntity]) -> list[SceneEntity]:
    """Make the names of entities unique: pieces of a track after the first get a number."""
    counts = Counter[str]()
    for entity in entities:
        counts[entity.id] += 1
        if counts[entity.id] > 1:
            entity.id += f", piece {counts[entity.id]}"
    return entities


def _trajectory(row: Row, track: Mover) -> SceneEntity:
    """Return the trajectory of a track, with its velocity as an arrow, 1 m per m/s."""
    T = T_world_camera(row)
    if track.in_world and T is not None:
        name, z = row["world_frame"] or "", T[2, 3] - (row["camera_height_m"] or 0.0)
    else:
        name, z = floor_name(row), 0.0
    angle = float(np.arctan2(track.velocity[1], track.velocity[0])) / 2
    turn = Quaternion(z=np.sin(angle), w=np.cos(angle))
    speed = float(np.hypot(*track.velocity))
    place, color = Vector3(x=track.path[-1, 0], y=track.path[-1, 1], z=z), _color(track.track, 1.0)
    arrow = ArrowPrimitive(
        pose=Pose(position=place, orientation=turn),
        shaft_length=max(speed - HEAD_M, 0.0),
        shaft_diameter=0.05,
        head_length=min(speed, HEAD_M),
        head_diameter=0.12,
        color=color,
    )
    line = LinePrimitive(
        pose=Pose(position=place, orientation=Quaternion(w=1.0)),
        type=LinePrimitive.LINE_STRIP,
        thickness=2.0,
        scale_invariant=True,
        # relative to the last point, as the viewer draws in float32
        points=_points(track.path[-PATH_POINTS:] - track.path[-1], 0.0),
        color=color,
    )
    return SceneEntity(
        timestamp=_stamp(row["stamp_ns"]),
        frame_id=name,
        id=f"trajectory of track {track.track}",
        metadata=[KeyValuePair(key="speed_mps", value=f"{speed:.6g}")],
        arrows=[arrow],
        lines=[line],
    )


def _entity(row: Row, obstacle: Row, T: np.ndarray, pose: Pose) -> SceneEntity:
    """Return an obstacle: its contour as a wall from bottom to top, or a box, and its label."""
    bottom, top = heights(row, obstacle)
    edge, number = contour(obstacle), number_of(obstacle)
    shape: dict[str, Any] = {}
    if len(edge) > 1:
        low, high = _points(edge, bottom), _points(edge, top)
        color = _color(number, 0.55)
        wall = {"points": [*low, *high], "indices": _wall(len(edge)), "color": color}
        shape["triangles"] = [TriangleListPrimitive(pose=pose, **wall)]
        line = {"type": LinePrimitive.LINE_STRIP, "thickness": 2.0, "scale_invariant": True}
        bright = _color(number, 1.0)
        shape["lines"] = [
            LinePrimitive(pose=pose, points=points, color=bright, **line) for points in (low, high)
        ]
    else:
        shape["cubes"] = [_cube(obstacle, T, bottom, top)]
    near = edge[np.argmin((edge**2).sum(axis=1))] if len(edge) else corners(obstacle)[:2].mean(0)
    at = T @ [*near, top + 0.08, 1.0]
    text = TextPrimitive(
        pose=Pose(position=_point(at), orientation=Quaternion(w=1.0)),
        billboard=True,
        font_size=14.0,
        scale_invariant=True,
        color=_TEXT,
        text=label(obstacle),
    )
    values = {key: obstacle[key] for key in _ABOUT if obstacle.get(key) is not None}
    about = [KeyValuePair(key=key, value=f"{value:.6g}") for key, value in values.items()]
    return SceneEntity(
        timestamp=_stamp(row["stamp_ns"]),
        frame_id=camera_name(row),
        id=f"obstacle {number}" if obstacle.get("track") is None else f"track {number}",
        metadata=about,
        texts=[text],
        **shape,
    )


def _wall(count: int) -> list[int]:
    """Return triangle indices between two lines of ``count`` points, stored line by line."""
    indices: list[int] = []
    for i in range(count - 1):
        indices += [i, i + 1, count + i, count + i, i + 1, count + i + 1]
    return indices


def _cube(obstacle: Row, T: np.ndarray, bottom: float, top: float) -> CubePrimitive:
    T_floor_box, size = box(obstacle, bottom, top)
    color = _color(number_of(obstacle), 0.6)
    return CubePrimitive(pose=_pose(T @ T_floor_box), size=_point(size), color=color)


def annotations(frame: Frame) -> ImageAnnotations:
    """Return the boxes and labels of a frame's obstacles that are in the image."""
    stamp = _stamp(frame.row["stamp_ns"])
    boxes, texts = [], []
    for obstacle in frame.obstacles:
        if obstacle["u_min"] is None:
            continue
        left, right = obstacle["u_min"], obstacle["u_max"] + 1
        upper, lower = obstacle["v_min"], obstacle["v_max"] + 1
        ring = [(left, upper), (right, upper), (right, lower), (left, lower)]
        color = _color(number_of(obstacle), 1.0)
        boxes.append(
            PointsAnnotation(
                timestamp=stamp,
                type=PointsAnnotation.LINE_LOOP,
                points=[Point2(x=x, y=y) for x, y in ring],
                outline_color=color,
                thickness=2.0,
            )
        )
        texts.append(
            TextAnnotation(
                timestamp=stamp,
                # Lower left corner of the text, kept inside of the image.
                position=Point2(x=left, y=max(upper, LINE_PX)),
                text=label(obstacle),
                font_size=TEXT_PX,
                text_color=_TEXT,
                background_color=_DARK,
            )
        )
    return ImageAnnotations(points=boxes, texts=texts)


def grid_message(grid: Grid, row: Row) -> GridMessage:
    """Return the coloured map in the world frame, with the timestamp of a row."""
    cells = np.zeros((*grid.states.shape, len(_CELL_FIELDS)), np.uint8)
    for state, color in _CELL_COLORS.items():
        cells[grid.states == state] = color
    x, y = grid.origin
    columns = grid.states.shape[1]
    stride = len(_CELL_FIELDS)
    return GridMessage(
        timestamp=_stamp(row["stamp_ns"]),
        frame_id=row["world_frame"] or "",
        pose=Pose(position=Vector3(x=x, y=y), orientation=Quaternion(w=1.0)),
        column_count=columns,
        cell_size=Vector2(x=grid.cell_m, y=grid.cell_m),
        row_stride=columns * stride,
        cell_stride=stride,
        fields=[
            PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8)
            for offset, name in enumerate(_CELL_FIELDS)
        ],
        data=cells.tobytes(),
    )


def layout(cameras: Sequence[tuple[ResultLog, str]]) -> dict[str, Any]:
    """Return a layout with the scene of a log next to the image of its first camera.

    The image is the colour image, or the depth image if there is no colour.

    Args:
        cameras: Cameras of the log, each with the frame that the view follows.
    """
    view, image = "3D!jaxdet", "Image!jaxdet"
    color, boxes, follow = "", "", ""
    for log, followed in cameras[:1]:
        color, boxes, follow = log.topic("color") or log.topic("depth"), topic(log, BOXES), followed
    shown = {topic(log, name): {"visible": True} for log, _ in cameras for name in (SCENE, MAP)}
    return {
        "configById": {
            view: {
                "followMode": "follow-none",
                "followTf": follow,
                "topics": shown,
                "cameraState": {"distance": 8, "phi": 45, "perspective": True},
            },
            image: {
                "imageMode": {
                    "imageTopic": color,
                    "annotations": {boxes: {"visible": True}},
                    "synchronize": False,
                }
            },
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": view, "second": image, "splitPercentage": 55},
    }


def _stamp(stamp_ns: int) -> Timestamp:
    seconds, nanos = divmod(stamp_ns, 10**9)
    return Timestamp(seconds=seconds, nanos=nanos)


def _color(number: int, alpha: float) -> Color:
    r, g, b = (part / 255 for part in color_of(number))
    return Color(r=r, g=g, b=b, a=alpha)


def _point(xyz: Sequence[float] | np.ndarray) -> Vector3:
    return Vector3(x=xyz[0], y=xyz[1], z=xyz[2])


def _points(edge: np.ndarray, z: float) -> list[Point3]:
    return [Point3(x=x, y=y, z=z) for x, y in edge.tolist()]


def _pose(T: np.ndarray) -> Pose:
    x, y, z, w = quaternion(T)
    return Pose(position=_point(T[:3, 3]), orientation=Quaternion(x=x, y=y, z=z, w=w))
