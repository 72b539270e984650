"""Independent single frames for experiments, in memory."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from jaxdet.errors import ConfigError
from jaxdet.sim.config import SimConfig
from jaxdet.sim.exposure import LightName
from jaxdet.sim.families import FAMILIES
from jaxdet.sim.frames import SimFrame, simulate_frame
from jaxdet.sim.scenes import SCENES, scene_of


def sample_frames(
    family: str,
    seed: int,
    count: int,
    *,
    light: LightName = "normal",
    base: SimConfig | None = None,
    **changes: Any,
) -> Iterator[SimFrame]:
    """Draw scenes of a family and render a frame of each.

    Args:
        family: One of ``FAMILIES`` (or a fixed scene).
        seed: Random seed; the scene of frame ``i`` depends only on the seed and ``i``, not on light
            or camera tilt, so that these can be compared on the same scenes.
        count: Number of frames.
        light: Illumination.
        base: Other parameters; None: the defaults of :class:`SimConfig`.
        **changes: Changed fields of ``base``, for instance ``camera_pitch_rad``,
            ``camera_roll_rad``, ``slope_rad``, ``distance_m``, ``width``, ``depth_form``.

    Yields:
        Frames with their scene and ground truth; ``frame.number`` counts from 0, and
        :func:`jaxdet.sim.frame_truth` returns extents and footprints.

    Raises:
        ConfigError: The family is unknown, or a value is out of range.
    """
    if family not in (*FAMILIES, *SCENES):
        raise ConfigError(f"unknown family {family!r}", remedy=f"use {', '.join(FAMILIES)}")
    start = replace(base or SimConfig(), scene=family, light=light, **changes)
    for index in range(count):
        drawn = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
        config = replace(start, seed=drawn, start_ns=start.start_ns + index * 10**9)
        yield simulate_frame(config, scene_of(config), 0)._replace(number=index)
