"""``python -m benchmarks maps``: maps of simulated drives against the ground truth.

Counts phantoms on the map before and after ``jaxdet track``, real objects lost from the map, and
obstacles matched with a lidar map of the room made before objects were added.

A phantom is a group of adjacent occupied cells inside the room that are all far from real objects.
An object is lost if it has occupied cells only on the map before ``jaxdet track``.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.drives import ADDED, write_drive
from jaxdet.engine import run
from jaxdet.export.grid import last_grid
from jaxdet.io import find_logs
from jaxdet.results.map_file import FREE, OCCUPIED, UNKNOWN, Grid
from jaxdet.results.occupancy import CELL_M, SHIFT, UNITS
from jaxdet.results.reading import ResultLog, Results
from jaxdet.sim import Truth, load_truth
from jaxdet.tracks import TrackConfig, track_results
from jaxdet.tracks.sightings import FRAME_COLUMNS, OBSTACLE_COLUMNS, contours, poses

NEAR_M = 0.25
"""Minimum distance of the cells of a phantom from real objects [m]."""
LIDAR_M, LIDAR_HEIGHT_M, LIDAR_NOISE_M = 12.0, 0.2, 0.02
"""Range, height and noise of the simulated lidar [m]."""
BEAMS = 1440
AT_M, AT_PER_M = 0.15, 0.02
"""Maximum distance of the points of a contour from their object [m], and its growth with the square
of the obstacle's distance [1/m]."""
PURE = 0.8
"""Minimum share of the points of an obstacle that belong to one object."""


@dataclass(frozen=True)
class Options:
    """Score maps of simulated drives."""

    seeds: tuple[int, int] = (200, 220)
    """First seed, and the one after the last."""
    frames: int = 40
    """Frames of each drive."""
    width: int = 640
    """Width of the images [pixel]."""
    most_floor: float = TrackConfig.most_floor
    folder: Path = Path("out/maps")
    """Folder of logs and results; existing ones are reused."""


class Score(NamedTuple):
    """Counts of one drive, or the sums of several."""

    phantoms: int
    """Number of phantoms on the map of all obstacles, before ``jaxdet track``."""
    left: int
    """Number of phantoms on the map after ``jaxdet track``."""
    things: int
    """Number of real objects on the map before ``jaxdet track``."""
    lost: int
    added: int
    """Number of obstacles of added objects."""
    new: int
    """Number of obstacles of added objects that are reported as not in the known map."""
    added_things: int
    """Number of added objects with obstacles."""
    new_things: int
    """Number of added objects most of whose obstacles are reported as not in the known map."""
    mapped: int
    """Number of obstacles of objects in the known map."""
    in_map: int
    mapped_things: int
    in_map_things: int


_TITLES = "phantoms before, after   things lost   added new, things   mapped in_map, things"


def main(options: Options) -> int:
    """Run the benchmark; return the exit code."""
    seeds = range(*options.seeds)
    logs = [write_drive(options.folder, s, options.frames, options.width) for s in seeds]
    results = options.folder / f"results{seeds[0]}-{seeds[-1]}"
    if not (results / "run.json").exists():
        run(find_logs([str(log) for log in logs]), results, "wheeled", pictures=0)
    print(f"seed   {_TITLES}")
    total = np.zeros(len(Score._fields), np.int64)
    for log in logs:
        score = score_drive(results / log.stem, log, options.most_floor)
        print(_line(log.stem.removeprefix("drive"), score), flush=True)
        total += score
    print(_line("all", Score(*total.tolist())))
    return 0


def _line(name: str, s: Score) -> str:
    shares = [
        f"{part}/{all_}" + (f" {part / all_:.1%}" if all_ else "")
        for part, all_ in (
            (s.new, s.added),
            (s.new_things, s.added_things),
            (s.in_map, s.mapped),
            (s.in_map_things, s.mapped_things),
        )
    ]
    return f"{name:<6} {s.phantoms:>3} {s.left:>3}   {s.things:>3} {s.lost:>2}   " + "   ".join(
        shares
    )


class _Untracked(Results):
    """Results without their tracks."""

    def tracked(self, log: ResultLog) -> bool:
        return False


def score_drive(folder: Path, log: Path, most_floor: float) -> Score:
    """Score the results of a drive; tracks in the folder are replaced."""
    room, grids = Room(load_truth(log)), []
    track_results(folder, TrackConfig(most_floor=most_floor), known=room.lidar_map())
    for kind in (_Untracked, Results):
        with kind(folder) as results:
            grids.append(last_grid(results, results.logs[0]))
    with Results(folder) as results:
        of, in_map = _obstacles(results, results.logs[0], room)
    phantoms, left = (room.phantoms(grid) for grid in grids)
    shown, kept = (room.things_on(grid) for grid in grids)
    figures = [phantoms, left, shown.sum(), (shown & ~kept).sum()]
    for things, wanted in ((room.is_added, False), (room.is_mapped, True)):
        chosen = (of >= 0) & things[of]
        right = chosen & (in_map == wanted)
        each, good = (np.bincount(of[rows], minlength=len(things)) for rows in (chosen, right))
        figures += [chosen.sum(), right.sum(), (each > 0).sum(), (2 * good > each).sum()]
    return Score(*map(int, figures))


