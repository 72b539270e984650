"""Floor of each frame, estimated from its own depth."""

import math
from typing import NamedTuple

import numpy as np

from jaxdet.config import FloorConfig
from jaxdet.floor.units import (
    ANGLES,
    DEEP_M,
    OVER_TABLE_M,
    RAMP_M,
    STEP_M,
    TABLE_M,
    FloorFit,
    Scale,
    floor_fit,
    prior_units,
    stride,
    wrapped,
)
from jaxdet.reference._cells import margins
from jaxdet.reference._floor_ahead import find_ahead
from jaxdet.reference._floor_planes import (
    BELOW,
    BELOW_COST,
    Plane,
    Sample,
    below,
    refined,
    score,
)
from jaxdet.reference._floor_profile import Ahead, distance
from jaxdet.reference._floor_ramp import crossing, ramp_plane
from jaxdet.reference._floor_search import any_plane, is_usual, least_share, near_planes
from jaxdet.types import GroundPlane, Refusal

MIN_CELLS = 50  # minimum number of cells for an estimate
FAR_GAIN = 5
"""A plane far from the prior is tried as a ramp ahead of it if it has more inliers than the floor
found near the prior, by more than this [percent of all cells]."""
OBSTACLE = 95  # maximum fraction of obstacle cells [percent]
UNDER = ((10, 2), (3, 8))
"""Limits ``(percent, inliers)`` with a prior, and without. A plane belongs to a table if more than
``percent`` of all cells are below it, and more than one cell per ``inliers`` inliers. A few cells
may be below a floor, because a glossy floor mirrors objects."""


class _Found(NamedTuple):
    """Floor of one frame."""

    plane: Plane
    ahead: Ahead | None
    on: int  # number of inliers
    total: int  # number of all cells
    refused: Refusal

    @property
    def row(self) -> tuple[int, ...]:
        """Integers that :func:`jaxdet.floor.units.floor_fit` expects."""
        ramp = self.ahead[:2] if self.ahead and self.ahead.turn else (0, 0)
        return (*self.plane, *ramp, self.on, self.total, self.refused)


def find_floor(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    prior: GroundPlane,
    config: FloorConfig,
    depth_unit: float,
) -> FloorFit:
    """Estimate the floor plane of each frame, and a ramp or step ahead, from that frame only.

    A fourth of the cells vote for planes on a fixed lattice of pitch, roll and height, around the
    prior or over all usual camera poses. A plane gets one vote per inlier, within a tolerance that
    grows with depth, and loses two per cell clearly below it. The best planes are refined by
    weighted least squares on the cells near them, in a fixed number of rounds. Planes that get
    votes mainly from nearer cells are tried with ramps and steps ahead; a ramp or step is accepted
    if it gets clearly more votes.

    Every decision is made on integers: angles of 1/32 degree and integer depth units. Only the
    tables of sines and tangents are rounded from floating point.

    Args:
        x: Position of the cells to the right of the optical axis, ``(B, R, C)`` int32 [depth
            units].
        y: Position below the axis.
        z: Position along the axis, 0 = none; the cells are a regular grid over the image.
        prior: Prior plane of each frame; a plane that is not valid means no prior. Ramps of the
            planes are ignored.
        config: Limits of corrections and reasons of refusal.
        depth_unit: Metres per depth unit.

    Returns:
        The planes, and the reasons why the planes of frames were refused. A camera pitched by more
        than 85 degrees keeps its prior.
    """
    part = used_cells(z.shape[1:], config)
    x, y, z = (a[:, part, part] for a in (x, y, z))
    return floor_of_cells(x, y, z, prior, config, depth_unit)


