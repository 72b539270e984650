"""The truth of a simulated log, kept beside it as ``<log>.truth.npz``.

The file holds the arrays of :class:`Truth` under their names, and for each frame ``i`` the
obstacle number of each colour pixel, ``(H, W)`` uint8, as ``obstacle_id_<i, six digits>``. Any
NumPy reads it: ``np.load("demo.mcap.truth.npz")["obstacle_id_000000"]``.
"""

import io
import zipfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxdet.errors import InputError
from jaxdet.sim.config import SimConfig
from jaxdet.sim.frames import SimFrame
from jaxdet.sim.robot import ground_frame
from jaxdet.sim.scene import Scene, bounds, footprint


class Truth(NamedTuple):
    """All that is true of a log but the pixels: ``F`` frames, ``J`` objects.

    Object ``j`` has the number ``j + 1`` in the obstacle pictures. An object out of sight has 0
    visible pixels and NaN extents.
    """

    stamp_ns: np.ndarray
    """``(F,)`` int64, colour stamp."""
    T_world_camera: np.ndarray
    """``(F, 4, 4)`` float64, colour optical frame to world, exact."""
    camera_height: np.ndarray
    """``(F,)`` float64 [m]."""
    camera_pitch: np.ndarray
    """``(F,)`` float64 [rad]."""
    camera_roll: np.ndarray
    """``(F,)`` float64 [rad]."""
    names: np.ndarray
    """``(J,)`` str."""
    is_wall: np.ndarray
    """``(J,)`` bool."""
    box_world: np.ndarray
    """``(J, 8, 3)`` float64, corners of the upright box around each, bottom first [m]."""
    footprint_world: np.ndarray
    """``(J, 16, 2)`` float64, outline on the floor, counter-clockwise, NaN after the last [m]."""
    visible_pixels: np.ndarray
    """``(F, J)`` int32, colour pixels that show the object."""
    nearest_m: np.ndarray
    """``(F, J)`` float32, smallest z of its visible surface in the colour camera [m]."""
    ground_min: np.ndarray
    """``(F, J, 2)`` float32, smallest right, forward of its visible surface in the camera's
    ground frame [m]; forward is the distance of its nearest face."""
    ground_max: np.ndarray
    """``(F, J, 2)`` float32, largest right, forward of the same [m]."""


def truth_path(log: str | Path) -> Path:
    """Where the truth of a log lies."""
    return Path(f"{log}.truth.npz")


class TruthWriter:
    """Writes the truth frame by frame, so memory stays small.

    Args:
        path: The file to write.
        config: The simulation.
        scene: Its scene.
    """

    def __init__(self, path: Path, config: SimConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._zip = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        self._stamps: list[int] = []
        self._poses: list[np.ndarray] = []
        self._rows: list[tuple[np.ndarray, ...]] = []

    def add(self, frame: SimFrame) -> None:
        """Take one frame in."""
        self._stamps.append(frame.stamp_ns)
        self._poses.append(frame.T_world_color)
        self._rows.append(visible_extents(frame, len(self._scene.objects)))
        self._put(f"obstacle_id_{frame.number:06d}", frame.truth.obstacle_id)

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
        scene, config, count = self._scene, self._config, len(self._stamps)
        objects = len(scene.objects)
        outlines = np.full((objects, 16, 2), np.nan)
        for row, solid in zip(outlines, scene.solids, strict=True):
            outline = footprint(solid)
            row[: len(outline)] = outline
        shapes = ((objects,), (objects,), (objects, 2), (objects, 2))
        kinds = (np.int32, np.float32, np.float32, np.float32)
        extents = [
            np.array([row[i] for row in self._rows], kind).reshape(count, *shape)
            for i, (shape, kind) in enumerate(zip(shapes, kinds, strict=True))
        ]
        return Truth(
            np.array(self._stamps, np.int64),
            np.array(self._poses, np.float64).reshape(count, 4, 4),
            np.full(count, config.camera_height_m),
            np.full(count, config.camera_pitch_rad),
            np.full(count, config.camera_roll_rad),
            np.array([thing.name for thing in scene.objects], np.str_),
            np.arange(objects) >= objects - len(scene.walls),
            np.array([bounds(solid) for solid in scene.solids]).reshape(objects, 8, 3),
            outlines,
            *extents,
        )


def visible_extents(
    frame: SimFrame, objects: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What of each object is seen.

    Returns:
        Pixels ``(J,)``, nearest z ``(J,)``, smallest and largest right, forward ``(J, 2)`` [m],
        as in :class:`Truth`.
    """
    T = ground_frame(frame.T_world_color)
    pixels = np.bincount(frame.truth.obstacle_id.ravel(), minlength=objects + 1)[1:]
    nearest = np.full(objects, np.nan)
    low, high = np.full((objects, 2), np.nan), np.full((objects, 2), np.nan)
    for j in np.flatnonzero(pixels):
        chosen = frame.truth.obstacle_id == j + 1
        ground = frame.truth.points[chosen] @ T[:2, :3].T + T[:2, 3]
        nearest[j] = frame.truth.depth[chosen].min()
        low[j], high[j] = ground.min(0), ground.max(0)
    return pixels, nearest, low, high


def load_truth(log: str | Path) -> Truth:
    """Read the truth of a log.

    Raises:
        InputError: There is none, or it is not what it should be.
    """
    path = truth_path(log)
    try:
        with np.load(path) as arrays:
            return Truth(*(arrays[name] for name in Truth._fields))
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        remedy = "only logs of jaxdet sim have a truth"
        raise InputError("no truth can be read", path=str(path), remedy=remedy) from error


def load_obstacle_ids(log: str | Path, frames: np.ndarray | list[int]) -> np.ndarray:
    """The obstacle number of each colour pixel of some frames, ``(B, H, W)`` uint8."""
    with np.load(truth_path(log)) as arrays:
        return np.stack([arrays[f"obstacle_id_{int(frame):06d}"] for frame in frames])
