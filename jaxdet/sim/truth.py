"""The truth of a simulated log, kept beside it as ``<log>.truth.npz``.

The file holds the arrays of :class:`Truth` under their names, and for each frame ``i`` the
obstacle number of each colour pixel, ``(H, W)`` uint8, as ``obstacle_id_<i, six digits>``, its
depth, ``(H, W)`` float16 [m], inf where nothing is, as ``depth_<i, six digits>``, and whether it
shows floor to drive on, ``(H, W)`` bool, as ``drivable_<i, six digits>``. Any NumPy reads it:
``np.load("demo.mcap.truth.npz")["obstacle_id_000000"]``.
"""

import io
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from jaxdet.errors import InputError
from jaxdet.sim.config import SimConfig
from jaxdet.sim.drivable import floor_edge, floor_truth
from jaxdet.sim.frames import SimFrame, simulate_frame
from jaxdet.sim.placed import placed
from jaxdet.sim.robot import ground_frame
from jaxdet.sim.scene import Scene
from jaxdet.sim.world import STEP_M

MAX_ARRAY_BYTES = 1 << 28
"""Of one array of a truth file."""


class Truth(NamedTuple):
    """All that is true of frames but the pixels: ``F`` frames, ``J`` objects.

    Object ``j`` has the number ``j + 1`` in the obstacle pictures. An object out of sight has 0
    visible pixels and NaN extents.
    """

    stamp_ns: np.ndarray
    """``(F,)`` int64, stamp of the colour image, which all but ``depth_stamp_ns`` is of."""
    depth_stamp_ns: np.ndarray
    """``(F,)`` int64, stamp of the depth image."""
    T_world_camera: np.ndarray
    """``(F, 4, 4)`` float64, colour optical frame to world, exact."""
    camera_height: np.ndarray
    """``(F,)`` float64, over the base, with the mount's errors that the log's TF doesn't have
    [m]."""
    camera_pitch: np.ndarray
    """``(F,)`` float64, likewise [rad]."""
    camera_roll: np.ndarray
    """``(F,)`` float64, likewise [rad]."""
    names: np.ndarray
    """``(J,)`` str, the objects' names; models have their kind's, as ``person`` or ``cone``."""
    is_wall: np.ndarray
    """``(J,)`` bool."""
    height_m: np.ndarray
    """``(F, J)`` float32, top of the object above the floor at its middle [m]."""
    box_world: np.ndarray
    """``(F, J, 8, 3)`` float32, corners of the upright box around each, turned with the object,
    bottom first, counter-clockwise from above [m]; :func:`to_camera` has them in the camera."""
    footprint_world: np.ndarray
    """``(F, J, 64, 2)`` float32, outline on the floor of what is between 0.05 m, which wheels
    climb, and 2.2 m: its convex hull from above, counter-clockwise, NaN after the last corner
    [m]."""
    visible_pixels: np.ndarray
    """``(F, J)`` int32, colour pixels that show the object."""
    nearest_m: np.ndarray
    """``(F, J)`` float32, smallest z in the colour camera of its visible surface, what is lower
    than 0.05 m left out unless that is all [m]."""
    ground_min: np.ndarray
    """``(F, J, 2)`` float32, smallest right, forward of the same in the camera's ground frame
    [m]; forward is the distance of its nearest face."""
    ground_max: np.ndarray
    """``(F, J, 2)`` float32, largest right, forward of the same [m]."""
    edge_m: np.ndarray
    """``(F, 81)`` float32, distance from the camera's foot to where the floor steps down, along the
    bearings ``EDGE_BEARINGS_RAD`` (-40 to 40 degrees, clockwise) [m]; NaN where it goes on."""
    edge_seen: np.ndarray
    """``(F, 81)`` bool, whether the colour camera sees that edge."""


def truth_path(log: str | Path) -> Path:
    """Where the truth of a log lies."""
    return Path(f"{log}.truth.npz")


class TruthWriter:
    """Writes the truth frame by frame, so memory stays small; a context manager.

    Args:
        path: The file to write.
        config: The simulation.
        scene: Its scene.
    """

    def __init__(self, path: Path, config: SimConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._zip = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        self._rows: list[Truth] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError, ValueError):  # what failed to be written is told already
            self._zip.close()

    def add(self, frame: SimFrame) -> None:
        """Take one frame in."""
        self._rows.append(frame_truth(frame))
        self._put(f"obstacle_id_{frame.number:06d}", frame.truth.obstacle_id)
        self._put(f"depth_{frame.number:06d}", frame.truth.depth.astype(np.float16))
        self._put(f"drivable_{frame.number:06d}", floor_truth(frame).drivable)

    def finish(self) -> Truth:
        """Write the rest and close the file."""
        truth = self._truth()
        for name, array in truth._asdict().items():
            self._put(name, array)
        self._zip.close()
        return truth

    def _put(self, name: str, array: np.ndarray) -> None:
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=False)
        # A fixed date, so that the same simulation gives the same bytes.
        info = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
        self._zip.writestr(info, buffer.getvalue(), zipfile.ZIP_DEFLATED, compresslevel=1)

    def _truth(self) -> Truth:
        one = self._rows[0] if self._rows else empty_truth(self._config, self._scene)
        if not self._rows:
            return one
        lists = zip(*self._rows, strict=True)
        fields = {
            name: getattr(one, name) if name in _OF_LOG else np.concatenate(parts)
            for name, parts in zip(Truth._fields, lists, strict=True)
        }
        return Truth(**fields)


_OF_LOG = ("names", "is_wall")