def used_cells(shape: tuple[int, ...], config: FloorConfig) -> slice:
    """Return the sampled rows and columns of a grid of cells ``(R, C)``."""
    step = stride(math.prod(shape), config)
    return slice(step // 2, None, step)


def floor_of_cells(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    prior: GroundPlane,
    config: FloorConfig,
    depth_unit: float,
) -> FloorFit:
    """Run :func:`find_floor` on only the cells of :func:`used_cells`."""
    scale = Scale(depth_unit, config.noise_per_m)
    priors = prior_units(prior, scale).tolist()
    found = np.zeros((len(z), 8), np.int32)
    for b, (*plane, valid) in enumerate(priors):
        cells, few = _take(x[b], y[b], z[b], config, scale)
        found[b] = _find(cells, few, Plane(*plane) if valid else None, config, scale).row
    return floor_fit(found, prior, depth_unit)


def _take(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, config: FloorConfig, scale: Scale
) -> tuple[Sample, Sample]:
    """Return the measured cells up to the maximum depth, and a fourth of them for the search.

    The fourth is from every second row and column.
    """
    x, y, z = (a.astype(np.int64) for a in (x, y, z))
    row, column = np.indices(z.shape)
    inner = np.broadcast_to(~margins(z.shape[1]), z.shape)
    used = (z > 0) & (z <= round(config.max_depth_m / scale.unit))
    cells = Sample(np.stack([x[used], y[used], z[used]], axis=1), inner[used])
    return cells, cells.take(((row | column) % 2 == 0)[used])


def _find(
    cells: Sample, few: Sample, prior: Plane | None, config: FloorConfig, scale: Scale
) -> _Found:
    """Estimate the floor of one frame."""
    if len(few.z) < MIN_CELLS:
        return _Found(prior or Plane(0, 0, 0), None, 0, 0, Refusal.TOO_LITTLE)
    guess = prior or any_plane(few, _permille(config.min_share_alone), scale)
    planes = [guess, *near_planes(few, guess, prior, scale)]
    votes = [int(score(below(p, few), scale.fine.of(few.z, p.height))) for p in planes]
    near = [_is_near(p, prior, config, scale) for p in planes]
    allowed = [(v, p) for v, p, n in zip(votes, planes, near, strict=True) if n]
    if not allowed:
        allowed = [(votes[0], guess)]
    plane, ahead = max(allowed, key=lambda pair: pair[0])[1], None
    if config.ramps:
        farthest = prior and prior.height + scale.length(config.max_shift_m)
        plane, ahead = find_ahead(plane, [p for _, p in allowed], few, scale, farthest)
    plane, ahead = _refined(plane, ahead, cells, prior, scale)
    found = _judge(plane, ahead, cells, prior, config, scale)
    best = votes.index(max(votes))
    least = (100 * found.on + FAR_GAIN * found.total) * len(few.z)
    if prior and not near[best] and 100 * votes[best] * found.total > least:
        steep = planes[best]
    elif found.refused == Refusal.FAR:
        steep = plane
    else:
        return found
    ramp = _as_ramp(steep, prior, config, scale) if prior and config.ramps else None
    if not ramp:
        return found._replace(refused=Refusal.FAR)
    return _judge(*ramp, cells, prior, config, scale)


def _refined(
    plane: Plane, ahead: Ahead | None, cells: Sample, prior: Plane | None, scale: Scale
) -> tuple[Plane, Ahead | None]:
    """Refine a plane on all cells or, if it has a ramp or a step, on the cells before its start.

    A ramp is refined on the cells beyond its start.
    """
    if not ahead:
        return refined(plane, cells, (0, 1, 5), prior, scale), None
    beyond = distance(plane, cells) >= ahead.start
    own = refined(plane, cells.take(~beyond), (0, 1, 5), prior, scale)
    if not ahead.turn:
        return own, ahead
    steep = ramp_plane(plane, ahead)
    steep = refined(steep, cells.take(beyond), (0, 1, 5), steep, scale)
    ramp = crossing(own, steep)
    return own, ramp if ramp and 0 < ramp.start <= scale.length(RAMP_M) else ahead


def _is_near(plane: Plane, prior: Plane | None, config: FloorConfig, scale: Scale) -> bool:
    """Return whether a plane is below the camera and near the prior.

    Without a prior, the camera's tilt must be usual instead.
    """
    if prior is None:
        return is_usual(plane)
    turn = round(config.max_turn_deg * ANGLES)
    return (
        plane.height > 0
        and abs(plane.pitch - prior.pitch) <= turn
        and abs(wrapped(plane.roll - prior.roll)) <= turn
        and abs(plane.height - prior.height) <= scale.length(config.max_shift_m)
    )


def _as_ramp(
    steep: Plane, prior: Plane, config: FloorConfig, scale: Scale
) -> tuple[Plane, Ahead] | None:
    """Return the prior and a plane far from it as a ramp ahead; None if the two do not cross."""
    level = prior._replace(roll=steep.roll)
    ramp = crossing(level, steep) if _is_near(level, prior, config, scale) else None
    return (level, ramp) if ramp and 0 < ramp.start <= scale.length(RAMP_M) else None


def _judge(
    plane: Plane,
    ahead: Ahead | None,
    cells: Sample,
    prior: Plane | None,
    config: FloorConfig,
    scale: Scale,
) -> _Found:
    """Count the inliers of a floor and decide whether it is refused."""
    level = below(plane, cells)
    deep = level + ahead.rise(distance(plane, cells)) if ahead else level
    slack, total = scale.fine.of(cells.z, plane.height), len(cells.z)
    on = int(np.count_nonzero(np.abs(deep) <= slack))
    is_low = deep > BELOW * slack + scale.length(TABLE_M)
    over_table = scale.length(OVER_TABLE_M)
    if prior is None and ahead and 0 < ahead.drop <= over_table - plane.height:
        # Without a prior, a floor beyond a deep step may be the floor below a table.
        is_low |= level > BELOW * slack + scale.length(DEEP_M)
    low = int(np.count_nonzero(is_low))
    high = int(np.count_nonzero(-deep > slack + scale.length(STEP_M)))
    has_prior = prior is not None
    share, part = UNDER[not has_prior]
    enough, least = on, _permille(config.min_share)
    if not has_prior:
        # Without a prior, cells in dents (more than 1.5 tolerances below the plane) cost inliers,
        # because below a plane through a table there are many.
        enough -= BELOW_COST * int(np.count_nonzero(2 * deep > 3 * slack))
        least = least_share(plane, _permille(config.min_share_alone))
    refused = Refusal.NONE
    if not _is_near(plane, prior, config, scale):
        refused = Refusal.FAR
    elif 100 * low > share * total and part * low > on:
        refused = Refusal.TABLE
    elif 100 * high > OBSTACLE * total:
        refused = Refusal.MOSTLY_OBSTACLE
    elif 1000 * enough < least * total:
        refused = Refusal.TOO_LITTLE
    return _Found(plane, ahead, on, total, refused)


def _permille(share: float) -> int:
    return round(1000 * share)
