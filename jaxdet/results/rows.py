"""Conversion of the detections of a batch to rows of the two result tables."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxdet.config import Config
from jaxdet.elementary import matmul
from jaxdet.errors import FrameStatus
from jaxdet.floor.plane import plane_in_color
from jaxdet.floor.units import FloorFit, floor_fit
from jaxdet.io.motion import inverse, quaternions
from jaxdet.results.free_floor import FreeFloor, Polygons, free_floor
from jaxdet.results.metric import (
    TILT,
    contour_lines,
    extents,
    nearest,
    point_distances,
    rectangles,
    tilted,
    to_world,
)
from jaxdet.types import (
    Calibration,
    Detections,
    Frames,
    GroundPlane,
    Obstacles,
    Refusal,
    Scene,
)

if TYPE_CHECKING:
    from jaxdet.io import Batch

_REFUSALS = np.array([reason.name.lower() for reason in Refusal], object)


class Lists(NamedTuple):
    """R lists of different lengths in a column, one after the other, as Arrow stores them."""

    values: np.ndarray
    """Values of all lists, ``(n,)``."""
    offsets: np.ndarray
    """First index in ``values`` of each list, and the end of the last one, ``(R + 1,)`` int32."""
    null: np.ndarray
    """Whether each list is null and has no values, ``(R,)`` bool."""

    @classmethod
    def of_lengths(cls, values: np.ndarray, length: np.ndarray, null: np.ndarray) -> "Lists":
        """Return lists of the lengths ``length``.

        Args:
            values: Values of all lists, ``(n,)``.
            length: Length of each list, ``(R,)`` integer; their sum is n, and nulls have 0.
            null: Whether each list is null, ``(R,)`` bool.
        """
        offsets = np.zeros(len(length) + 1, np.int32)
        np.cumsum(length, out=offsets[1:])
        return cls(values, offsets, null)

    @classmethod
    def nulls(cls, count: int) -> "Lists":
        """Return ``count`` nulls."""
        return cls(np.zeros(0), np.zeros(count + 1, np.int32), np.ones(count, bool))


class Rows(NamedTuple):
    """Table rows of a batch, with the floors, poses and free floor that belong to them."""

    frames: dict[str, Any]
    """Columns of ``frames.parquet``."""
    obstacles: dict[str, Any]
    """Columns of ``obstacles.parquet``."""
    plane: GroundPlane
    """Floor of each frame, ``(B,)``, relative to the camera that lengths refer to."""
    T_world_camera: np.ndarray
    """Poses of the camera that lengths refer to, ``(B, 4, 4)``, NaN if unknown."""
    free_world: Polygons | None
    """Free floor of each frame in the world; None without poses."""


def row_inputs(found: Detections) -> Detections:
    """Return the arrays of detections that :func:`batch_rows` needs: no points, cells and prior.

    This function can be compiled by ``jax.jit``.

    Args:
        found: NumPy or JAX arrays.
    """
    scene = found.scene and found.scene._replace(prior=None)
    return found._replace(scene=scene, cells=None, points=None)


def no_inputs(count: int) -> Detections:
    """Return inputs of ``count`` frames without detections."""
    numbers, no = np.zeros(count, np.int32), np.zeros(count, bool)
    shapes = {"uv_min": 2, "uv_max": 2, "xyz_min": 3, "xyz_max": 3, "a": 2, "b": 2, "c": 2}
    shapes |= {"direction": 2, "span": 4, "nearest": 2}
    slots = {name: np.zeros((count, 0, size), np.int32) for name, size in shapes.items()}
    none = Obstacles(
        num_points=np.zeros((count, 0), np.int32),
        xyz_sum=np.zeros((count, 0, 3, 2), np.int32),
        has_vertex=np.zeros((count, 0), bool),
        **slots,
    )
    return Detections(numbers, no, no, none)


def used_slots(inputs: Detections, count: int) -> Detections:
    """Return a copy of the first ``count`` frames, without slots that are empty in all frames.

    Most slots are empty: of 240 KB per frame, about 20 KB are used.
    """
    found: Detections = _first(inputs, count)
    slots = int(found.num_obstacles.max(initial=0))

    def few(part: np.ndarray) -> np.ndarray:
        return part[:, :slots]

    scene = found.scene
    if scene is not None:
        names = ("contour", "contour_points", "bottom_top")
        scene = scene._replace(**{name: few(getattr(scene, name)) for name in names})
    few_slots = found._replace(obstacles=map_leaves(few, found.obstacles), scene=scene)
    return map_leaves(np.ndarray.copy, few_slots)


def joined_inputs(parts: Sequence[Any]) -> Any:
    """Concatenate trees of arrays frame after frame, padded to the largest number of slots."""
    first = parts[0]
    if first is None:
        return None
    if isinstance(first, tuple):
        return type(first)(*map(joined_inputs, zip(*parts, strict=True)))
    shapes = {part.shape[1:] for part in parts}
    if len(shapes) == 1:
        return np.concatenate(parts)
    slots, row = max(shape[0] for shape in shapes), 0
    joined = np.zeros((sum(map(len, parts)), slots, *first.shape[2:]), first.dtype)
    for part in parts:
        joined[row : row + len(part), : part.shape[1]] = part
        row += len(part)
    return joined


def map_leaves(function: Callable[[Any], Any], tree: Any) -> Any:
    """Return a tree of named tuples and None, with ``function`` applied to each leaf in order."""
    if tree is None:
        return None
    if isinstance(tree, tuple):
        return type(tree)(*[map_leaves(function, part) for part in tree])
    return function(tree)


def to_host(part: Any) -> Any:
    """Return detections, or a part of them, as NumPy arrays; waits for the device."""
    return map_leaves(np.asarray, part)


def batch_rows(
    log: str,
    camera: str,
    batch: "Batch",
    plane: GroundPlane,
    sources: Sequence[str],
    inputs: Detections,
    config: Config,
) -> Rows:
    """Return the rows of a batch, in the order of the frames.

    Args:
        log: Name of the log.
        camera: Name of the camera.
        batch: Frames, with or without images; padding has no rows.
        plane: Prior of each frame's floor that the detections were made with, ``(B,)``, relative to
            the depth camera; not used for frames that show their own floor.
        sources: Sources of the priors, ``B`` words, see :meth:`jaxdet.engine.Planes.sources`.
        inputs: Detections, see :func:`row_inputs`; NumPy or JAX arrays.
        config: Configuration of the outlines.

    Returns:
        Columns for :meth:`jaxdet.results.tables.Tables.of`, and arrays that they are made from.

    Raises:
        ValueError: A frame has more obstacles than there are slots.
    """
    count, frames = len(batch.status), batch.frames
    if config.cluster.points:
        batch, plane = _of_color_camera(batch), plane_in_color(plane, frames.calibration)
    found, plane = _first(inputs, count), _first(plane, count)
    frames, unit = batch.frames, frames.calibration.depth_unit
    status = np.array(batch.status, object)
    blind = (status == FrameStatus.OK) & ~found.has_depth
    good = (status == FrameStatus.OK) & found.has_depth
    status[blind] = FrameStatus.NO_DEPTH
    fit = free = None
    if found.scene is not None:
        fit = floor_fit(found.scene.floor, plane, unit)
        free = free_floor(found.scene.free, found.scene.free_end, unit)
        plane = fit.plane
    known = good & plane.valid  # distances and heights need a floor
    poses = np.full((count, 4, 4), np.nan)
    if frames.T_world_camera is not None:
        poses = frames.T_world_camera[:count]
    frame_columns = {
        **_frame_columns(batch, status, poses, plane),
        **_floor_columns(fit, sources[:count], good, config),
        **_free_columns(free, known),
        "num_obstacles": np.where(good, found.num_obstacles, 0).astype(np.int32),
        "overflow": found.overflow & good,
    }
    placed = known & ~tilted(*(frame_columns[name] for name in TILT))
    places = np.where(placed[:, None, None], poses, np.nan)
    obstacle_columns = _obstacle_columns(frames, places, plane, found, good, config)
    for columns in (frame_columns, obstacle_columns):
        rows = len(columns["frame"])
        columns["log"], columns["camera"] = (np.full(rows, n, object) for n in (log, camera))
    world = free.in_world(places) if free and frames.T_world_camera is not None else None
    return Rows(frame_columns, obstacle_columns, plane, poses, world)


def _of_color_camera(batch: "Batch") -> "Batch":
    """Return the batch with the poses and the name of the colour camera's frame.

    The preset ``paper`` aligns depth to colour, so its lengths refer to the colour camera.
    """
    frames, motion = batch.frames, batch.frames.calibration.color_from_depth
    name = batch.color_frame or batch.camera_frame
    if motion is None or frames.T_world_camera is None:
        return batch._replace(camera_frame=name)
    poses = matmul(frames.T_world_camera, inverse(motion.T))
    return batch._replace(frames=frames._replace(T_world_camera=poses), camera_frame=name)


def shown_planes(found: Detections, plane: GroundPlane, calibration: Calibration) -> GroundPlane:
    """Return the floor of each frame: the floor that the frame shows, or else its prior.

    Args:
        found: Detections of ``B`` frames.
        plane: Priors, ``(B,)``, relative to the depth camera.
        calibration: Calibration of the log.

    Returns:
        Planes ``(B,)`` relative to the camera that lengths refer to.
    """
    if found.scene is None:
        return plane_in_color(plane, calibration)
    return floor_fit(np.asarray(found.scene.floor), plane, calibration.depth_unit).plane


def _first(part: Any, count: int) -> Any:
    """Return the first ``count`` rows of named tuples of arrays, on the host."""
    return map_leaves(lambda a: np.asarray(a)[:count], part)


def _frame_columns(
    batch: "Batch", status: np.ndarray, poses: np.ndarray, plane: GroundPlane
) -> dict[str, Any]:
    """Return the columns of times, status, poses, and the camera's mount."""
    frames, n = batch.frames, len(status)
    colors, times = batch.nearest_color_ns, batch.log_time_ns

    def named(frame: str) -> np.ndarray:
        return np.ma.array(np.full(n, frame, object), mask=np.full(n, not frame))

    def known(values: np.ndarray) -> np.ndarray:
        return np.where(plane.valid, values, np.nan).astype(np.float32)

    return {
        "frame": frames.number[:n],
        "stamp_ns": frames.stamp_ns[:n],
        # The colour images' stamps don't depend on whether colour is read.
        "color_stamp_ns": np.ma.masked_less(np.full(n, -1) if colors is None else colors[:n], 0),
        "log_time_ns": np.ma.array(
            np.zeros(n, np.int64) if times is None else times, mask=np.full(n, times is None)
        ),
        "status": np.array([str(s) for s in status.tolist()], object),
        "camera_height_m": known(plane.height),
        "camera_pitch_rad": known(plane.pitch),
        "camera_roll_rad": known(plane.roll),
        "camera_frame": named(batch.camera_frame),
        "world_frame": named(batch.world_frame),
        "camera_position_world": poses[:, :3, 3],
        "camera_orientation_world": quaternions(poses[:, :3, :3]),
    }


