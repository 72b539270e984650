"""surfaces: connected components of cells, cut along creases, and bent floor."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxdet.config import SurfaceConfig
from jaxdet.reference._components import components
from jaxdet.reference._surfaces import (
    creases,
    dilated,
    renumbered,
    surfaces,
    without_bent_floor,
    without_small,
)

UNIT = 0.001
PLAIN = SurfaceConfig(step_m=0.03, step_per_m=0.0, crease_m=1.0, min_cells=1)
"""Configuration with a step of 30 mm at any depth, without creases and without minimum size."""
CREASED = SurfaceConfig(step_m=0.03, step_per_m=0.0, crease_m=0.01, crease_per_m=0.0, min_cells=6)


def found(z: list, keep: list | None = None, config: SurfaceConfig = PLAIN) -> list:
    """Return the surfaces of cells with these depths [mm], all kept by default."""
    depth = np.array(z, np.int32)
    kept = depth > 0 if keep is None else np.array(keep, bool) & (depth > 0)
    return surfaces(depth, kept, UNIT, config).tolist()


def roof(outward: bool) -> np.ndarray:
    """Return two planes that meet in the middle column, 20 mm per cell, convex or concave."""
    u = np.abs(np.arange(31) - 15)
    return np.tile(1500 + 20 * u if outward else 1800 - 20 * u, (12, 1))


def same_parts(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two labelings divide the cells in the same way."""
    return bool((renumbered(one) == renumbered(other)).all())


masks = arrays(bool, (9, 12))
depths = arrays(np.int32, (9, 12), elements=st.sampled_from([0, 900, 925, 950, 981, 1200]))


# by hand


def test_steps_in_depth_separate_surfaces() -> None:
    assert found([[900, 930, 960, 991, 990]]) == [[0, 0, 0, 1, 1]]
    assert found([[900, 2000], [930, 1999], [961, 2031]]) == [[0, 1], [0, 1], [2, 3]]


def test_diagonal_neighbours_are_not_connected() -> None:
    assert found([[900, 2000], [2000, 900]]) == [[0, 1], [2, 3]]


def test_cells_not_kept_or_not_measured_separate_surfaces() -> None:
    assert found([[900, 0, 900]]) == [[0, -1, 1]]
    assert found([[900, 900, 900]], [[1, 0, 1]]) == [[0, -1, 1]]


def test_the_step_of_the_nearer_cell_is_used() -> None:
    """The step is 10 mm plus 10 mm times the squared depth: 20 mm at 1 m, 50 mm at 2 m."""
    config = replace(PLAIN, step_m=0.01, step_per_m=0.01)
    assert found([[1000, 1020, 1041]], config=config) == [[0, 0, 1]]
    assert found([[2000, 2050, 2103]], config=config) == [[0, 0, 1]]


def test_small_components_are_not_surfaces() -> None:
    config = replace(PLAIN, min_cells=3)
    assert found([[900, 900, 990, 900, 900, 900]], config=config) == [[-1, -1, -1, 0, 0, 0]]


def test_steps_are_in_metres_whatever_the_depth_unit() -> None:
    z = np.array([[9000, 9300, 9601]], np.int32)
    assert surfaces(z, z > 0, 0.0001, PLAIN).tolist() == [[0, 0, 1]]
    assert surfaces(z, z > 0, 0.001, PLAIN).tolist() == [[0, 1, 2]]


def test_a_concave_edge_separates_and_a_convex_one_does_not() -> None:
    inside, outside = roof(outward=False), roof(outward=True)
    label = surfaces(inside, inside > 0, UNIT, CREASED)
    assert label.max() == 1 and label.min() == 0
    assert (label[:, :13] == 0).all() and (label[:, 18:] == 1).all()
    assert not surfaces(outside, outside > 0, UNIT, CREASED).any()
    assert not surfaces(inside, inside > 0, UNIT, PLAIN).any()


def test_an_object_against_a_wall_is_separated_by_its_crease() -> None:
    """A box leans on a wall: its side recedes by 25 mm per cell, without a step."""
    profile = [1000] * 10 + [1025, 1050, 1075, 1100] + [1125] * 10
    z = np.tile(profile, (12, 1))
    label = surfaces(z, z > 0, UNIT, CREASED)
    assert label.max() == 1
    assert (label[:, :10] == 0).all() and (label[:, 16:] == 1).all()


