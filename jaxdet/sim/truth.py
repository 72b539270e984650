"""Ground truth of a simulated log, in ``<log>.truth.npz`` next to it.

The file holds the arrays of :class:`Truth` by name, and for each frame ``i`` three images in the
colour camera: the object number, ``(H, W)`` uint8, as ``obstacle_id_<i, six digits>``; the depth,
``(H, W)`` float16 [m], inf without a hit, as ``depth_<i, six digits>``; and whether the
pixel shows drivable floor, ``(H, W)`` bool, as ``drivable_<i, six digits>``. NumPy reads it:
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
"""Maximum size of an array in a ground truth file."""


class Truth(NamedTuple):
    """Ground truth of ``F`` frames and ``J`` objects, without images.

    Object ``j`` has the number ``j + 1`` in the images. An object that is not visible has 0 pixels
    and NaN extents.
    """

    stamp_ns: np.ndarray
    """Timestamp of the colour image, ``(F,)`` int64; all other fields refer to it."""
    depth_stamp_ns: np.ndarray
    """Timestamp of the depth image, ``(F,)`` int64."""
    T_world_camera: np.ndarray
    """Exact pose of the colour optical frame in the world, ``(F, 4, 4)`` float64."""
    camera_height: np.ndarray
    """True mounting height above the base, ``(F,)`` float64, including errors not in TF [m]."""
    camera_pitch: np.ndarray
    """True pitch ``(F,)`` float64, including errors not in TF [rad]."""
    camera_roll: np.ndarray
    """True roll ``(F,)`` float64, including errors not in TF [rad]."""
    names: np.ndarray
    """Names of the objects, ``(J,)`` str; for models without a name the kind, such as ``cone``."""
    is_wall: np.ndarray
    """Whether each object is a wall, ``(J,)`` bool."""
    height_m: np.ndarray
    """Top of each object above the floor at its middle, ``(F, J)`` float32 [m]."""
    box_world: np.ndarray
    """Corners of the oriented upright bounding box, bottom first, counter-clockwise from above,
    ``(F, J, 8, 3)`` float32 [m]; :func:`to_camera` transforms them to the camera."""
    footprint_world: np.ndarray
    """Footprint ``(F, J, 64, 2)`` float32 [m]: convex hull, from above, of the object between
    0.05 m (which wheels climb) and 2.2 m, counter-clockwise, NaN after the last corner."""
    visible_pixels: np.ndarray
    """Number of colour pixels that show the object, ``(F, J)`` int32."""
    nearest_m: np.ndarray
    """Minimum z in the colour camera of the visible surface, ``(F, J)`` float32 [m]; only parts
    above 0.05 m count, if there are any."""
    ground_min: np.ndarray
    """Minimum coordinates (right, forward) of the surface measured by ``nearest_m``, in the
    camera's ground frame, ``(F, J, 2)`` float32 [m]."""
    ground_max: np.ndarray
    """Maximum coordinates (right, forward) of the same surface, ``(F, J, 2)`` float32 [m]."""
    edge_m: np.ndarray
    """Distance from the camera's ground projection to the first step down, ``(F, 81)`` float32 [m],
    at the bearings ``EDGE_BEARINGS_RAD`` (-40 to 40 degrees, clockwise); NaN without a step."""
    edge_seen: np.ndarray
    """Whether the colour camera sees the edge of ``edge_m``, ``(F, 81)`` bool."""


def truth_path(log: str | Path) -> Path:
    """Return the path of a log's ground truth."""
    return Path(f"{log}.truth.npz")


