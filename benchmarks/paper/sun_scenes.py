"""Scenes of SUN RGB-D (Song et al., CVPR 2015), read from the folders of the dataset.

Each scene is a folder with ``image/*.jpg``, ``depth/*.png`` (aligned to the image, its bits rotated
by three), ``intrinsics.txt``, ``extrinsics/*.txt`` (the rotation that makes the camera level),
``scene.txt`` and, if it is labelled, ``annotation2Dfinal/index.json`` with a polygon and a name for
each object. ``depth_bfx``, in which holes are filled, is not used, because a robot's depth has
holes. ``labels/sunrgbd.json`` lists public repositories that contain scenes.
"""

import json
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from benchmarks.paper.stills import read_color, read_depth
from benchmarks.scores.boxes import MIN_PLANE_PIXELS, FrameLabels, heights
from jaxdet.errors import InputError
from jaxdet.eval.boxes import near_surface
from jaxdet.types import Calibration, Frames, Intrinsics

LABELS = "annotation2Dfinal/index.json"
UNIT_M = 0.001
FLOORS = frozenset({"floor", "ground", "carpet", "rug", "mat", "floormat", "bathmat", "doormat"})
"""Last words of names of the floor."""
ROOM = (
    "wall", "ceiling", "pillar", "column", "beam", "stair", "staircase", "step", "railing", "room",
    "door", "doorway", "doorframe", "doorknob", "window", "windowsill", "sill", "frame", "blind",
    "curtain", "pipe", "vent", "airvent", "hole", "background", "unknown", "other", "object",
)  # fmt: skip
"""Last words of names of parts of the room, and of names without meaning."""
HANGING = (
    "board", "whiteboard", "blackboard", "bulletin", "picture", "painting", "poster", "photo",
    "mirror", "light", "lightswitch", "switch", "outlet", "socket",
)  # fmt: skip
"""Last words of names of objects on walls and ceilings."""
NO_THINGS = frozenset(ROOM + HANGING)
"""Last words of names that are not objects to be found."""
MAX_DEPTH_M = 3.0
"""Maximum distance of objects to be found, the range of preset ``paper`` [m]; farther ones are
neither missed nor false.
"""
MIN_SIDE = 16 / 640
"""Minimum width and height of an object's box, as a share of the image's width."""
STANDS_M, LOWEST = 0.15, 0.01
"""Maximum height of the lowest points of an object that stands on the floor [m], and the quantile
of its heights that is compared with it.
"""


class Polygon(NamedTuple):
    """Labelled outline of an object or the floor."""

    name: str
    points: np.ndarray
    """Corners ``(P, 2)`` float64, u and v [pixel]; they may be outside of the image."""

    @property
    def last_word(self) -> str:
        """Last word of the name, in lower case, singular and without a number."""
        words = "".join(c if c.isalpha() else " " for c in self.name.lower()).split()
        word = words[-1] if words else "unknown"
        return word[:-1] if word.endswith("s") and not word.endswith("ss") else word

    @property
    def is_floor(self) -> bool:
        """Whether the outline is of floor."""
        return self.last_word in FLOORS

    @property
    def is_thing(self) -> bool:
        """Whether the outline is of an object that can be found."""
        return not self.is_floor and self.last_word not in NO_THINGS


class SunScene(NamedTuple):
    """Scene of SUN RGB-D."""

    name: str
    """Path of the scene's folder relative to the root."""
    frames: Frames
    """Frame with depth aligned to colour, without a plane."""
    down: np.ndarray | None
    """Direction of gravity in the camera's optical frame, ``(3,)`` float64; None if unknown."""
    kind: str
    """Kind of room, such as ``office``; empty if unknown."""
    polygons: tuple[Polygon, ...] | None
    """Labelled outlines; None if the scene has no labels."""


def find_scenes(root: Path) -> list[Path]:
    """Return the folders of scenes under a folder, in the order of their paths.

    Raises:
        InputError: The folder contains no scenes.
    """
    scenes = sorted(path.parent for path in root.rglob("intrinsics.txt") if _is_scene(path.parent))
    if not scenes:
        remedy = "name the folder that holds kv1, kv2, realsense and xtion, or a scene's own"
        raise InputError("no scene of SUN RGB-D", path=str(root), remedy=remedy)
    return scenes


def _is_scene(folder: Path) -> bool:
    return (folder / "image").is_dir() and (folder / "depth").is_dir()


