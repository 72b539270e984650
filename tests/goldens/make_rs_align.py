"""Make ``rs_align.npz``: small depth images aligned by librealsense.

Run with pyrealsense2 installed, in the project's root:

    python -m tests.goldens.make_rs_align
"""

from pathlib import Path

import numpy as np

from jaxdet.types import Calibration, Extrinsics
from tests.scenes import (
    D435_MOTION,
    noise_depth,
    resized,
    rotation,
    small,
    smooth_depth,
    with_lens,
)

TURNED = Extrinsics(rotation(3, -5, 8), (-0.03, 0.01, 0.02))
BASE = small()
CASES: dict[str, tuple[Calibration, np.ndarray]] = {
    "noise": (BASE, noise_depth(1, BASE.depth)[0]),
    "smooth": (BASE, smooth_depth(1, BASE.depth)[0]),
    "turned": (BASE._replace(color_from_depth=TURNED), noise_depth(1, BASE.depth, 1)[0]),
    "fine_color": (small(color_scale=2.5), smooth_depth(1, BASE.depth)[0]),
    "coarse_color": (
        Calibration(BASE.depth, resized(BASE.depth, 40, 30), D435_MOTION),
        smooth_depth(1, BASE.depth)[0],
    ),
    "depth_lens": (
        BASE._replace(depth=with_lens(BASE.depth, "inverse")),
        noise_depth(1, BASE.depth, 2)[0],
    ),
    "color_lens": (
        BASE._replace(color=with_lens(BASE.color, "inverse")),
        noise_depth(1, BASE.depth, 3)[0],
    ),
}
"""Calibration and depth image of each case, by name."""

FILE = Path(__file__).with_name("rs_align.npz")

if __name__ == "__main__":
    from tests.oracles import realsense

    outputs = {name: realsense.align(depth, case) for name, (case, depth) in CASES.items()}
    np.savez_compressed(FILE, **outputs)
    print({name: int(np.count_nonzero(output)) for name, output in outputs.items()})
