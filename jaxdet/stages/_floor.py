"""The floor of each frame, found in its own depth: integers in, integers out.

Twin of ``jaxdet/reference/_floor.py``. What is known and found has other units outside, see
:mod:`jaxdet.floor.units`.
"""

from typing import Any

import numpy as np

from jaxdet.config import FloorConfig
from jaxdet.floor import units
from jaxdet.floor.units import Scale, stride
from jaxdet.stages._tables import Tables, kernel_tables

_SINES = units.SINES.astype(np.int32)


def tables(cells: int, config: FloorConfig, unit: float) -> Tables:
    """The tables of a grid of so many cells and a configuration, on the host."""
    settings = np.hstack(list(_settings(cells, config, unit).values()))
    return kernel_tables(floor_settings=settings, sines=_SINES)


def _settings(cells: int, config: FloorConfig, unit: float) -> dict[str, Any]:
    """The settings [depth units], in the order of ``floor_planes.h``.

    Args:
        cells: Rows times columns.
        config: What to correct and what to refuse.
        unit: Metres in one depth unit.
    """
    scale = Scale(unit, config.noise_per_m)
    rough, fine, sharp = scale.rough(units.ROUGH_DEG), scale.fine, scale.sharp
    span, bin_bits = scale.length(units.STEEP_M), scale.bits(units.BIN_M)
    run_bits, rise_bits = scale.bits(units.RUN_M), scale.bits(units.RISE_M)
    return {
        "stride": stride(cells, config),  # of the cells used, in rows and columns
        "max_depth": round(config.max_depth_m / unit),
        "noise": rough.noise,
        "rough": (rough.base, rough.per_z),
        "fine": (fine.base, fine.per_z),
        "sharp": (sharp.base, sharp.per_z),
        "wide_per_z": scale.rough(units.STEP_DEG / 2).per_z,
        "lever_bits": scale.bits(units.LEVER_M),
        "bin_bits": bin_bits,
        "span": span,  # heights are tried so far from a guess
        # Bins at each end that are farther than most planes are looked for.
        "edge": (span - scale.length(units.NEAR_M)) >> bin_bits,
        "lowest": scale.length(units.HEIGHTS_M[0]),
        "highest": scale.length(units.HEIGHTS_M[1]),
        "rings": tuple(scale.length(m) for m in units.RINGS_M),
        "max_turn": round(config.max_turn_deg * units.ANGLES),
        "max_shift": scale.length(config.max_shift_m),
        "min_share": round(1000 * config.min_share),  # in thousandths
        "min_share_alone": round(1000 * config.min_share_alone),
        "table": scale.length(units.TABLE_M),
        "step": scale.length(units.STEP_M),
        "ramps": int(config.ramps),
        "farthest_ramp": scale.length(units.RAMP_M),
        "run_bits": run_bits,
        "rise_bits": rise_bits,
        "runs": round(units.FARTHEST_M / unit) >> run_bits,
        # Heights of the profile above the plane, and below.
        "half": round(units.HIGHEST_M / unit) >> rise_bits,
        "profile_base": scale.length(units.PROFILE_M),
        "ramp_near": round(units.RAMP_NEAR_M / unit),
        "spread": round(units.SPREAD_M / unit),
        "start_step": scale.length(units.FINE_START_M),
        "drop_spacing": scale.length(units.DROP_SPACING_M),
        "alike": scale.length(units.ALIKE_M),
        "starts": tuple(np.rint(units.STARTS_M / unit).astype(np.int64).tolist()),
    }
