"""The floor of each frame, found in its own depth: integers in, integers out.

Twin of ``jaxdet/reference/_floor.py``. What is known and found has other units outside, see
:mod:`jaxdet.floor.units`.
"""

from typing import Any

import jax
import numpy as np

from jaxdet.config import FloorConfig
from jaxdet.floor import units
from jaxdet.floor.units import Scale, stride
from jaxdet.stages._teams import TeamKernel
from jaxdet_kernels import floor as kernels

_floor = TeamKernel(kernels.floor)
_frames = TeamKernel(kernels.found_frame)
_SINES = units.SINES.astype(np.int32)


def floor_settings(cells: int, config: FloorConfig, unit: float) -> np.ndarray:
    """The kernel's settings, ``(N,)`` int32, see :func:`_settings`."""
    return np.hstack(list(_settings(cells, config, unit).values())).astype(np.int32)


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


def scratch_words(rows: int, columns: int, config: FloorConfig, unit: float) -> int:
    """Words of scratch memory that a team needs for grids of so many cells."""
    sizes = _settings(rows * columns, config, unit)
    rows, columns = (len(range(sizes["stride"] // 2, n, sizes["stride"])) for n in (rows, columns))
    heights = 2 * sizes["span"], sizes["highest"] - sizes["lowest"]
    near, wide = ((height >> sizes["bin_bits"]) + 1 for height in heights)
    return kernels.floor_scratch_words(rows, columns, near, wide, sizes["runs"])


def find_floor(
    x: jax.Array, y: jax.Array, z: jax.Array, prior: jax.Array, settings: jax.Array, words: int
) -> jax.Array:
    """Finds the floor of each frame, inside ``jax.jit``.

    Takes what the kernel takes, ``prior`` as :func:`jaxdet.floor.units.prior_units` makes it, and
    :func:`scratch_words`.

    Returns:
        ``(B, 8)`` int32, see :func:`jaxdet.floor.units.floor_fit`.
    """
    inputs, batch = (x, y, z, prior, settings, _SINES), z.shape[0]
    [found] = _floor(*inputs, batch=batch, shapes={"found_out": (batch, 8)}, scratch=words)
    return found


def found_frames(found: jax.Array, given: jax.Array) -> jax.Array:
    """The floor frames of frames: of their own floor, or where that was refused the one given.

    Args:
        found: From :func:`find_floor`.
        given: ``(B, 13)`` int32, see :func:`jaxdet.floor.frame.floor_frames`.
    """
    shapes = {"frame_out": given.shape}
    (frame,) = _frames(found, given, _SINES, batch=given.shape[0], shapes=shapes, scratch=1)
    return frame
