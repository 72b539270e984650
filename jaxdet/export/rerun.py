"""``--to rerun``: recordings for the Rerun viewer: frames, obstacles in space, time series.

Entities of a recording::

    world                        z up; without poses the floor below the camera. Translated by the
                                 distance of the first pose from the origin, in whole kilometres
      map, path                  static, if the log has poses
      floor                      ground projection of the camera: x right, y forward, z up
        boxes, contours, free    obstacles, and the free floor
        tracks/N                 paths of moving tracks, during their lifetime; world/tracks/N if
                                 the log has poses
        camera                   optical frame of the depth camera; of the colour camera in the
                                 preset paper
          color                  image, if any, and boxes
          depth                  image, and the boxes if there is no colour
          points                 depth cells by obstacle
    distance, obstacles          time series
    frames                       text: reasons why frames have no result
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from jaxdet.errors import FrameStatus
from jaxdet.export.map_picture import map_picture
from jaxdet.export.recordings import Seen, look_again
from jaxdet.export.shapes import (
    LEVEL,
    T_camera_floor,
    T_world_upright,
    box,
    contour,
    free_floor,
    heights,
    label,
    number_of,
)
from jaxdet.io import LogFiles
from jaxdet.io.motion import quaternions
from jaxdet.render.camera import has_color
from jaxdet.render.canvas import FREE, PALETTE
from jaxdet.results.masks import obstacle_points
from jaxdet.results.metric import TILT, world_angle
from jaxdet.results.occupancy import MapImage
from jaxdet.results.reading import ResultLog, Results
from jaxdet.results.tables import Frame, Tables
from jaxdet.types import Detections, Extrinsics

FLOOR, CAMERA = "world/floor", "world/floor/camera"
COLOR, DEPTH = f"{CAMERA}/color", f"{CAMERA}/depth"
FLUSH_FRAMES = 1024
"""Maximum number of frames that wait to be written."""
QUALITY = 85
"""Quality of the JPEG images."""
PNG_LEVEL = 1
PATH_POINTS = 10_000
UNKNOWN = np.array((70, 74, 80), np.uint8)
"""Colour of unknown cells of the map."""
COLORS = np.array(PALETTE, np.uint8)


def export(results: Results, output: Path, recordings: Mapping[str, LogFiles]) -> None:
    """Write a folder with a recording of each log.

    Args:
        results: Results of a run.
        output: Folder to write.
        recordings: Logs of the results by name; their images, depth and points are added.

    Raises:
        InputError: A passed log is not the one in the results.
    """
    output.mkdir()
    for log in results.logs:
        files = recordings.get(log.name)
        stream = rr.RecordingStream("jaxdet", recording_id=log.label, send_properties=False)
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        flat = ([("Colour", COLOR)] if _has_color(log) else []) + [("Depth", DEPTH)]
        shown = flat if files is not None else flat[:1]
        stream.save(output / f"{log.file_name}.rrd", _blueprint(shown))
        stream.send_recording_name(log.label)
        try:
            _Recording(stream, results, log).write(files)
        finally:
            stream.disconnect()


def _has_color(log: ResultLog) -> bool:
    """Return whether boxes refer to colour images, separate or aligned with depth."""
    camera = log.summary["calibration"] or {}
    return bool(camera.get("color") or log.topic("color"))


def _blueprint(images: Sequence[tuple[str, str]]) -> rrb.Blueprint:
    """Return the layout of the viewer; ``images`` has the name and the entity of each image."""
    flat = [rrb.Spatial2DView(origin=path, name=name) for name, path in images]
    series = [
        rrb.TimeSeriesView(origin="distance", name="Distance [m]"),
        rrb.TimeSeriesView(origin="obstacles", name="Obstacles"),
        rrb.TextLogView(origin="frames", name="Frames without a result"),
    ]
    # Points of the depth image would hide those of the obstacles.
    shown = ["$origin/**", f"- {DEPTH}/**"]
    space = rrb.Spatial3DView(origin="world", contents=shown, name="Space")
    upper = rrb.Horizontal(space, rrb.Vertical(*flat), column_shares=[3, 2])
    lower = rrb.Horizontal(*series)
    return rrb.Blueprint(rrb.Vertical(upper, lower, row_shares=[3, 1]), collapse_panels=True)


class _Recording:
    """Writer of the recording of a log."""

    def __init__(self, stream: rr.RecordingStream, results: Results, log: ResultLog) -> None:
        self.stream, self.results, self.log = stream, results, log
        self.origin = _origin(results, log)
        self.in_world = _in_world(results, log)
        """Whether any frame has a pose in the world. If so, frames without a pose are not shown in
        space, where they would appear at the pose of the previous frame."""
        self.boxes = COLOR if _has_color(log) else DEPTH
        """Entity of the image in which boxes are shown."""
        self.floor_z = 0.0
        """Height of the floor in the last frame with a pose, relative to the origin [m]."""

    def write(self, files: LogFiles | None) -> None:
        """Write the recording, with images and points if the files of the log are passed."""
        self._start()
        for chunk in self.results.chunks(self.log):
            _series(self.stream, chunk)
            for number, frame in enumerate(chunk.each(), 1):
                self._at(frame.row)
                self._frame(frame)
                if number % FLUSH_FRAMES == 0:
                    self.stream.flush()  # limits the size of the queue
        if files is not None:
            for seen in look_again(self.results, self.log, files, with_cells=True, color=True):
                for b, frame in enumerate(seen.chunk.each()):
                    self._at(frame.row)
                    self._images(seen, b, frame)
                self.stream.flush()
        self._tracks()
        image = self.results.map(self.log)
        if image is not None:
            _map(self.stream, image, self.origin, self.floor_z)

    def _start(self) -> None:
        """Write static data."""
        camera = self.log.summary["calibration"]
        log = self.stream.log
        log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        log("world", rr.Transform3D(translation=self.origin), static=True)
        if motion := camera["color_from_depth"]:
            T = Extrinsics(tuple(motion["rotation"]), tuple(motion["translation"])).T
            # the lengths of the preset paper refer to the colour camera
            paper = self.results.method.cluster.points
            path, T = (DEPTH, T) if paper else (COLOR, np.linalg.inv(T))
            log(path, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]), static=True)
        if self.boxes == COLOR:
            log(COLOR, _pinhole(camera["color"] or camera["depth"]), static=True)
        log(DEPTH, _pinhole(camera["depth"]), static=True)
        for name, color in (("nearest", PALETTE[0]), ("drop", PALETTE[4])):
            log(f"distance/{name}", rr.SeriesLines(colors=[color], names=[name]), static=True)
        log("obstacles", rr.SeriesLines(colors=[PALETTE[1]], names=["obstacles"]), static=True)

    def _at(self, row: Mapping[str, Any]) -> None:
        self.stream.set_time("frame", sequence=row["frame"])
        self.stream.set_time("stamp", timestamp=np.datetime64(row["stamp_ns"], "ns"))

    def _frame(self, frame: Frame) -> None:
        """Write the data of a frame from the tables."""
        row, log = frame.row, self.stream.log
        pose = T_world_upright(row)
        if pose is not None:
            pose[:3, 3] -= self.origin
            log(FLOOR, _floor_in_world(row, pose))
            self.floor_z = pose[2, 3] - (row["camera_height_m"] or 0.0)
        log(CAMERA, _camera_on_floor(row))
        if self._has_place(row):
            log(f"{FLOOR}/boxes", _boxes(row, frame.obstacles))
            log(f"{FLOOR}/contours", _contours(frame.obstacles))
            log(f"{FLOOR}/free", _free(row))
        else:
            for name in ("boxes", "contours", "free"):
                log(f"{FLOOR}/{name}", rr.Clear(recursive=False))
        log(f"{self.boxes}/boxes", _flat_boxes(frame.obstacles))
        if row["status"] != FrameStatus.OK:
            text = f"frame {row['frame']}: {row['status']}"
            log("frames", rr.TextLog(text, level=rr.TextLogLevel.WARN))

    def _has_place(self, row: Mapping[str, Any]) -> bool:
        """Return whether a frame can be shown in space: it has a pose, or no frame has one."""
        return not self.in_world or _is_placed(row)

    def _tracks(self) -> None:
        """Write the trajectories of moving tracks, each from its first frame to its last."""
        for track in self.results.tracks(self.log):
            if track["moving"]:
                place = f"{'world' if track['in_world'] else FLOOR}/tracks/{track['track']}"
                z = self.floor_z if track["in_world"] else 0.0
                path = np.reshape(track["path"], (-1, 2))
                path = path - self.origin[:2] if track["in_world"] else path
                strip = np.column_stack([path, np.full(len(path), z + 0.02)])
                text = f"track {track['track']}   {track['mean_speed_mps']:.2f} m/s"
                color = _colors([track["track"]])
                self._at({"frame": track["first_frame"], "stamp_ns": track["first_stamp_ns"]})
                line = rr.LineStrips3D([strip], colors=color, labels=[text], radii=0.015)
                self.stream.log(place, line)
                self._at({"frame": track["last_frame"] + 1, "stamp_ns": track["last_stamp_ns"] + 1})
                self.stream.log(place, rr.Clear(recursive=False))

    def _images(self, seen: Seen, b: int, frame: Frame) -> None:
        """Write the data of a frame from the log."""
        row, log, frames = frame.row, self.stream.log, seen.batch.frames
        if row["status"] == FrameStatus.DECODE_ERROR:
            for path in (COLOR, DEPTH, f"{CAMERA}/points"):
                log(path, rr.Clear(recursive=False))
            return
        if has_color(frames, b):
            assert frames.color is not None
            color = _encoded(".jpg", frames.color[b, ..., ::-1], cv2.IMWRITE_JPEG_QUALITY, QUALITY)
            log(COLOR, rr.EncodedImage(contents=color, media_type="image/jpeg"))
        elif self.boxes == COLOR:
            log(COLOR, rr.Clear(recursive=False))
        depth = _encoded(".png", frames.depth[b], cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL)
        unit = frames.calibration.depth_unit
        reach = (0.0, self.results.method.ground.max_depth_m / unit)
        how = {"media_type": "image/png", "meter": 1 / unit, "depth_range": reach}
        log(DEPTH, rr.EncodedDepthImage(blob=depth, **how))
        if row["status"] == FrameStatus.OK and self._has_place(row):
            log(f"{CAMERA}/points", _points(seen.found, b, unit, frame.obstacles))
        else:  # the frame has no result or no place in the world
            log(f"{CAMERA}/points", rr.Clear(recursive=False))


def _origin(results: Results, log: ResultLog) -> np.ndarray:
    """Return the origin of the entity ``world`` [m]: the first position, rounded to kilometres.

    Rerun uses float32, while coordinates in frames such as UTM are millions of metres.
    """
    name = "camera_position_world"
    places = (frame.row[name] for frame in results.frames(log, (name,), ()))
    return np.round(next(filter(None, places), np.zeros(3)), -3)


def _in_world(results: Results, log: ResultLog) -> bool:
    """Return whether any frame of a log has a pose in the world."""
    columns = ("camera_position_world", "camera_height_m", *TILT)
    return any(_is_placed(frame.row) for frame in results.frames(log, columns, ()))


def _is_placed(row: Mapping[str, Any]) -> bool:
    """Return whether floor and pose of a frame are known, so that it has a place in the world."""
    return row["camera_height_m"] is not None and T_world_upright(row) is not None


def _encoded(kind: str, image: np.ndarray, *how: int) -> bytes:
    return cv2.imencode(kind, image, how)[1].tobytes()


def _series(stream: rr.RecordingStream, chunk: Tables) -> None:
    """Write the distances and counts of a chunk of frames."""
    numbers, stamps = (chunk.frames[name].to_numpy() for name in ("frame", "stamp_ns"))
    count = chunk.frames["num_obstacles"].to_numpy()
    distance, first = chunk.obstacles["distance_m"].to_numpy(), chunk.first[:-1][count > 0]
    nearest = np.full(len(count), np.nan)
    if first.size:
        nearest[count > 0] = np.fmin.reduceat(distance, first)
    drop = chunk.frames["drop_m"].to_numpy()
    good = chunk.frames["status"].to_numpy() == FrameStatus.OK
    for path, values in (
        ("distance/nearest", nearest),
        ("distance/drop", drop),
        ("obstacles", np.where(good, count, np.nan)),
    ):
        valid = ~np.isnan(values)
        if valid.any():
            times = [
                rr.TimeColumn("frame", sequence=numbers[valid]),
                rr.TimeColumn("stamp", timestamp=stamps[valid].astype("datetime64[ns]")),
            ]
            columns = rr.Scalars.columns(scalars=values[valid].astype(np.float64))
            rr.send_columns(path, times, columns, recording=stream)


def _pinhole(camera: Mapping[str, Any]) -> rr.Pinhole:
    K = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
    size = [camera["width"], camera["height"]]
    return rr.Pinhole(image_from_camera=K, resolution=size, image_plane_distance=0.3)


def _floor_in_world(row: Mapping[str, Any], T: np.ndarray) -> rr.Transform3D:
    """Return the transform from the floor below the camera to the world, as for outlines."""
    sin, cos = world_angle(T)
    x, y, z = T[:3, 3] - (0, 0, row["camera_height_m"] or 0.0)
    turn = [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]
    return rr.Transform3D(translation=[x, y, z], mat3x3=turn)


def _camera_on_floor(row: Mapping[str, Any]) -> rr.Transform3D:
    """Return the transform from the optical frame to the floor frame below it."""
    T = np.linalg.inv(T_camera_floor(row))
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def _colors(obstacles: Any) -> np.ndarray:
    return COLORS[np.asarray(obstacles, np.int64) % len(COLORS)]


def _boxes(row: Mapping[str, Any], obstacles: list[dict[str, Any]]) -> rr.Boxes3D:
    """Return the outlines as boxes, from bottom to top."""
    boxes = [box(one, *heights(row, one)) for one in obstacles]
    placed = np.reshape([T for T, _ in boxes], (-1, 4, 4))
    return rr.Boxes3D(
        centers=placed[:, :3, 3],
        half_sizes=np.reshape([size for _, size in boxes], (-1, 3)) / 2,
        quaternions=quaternions(placed[:, :3, :3]),
        colors=_colors([number_of(one) for one in obstacles]),
        labels=[label(one) for one in obstacles],
    )


def _contours(obstacles: list[dict[str, Any]]) -> rr.LineStrips3D:
    """Return the visible edges of obstacles on the floor."""
    some = [one for one in obstacles if one["contour"]]
    lines = [contour(one) for one in some]
    strips = [np.column_stack([line, np.full(len(line), 0.01)]) for line in lines]
    return rr.LineStrips3D(strips, colors=_colors([number_of(one) for one in some]), radii=0.008)


def _flat_boxes(obstacles: list[dict[str, Any]]) -> rr.Boxes2D:
    """Return the boxes of obstacles that are in the image."""
    names = ("u_min", "v_min", "u_max", "v_max")
    obstacles = [one for one in obstacles if one["u_min"] is not None]
    box = np.reshape([[one[name] for name in names] for one in obstacles], (-1, 4))
    return rr.Boxes2D(
        mins=box[:, :2],
        sizes=box[:, 2:] + 1 - box[:, :2],
        colors=_colors([number_of(one) for one in obstacles]),
        labels=[label(one) for one in obstacles],
    )


def _free(row: Mapping[str, Any]) -> rr.Mesh3D | rr.Clear:
    """Return the free floor as a mesh of the polygons that the map is made from."""
    points, corners, _ = free_floor(row).in_world(LEVEL[None])
    if not len(corners):
        return rr.Clear(recursive=False)
    triangles: list[np.ndarray] = []
    for count, stop in zip(corners, np.cumsum(corners), strict=True):
        middle = stop - count // 2
        far, near = np.arange(stop - count, middle, 2), np.arange(stop - 1, middle, -2)
        halves = (far, near, far + 1), (near, near - 1, far + 1)
        triangles += [np.stack(half, axis=1) for half in halves]
    return rr.Mesh3D(
        vertex_positions=np.insert(points, 2, 0.0, axis=1),
        triangle_indices=np.concatenate(triangles),
        albedo_factor=[*FREE, 110],
    )


def _points(found: Detections, b: int, unit: float, obstacles: list[dict[str, Any]]) -> rr.Points3D:
    """Return the points of obstacles, coloured by obstacle or track."""
    xyz, label = obstacle_points(found, b, unit)
    number = np.array([number_of(one) for one in obstacles], np.int64)
    return rr.Points3D(xyz, colors=_colors(number[label]), radii=0.008)


def _map(stream: rr.RecordingStream, image: MapImage, origin: np.ndarray, floor_z: float) -> None:
    """Write the map just below the floor, and the camera's path on the floor."""
    picture, cell_m = map_picture(image)
    height, width, _ = picture.shape
    seen = picture[..., 3:] > 0
    opaque = np.where(seen, picture[..., :3], UNKNOWN)  # grids have no transparency
    kind = rr.components.ImageFormat(
        width=width, height=height, color_model="RGB", channel_datatype="U8"
    )
    grid = rr.GridMap(
        data=opaque[::-1].tobytes(),
        format=kind,
        cell_size=cell_m,
        translation=[*(image.origin - origin[:2]), floor_z - 0.02],
    )
    stream.log("world/map", grid, static=True)
    path = image.path[:: -(-len(image.path) // PATH_POINTS) or 1]
    if len(path) > 1:
        strip = np.column_stack([path - origin[:2], np.full(len(path), floor_z)])
        stream.log(
            "world/path", rr.LineStrips3D([strip], colors=PALETTE[1], radii=0.01), static=True
        )
