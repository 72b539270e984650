"""Tables that the kernels on depth images read, computed from a camera and a configuration.

Tables are int32 with clipped lengths (two are float32), and have the names of ``program.h``.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxdet.affinity import BEYOND, NO_STEP, Affinity, affinity
from jaxdet.camera import cell_rays, cell_side, corner_rays, splat_parameters
from jaxdet.config import Config, FloorConfig, ObstacleConfig, SurfaceConfig
from jaxdet.floor import units
from jaxdet.floor.plane import (
    band_table,
    depth_range,
    direction_table,
    max_height,
    quadratic_table,
    step_height,
)
from jaxdet.floor.rays import (
    NOTCH_M,
    bearing_table,
    block_settings,
    half_turn,
    ray_directions,
    tile_corners,
)
from jaxdet.floor.units import Scale, stride
from jaxdet.types import Array, Calibration, Distortion
from jaxdet_kernels.paper import PARAMETERS

LIMIT = 1 << 30  # maximum of settings and entries of tables: no length is larger
MOST_STEP, MOST_LIMIT = 1 << 16, 1 << 17
"""Maximum step and limit in a table: depths have 16 bits and bends 17, so larger values would have
the same effect."""
FARTHEST = 1 << 28
"""Length greater than any that is compared [depth units]; products with it fit in 64 bits."""
MOST_EVIDENCE = (1 << 15) - 1  # maximum per pair; the sum over 256 x 256 pairs fits in 32 bits
_MODELS = Distortion.NONE, Distortion.PLUMB_BOB, Distortion.RATIONAL, Distortion.EQUIDISTANT
"""Lens models in the order of ``projection.h``."""

Tables = dict[str, Array]
"""Tables and settings of a step, by their names in ``program.h``."""


class Sizes(NamedTuple):
    """Sizes of the depth images and of their grid of cells."""

    height: int  # rows of pixels
    width: int  # columns of pixels
    side: int  # side of a cell [pixel]
    rows: int  # rows of cells
    columns: int  # columns of cells


def host_tables(calibration: Calibration, config: Config) -> tuple[Sizes, Tables]:
    """Return the sizes and the tables of all steps."""
    unit, camera = calibration.depth_unit, calibration.depth
    cells = cell_tables(calibration, config.surface)
    rows, columns = cells["rays"].shape[1:]
    bounds = depth_range(config.ground.min_depth_m, config.ground.max_depth_m, unit)
    table = affinity(config.obstacle.affinity, unit)
    side = cell_side(camera, config.surface.cell_rad)
    return Sizes(camera.height, camera.width, side, rows, columns), {
        **cells,
        **floor_tables(rows * columns, config.floor, unit),
        **surface_tables(calibration, config),
        **obstacle_tables(bounds[1], unit, config.obstacle, table),
        **outline_tables(calibration, config),
        **free_tables(calibration, config),
    }


def kernel_table(values: ArrayLike) -> np.ndarray:
    """Return a table or settings as clipped int32."""
    return np.minimum(values, LIMIT).astype(np.int32)


def kernel_tables(**values: ArrayLike) -> Tables:
    """Return several tables by name, as clipped int32."""
    return {name: kernel_table(one) for name, one in values.items()}


def cell_tables(calibration: Calibration, config: SurfaceConfig) -> Tables:
    """Return the tables of the grid of cells.

    Raises:
        CalibrationError: The calibration cannot be used.
    """
    side = cell_side(calibration.depth, config.cell_rad)
    steps = quadratic_table(config.step_m, config.step_per_m, calibration.depth_unit)
    return kernel_tables(near=steps, rays=cell_rays(calibration.depth, side))


def floor_tables(cells: int, config: FloorConfig, unit: float) -> Tables:
    """Return the tables of the floor search in a grid of ``cells`` cells."""
    settings = np.hstack(list(_floor_settings(cells, config, unit).values()))
    return kernel_tables(floor_settings=settings, sines=units.SINES.astype(np.int32))


def _floor_settings(cells: int, config: FloorConfig, unit: float) -> dict[str, Any]:
    """Return the settings of the floor search, in the order of ``floor_planes.h``.

    Lengths are in depth units, and angles in angle steps.

    Args:
        cells: Number of cells of the grid, rows times columns.
        config: Limits of corrections and reasons of refusal.
        unit: Metres per depth unit.
    """
    scale = Scale(unit, config.noise_per_m)
    rough, fine, sharp = scale.rough(units.ROUGH_DEG), scale.fine, scale.sharp
    span, bin_bits = scale.length(units.STEEP_M), scale.bits(units.BIN_M)
    run_bits, rise_bits = scale.bits(units.RUN_M), scale.bits(units.RISE_M)
    return {
        "stride": stride(cells, config),  # subsampling of the cells, in rows and columns
        "max_depth": round(config.max_depth_m / unit),
        "noise": rough.noise,
        "rough": (rough.base, rough.per_z),
        "fine": (fine.base, fine.per_z),
        "sharp": (sharp.base, sharp.per_z),
        "wide_per_z": scale.rough(units.STEP_DEG / 2).per_z,
        "lever_bits": scale.bits(units.LEVER_M),
        "bin_bits": bin_bits,
        "span": span,  # range of heights around a guess
        # Number of height bins at each end that only the search for steep planes uses.
        "edge": (span - scale.length(units.NEAR_M)) >> bin_bits,
        "lowest": scale.length(units.HEIGHTS_M[0]),
        "highest": scale.length(units.HEIGHTS_M[1]),
        "rings": tuple(scale.length(m) for m in units.RINGS_M),
        "max_turn": round(config.max_turn_deg * units.ANGLES),
        "max_shift": scale.length(config.max_shift_m),
        "min_share": round(1000 * config.min_share),  # per mille
        "min_share_alone": round(1000 * config.min_share_alone),
        "table": scale.length(units.TABLE_M),
        "deep": scale.length(units.DEEP_M),
        "over_table": scale.length(units.OVER_TABLE_M),
        "step": scale.length(units.STEP_M),
        "ramps": int(config.ramps),
        "farthest_ramp": scale.length(units.RAMP_M),
        "run_bits": run_bits,
        "rise_bits": rise_bits,
        "runs": round(units.FARTHEST_M / unit) >> run_bits,
        # Number of height bins of the profile above the plane; there are as many below.
        "half": round(units.HIGHEST_M / unit) >> rise_bits,
        "profile_base": scale.length(units.PROFILE_M),
        "ramp_near": round(units.RAMP_NEAR_M / unit),
        "spread": round(units.SPREAD_M / unit),
        "start_step": scale.length(units.FINE_START_M),
        "drop_spacing": scale.length(units.DROP_SPACING_M),
        "alike": scale.length(units.ALIKE_M),
        "starts": tuple(np.rint(units.STARTS_M / unit).astype(np.int64).tolist()),
    }


def surface_tables(calibration: Calibration, config: Config) -> Tables:
    """Return the tables of the segmentation into surfaces, with clipped lengths."""
    ground, surface, unit = config.ground, config.surface, calibration.depth_unit
    nearest, farthest = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    steps = quadratic_table(surface.step_m, surface.step_per_m, unit)
    limits = quadratic_table(surface.crease_m, surface.crease_per_m, unit)
    step = step_height(calibration, config)
    beyond, bent = round(farthest * surface.beyond), round(surface.bent_m / unit)
    creases = surface.crease_cells, surface.min_cells, surface.crease_margin
    lengths = nearest, beyond, *creases, bent, step.noise
    return kernel_tables(
        steps=np.minimum(steps, MOST_STEP),
        limits=np.minimum(limits, MOST_LIMIT),
        rises=step.table,
        surface_settings=(*lengths, max_height(ground, unit), farthest, surface.hole_cells),
    )


def obstacle_tables(farthest: int, unit: float, config: ObstacleConfig, table: Affinity) -> Tables:
    """Return the tables of the step that groups surfaces into obstacles.

    Args:
        farthest: Maximum depth of obstacles [depth units].
        unit: Metres per depth unit.
        config: Limits of gaps, bends and sizes [m].
        table: Affinity table of the configuration, in the same depth units.

    Raises:
        ValueError: Sums of the table's evidence could overflow.
    """
    most = int(np.abs(table.value).max(axis=1).sum()) + abs(table.offset)
    if most > MOST_EVIDENCE:
        raise ValueError(f"evidence sums up to {most}, expected at most {MOST_EVIDENCE}")
    gaps = config.lateral_gap_m, config.forward_gap_m, config.depth_gap_m, config.contact_m
    sizes = config.bend_m, config.side_m, config.min_size_m
    lengths = (round(m / unit) for m in (*gaps, *sizes))
    settings = farthest, *lengths, config.min_cells, round(NO_STEP / (1000 * unit)), table.offset
    return kernel_tables(
        feature=table.feature,
        threshold=np.clip(table.threshold, -BEYOND, BEYOND),
        value=table.value,
        obstacle_settings=np.clip(settings, -FARTHEST, FARTHEST),
    )


def outline_tables(calibration: Calibration, config: Config) -> Tables:
    """Return the tables of outlines and measurements."""
    unit, footprint = calibration.depth_unit, config.footprint
    vertex, long = (round(m / unit) for m in (footprint.vertex_threshold_m, footprint.long_m))
    image, camera = calibration.image, calibration.depth
    found = kernel_tables(
        bands=band_table(footprint, unit),
        directions=direction_table(),
        outline_settings=(footprint.trim, vertex, long),
        last=(image.width - 1, image.height - 1),
    )
    if calibration.is_aligned:
        return found | {"parameters": np.zeros(PARAMETERS + 2, np.float32)}
    side = cell_side(camera, config.surface.cell_rad)
    corners = tuple(slice(0, n // side * side + 1, side) for n in (camera.height, camera.width))
    x, y = (rays[corners] for rays in corner_rays(camera))
    return found | {"corner_x": x, "corner_y": y, "parameters": parameters(calibration)}


def free_tables(calibration: Calibration, config: Config) -> Tables:
    """Return the tables of the free floor and its rays."""
    floor, ground, unit = config.floor, config.ground, calibration.depth_unit
    bows = quadratic_table(ground.step_height_m, floor.bow_per_m, unit)
    drops = quadratic_table(floor.drop_m, floor.noise_per_m, unit)
    lengths = [round(m / unit) for m in (ground.max_depth_m, floor.gap_m)]
    bounds = depth_range(ground.min_depth_m, ground.max_depth_m, unit)
    side = cell_side(calibration.depth, config.surface.cell_rad)
    half, notch = half_turn(calibration.depth, side), round(NOTCH_M / unit)
    least = config.obstacle.min_cells
    made = kernel_tables(
        bows=bows,
        drops=drops,
        free_settings=(*lengths, *bounds, max_height(ground, unit), half, notch, least),
        bearings=bearing_table(),
        ray_directions=ray_directions(),
        tile_corners=tile_corners(cell_rays(calibration.depth, side)),
    )
    return made | {"block_settings": block_settings(ground, unit)}


def parameters(calibration: Calibration) -> np.ndarray:
    """Return the parameters of the projection into the colour image, ``(PARAMETERS + 2,)`` float32.

    The last two elements are the lens model, and whether a depth pixel covers all colour pixels
    between its corners.
    """
    splat = splat_parameters(calibration)
    more = splat.max_r2, splat.depth_unit, _MODELS.index(splat.model), splat.fills_corners
    return np.concatenate(
        [splat.rotation, splat.translation, splat.pinhole, splat.lens, np.array(more, np.float32)]
    )
