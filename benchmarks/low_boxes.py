"""Insert low boxes into real depth images, and count those that are found.

    python -m benchmarks.low_boxes FOLDER... [--only public.learn]

FOLDER has the recordings that scripts/rooms_to_mcap makes. Boxes of several sizes are placed on the
floor of each frame in which it is known, where nothing else is within 12 cm. They have the noise of
the pixels that they cover: the deviation of disparity (1 / z) from its mean in the vicinity. Pixels
without depth remain without. So floors, noise and holes are those of real cameras, while sizes and
places are known. Edges are as sharp as those of a perfect camera.
"""

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.free_rays import rays_of
from benchmarks.paper.labelled import Recording, find_recordings
from benchmarks.paper.realframes import Found, frames_with_floor
from jaxdet.camera import pixel_rays
from jaxdet.config import Config
from jaxdet.eval.boxes import MIN_IOU, box_iou
from jaxdet.floor.frame import CAMERA_HEIGHT, FRAME_BITS, floor_frames
from jaxdet.io import open_log
from jaxdet.pipeline import detect
from jaxdet.presets import preset
from jaxdet.results.metric import floors
from jaxdet.results.rows import to_host
from jaxdet.types import Frames, GroundPlane

HEIGHTS_M, WIDTHS_M = (0.06, 0.08, 0.10), (0.1, 0.2, 0.3)
FORWARD_M, RIGHT_M = (0.8, 1.2, 1.6, 2.0, 2.5, 3.0), (0.0, -0.25, 0.25, -0.5, 0.5)
"""Distances of a box, and its offsets to the right; the first one that fits is used."""
AROUND_M = 0.12
"""Width of the empty floor around a box."""
BEYOND_M = 0.15
"""A ray of free floor ends at a box if it ends at most this far behind its front."""
FEWEST = 30
"""Minimum number of pixels of a box."""
SMOOTH = 128
"""The mean of disparity is weighted by a Gaussian with a standard deviation of 1/SMOOTH of the
image's width."""


class Box(NamedTuple):
    """Box on the floor of a camera, as deep as it is wide [m]."""

    forward: float
    """Forward distance of its front."""
    right: float
    """Position of its middle."""
    width: float
    height: float


class Outcome(NamedTuple):
    """Result for one box."""

    box: Box
    found: bool
    """Whether the image box of an obstacle has an IoU of at least one half with that of the box."""
    ends: bool
    """Whether the free floor ends at the box."""


class FloorView(NamedTuple):
    """Pixels of a depth image relative to its floor, each ``(H, W)`` float64."""

    z: np.ndarray
    """Depth, 0 = none [m]."""
    right: np.ndarray
    """Components of the rays whose depth is 1."""
    forward: np.ndarray
    up: np.ndarray
    inverse: np.ndarray
    """Inverses of these components, ``(3, H, W)``; inf for 0."""
    camera_m: float
    """Height of the camera [m]."""

    @property
    def floor_z(self) -> np.ndarray:
        """Depth at which the rays meet the floor, inf or negative if they don't [m]."""
        return -self.camera_m * self.inverse[2]


def view_of(frames: Frames, plane: GroundPlane) -> FloorView:
    """Return the first frame relative to a floor without a ramp."""
    unit, camera = frames.calibration.depth_unit, frames.calibration.depth
    frame = floor_frames(plane, unit)[0]
    x, y = np.broadcast_arrays(*pixel_rays(camera))
    axes = frame[:9].reshape(3, 3) / (1 << FRAME_BITS)
    right, forward, down = np.tensordot(axes, np.stack([x, y, np.ones_like(x)]), axes=1)
    rays = right, forward, -down
    with np.errstate(divide="ignore"):
        inverse = 1 / np.stack(rays)
    height_m = float(frame[CAMERA_HEIGHT]) * unit
    return FloorView(frames.depth[0] * unit, *rays, inverse, height_m)


