"""Deviation of measured floors from their plane: a labelled recording, and the simulator.

    python -m benchmarks.real_floor                 simulated depth camera, without and with errors
    python -m benchmarks.real_floor LOG LABELS      also a log with one PNG per frame, 1 = floor

The parameters of ``DepthSensor.with_errors`` were compared with the labelled frames of a
wheelchair's D415 in SSLG (Wang et al., "Self-supervised drivable area and road anomaly segmentation
using RGB-D data for robotic wheelchairs", IEEE RA-L 4(4), 2019; its ``examples`` folder).
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

import jaxdet
from jaxdet.sim import floor_truth, sample_frames
from jaxdet.sim.config import calibration_of
from jaxdet.types import Intrinsics

RANGES_M = ((1.5, 2.0), (2.5, 3.0), (3.0, 4.0))
MARGIN = 0.11
"""Share of the width at each side that is excluded from the second result."""


class Spread(NamedTuple):
    """Deviation of a floor from the plane fitted to it."""

    no_depth: float
    """Share of the floor's pixels without depth."""
    deviation_m: tuple[float, ...]
    """Standard deviation of the heights in each of ``RANGES_M`` [m]; NaN without enough pixels."""
    above_step: float
    """Share of the measured pixels within 4 m that are more than 5 cm above the plane."""


def spread_of(z: np.ndarray, floor: np.ndarray, camera: Intrinsics) -> Spread:
    """Compute the deviation of a floor.

    Args:
        z: Measured depth ``(H, W)`` float [m], 0 = no measurement.
        floor: Mask of the pixels that show the floor, ``(H, W)`` bool.
        camera: Intrinsics of the camera.
    """
    v, u = np.nonzero(floor & (z > 0) & (z < RANGES_M[-1][1]))
    near = z[v, u]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))], 1)
    points = rays * near[:, None]
    height = _heights(points)
    bands = [height[(near > low) & (near <= high)] for low, high in RANGES_M]
    deviations = tuple(float(band.std()) if len(band) > 100 else np.nan for band in bands)
    return Spread(float((z[floor] == 0).mean()), deviations, float((height > 0.05).mean()))


def _heights(points: np.ndarray) -> np.ndarray:
    """Return the heights of points ``(n, 3)`` above the plane on which most of them lie."""
    kept = np.ones(len(points), bool)
    height = np.zeros(len(points))
    for _ in range(8):
        chosen = points[kept][::5]
        middle = chosen.mean(0)
        normal = np.linalg.svd(chosen - middle, full_matrices=False)[2][2]
        height = (middle - points) @ (normal * np.sign(normal[1]))
        kept = np.abs(height) < 3 * max(1.4826 * float(np.median(np.abs(height))), 0.005)
    return height


def simulated(depth_error: float, seeds: Sequence[int], width: int = 640) -> Iterator[list[Spread]]:
    """Yield results for simulated floors with the wheelchair's mount, with and without margins."""
    for seed in seeds:
        for family in ("corridor", "low_clutter", "wall_in_range", "mixed"):
            (frame,) = sample_frames(
                family, seed, 1, depth_error=depth_error, depth_form="aligned", width=width,
                height=width * 3 // 4, camera_height_m=0.52, camera_pitch_rad=0.15,
            )  # fmt: skip
            assert frame.aligned is not None
            # The labels of objects are 4 pixels of 1280 too large.
            drivable = floor_truth(frame).drivable.astype(np.uint8)
            floor = cv2.erode(drivable, np.ones((7, 7), np.uint8), borderValue=1) > 0
            camera = calibration_of(frame.config).image
            yield _both(frame.aligned * 0.001, floor, camera)


def recorded(log: str, labels: str) -> Iterator[list[Spread]]:
    """Yield results for a recording with depth aligned to colour, with and without margins."""
    files = sorted(Path(labels).glob("*.png"))
    with jaxdet.open_log(log) as source:
        camera, unit = source.calibration.depth, source.calibration.depth_unit
        for batch in source.batches(1):
            file = files[int(batch.frames.number[0])]
            label = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
            assert label is not None
            yield _both(np.asarray(batch.frames.depth[0]) * unit, label == 1, camera)


def _both(z: np.ndarray, floor: np.ndarray, camera: Intrinsics) -> list[Spread]:
    edge = round(MARGIN * z.shape[1])
    inner = floor.copy()
    inner[:, :edge] = inner[:, -edge:] = False
    return [spread_of(z, floor, camera), spread_of(z, inner, camera)]


def _print_row(name: str, every: list[list[Spread]]) -> None:
    for k, part in enumerate(("whole image", "without margins")):
        rows = [one[k] for one in every]
        values = [[r.no_depth * 100 for r in rows]]
        values += [[r.deviation_m[i] * 100 for r in rows] for i in range(len(RANGES_M))]
        values += [[r.above_step * 100 for r in rows]]
        cells = [" ".join(f"{x:5.1f}" for x in np.nanquantile(v, (0.1, 0.5, 0.9))) for v in values]
        print(f"{name:16} {part:16} {' | '.join(cells)}")


def main(args: list[str]) -> None:
    """Print the table: 10th, 50th and 90th percentile over the frames."""
    print("no depth [%] | height deviation [cm] at 1.5-2 m | 2.5-3 m | 3-4 m | above step [%]")
    if args:
        _print_row("recorded", list(recorded(*args)))
    for error in (0.0, 1.0, 2.0):
        _print_row(f"depth_error {error:g}", list(simulated(error, range(6))))


if __name__ == "__main__":
    main(sys.argv[1:])
