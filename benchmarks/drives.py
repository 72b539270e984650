"""Simulated drives of a robot through furnished rooms, for the benchmarks of maps.

The depth is a D435's on real floors, half of which are wet, polished or coated, and mirror.
"""

from dataclasses import replace
from pathlib import Path as File
from typing import Any

import numpy as np

from jaxdet.sim import Scene, SimConfig, truth_path, write_log, write_scene
from jaxdet.sim.apart import apart
from jaxdet.sim.appearance import (
    CARPET,
    EPOXY,
    LINOLEUM,
    MOSAIC,
    POLISHED,
    SCREED,
    STEEL,
    TILES,
    WET,
    WOOD,
    pick,
)
from jaxdet.sim.draft import Draft, inner_wall, room
from jaxdet.sim.scene import Box, Path

FLOORS = (WET, TILES, EPOXY, CARPET, POLISHED, WOOD, WET, SCREED, LINOLEUM, MOSAIC)
"""Floors by the last digit of the seed."""
THINGS = ("box", "box", "bin", "bucket", "chair", "cone", "pole", "brick")
ADDED = "added"
"""Name of objects that are added after the room is mapped."""
WEAVE_M, CLEAR_M = 0.25, 0.5
"""Amplitude of the robot's path, and minimum distance of objects from it [m]."""
THING_M = 0.3
"""Radius reserved for each object [m]."""
RATE_HZ = 3.0


def drive_scene(seed: int) -> Scene:
    """Create a room with furniture along its walls, and objects on both sides of a robot's path.

    Half of the objects are :data:`ADDED`.
    """
    draft = Draft(seed, "drive")
    rng = draft.rng
    left, right, front = rng.uniform((1.7, 1.7, 5.0), (3.0, 3.0, 8.0)).tolist()
    walls = room(inner_wall(rng), left, right, front)
    path = Path(length=front - 2.6, speed=0.5, weave=WEAVE_M, weave_length=2.4)
    for side, distance in ((-1, right), (1, left)):
        for x in np.arange(0.8, front - 1.0, 2.0).tolist():
            if rng.random() < 0.6:
                _put_by_wall(draft, x + float(rng.uniform(0, 0.6)), side, distance)
    for k in range(int(rng.integers(5, 9))):
        _put_thing(draft, (left, right, front), path, ADDED if k % 2 else "")
    scene = draft.enclosed("drive", walls, FLOORS[seed % len(FLOORS)])
    return apart(replace(scene, path=path), seed)


def _put_by_wall(draft: Draft, x: float, side: int, distance: float) -> None:
    """Place a cabinet or a sofa with its back to the left (1) or the right (-1) wall."""
    rng, yaw, face = draft.rng, -side * np.pi / 2, distance - 0.05
    if rng.random() < 0.3:
        draft.put("sofa", x, side * (face - 0.5), yaw)
        draft.taken.append((x, side * (face - 0.5), 0.9))
        return
    deep, wide, tall = rng.uniform((0.35, 0.6, 0.5), (0.55, 1.4, 1.9)).tolist()
    place = x, side * (face - deep / 2)
    draft.boxes.append(Box(place, (deep, wide, tall), yaw, pick(rng, WOOD, STEEL), name="cabinet"))
    draft.taken.append((*place, wide / 2))


def _put_thing(draft: Draft, size: tuple[float, float, float], path: Path, name: str) -> None:
    """Place an object next to the path or beyond its end, if there is space for one."""
    rng, (left, right, front) = draft.rng, size
    for _ in range(100):
        x, y = rng.uniform((0.8, 0.5 - right), (front - 0.5, left - 0.5)).tolist()
        on_path = x < path.length + 1.0 and abs(y) < WEAVE_M + CLEAR_M + THING_M
        near = (np.hypot(x - a, y - b) < THING_M + 0.15 + r for a, b, r in draft.taken)
        if on_path or any(near):
            continue
        draft.taken.append((x, y, THING_M))
        draft.add_object(str(rng.choice(THINGS)), x, y)
        kinds: list[list[Any]] = [draft.boxes, draft.cylinders, draft.models]
        for kind in kinds:
            if kind and kind[-1].center == (x, y) and name:
                kind[-1] = replace(kind[-1], name=name)
        return


def write_drive(folder: File, seed: int, frames: int, width: int) -> File:
    """Return the path of the log of a drive; simulate it if it does not exist.

    Args:
        folder: Folder of the log, its truth and its scene.
        seed: Seed of the scene and of the depth's errors.
        frames: Number of frames.
        width: Width of the images; their height is three quarters of it [pixel].
    """
    folder.mkdir(parents=True, exist_ok=True)
    log, scene = folder / f"drive{seed}.mcap", folder / f"drive{seed}.toml"
    if not truth_path(log).exists():
        write_scene(drive_scene(seed), scene)
        size = width, width * 3 // 4
        config = SimConfig(str(scene), frames, seed, RATE_HZ, *size, camera_height_m=0.4)
        write_log(log, replace(config, depth_error=1.0))
    return log