def insert(view: FloorView, box: Box) -> tuple[np.ndarray, np.ndarray] | None:
    """Insert a box.

    Returns:
        Depth with the box ``(H, W)`` [m], and the mask of its pixels; None if the box doesn't fit:
        it is at the border of the image, on an object or on unmeasured floor, or hidden.
    """
    low = np.array([box.right - box.width / 2, box.forward, 0.0])
    high = low + (box.width, box.width, box.height)
    near, far = np.full(view.z.shape, -np.inf), np.full(view.z.shape, np.inf)
    for inverse, start, *bounds in zip(view.inverse, (0, 0, view.camera_m), low, high, strict=True):
        one, other = ((bound - start) * inverse for bound in bounds)
        near, far = np.fmax(near, np.fmin(one, other)), np.fmin(far, np.fmax(one, other))
    hit, known = (near < far) & (near > 0), view.z > 0
    inner = hit[2:-2, 2:-2].sum()
    if inner < FEWEST or inner < hit.sum() or not (hit & known).any():
        return None
    z = view.floor_z
    with np.errstate(invalid="ignore"):
        aside, ahead = np.abs(z * view.right - box.right), z * view.forward - box.forward
    around = (z > 0) & np.isfinite(z) & (aside < box.width / 2 + AROUND_M)
    around &= (ahead > -AROUND_M) & (ahead < box.width + AROUND_M)
    seen = around & known
    if seen.sum() < max(FEWEST, 0.6 * around.sum()):
        return None
    height = view.camera_m + view.up[seen] * view.z[seen]
    objects = np.abs(height) > 0.03 + 0.006 * view.z[seen] ** 2
    hidden = view.z[hit & known] < near[hit & known] - 0.05
    if objects.mean() > 0.02 or hidden.mean() > 0.02:
        return None
    disparity = np.where(known, 1 / np.where(known, view.z, 1), 0)
    blur = partial(cv2.GaussianBlur, ksize=(0, 0), sigmaX=hit.shape[1] / SMOOTH)
    mean = blur(disparity) / np.maximum(blur(known.astype(np.float64)), 1e-6)
    noise = np.where(known, disparity - mean, 0)
    most = 3 * 1.48 * np.median(np.abs(noise[seen]))
    offset = np.median(disparity[seen] - 1 / z[seen])  # the box stands on the floor as measured
    own = 1 / np.where(hit, near, 1) + offset + np.clip(noise, -most, most)
    return np.where(hit & known, 1 / own, view.z), hit & known


def outcomes(frames: Frames, config: Config) -> Iterator[Outcome]:
    """Insert boxes into a frame, one at a time; yield the results."""
    scene, unit = _detect(frames, config).detections.scene, frames.calibration.depth_unit
    assert scene
    plane = floors(scene, unit).plane
    if not plane.valid[0] or np.isfinite(plane.ramp_start[0]) or not frames.calibration.is_aligned:
        return
    view = view_of(frames, plane)
    for forward, width, height in product(FORWARD_M, WIDTHS_M, HEIGHTS_M):
        boxes = (Box(forward, right, width, height) for right in RIGHT_M)
        made = next(((box, *new) for box in boxes if (new := insert(view, box))), None)
        if made is None:
            continue
        box, depth, mask = made
        image = np.clip(np.rint(depth / unit), 0, 65535).astype(np.uint16)
        yield _outcome(box, mask, _detect(frames._replace(depth=image[None]), config), unit)


def _detect(frames: Frames, config: Config) -> Found:
    return Found(frames, to_host(detect(frames, config, backend="reference")), config)


def _outcome(box: Box, mask: np.ndarray, found: Found, unit: float) -> Outcome:
    v, u = np.nonzero(mask)
    true, scene = np.array([[u.min(), v.min(), u.max(), v.max()]]), found.detections.scene
    assert scene
    end = scene.free[0, rays_of(box.right, box.forward), 1] * unit
    near = bool(end <= np.hypot(box.right, box.forward) + BEYOND_M)
    return Outcome(box, bool((box_iou(true, found.boxes) >= MIN_IOU).any()), near)


def judge(task: tuple[Recording, Path]) -> list[Outcome]:
    """Insert boxes into all frames of a recording; task of a worker."""
    recording, folder = task
    config = preset("wheeled")
    with open_log(str(folder / recording.place)) as log:
        every = frames_with_floor(log, config)
        return [one for batch in every for one in outcomes(batch.frames, config)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the share of boxes that are found, and of those at which the free floor ends."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.low_boxes")
    parser.add_argument("folders", nargs="+", type=Path, help="folders of recordings")
    parser.add_argument("--only", nargs="*", default=(), help="prefixes of recordings' names")
    options = parser.parse_args(arguments)
    tasks = [
        task
        for task in find_recordings(options.folders, options.only)
        if task[0].presets[0] == "wheeled"
    ]
    with ProcessPoolExecutor() as pool:
        parts = list(pool.map(judge, tasks))
    print(f"{sum(map(bool, parts))} recordings, {sum(map(len, parts))} boxes")
    every = [one for part in parts for one in part]
    print("height, distance [m]: number of boxes; found; free floor ends")
    for height, (first, last) in product((*HEIGHTS_M, None), ((0.8, 1.6), (2.0, 2.5), (3.0, 3.0))):
        own = [
            one
            for one in every
            if height in (None, one.box.height) and first <= one.box.forward <= last
        ]
        if own:
            found, ends = (100 * np.mean([getattr(o, n) for o in own]) for n in ("found", "ends"))
            name = "all " if height is None else f"{height:.2f}"
            print(f"{name}, {first:g} to {last:g}: {len(own)}; {found:.1f} %; {ends:.1f} %")


if __name__ == "__main__":
    main()