def _floor_columns(
    fit: FloorFit | None, sources: Sequence[str], good: np.ndarray, config: Config
) -> dict[str, Any]:
    """Return the source of each frame's floor, and the reason if the frame's own was refused."""
    own, refused = np.zeros_like(good), np.zeros(good.size, int)
    if fit is not None and config.ground.source != "none":
        own, refused = good & fit.own, fit.refused
    return {
        "floor_source": np.where(own, "frame", np.array(sources, object)),
        "floor_refused": np.ma.array(_REFUSALS[refused], mask=~good | (refused == Refusal.NONE)),
    }


def _free_columns(free: FreeFloor | None, good: np.ndarray) -> dict[str, Any]:
    """Return the columns of the free floor, null for frames with False in ``good`` ``(n,)``.

    Without an estimate of the free floor all values are null.
    """
    kinds = {
        "free_bearing_rad": np.float32,
        "free_from_m": np.float32,
        "free_to_m": np.float32,
        "free_end": np.int8,
    }
    if free is None:
        nulls = dict.fromkeys(kinds, Lists.nulls(good.size))
        return {**nulls, "drop_m": np.full(good.size, np.nan)}
    used = free.seen & good[:, None]
    at, length = np.flatnonzero(used), used.sum(axis=1, dtype=np.int32)
    columns: dict[str, Any] = {}
    for name, kind in kinds.items():
        values = getattr(free, name.removeprefix("free_")).ravel()[at].astype(kind)
        columns[name] = Lists.of_lengths(values, length, ~good)
    return columns | {"drop_m": np.where(good, free.drop_m, np.nan).astype(np.float32)}