def _obstacles(results: Results, log: ResultLog, room: "Room") -> tuple[np.ndarray, np.ndarray]:
    """Return the object of each obstacle (-1 = none or several), and whether it is in the map."""
    of, in_map = [], []
    for chunk in results.chunks(log, FRAME_COLUMNS, (*OBSTACLE_COLUMNS, "in_map")):
        lines = contours(chunk, poses(chunk.frames))
        points = np.split(lines.points, np.cumsum(lines.lengths)[:-1])
        distance = chunk.obstacles["distance_m"].to_numpy()
        of += [room.thing_of(p, d) for p, d in zip(points, distance, strict=True)]
        in_map += chunk.obstacles["in_map"].to_pylist()
    return np.array(of), np.array(in_map, bool)


class Room:
    """Objects of a drive, rasterised into cells of the world."""

    def __init__(self, truth: Truth) -> None:
        rings = [
            ring[~np.isnan(ring[:, 0])].astype(np.float64) for ring in truth.footprint_world[0]
        ]
        self.low = np.floor(np.concatenate(rings).min(axis=0) / CELL_M) - 20
        size = np.ceil(np.concatenate(rings).max(axis=0) / CELL_M) + 20 - self.low
        masks = [np.zeros(size[::-1].astype(int), np.uint8) for _ in rings]
        for mask, ring in zip(masks, rings, strict=True):
            cells = np.rint((ring / CELL_M - self.low - 0.5) * UNITS).astype(np.int32)
            cv2.fillPoly(mask, [cells], (1,), cv2.LINE_8, SHIFT)
        self.masks = np.stack(masks)
        self.away = np.stack([self._distance(mask) for mask in masks])
        """Distance from each object, ``(J, H, W)`` [m]."""
        low = (truth.height_m[0] < LIDAR_HEIGHT_M) & ~truth.is_wall
        self.is_added = truth.names == ADDED
        self.is_mapped = ~self.is_added & ~low
        self.path = truth.T_world_camera[:, :2, 3]
        wall = np.concatenate(
            [r for r, is_wall in zip(rings, truth.is_wall, strict=True) if is_wall]
        )
        self.inside = np.array([wall.min(axis=0), wall.max(axis=0)])

    @staticmethod
    def _distance(mask: np.ndarray) -> np.ndarray:
        return cv2.distanceTransform(1 - mask, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * CELL_M

    def cells(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return rows and columns of points ``(..., 2)``, clipped."""
        cell = (np.floor(points / CELL_M) - self.low).astype(np.int64)
        limit = np.array(self.masks.shape[:0:-1]) - 1
        cell = np.clip(cell, 0, limit)
        return cell[..., 1], cell[..., 0]

    def thing_of(self, points: np.ndarray, distance_m: float) -> int:
        """Return the object to which nearly all points of a contour belong; -1 if there is none."""
        row, column = self.cells(points)
        away = self.away[:, row, column]
        near = away.argmin(axis=0)[away.min(axis=0) <= AT_M + AT_PER_M * distance_m**2]
        count = np.bincount(near, minlength=len(away))
        return int(count.argmax()) if count.max() >= PURE * len(points) else -1

    def _occupied(self, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        """Return the mask of occupied cells of a grid, and the centres of all, ``(h, w, 2)``."""
        rows, columns = grid.states.shape
        at = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5
        return grid.states == OCCUPIED, grid.world(at)

    def phantoms(self, grid: Grid) -> int:
        """Return the number of phantoms on a map."""
        occupied, at = self._occupied(grid)
        real = self.away.min(axis=0)[self.cells(at)] <= NEAR_M
        real |= ((at < self.inside[0]) | (at > self.inside[1])).any(axis=-1)
        count, group = cv2.connectedComponents(occupied.astype(np.uint8), connectivity=8)
        return count - 1 - len(np.unique(group[occupied & real]))

    def things_on(self, grid: Grid) -> np.ndarray:
        """Return whether each object has occupied cells at most 10 cm away, ``(J,)`` bool."""
        occupied, at = self._occupied(grid)
        row, column = self.cells(at[occupied])
        return np.any(self.away[:, row, column] <= 0.1, axis=1)

    def lidar_map(self) -> Grid:
        """Simulate the map of a lidar on the robot's path, made before objects were added."""
        things = self.masks[self.is_mapped].max(axis=0)
        rng = np.random.default_rng(len(self.path))
        states = np.full(things.shape, UNKNOWN, np.int8)
        angle = 2 * np.pi * np.arange(BEAMS) / BEAMS
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        steps = np.arange(0, LIDAR_M, CELL_M / 2)
        hits = []
        for place in self.path[::4]:
            row, column = self.cells(place + steps[:, None, None] * way)
            hit = things[row, column] > 0
            first = np.where(hit.any(axis=0), hit.argmax(axis=0), len(steps))
            before = np.arange(len(steps))[:, None] < first
            states[row[before], column[before]] = FREE
            beams = first < len(steps)
            length = steps[first[beams]] + rng.normal(0, LIDAR_NOISE_M, beams.sum())
            hits.append(place + length[:, None] * way[beams])
        states[self.cells(np.concatenate(hits))] = OCCUPIED
        x, y = (self.low * CELL_M).tolist()
        return Grid(states, (x, y), CELL_M)