def test_a_gap_in_a_crease_does_not_connect_surfaces() -> None:
    """In three rows the box continues into the wall at 9 mm per cell, without a bend."""
    z = np.tile([1000] * 10 + [1025, 1050, 1075, 1100] + [1125] * 10, (12, 1))
    z[5:8, 10:] = 1009 + 9 * np.arange(14)
    label = surfaces(z, z > 0, UNIT, CREASED)
    assert label.max() == 1
    assert (label[:, :10] == 0).all() and (label[:, 16:] == 1).all()
    assert not surfaces(z, z > 0, UNIT, replace(CREASED, crease_margin=0)).any()


def test_creases_below_the_threshold_do_not_separate() -> None:
    z = np.full((20, 30), 1000)
    z[9:11, 14:16] = 1029
    step, fine = np.full(z.shape, 30), replace(CREASED, crease_m=0.005)
    few = creases(z, step, z > 0, UNIT, replace(fine, min_cells=4))
    assert few.sum() == 16 and few[8:12, 13:17].all()
    thin = creases(z, step, z > 0, UNIT, replace(fine, min_cells=4, crease_margin=0))
    assert thin.sum() == 4 and thin[9:11, 14:16].all()
    assert not creases(z, step, z > 0, UNIT, replace(fine, min_cells=5)).any()


def test_a_jump_is_not_a_crease() -> None:
    z = np.tile([1000] * 8 + [1400] * 8, (8, 1))
    assert not creases(z, np.full(z.shape, 30), z > 0, UNIT, CREASED).any()


def test_noise_of_single_cells_is_not_a_crease() -> None:
    z = 1500 + np.random.default_rng(0).integers(-8, 9, (30, 40))
    assert not surfaces(z, z > 0, UNIT, CREASED).any()


def test_surfaces_without_a_steep_front_are_floor() -> None:
    """A low wedge with a slope of 1 in 4 is removed as bent floor; the face of a kerb is kept."""
    forward = np.tile(np.arange(1500, 900, -100)[:, None], (1, 4))
    label = np.full((6, 4), -1)
    label[:3] = 0
    low = label < 0
    wedge = np.tile(np.array([105, 80, 55, 30, 5, 0])[:, None], (1, 4))
    config = SurfaceConfig(bent_m=0.2)
    assert (without_bent_floor(label, low, forward, wedge, UNIT, config) == -1).all()
    upright = np.where(label == 0, 1000, forward)
    kept = without_bent_floor(label, low, upright, wedge, UNIT, config)
    np.testing.assert_array_equal(kept, label)
    high = np.where(np.arange(6)[:, None] == 0, 201, wedge)
    kept = without_bent_floor(label, low, forward, high, UNIT, config)
    np.testing.assert_array_equal(kept, label)
    off = without_bent_floor(label, low, forward, wedge, UNIT, SurfaceConfig(bent_m=0.0))
    np.testing.assert_array_equal(off, label)


def test_floor_measured_too_near_in_the_margins_is_removed() -> None:
    """Sloping strips in the margins are removed; a sloping strip in the middle and upright strips
    in the margins are kept.
    """
    label, height = np.full((4, 24), -1), np.zeros((4, 24), int)
    label[:2, :2], label[:2, 11:13], label[:2, 22:] = 0, 1, 2
    height[label >= 0] = 60
    forward = np.tile(np.array([2650, 2630, 2700, 2600])[:, None], (1, 24))
    gone = without_bent_floor(label, label < 0, forward, height, UNIT, CREASED) < 0
    np.testing.assert_array_equal(gone, label != 1)
    for sideways in (-59, 0, 59):
        forward[1] = forward[2] + sideways
        kept = without_bent_floor(label, label < 0, forward, height, UNIT, CREASED)
        np.testing.assert_array_equal(kept, label)


def test_only_bent_surfaces_are_removed() -> None:
    label = np.array([[0, 0, 1, 1], [0, 0, 1, 1], [-1, -1, -1, -1]])
    height = np.array([[90, 90, 190, 190], [60, 60, 100, 100], [0, 0, 0, 0]])
    forward = np.array([[1400, 1400, 1000, 1000], [1200, 1200, 1000, 1000], [1000] * 4])
    left = without_bent_floor(label, label < 0, forward, height, UNIT, SurfaceConfig(bent_m=0.2))
    assert left.tolist() == [[-1, -1, 0, 0], [-1, -1, 0, 0], [-1, -1, -1, -1]]