def frame_truth(frame: SimFrame) -> Truth:
    """The truth of one frame, ``F`` = 1."""
    scene = frame.scene
    shapes = placed(scene, frame.time_s if scene.moves else 0.0)
    extents = visible_extents(frame, len(scene.objects))
    height, pitch, roll = (np.array([value]) for value in frame.mount)
    return Truth(
        np.array([frame.stamp_ns], np.int64),
        np.array([frame.depth_stamp_ns], np.int64),
        frame.T_world_color[None],
        height,
        pitch,
        roll,
        np.array(scene.names, np.str_),
        np.arange(len(scene.objects)) >= len(scene.objects) - len(scene.walls),
        *(array[None] for array in (*shapes, *extents, *floor_edge(frame))),
    )


def empty_truth(config: SimConfig, scene: Scene) -> Truth:
    """The truth of a log without frames."""
    tiny = replace(config, width=16, height=16)
    truth = frame_truth(simulate_frame(tiny, scene, 0))
    arrays = truth._asdict().items()
    return Truth(**{name: a if name in _OF_LOG else a[:0] for name, a in arrays})


def to_camera(T_world_camera: np.ndarray, points: np.ndarray) -> np.ndarray:
    """World points ``(..., 3)`` in the camera optical frame."""
    return (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]


def visible_extents(
    frame: SimFrame, objects: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What of each object is seen.

    Returns:
        Pixels ``(J,)``, nearest z ``(J,)``, smallest and largest right, forward ``(J, 2)`` [m],
        as in :class:`Truth`.
    """
    T = ground_frame(frame.T_world_base)
    pixels = np.bincount(frame.truth.obstacle_id.ravel(), minlength=objects + 1)[1:]
    pixels = pixels.astype(np.int32)
    nearest = np.full(objects, np.nan, np.float32)
    low, high = np.full((2, objects, 2), np.nan, np.float32)
    height = frame.truth.height
    for j in np.flatnonzero(pixels):
        chosen = frame.truth.obstacle_id == j + 1
        above = chosen & (height > STEP_M)
        chosen = above if above.any() else chosen
        ground = frame.truth.points[chosen] @ T[:2, :3].T + T[:2, 3]
        nearest[j] = frame.truth.depth[chosen].min()
        low[j], high[j] = ground.min(0), ground.max(0)
    return pixels, nearest, low, high


def load_truth(log: str | Path) -> Truth:
    """Read the truth of a log.

    Raises:
        InputError: There is none, or it is not what it should be.
    """
    truth = Truth(*_load(log, Truth._fields))
    sizes = {"F": len(truth.stamp_ns), "J": len(truth.names)}
    for name, array in truth._asdict().items():
        *shape, kinds = _SHAPES.get(name, ("F", "J", "f"))
        if array.shape != tuple(sizes.get(n, n) for n in shape) or array.dtype.kind not in kinds:
            raise _unreadable(log)
    if len(truth.stamp_ns):
        _load(log, ("drivable_000000",))
    return truth


_SHAPES: dict[str, tuple] = {
    "stamp_ns": ("F", "i"),
    "depth_stamp_ns": ("F", "i"),
    "T_world_camera": ("F", 4, 4, "f"),
    "camera_height": ("F", "f"),
    "camera_pitch": ("F", "f"),
    "camera_roll": ("F", "f"),
    "names": ("J", "U"),
    "is_wall": ("J", "b"),
    "box_world": ("F", "J", 8, 3, "f"),
    "footprint_world": ("F", "J", 64, 2, "f"),
    "visible_pixels": ("F", "J", "i"),
    "ground_min": ("F", "J", 2, "f"),
    "ground_max": ("F", "J", 2, "f"),
    "edge_m": ("F", 81, "f"),
    "edge_seen": ("F", 81, "b"),
}
"""Shape and kind of number of each array; of those not named ``(F, J)`` of floats."""


def _load(log: str | Path, names: Sequence[str]) -> list[np.ndarray]:
    """Arrays of a truth file, each within ``MAX_ARRAY_BYTES``.

    Raises:
        InputError: One isn't there, is damaged or too large.
    """
    try:
        with truth_path(log).open("rb") as file, np.load(file) as arrays:
            for name in names:
                if arrays.zip.getinfo(f"{name}.npy").file_size > MAX_ARRAY_BYTES:
                    raise ValueError(f"{name} is too large")
            return [arrays[name] for name in names]
    except Exception as error:  # zip, zlib and NumPy raise what they like of a damaged file
        raise _unreadable(log) from error


def _unreadable(log: str | Path) -> InputError:
    remedy = "only logs of jaxdet sim have one; those of older versions have to be made again"
    return InputError("no truth can be read", path=str(truth_path(log)), remedy=remedy)


def load_obstacle_ids(log: str | Path, frames: np.ndarray | list[int]) -> np.ndarray:
    """The obstacle number of each colour pixel of some frames, ``(B, H, W)`` uint8."""
    return _load_images(log, "obstacle_id", frames)


def load_depths(log: str | Path, frames: np.ndarray | list[int]) -> np.ndarray:
    """The true z of what each colour pixel of some frames shows, ``(B, H, W)`` float16 [m]."""
    return _load_images(log, "depth", frames)


def load_drivable(log: str | Path, frames: np.ndarray | list[int]) -> np.ndarray:
    """Which colour pixels of some frames show floor to drive on, ``(B, H, W)`` bool."""
    return _load_images(log, "drivable", frames)


def _load_images(log: str | Path, name: str, frames: np.ndarray | list[int]) -> np.ndarray:
    images = _load(log, [f"{name}_{int(frame):06d}" for frame in frames])
    kind = {"obstacle_id": "u", "depth": "f", "drivable": "b"}[name]
    if any((a.ndim, a.shape, a.dtype.kind) != (2, images[0].shape, kind) for a in images):
        raise _unreadable(log)
    return np.stack(images)
