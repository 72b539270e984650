"""Print a digest of the results of each group of functions on the same numbers, one per line.

``tests/test_machines.py`` runs it in several environments. Numbers are made from integers by exact
operations, so they are the same on every machine.
"""

import hashlib
import sys
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from jaxdet.camera import cell_rays, corner_rays, fixed_rays, splat_parameters
from jaxdet.config import FootprintConfig
from jaxdet.floor.plane import (
    band_table,
    direction_table,
    flat_plane,
    ground_axes,
    plane_from_transform,
    plane_in_color,
    quadratic_table,
)
from jaxdet.floor.sampled import sampled_floor
from jaxdet.floor.units import SINES, floor_fit
from jaxdet.io.message_fields import motion
from jaxdet.io.motion import (
    MotionSamples,
    difference,
    interpolate,
    inverse,
    motion_matrix,
    quaternions,
)
from jaxdet.io.poses import PoseSource
from jaxdet.io.transforms import TransformTree
from jaxdet.results.free_floor import free_floor
from jaxdet.results.metric import extents, rectangles, tilted, to_world
from jaxdet.results.occupancy import OccupancyMap
from jaxdet.tracks.config import TrackConfig
from jaxdet.tracks.observations import observations_of
from jaxdet.tracks.tracker import Tracker
from jaxdet.types import RAYS, Calibration, Distortion, Extrinsics, Intrinsics, Obstacles

RNG = np.random.default_rng(11)
UNIT = 0.001


def numbers(*shape: int) -> np.ndarray:
    """Return random numbers from -1 to 1 with 52 bits."""
    return RNG.integers(-(1 << 52), 1 << 52, shape) / (1 << 52)


def unit_quaternions(count: int) -> np.ndarray:
    """Return random rotations, some nearly equal to the previous one."""
    q = numbers(count, 4)
    q[1::3] = q[::3][: len(q[1::3])] + numbers(len(q[1::3]), 4) / 1e4
    x, y, z, w = q.T
    return q / np.sqrt(x * x + y * y + z * z + w * w)[:, None]


def poses(count: int) -> np.ndarray:
    """Return random poses of cameras in the world."""
    return motion_matrix(numbers(count, 3) * 9, unit_quaternions(count))


def motions() -> Iterator[object]:
    """Yield results for poses and transforms of logs."""
    count = 300
    stamps = np.cumsum(RNG.integers(1, 90_000_000, count))
    samples = np.hstack([numbers(count, 3) * 9, unit_quaternions(count)])
    wanted = np.sort(RNG.integers(stamps[0], stamps[-1], 500))
    yield interpolate(wanted, stamps, samples)
    T = poses(count)
    yield from (inverse(T), quaternions(T[:, :3, :3]), [difference(a, b) for a, b in pairwise(T)])
    tree, odometry = TransformTree(), MotionSamples()
    for parent, child in (("world", "odom"), ("base", "mast"), ("mast", "camera")):
        tree.add([motion(0, parent, child, numbers(3), unit_quaternions(1)[0])], static=True)
    for stamp, sample in zip(stamps.tolist(), samples, strict=True):
        message = motion(stamp, "odom", "base", sample[:3], sample[3:])
        tree.add([message], static=False)
        odometry.add(stamp, message.translation, message.rotation)
    tree.settle()
    yield from (tree.fixed("base", "camera"), tree.at("world", "camera", wanted))
    source = PoseSource("", camera="camera", topic="odom", T_child_camera=T[0])
    yield source.at(wanted, tree, {"odom": odometry})


def planes() -> Iterator[object]:
    """Yield floors, their axes and integer tables."""
    yield from (SINES, direction_table(), quadratic_table(0.02, 0.003, UNIT))
    yield band_table(FootprintConfig(), UNIT)
    angles = numbers(2, 400)
    plane = flat_plane(1 + numbers(400), angles[0] * 1.5, angles[1] * 3)
    yield from (ground_axes(plane), sampled_floor(plane, np.ones(400, bool)))
    yield [plane_from_transform(T) for T in poses(50)]
    yield plane_in_color(plane, calibration(Distortion.NONE, ()))
    found = RNG.integers(-2000, 2000, (400, 8)).astype(np.int32)
    found[:, 7] = 0
    yield floor_fit(found, plane, UNIT)


def calibration(model: Distortion, coefficients: tuple[float, ...]) -> Calibration:
    """Return a depth camera with a lens and a rotated colour camera."""
    depth = Intrinsics(80, 60, 61.3, 60.9, 40.2, 29.4, model, coefficients)
    color = Intrinsics(96, 72, 78.1, 78.4, 47.1, 35.8, model, coefficients)
    T = motion_matrix(np.array([0.05, 0.001, -0.002]), np.array([0.01, -0.02, 0.005, 1.0]))
    shift = tuple(T[:3, 3].tolist())
    between = Extrinsics(tuple(T[:3, :3].ravel().tolist()), shift)
    return Calibration(depth=depth, depth_unit=UNIT, color=color, color_from_depth=between)


