"""Presets: named configurations for robots and cameras."""

from dataclasses import replace
from typing import Any

from jaxdet.config import (
    ClusterConfig,
    Config,
    FeaturesConfig,
    FloorConfig,
    FootprintConfig,
    GroundConfig,
    ObstacleConfig,
    SurfaceConfig,
)
from jaxdet.config_changes import with_changes
from jaxdet.errors import ConfigError, meant

DEFAULT_PRESET = "wheeled"


def _with(**ground: Any) -> Config:
    return Config(ground=replace(GroundConfig(), **ground))


PRESETS: dict[str, Config] = {
    "wheeled": Config(),
    "tabletop": Config(
        ground=GroundConfig(max_depth_m=2.0, step_height_m=0.008, step_height_per_m=0.016),
        floor=FloorConfig(max_depth_m=1.5),
        footprint=FootprintConfig(margin_m=0.005, margin_per_m2=0.0),
        surface=SurfaceConfig(
            step_m=0.008,
            step_per_m=0.005,
            crease_m=0.002,
            crease_per_m=0.002,
            crease_margin=0,
            bent_m=0.02,
            beyond=1.0,
        ),
        obstacle=ObstacleConfig(
            affinity="tabletop",
            lateral_gap_m=0.5,
            forward_gap_m=0.3,
            depth_gap_m=0.02,
            contact_m=0.03,
            min_size_m=0.025,
            min_cells=12,
        ),
    ),
    "paper": Config(
        ground=GroundConfig(max_depth_m=3.0, step_height_per_m=0.0),
        features=FeaturesConfig(canny_low=50.0, canny_high=100.0, min_distance=10.5),
        cluster=ClusterConfig(points=True, min_points=3),
        footprint=FootprintConfig(
            trim=0, side_band_per_m=0.0, near_band_per_m2=0.0, margin_per_m2=0.0
        ),
    ),
    "d435": _with(min_depth_m=0.20, max_depth_m=4.0),
    "d455": _with(min_depth_m=0.40, max_depth_m=6.0),
    "oak-d": _with(min_depth_m=0.40, max_depth_m=6.0),
    "zed": _with(min_depth_m=0.30, max_depth_m=8.0),
    "azure-kinect": _with(min_depth_m=0.30, max_depth_m=5.0),
    "orbbec": _with(min_depth_m=0.25, max_depth_m=5.0),
}
"""Presets. ``wheeled``, the default, is for wheeled robots that climb steps of 5 cm. ``tabletop``
is for objects on a table top within 1.5 m; its step height is 8 mm plus 4 mm per metre of depth for
cells of 4 x 4 pixels, as with a Kinect. ``paper`` is the method of the paper, with clusters of
corners as obstacles; ``python -m benchmarks.paper.choose`` chose the parameters that the paper does
not specify. Each of the others is ``wheeled`` with the depth range in the data sheet of a camera.
"""


def preset(name: str, **changes: Any) -> Config:
    """Return the configuration of a preset, with changes.

    Args:
        name: Name of the preset.
        **changes: A section with its changes, such as ``ground={"max_depth_m": 3.0}``, or a single
            parameter, such as ``max_depth_m=3.0``. If several sections have the parameter, the one
            in ``ground`` is changed.

    Raises:
        ConfigError: The preset or parameter is unknown, or a value is invalid.

    Example:
        >>> preset("d435", max_depth_m=3.0).ground.max_depth_m
        3.0
    """
    if not isinstance(name, str):
        problem = f"expected the name of a preset, got {type(name).__name__}"
        raise ConfigError(problem, topic="name", remedy=f"use one of {', '.join(PRESETS)}")
    if name not in PRESETS:
        remedy = f"{meant(name, PRESETS)}use one of {', '.join(PRESETS)}"
        raise ConfigError(f"unknown preset {name[:40]!r}", remedy=remedy)
    return with_changes(PRESETS[name], changes) if changes else PRESETS[name]