def read_scene(folder: Path, root: Path) -> SunScene:
    """Read a scene.

    Raises:
        InputError: A file is missing or can't be read.
    """
    color = read_color(_only(folder / "image", "*.jpg"))
    depth = read_depth(_only(folder / "depth", "*.png"), UNIT_M, "sunrgbd")
    height, width = color.shape[:2]
    if depth.shape != (height, width):
        problem = f"the depth has {depth.shape[::-1]} pixels, the image {width, height}"
        raise InputError(problem, path=str(folder), remedy="copy the scene again")
    K = _numbers(folder / "intrinsics.txt", 9).reshape(3, 3)
    camera = Intrinsics(width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    zero = np.zeros(1, np.int64)
    frames = Frames(depth[None], Calibration(camera), zero, zero, zero == 0, color[None], zero)
    extrinsics = sorted((folder / "extrinsics").glob("*.txt"))
    down = _numbers(extrinsics[-1], 12).reshape(3, 4)[1, :3] if extrinsics else None
    kind = folder / "scene.txt"
    return SunScene(
        folder.relative_to(root).as_posix(),
        frames,
        down,
        kind.read_text(encoding="utf-8").strip() if kind.is_file() else "",
        read_polygons(folder / LABELS) if (folder / LABELS).is_file() else None,
    )


def _only(folder: Path, pattern: str) -> Path:
    paths = sorted(folder.glob(pattern))
    if len(paths) != 1:
        problem = f"{len(paths)} files match {pattern}, but a scene has one"
        raise InputError(problem, path=str(folder), remedy="copy the scene again")
    return paths[0]


def _numbers(path: Path, count: int) -> np.ndarray:
    """Return the first numbers of a text file, ``(count,)`` float64."""
    try:
        values = np.array(path.read_text(encoding="utf-8").split()[:count], np.float64)
    except ValueError as error:
        raise InputError("no matrix of numbers", path=str(path)) from error
    if len(values) < count:
        problem = f"expected {count} numbers, got {len(values)}"
        raise InputError(problem, path=str(path), remedy="copy the scene again")
    return values


def read_polygons(path: Path) -> tuple[Polygon, ...]:
    """Read the outlines of an ``index.json``, except those without a name or an area.

    Raises:
        InputError: The file does not contain labels (in one file of the dataset, a name has stray
            quotes).
    """
    try:
        read = json.loads(path.read_text(encoding="utf-8"))
        names = [str(one.get("name", "")) if one else "" for one in read["objects"]]
        found = [_polygon(one, names) for one in read["frames"][0].get("polygon") or []]
    except (ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
        problem = f"not a file of SUN RGB-D labels ({error})"
        raise InputError(problem, path=str(path), remedy="correct or remove the file") from error
    return tuple(one for one in found if one is not None)


def _polygon(read: dict[str, Any] | None, names: list[str]) -> Polygon | None:
    """Return an outline, or None if it has less than three corners or no name."""
    if not read or "object" not in read:
        return None
    points = np.stack([np.atleast_1d(np.array(read[axis], np.float64)) for axis in "xy"], axis=1)
    number = int(read["object"])
    return Polygon(names[number], points) if len(points) >= 3 and number < len(names) else None


def labels_of_scene(scene: SunScene, standing: bool) -> FrameLabels:
    """Return the labels of a scene as boxes and masks.

    An object is to be found if its near surface is within ``MAX_DEPTH_M`` and its box has at least
    ``MIN_SIDE``. Everything else except the floor is unknown: detections there are neither right
    nor wrong.

    Args:
        scene: Scene with polygons.
        standing: Whether only objects that stand on the floor are to be found; objects on a table
            are unknown then. If no labelled floor has depth, no object counts as standing.
    """
    assert scene.polygons is not None
    depth, camera = scene.frames.depth[0], scene.frames.calibration.image
    z_m, height, width = depth * UNIT_M, camera.height, camera.width
    masks = [_mask(polygon.points, height, width) for polygon in scene.polygons]
    floor = np.zeros((height, width), bool)
    for polygon, mask in zip(scene.polygons, masks, strict=True):
        floor |= mask & polygon.is_floor
    for polygon, mask in zip(scene.polygons, masks, strict=True):
        floor &= ~mask | polygon.is_floor
    seen = (floor & (z_m > 0)).sum() >= MIN_PLANE_PIXELS
    height_m = heights(z_m, floor, camera) if seen else z_m
    boxes, distance, known = [], [], floor.copy()
    for polygon, mask in zip(scene.polygons, masks, strict=True):
        v, u = np.nonzero(mask)
        measured = mask & (z_m > 0)
        if not polygon.is_thing or not measured.any():
            continue
        box, near = (u.min(), v.min(), u.max(), v.max()), near_surface(z_m[measured])
        large = min(box[2] - box[0], box[3] - box[1]) + 1 >= MIN_SIDE * width
        stands = seen and np.quantile(height_m[measured], LOWEST) <= STANDS_M
        if near <= MAX_DEPTH_M and large and (stands or not standing):
            boxes.append(box)
            distance.append(near)
            known |= mask
    shaped = np.array(boxes, np.int64).reshape(-1, 4)
    tags = (frozenset[str](),) * len(boxes)
    return FrameLabels(shaped, np.array(distance, np.float64), floor, known, tags)


def _mask(points: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return the mask of the pixels inside of an outline, ``(H, W)`` bool."""
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.rint(points).astype(np.int32)], 1)
    return mask > 0
