"""Single independent frames for experiments, in memory."""

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
    """Draw scenes of a family and look at each once.

    Args:
        family: One of ``FAMILIES`` (or a fixed scene).
        seed: Draws scenes and noise; frame ``i`` depends on the seed and ``i`` alone, and on
            neither the light nor the camera's tilt, so levels can be compared on the same scenes.
        count: Number of frames.
        light: How bright it is.
        base: What else differs from :class:`SimConfig`.
        **changes: Fields of it, as ``camera_pitch_rad``, ``camera_roll_rad``, ``slope_rad``,
            ``distance_m``, ``width``, ``depth_form``.

    Yields:
        Frames with their scene and truth; ``frame.number`` counts from 0, and
        :func:`jaxdet.sim.frame_truth` gives extents and footprints.

    Raises:
        ConfigError: The family is not known, or a value is out of its range.
    """
    if family not in (*FAMILIES, *SCENES):
        raise ConfigError(f"no family {family!r}", remedy=f"use {', '.join(FAMILIES)}")
    start = replace(base or SimConfig(), scene=family, light=light, **changes)
    for index in range(count):
        drawn = int(np.random.SeedSequence([seed, index]).generate_state(1)[0])
        config = replace(start, seed=drawn, start_ns=start.start_ns + index * 10**9)
        yield simulate_frame(config, scene_of(config), 0)._replace(number=index)
