"""Arrays for tests of stages: calibrations, random and plausible images."""

from pathlib import Path

import cv2
import numpy as np

from jaxdet import stages
from jaxdet.floor.plane import flat_plane
from jaxdet.types import (
    AlignedDepth,
    Calibration,
    Distortion,
    Extrinsics,
    Features,
    Frames,
    GroundPlane,
    Intrinsics,
)

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def rotation(x: float, y: float, z: float) -> tuple[float, ...]:
    """Return the rotation by angles about x, then y, then z [degrees], 9 numbers, row-major."""
    R = np.eye(3)
    for axis, degrees in enumerate((x, y, z)):
        vector = np.zeros(3)
        vector[axis] = np.radians(degrees)
        R = cv2.Rodrigues(vector)[0] @ R
    return tuple(R.ravel().tolist())


D435_DEPTH = Intrinsics(640, 480, 390.4315, 390.4315, 331.3879, 242.1873)
D435_COLOR = Intrinsics(640, 480, 613.2037, 613.4193, 319.9388, 239.183)
D435_MOTION = Extrinsics(rotation(0.0, 0.74, 0.59), (0.01431131, 0.00060231, 0.0006108))
D435 = Calibration(D435_DEPTH, D435_COLOR, D435_MOTION)


def resized(camera: Intrinsics, width: int, height: int) -> Intrinsics:
    """Return the camera with another image size."""
    sx, sy = width / camera.width, height / camera.height
    scaled = camera.fx * sx, camera.fy * sy, camera.cx * sx, camera.cy * sy
    return Intrinsics(width, height, *scaled, camera.distortion, camera.coefficients)


def small(width: int = 80, height: int = 60, color_scale: float = 1.0) -> Calibration:
    """Return a calibration like that of a D435, for small images."""
    color = resized(D435_COLOR, round(width * color_scale), round(height * color_scale))
    return Calibration(resized(D435_DEPTH, width, height), color, D435_MOTION)


LENSES = {
    "pinhole": (Distortion.NONE, ()),
    "plumb_bob": (Distortion.PLUMB_BOB, (0.1, -0.2, 0.001, 0.002, 0.05)),
    "rational": (Distortion.RATIONAL, (0.3, -0.2, 0.001, 0.002, 0.05, 0.2, -0.1, 0.02)),
    "equidistant": (Distortion.EQUIDISTANT, (0.1, -0.02, 0.01, 0.002)),
    "inverse": (Distortion.INVERSE_BROWN_CONRADY, (0.1, -0.2, 0.001, 0.002, 0.05)),
}


def with_lens(camera: Intrinsics, lens: str) -> Intrinsics:
    """Return the camera with one of ``LENSES``."""
    model, coefficients = LENSES[lens]
    return camera._replace(distortion=model, coefficients=coefficients)


def noise_depth(batch: int, camera: Intrinsics, seed: int = 0) -> np.ndarray:
    """Return random depth with 30 % holes, ``(B, Hd, Wd)`` uint16."""
    rng = np.random.default_rng(seed)
    depth = rng.integers(0, 8000, (batch, camera.height, camera.width)).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.3] = 0
    depth[:, 0, :5] = 65535, 1, 2, 65534, 0
    return depth


def smooth_depth(batch: int, camera: Intrinsics) -> np.ndarray:
    """Return depth of a slanted wall and a nearer box, ``(B, Hd, Wd)`` uint16."""
    v, u = np.mgrid[: camera.height, : camera.width]
    depth = np.stack([1000 + 3 * u + 2 * v + 50 * b for b in range(batch)]).astype(np.uint16)
    depth[:, camera.height // 3 : camera.height // 2, camera.width // 4 : camera.width // 2] = 700
    return depth


def blocks(batch: int, height: int, width: int, seed: int = 0) -> np.ndarray:
    """Return colour images of overlapping rectangles with noise, ``(B, H, W, 3)`` uint8."""
    rng = np.random.default_rng(seed)
    images = np.zeros((batch, height, width, 3), np.uint8)
    for image in images:
        image[:] = rng.integers(0, 256, 3)
        for _ in range(12):
            v, u = rng.integers(0, height), rng.integers(0, width)
            tall, wide = rng.integers(3, height // 2), rng.integers(3, width // 2)
            image[v : v + tall, u : u + wide] = rng.integers(0, 256, 3)
        image[:] = np.clip(image + rng.normal(0, 3, image.shape), 0, 255)
    return images


def level(batch: int, height: float = 0.4, pitch: float = 0.0, roll: float = 0.0) -> GroundPlane:
    """Return the same floor for each of ``batch`` frames."""
    full = [np.full(batch, value, np.float64) for value in (height, pitch, roll)]
    return flat_plane(*full)


def frames(calibration: Calibration, color: np.ndarray, depth: np.ndarray, **rest) -> Frames:
    """Return a batch without poses."""
    number = np.arange(len(depth), dtype=np.int64)
    valid = np.ones(len(depth), bool)
    return Frames(depth, calibration, number, number, valid, color, **rest)


def points(x, z, kept=None) -> Features:
    """Return features ``(B, N)`` at given x and z [depth units], in the row of the optical axis."""
    x, z = np.atleast_2d(np.asarray(x, np.int32)), np.atleast_2d(np.asarray(z, np.int32))
    valid = np.ones(z.shape, bool)
    kept = valid if kept is None else np.atleast_2d(np.asarray(kept, bool))
    u, overflow = np.broadcast_to(np.arange(z.shape[1], dtype=np.int32), z.shape), ~valid[:, 0]
    return Features(u.copy(), 0 * z, x, 0 * z, z, valid, kept, overflow)


def every_pixel(batch: int, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows ``(B, H W)`` int32 of all pixels, in raster order."""
    v, u = np.indices((height, width), np.int32).reshape(2, -1)
    return np.broadcast_to(u, (batch, u.size)), np.broadcast_to(v, (batch, v.size))


def align_all(depth: np.ndarray, calibration: Calibration) -> AlignedDepth:
    """Return aligned depth ``(B, H, W)`` of all pixels of the colour image, by the kernel."""
    shape = len(depth), calibration.image.height, calibration.image.width
    found = stages.paper.align(depth, *every_pixel(*shape), calibration)
    return AlignedDepth(*(np.asarray(a).reshape(shape) for a in found))


def at_every_pixel(z: np.ndarray) -> Features:
    """Return features at all pixels of images of z ``(B, H, W)``."""
    u, v = every_pixel(*z.shape)
    flat = z.reshape(len(z), -1).astype(np.int32)
    valid = np.ones(flat.shape, bool)
    return Features(u, v, 0 * flat, 0 * flat, flat, valid, valid, valid[:, 0])


def assert_equal(twin, reference) -> None:
    """Assert that arrays of two nested NamedTuples are equal, including dtype and shape."""
    for name, want, got in zip(reference._fields, reference, twin, strict=True):
        if hasattr(want, "_fields"):
            assert_equal(got, want)
            continue
        if want is None:
            assert got is None, name
            continue
        got = np.asarray(got)
        assert (got.dtype, got.shape) == (want.dtype, want.shape), name
        assert np.array_equal(got, want), f"{name}: {np.sum(got != want)} of {want.size} differ"


def recorded_colors(shared_data: Path) -> list[np.ndarray]:
    """Return some recorded colour images, RGB."""
    files = sorted((shared_data / "aims_slam/data/rgb").glob("*.png"))[::16]
    files += sorted((shared_data / "d435_boxes_felixchenfy/data/color").glob("*.png"))[::4]
    return [cv2.cvtColor(cv2.imread(str(file)), cv2.COLOR_BGR2RGB) for file in files]