def lenses() -> Iterator[object]:
    """Yield rays of all lens models."""
    brown = (0.11, -0.23, 0.0007, -0.0004, 0.09)
    models = {
        Distortion.PLUMB_BOB: brown,
        Distortion.RATIONAL: (*brown, 0.02, -0.01, 0.003),
        Distortion.EQUIDISTANT: (0.03, -0.01, 0.004, -0.001),
        Distortion.INVERSE_BROWN_CONRADY: brown,
    }
    for model, coefficients in models.items():
        cameras = calibration(model, coefficients)
        yield from (fixed_rays(cameras.depth), cell_rays(cameras.depth, 3))
        yield from (corner_rays(cameras.depth), splat_parameters(cameras)[:6])


def outlines() -> Iterator[object]:
    """Yield obstacles in metres, in the world and on the map, and the free floor."""
    frames, slots = 40, 9

    def integers(*shape: int, low: int = -3000, high: int = 3000) -> np.ndarray:
        return RNG.integers(low, high, (frames, slots, *shape)).astype(np.int32)

    obstacles = Obstacles(
        num_points=integers(low=1, high=500),
        uv_min=integers(2),
        uv_max=integers(2),
        xyz_min=integers(3),
        xyz_max=integers(3),
        xyz_sum=integers(3, 2),
        has_vertex=integers(low=0, high=2).astype(bool),
        a=integers(2),
        b=integers(2),
        c=integers(2),
        direction=np.zeros((frames, slots, 2), np.int32),
        span=integers(4),
    )
    yield extents(obstacles, UNIT)
    world = poses(frames)
    turned = obstacles._replace(direction=integers(2, low=1, high=512))
    grid = OccupancyMap()
    for part in (obstacles, turned):
        corners = rectangles(part, UNIT, FootprintConfig())
        found = to_world(corners, world)
        yield from (corners, found)
        grid.add(found.reshape(-1, 8))
    yield tilted(quaternions(world[:, :3, :3]), numbers(frames), numbers(frames))
    ranges = np.sort(RNG.integers(-2000, 4000, (frames, RAYS, 2)).clip(0), axis=2)
    free = free_floor(ranges.astype(np.int32), RNG.integers(0, 3, (frames, RAYS)), UNIT)
    yield from free
    areas = free.in_world(world)
    yield from areas
    grid.add_free(areas)
    image = grid.image()
    assert image is not None
    yield from (image.counts, image.free, image.origin)


def tracks() -> Iterator[object]:
    """Yield tracks of boxes that move, rotate and are partly hidden."""
    tracker, frames, boxes = Tracker(TrackConfig()), 120, 12
    place, way = numbers(boxes, 2) * 6, numbers(boxes, 2) * 0.06
    half = 0.3 + numbers(boxes, 2) / 5
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for start in range(0, frames, 40):
        frame = np.repeat(np.arange(start, start + 40), boxes)
        box = np.tile(np.arange(boxes), 40)
        ground = place[box] + way[box] * frame[:, None] + numbers(len(frame), 2) / 50
        turn = motion_matrix(np.zeros((len(frame), 3)), unit_quaternions(len(frame)))[:, :2, :2]
        sides = (half[box] + numbers(len(frame), 2) / 40)[:, None] * corner
        corners = (ground[:, None] + sides).reshape(-1, 8)
        skewed = np.stack([sides[..., 0] + turn[:, :1, 0] / 50, sides[..., 1]], axis=-1)
        u = RNG.integers(0, 600, len(frame)).astype(np.float64)
        columns = {
            "corners_ground": corners.astype(np.float32),
            "corners_world": (ground[:, None] + skewed).reshape(-1, 8),
            "bottom_m": numbers(len(frame)).astype(np.float32),
            "top_m": 1 + numbers(len(frame)).astype(np.float32),
            "distance_m": (3 + 2 * numbers(len(frame))).astype(np.float32),
            "z_min": np.full(len(frame), 2.5, np.float32),
            "u_min": u,
            "u_max": u + 39,
            "x_min": numbers(len(frame)).astype(np.float32) - 1,
            "x_max": numbers(len(frame)).astype(np.float32) + 1,
        }
        stamps = frame * 33_333_333
        roll = numbers(len(frame)) * 3
        seen = observations_of(frame, stamps, roll, columns, 640)
        numbered = np.arange(start, start + 40)
        tracker.add(numbered, numbered * 33_333_333, seen, RNG.integers(1, 99, len(frame)))
    tracker.finish()
    found, links = tracker.take()
    assert len(found) > 3
    assert any(track.moving for track in found)
    yield from (found, links)


def digest(part: object) -> str:
    """Return a digest of nested arrays and numbers."""
    if isinstance(part, (tuple, list)):
        text = " ".join(map(digest, part)).encode()
    else:
        array = np.asarray(part)
        text = str(array).encode() if array.dtype.hasobject else array.tobytes()
    return hashlib.sha256(text).hexdigest()


def main() -> None:
    """Print a line for each group of functions; with ``--parts``, for each of its parts."""
    for group in (motions, planes, lenses, outlines, tracks):
        parts = [digest(part) for part in group()]
        if "--parts" in sys.argv:
            print(*(f"{group.__name__} {i} {part[:16]}" for i, part in enumerate(parts)), sep="\n")
        else:
            print(group.__name__, digest(parts))


if __name__ == "__main__":
    main()
