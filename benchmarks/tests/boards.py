"""Preprocessed frame of three boards and its truth, for tests of the baselines."""

import numpy as np

from benchmarks.baselines import Frame
from jaxdet.config import Config
from jaxdet.eval import FrameTruth
from jaxdet.floor.plane import flat_plane
from jaxdet.types import Calibration, Features, Intrinsics

CAMERA = Intrinsics(160, 120, 120.0, 120.0, 79.5, 59.5)
CALIBRATION = Calibration(CAMERA)
LEVEL = flat_plane(np.array([1.0]), np.zeros(1), np.zeros(1))
CONFIG = Config()
BOXES = [(10, 40, 1200), (80, 110, 1600), (125, 150, 2600)]
"""First and last columns and depth [mm] of the three boards, which are in rows 20 to 80."""


def board_picture():
    depth = np.full((120, 160), 6000, np.uint16)
    ids = np.zeros((120, 160), np.uint8)
    for number, (left, right, z) in enumerate(BOXES, 1):
        depth[20:80, left:right], ids[20:80, left:right] = z, number
    return depth, ids


def board_frame():
    """Return a frame of the boards with a feature every 6 pixels and 2 mm of noise."""
    depth, ids = board_picture()
    rng = np.random.default_rng(0)
    depth = np.where(ids > 0, depth + rng.integers(-2, 3, depth.shape), depth).astype(np.uint16)
    v, u = np.argwhere(ids[::6, ::6] > 0).T[:, None] * 6
    z = depth[v, u].astype(np.int32)
    x, y = (np.rint(a * z / 120).astype(np.int32) for a in (u - 79.5, v - 59.5))
    yes = np.ones(z.shape, bool)
    features = Features(
        u.astype(np.int32), v.astype(np.int32), x, y, z, yes, yes, np.zeros(1, bool)
    )
    keep = (depth < 4000) & (depth > 0)
    return Frame(np.zeros((120, 160, 3), np.uint8), depth, keep, features, LEVEL, CALIBRATION)


def board_truth():
    _, ids = board_picture()
    z = np.array([[b[2] / 1000 for b in BOXES]])
    pixels = np.array([[(ids == i).sum() for i in (1, 2, 3)]])
    return FrameTruth(ids[None], pixels, z, z, np.zeros(3, bool))


def same_partition(a, b):
    """Return whether two clusterings consist of the same clusters."""
    pairs = np.unique(np.stack([a, b]), axis=1).shape[1]
    return pairs == len(np.unique(a)) == len(np.unique(b))