# SciPy


def test_the_size_of_a_surface_includes_parts_behind_a_hole() -> None:
    """The parts on both sides of unmeasured cells count together; evidence merges them later."""
    small = replace(PLAIN, min_cells=6)
    row = [900, 905, 910, 0, 0, 0, 0, 915, 905, 900]
    assert found([row], config=small) == [[0, 0, 0, -1, -1, -1, -1, 1, 1, 1]]
    column = [[z] for z in row]
    assert found(column, config=small) == [[0]] * 3 + [[-1]] * 4 + [[1]] * 3
    nothing = [[-1] * 10]
    assert found([row], config=replace(small, min_cells=7)) == nothing
    assert found([row], config=replace(small, hole_cells=3)) == nothing
    assert found([row], config=replace(small, hole_cells=0)) == nothing
    stepped = [900, 905, 910, 0, 0, 0, 0, 945, 905, 900]
    assert found([stepped], config=small) == nothing
    seen_through = [900, 905, 910, 0, 2000, 0, 0, 915, 905, 900]
    assert found([seen_through], config=small) == nothing


@given(masks)
def test_equal_depths_are_labelled_as_in_scipy(keep: np.ndarray) -> None:
    z = np.full(keep.shape, 1000, np.int32)
    want = np.zeros(keep.shape, np.int32)
    ndimage.label(keep, output=want)
    np.testing.assert_array_equal(surfaces(z, keep, UNIT, PLAIN), want - 1)


@given(depths, masks)
def test_surfaces_divided_by_steps_equal_components_of_a_graph(
    z: np.ndarray, keep: np.ndarray
) -> None:
    keep = keep & (z > 0)
    links = [
        (a * 12 + b, c * 12 + d)
        for a in range(9)
        for b in range(12)
        for c, d in ((a + 1, b), (a, b + 1))
        if c < 9 and d < 12 and keep[a, b] and keep[c, d] and abs(z[a, b] - z[c, d]) <= 30
    ]
    row, column = np.array(links, int).reshape(-1, 2).T
    graph = coo_array((np.ones(len(links)), (row, column)), shape=(z.size, z.size))
    part = connected_components(graph, directed=False)[1].reshape(z.shape)
    want = renumbered(np.where(keep, part, -1))
    np.testing.assert_array_equal(surfaces(z, keep, UNIT, PLAIN), want)


@given(masks, st.integers(1, 8))
def test_removal_of_small_components_equals_that_of_scipy(mask: np.ndarray, least: int) -> None:
    label = np.zeros(mask.shape, np.int32)
    ndimage.label(mask, np.ones((3, 3)), output=label)
    want = mask & (np.bincount(label.ravel())[label] >= least)
    np.testing.assert_array_equal(without_small(mask, least), want)


@given(masks)
def test_dilation_equals_that_of_scipy(mask: np.ndarray) -> None:
    np.testing.assert_array_equal(dilated(mask), ndimage.binary_dilation(mask, np.ones((3, 3))))


@given(st.integers(1, 40), st.data())
def test_components_equal_those_of_scipy(count: int, data: st.DataObject) -> None:
    node = st.integers(0, count - 1)
    links = data.draw(st.lists(st.tuples(node, node), max_size=60))
    first, second = np.array(links, int).reshape(-1, 2).T
    graph = coo_array((np.ones(len(links)), (first, second)), shape=(count, count))
    part = connected_components(graph, directed=False)[1]
    label = components(count, first, second)
    smallest = [int(np.flatnonzero(part == one)[0]) for one in part]
    assert label.tolist() == smallest


# laws


@given(depths, masks, st.integers(1, 3000))
def test_a_shift_of_all_depths_has_no_influence(
    z: np.ndarray, keep: np.ndarray, shift: int
) -> None:
    keep = keep & (z > 0)
    moved = np.where(z > 0, z + shift, 0).astype(np.int32)
    for config in (PLAIN, replace(CREASED, min_cells=2)):
        np.testing.assert_array_equal(
            surfaces(moved, keep, UNIT, config), surfaces(z, keep, UNIT, config)
        )