def _obstacle_columns(
    frames: Frames,
    poses: np.ndarray,
    plane: GroundPlane,
    found: Detections,
    good: np.ndarray,
    config: Config,
) -> dict[str, Any]:
    unit, slots = frames.calibration.depth_unit, found.obstacles.num_points.shape[1]
    if (most := found.num_obstacles.max(initial=0)) > slots:
        raise ValueError(f"{most} obstacles do not fit in {slots} slots")
    row, slot = np.nonzero(good[:, None] & (np.arange(slots) < found.num_obstacles[:, None]))
    obstacles: Obstacles = map_leaves(lambda part: part[row, slot], found.obstacles)
    box, corners = extents(obstacles, unit), rectangles(obstacles, unit, config.footprint)
    columns: dict[str, Any] = {
        "frame": frames.number[row],
        "stamp_ns": frames.stamp_ns[row],
        "obstacle": slot.astype(np.int32),
        "num_points": obstacles.num_points,
        "evidence": _evidence(found.scene, row, slot),
        "vertices": obstacles.has_vertex.astype(np.int8),
        "corners_ground": corners.reshape(-1, 8).astype(np.float32),
        "corners_world": to_world(corners[:, None], poses[row]).reshape(-1, 8),
    }
    columns |= _shape_columns(obstacles, found.scene, plane, row, slot, unit)
    in_color = config.cluster.points or frames.calibration.color is not None
    columns["box_image"] = np.full(row.size, "color" if in_color else "depth", object)
    outside = (obstacles.uv_max < obstacles.uv_min).any(axis=1)
    for i, axis in enumerate("uv"):
        columns[f"{axis}_min"] = np.ma.array(obstacles.uv_min[:, i], mask=outside)
        columns[f"{axis}_max"] = np.ma.array(obstacles.uv_max[:, i], mask=outside)
    for i, axis in enumerate("xyz"):
        columns[f"{axis}_min"] = box.minimum[:, i]
        columns[f"{axis}_max"] = box.maximum[:, i]
        columns[axis] = box.centroid[:, i]
    return columns


