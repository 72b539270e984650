"""cluster, along surfaces: by hand, and the twin."""

import numpy as np
import pytest

from jaxdet import reference, stages
from jaxdet.types import Features
from tests.scenes import assert_equal, points
from tests.slices import BACKENDS, config, row_labels, rows_of


def picture(z: list[list[int]], step: int = 100) -> Features:
    """A grid of pixels without depth 0, so many millimetres apart, after one corner."""
    v, u = np.indices(np.shape(z))
    pixels = u * step, v * step, np.array(z), v
    x, y, depth, v = (np.concatenate([[0], a.ravel()]) for a in pixels)
    features = points(x, depth, (depth > 0) & (np.arange(len(x)) > 0))
    return features._replace(y=y[None].astype(np.int32), v=v[None].astype(np.int32))


APART = {"lateral_gap_m": 0.1, "surface_height_m": 0.2, "surface_gap_m": 0.03}
"""Links sideways reach the next column."""


@pytest.mark.parametrize(("height", "want"), [(0.2, 1), (0.21, 0), (0.0, 0)])
@BACKENDS
def test_tall_surfaces_stay_apart(backend, height, want):
    tall = picture([[1000, 1000, 1060, 1060]] * 3)
    settings_ = config(1, **{**APART, "surface_height_m": height})
    assert row_labels(backend, tall, settings_) == [0, 0, want, want] * 3


@BACKENDS
def test_a_surface_has_no_step(backend):
    """What a slope joins is one surface; a low thing is one with what it stands beside."""
    slope = picture([[1000, 1020, 1040, 1060]] * 3)
    assert row_labels(backend, slope, config(1, **APART)) == [0] * 12
    low = picture([[1000, 0, 0], [1000, 0, 0], [1000, 1000, 1060]])
    assert row_labels(backend, low, config(1, **APART)) == [0, -1, -1] * 2 + [0] * 3


@BACKENDS
def test_what_lies_between_goes_to_the_nearest_in_links(backend):
    """The one in the middle is as near to both: it goes to the surface with the first slot."""
    low, high = [[1000, 0, 0, 0, 1000]] * 2, [[1000, 1040, 1000, 1040, 1000]]
    found = row_labels(backend, picture(low + high), config(1, **APART))
    assert found == [0, -1, -1, -1, 1] * 2 + [0, 0, 0, 1, 1]


@BACKENDS
def test_a_surface_behind_a_nearer_thing_is_tall_as_a_whole(backend):
    """Two halves of 0.1 m, above each other at the two sides of a nearer thing."""
    z = [[2000, 500, 0, 2030], [2000, 500, 2000, 2030], [0, 500, 2000, 2030]]
    settings_ = config(1, **APART, max_holes=0)
    assert row_labels(backend, picture(z), settings_) == [
        *(1, 0, -1, 1),
        *(1, 0, 1, 1),
        *(-1, 0, 1, 1),
    ]


@BACKENDS
def test_points_near_no_tall_surface_are_grouped_as_ever(backend):
    z = [[1000, 1000, 0, 0, 3000, 3060], [1000, 1060, 0, 0, 3000, 3060], [1000, 1060, 0, 0, 0, 0]]
    found = row_labels(backend, picture(z), config(1, **{**APART, "surface_height_m": 0.1}))
    assert found == [0, 0, -1, -1, 2, 3, 0, 1, -1, -1, 2, 3, 0, 1, -1, -1, -1, -1]
    found = row_labels(backend, picture(z), config(1, **APART))
    assert found == [0, 0, -1, -1, 1, 1, 0, 0, -1, -1, 1, 1, 0, 0, -1, -1, -1, -1]


@pytest.mark.parametrize("height", [0.001, 0.05, 0.2])
@pytest.mark.parametrize("gap", [0.0, 0.02, 0.2])
def test_twin_with_tall_surfaces(device, cluster_form, height, gap):
    """A slanted wall in pieces, things before it, holes, and some noise."""
    rng = np.random.default_rng(round(1000 * (height + gap)))
    features = rows_of(rng, 4, 1500, 200, 500)
    i = np.arange(1500)
    z = 900 + 20 * (i % 23) + (i % 23) // 6 * 60 - 300 * (i // 230 % 2)
    z = np.where(features.z > 0, z + rng.integers(-15, 16, (4, 1500)), 0).astype(np.int32)
    x = np.where(i < 200, features.x, 30 * (i % 23) - 300).astype(np.int32)
    settings_ = config(
        200, surface_height_m=height, surface_gap_m=gap, surface_gap_per_m=0.01, occluder_slope=0.3
    )
    given_ = features._replace(x=x, z=z), 0.001, settings_
    want = reference.cluster(*given_)
    assert want.num_obstacles.min() > 1
    assert_equal(stages.cluster(*given_), want)