@given(depths, masks)
def test_mirrored_and_rotated_cells_have_the_same_partition(
    z: np.ndarray, keep: np.ndarray
) -> None:
    keep = keep & (z > 0)
    label = surfaces(z, keep, UNIT, PLAIN)
    assert same_parts(surfaces(z[:, ::-1], keep[:, ::-1], UNIT, PLAIN)[:, ::-1], label)
    assert same_parts(surfaces(z[::-1], keep[::-1], UNIT, PLAIN)[::-1], label)
    assert same_parts(surfaces(z.T, keep.T, UNIT, PLAIN).T, label)
    step = np.full(z.shape, 30)
    crease = creases(z, step, keep, UNIT, CREASED)
    mirrored = creases(z[:, ::-1], step, keep[:, ::-1], UNIT, CREASED)
    np.testing.assert_array_equal(mirrored[:, ::-1], crease)


@given(depths, masks)
def test_numbers_of_surfaces_have_no_gaps(z: np.ndarray, keep: np.ndarray) -> None:
    keep = keep & (z > 0)
    for config in (PLAIN, replace(CREASED, min_cells=3)):
        label = surfaces(z, keep, UNIT, config)
        assert (label[~keep] == -1).all()
        values, first = np.unique(label[label >= 0], return_index=True)
        assert values.tolist() == list(range(len(values)))
        assert (np.diff(first) > 0).all()


@given(depths)
def test_all_kept_cells_have_a_surface_when_none_is_too_small(z: np.ndarray) -> None:
    np.testing.assert_array_equal(surfaces(z, z > 0, UNIT, PLAIN) >= 0, z > 0)


@pytest.mark.parametrize("margin", range(5))
def test_no_cell_of_a_crease_is_lost(margin: int) -> None:
    """Two walls form a V; all cells of the dilated crease are assigned to them."""
    column = np.arange(41)
    z = np.tile(1500 - 30 * np.abs(column - 20), (20, 1))
    config = replace(SurfaceConfig(), crease_margin=margin, crease_m=0.01, crease_per_m=0.0)
    label = surfaces(z, z > 0, UNIT, config)
    assert (label >= 0).all() and label.max() == 1


@given(arrays(np.int64, (4, 5), elements=st.integers(-3, 6)))
def test_renumbered_is_idempotent_and_keeps_the_partition(label: np.ndarray) -> None:
    one = renumbered(label)
    np.testing.assert_array_equal(renumbered(one), one)
    np.testing.assert_array_equal(one < 0, label < 0)
    pairs = {(a, b) for a, b in zip(label[label >= 0], one[label >= 0], strict=True)}
    assert len(pairs) == len(np.unique(label[label >= 0])) == one.max() + 1


# edges


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 3), (0, 5), (5, 0)])
@pytest.mark.parametrize("config", [PLAIN, SurfaceConfig(min_cells=1), SurfaceConfig()])
def test_small_grids_are_supported(shape: tuple, config: SurfaceConfig) -> None:
    z = np.full(shape, 1000, np.int32)
    label = surfaces(z, z > 0, UNIT, config)
    assert label.shape == shape
    large = z.size >= config.min_cells
    assert (label == (0 if large else -1)).all()
    none = surfaces(0 * z, z < 0, UNIT, config)
    assert (none == -1).all()
    if z.size:
        assert (without_bent_floor(none, z > 0, z, 0 * z, UNIT, config) == -1).all()


def test_an_object_in_a_margin_at_the_lower_image_edge_is_not_bent_floor():
    label, height = np.full((4, 24), -1), np.zeros((4, 24), int)
    label[2:, :2], height[2:, :2] = 0, 60
    forward = np.full((4, 24), 1000)
    config = SurfaceConfig(bent_m=0.2)
    kept = without_bent_floor(label, label < 0, forward, height, 0.001, config)
    np.testing.assert_array_equal(kept, label)


def test_a_speck_is_not_merged_with_cells_far_behind_it():
    z = np.array([[500, 1500, 1500, 1500]], np.int32)
    assert surfaces(z, z > 0, 0.001, SurfaceConfig(min_cells=2)).tolist() == [[-1, 0, 0, 0]]


@pytest.mark.parametrize(("steep", "kept"), [(4, True), (3, False)])
def test_surfaces_are_kept_if_two_thirds_of_their_lowest_cells_are_steep(steep, kept):
    label = np.array([[0] * 5, [-1] * 5])
    height = np.array([[60] * 5, [0] * 5])
    forward = np.array([[1000] * steep + [1400] * (5 - steep), [1000] * 5])
    found = without_bent_floor(label, label < 0, forward, height, 0.001, SurfaceConfig(bent_m=0.2))
    assert (found[0] == (0 if kept else -1)).all()