def _evidence(scene: Scene | None, row: np.ndarray, slot: np.ndarray) -> np.ndarray:
    """Return the evidence of each obstacle, ``(R,)`` object."""
    if scene is None:
        return np.full(row.size, "corners", object)
    is_notch = slot >= np.asarray(scene.first_notch)[row]
    return np.where(is_notch, "free_floor", "surface").astype(object)


def _shape_columns(
    obstacles: Obstacles,
    scene: Scene | None,
    plane: GroundPlane,
    row: np.ndarray,
    slot: np.ndarray,
    unit: float,
) -> dict[str, Any]:
    """Return distances, heights above the floor and contours, null without a floor.

    Clusters of points have no heights and no contours.
    """
    known = plane.valid[row]
    if scene is None:
        distance = point_distances(obstacles)
        bottom = top = np.full(row.size, np.nan)
        contours = Lists.nulls(row.size)
    else:
        turned = np.abs(plane.roll) > 0.5 * np.pi  # upside down: columns go from right to left
        placed = np.where(plane.valid[:, None], scene.contour_points, 0)
        points, count = contour_lines(scene.contour, placed, row, slot, turned[row])
        distance = nearest(points, count)
        bottom, top = (scene.bottom_top[row, slot] * unit).T
        values = (points * unit).astype(np.float32).ravel()
        contours = Lists.of_lengths(values, 2 * count, ~known)
    metres = {"distance_m": distance * unit, "bottom_m": bottom, "top_m": top}
    return {
        **{name: np.where(known, a, np.nan).astype(np.float32) for name, a in metres.items()},
        "contour": contours,
    }