class TruthWriter:
    """Writer of a ground truth file, a context manager; images are written frame by frame.

    Args:
        path: Output file.
        config: Parameters of the simulation.
        scene: Scene.
    """

    def __init__(self, path: Path, config: SimConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._zip = zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        self._rows: list[Truth] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError, ValueError):  # a failed write was reported already
            self._zip.close()

    def add(self, frame: SimFrame) -> None:
        """Write the images of a frame, and keep the rest of its ground truth for :meth:`finish`."""
        self._rows.append(frame_truth(frame))
        self._put(f"obstacle_id_{frame.number:06d}", frame.truth.obstacle_id)
        self._put(f"depth_{frame.number:06d}", frame.truth.depth.astype(np.float16))
        self._put(f"drivable_{frame.number:06d}", floor_truth(frame).drivable)

    def finish(self) -> Truth:
        """Write all arrays without pixels, close the file and return these arrays."""
        truth = self._truth()
        for name, array in truth._asdict().items():
            self._put(name, array)
        self._zip.close()
        return truth

    def _put(self, name: str, array: np.ndarray) -> None:
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=False)
        # A fixed date, for reproducible bytes.
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
"""Fields of :class:`Truth` with one row for the log, not one per frame."""


def frame_truth(frame: SimFrame) -> Truth:
    """Return the ground truth of a frame, ``F`` = 1."""
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
    """Return the ground truth of a log without frames."""
    tiny = replace(config, width=16, height=16)
    truth = frame_truth(simulate_frame(tiny, scene, 0))
    arrays = truth._asdict().items()
    return Truth(**{name: a if name in _OF_LOG else a[:0] for name, a in arrays})


def to_camera(T_world_camera: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Transform world points ``(..., 3)`` to the camera optical frame."""
    return (points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]


def visible_extents(
    frame: SimFrame, objects: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Compute the extent of the visible part of each object.

    Returns:
        Number of pixels ``(J,)``, nearest z ``(J,)`` [m], and minimum and maximum coordinates
        (right, forward), each ``(J, 2)`` [m], as in :class:`Truth`.
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
    """Read the ground truth of a log.

    Raises:
        InputError: The file is missing or invalid.
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
"""Shape and NumPy kinds of each array; default: ``(F, J)`` floats."""


def _load(log: str | Path, names: Sequence[str]) -> list[np.ndarray]:
    """Load arrays of a ground truth file, each within ``MAX_ARRAY_BYTES``.

    Raises:
        InputError: An array is missing, damaged or too large.
    """
    try:
        with truth_path(log).open("rb") as file, np.load(file) as arrays:
            for name in names:
                if arrays.zip.getinfo(f"{name}.npy").file_size > MAX_ARRAY_BYTES:
                    raise ValueError(f"{name} is too large")
            return [arrays[name] for name in names]
    except Exception as error:  # zip, zlib and NumPy raise many types for damaged files
        raise _unreadable(log) from error


def _unreadable(log: str | Path) -> InputError:
    remedy = "only logs of jaxdet sim have ground truth; simulate logs of older versions again"
    return InputError("cannot read ground truth", path=str(truth_path(log)), remedy=remedy)


def load_obstacle_ids(log: str | Path, frames: np.ndarray | list[int]) -> np.ndarray:
    """Load the object number of each colour pixel of some frames, ``(B, H, W)`` uint8."""
    return _load_images(log, "obstacle_id", frames)


def load_depths(log: str | Path, frames: np.ndarray | list[int]) -> np.ndarray:
    """Load the true z of each colour pixel of some frames, ``(B, H, W)`` float16 [m]."""
    return _load_images(log, "depth", frames)


def load_drivable(log: str | Path, frames: np.ndarray | list[int]) -> np.ndarray:
    """Load which colour pixels of some frames show drivable floor, ``(B, H, W)`` bool."""
    return _load_images(log, "drivable", frames)


def _load_images(log: str | Path, name: str, frames: np.ndarray | list[int]) -> np.ndarray:
    images = _load(log, [f"{name}_{int(frame):06d}" for frame in frames])
    kind = {"obstacle_id": "u", "depth": "f", "drivable": "b"}[name]
    if any((a.ndim, a.shape, a.dtype.kind) != (2, images[0].shape, kind) for a in images):
        raise _unreadable(log)
    return np.stack(images)
