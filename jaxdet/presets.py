"""Presets: configurations for robots and cameras, by name."""

from dataclasses import replace
from typing import Any

from jaxdet.config import (
    ClusterConfig,
    Config,
    FeaturesConfig,
    FootprintConfig,
    GroundConfig,
    ObstacleConfig,
    SurfaceConfig,
)
from jaxdet.errors import ConfigError


def _with(ground: dict[str, Any], footprint: dict[str, float] | None = None) -> Config:
    return Config(
        ground=replace(GroundConfig(), **ground),
        footprint=replace(FootprintConfig(), **(footprint or {})),
    )


CELL_RAD = 0.0078
"""4 pixels of a Kinect's depth image of 640 columns, 3 of a D435's, 7 of a D415's of 1280."""

PRESETS: dict[str, Config] = {
    "wheeled": Config(),
    "paper": Config(
        ground=GroundConfig(max_depth_m=3.0, step_height_per_m=0.0),
        features=FeaturesConfig(
            canny_low=100.0, canny_high=200.0, min_distance=5.0, grid_columns=0, use_mask=False
        ),
        cluster=ClusterConfig(lateral_gap_m=0.40, min_points=10, slice_m=0.0),
        footprint=FootprintConfig(
            trim=0, side_band_per_m=0.0, near_band_per_m2=0.0, cover=False, margin_m=0.0
        ),
    ),
    "surfaces": Config(
        footprint=FootprintConfig(fitted=True, margin_m=0.0, margin_per_m2=0.007),
        surface=SurfaceConfig(cell_rad=CELL_RAD),
    ),
    "tabletop": Config(
        ground=GroundConfig(max_depth_m=2.0, step_height_m=0.008, step_height_per_m=0.016),
        footprint=FootprintConfig(fitted=True, margin_m=0.005),
        surface=SurfaceConfig(
            cell_rad=CELL_RAD,
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
    "uneven": _with({"window_s": 0.1, "sample_frames": 1, "step_height_per_m": 0.001}),
    "d435": _with({"min_depth_m": 0.20, "max_depth_m": 4.0}),
    "d455": _with({"min_depth_m": 0.40, "max_depth_m": 6.0}),
    "oak-d": _with({"min_depth_m": 0.40, "max_depth_m": 6.0}),
    "zed": _with({"min_depth_m": 0.30, "max_depth_m": 8.0}, {"vertex_threshold_m": 0.05}),
    "azure-kinect": _with({"min_depth_m": 0.30, "max_depth_m": 5.0}, {"vertex_threshold_m": 0.02}),
    "orbbec": _with({"min_depth_m": 0.25, "max_depth_m": 5.0}),
}
"""Presets: ``wheeled`` (the default robot; what differs from the paper is what the tables of
benchmarks/paper speak for), ``paper`` (the paper's setting: Canny at 100 and 200, corners only, no
mask, points dropped after the selection, its rectangle), ``surfaces`` (wheeled robots with a floor
of every frame, obstacles made of surfaces, contours and free floor; on the reference until it has
a fast program), ``tabletop`` (the same over a table, with steps of 8 mm and 4 mm for each metre at
a Kinect's cells of 4 pixels), ``uneven`` (for ramps
and floors that are not flat: ``jaxdet run`` looks for the floor every 0.1 s, so a lower step does),
and depth ranges of common cameras, by their data sheets."""


def preset(name: str) -> Config:
    """The configuration called ``name``.

    Raises:
        ConfigError: There is no such preset.
    """
    if name not in PRESETS:
        raise ConfigError(f"no preset {name!r}", remedy=f"use one of {', '.join(PRESETS)}")
    return PRESETS[name]
