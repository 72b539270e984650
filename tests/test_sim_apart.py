"""Objects of a random scene do not intersect."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from jaxdet.sim import FAMILIES, HARD_FAMILIES, Scene, make_scene
from jaxdet.sim.apart import CLEAR_M, apart
from jaxdet.sim.appearance import WOOD
from jaxdet.sim.families import draw_scene
from jaxdet.sim.mesh import Mesh, shift
from jaxdet.sim.models import build_model
from jaxdet.sim.scene import Box, Cylinder, Model, Path, Wall
from jaxdet.sim.shapes import box, cylinder
from jaxdet.sim.solid import TOUCH_M, gap, intersect, solid_of
from jaxdet.sim.world import object_mesh

SQUARE = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


def pierces(one: Mesh, other: Mesh) -> bool:
    """Return whether an edge of a mesh penetrates a triangle of another by TOUCH_M or more.

    Möller and Trumbore, Journal of Graphics Tools 2 (1997), 21-28.
    """
    low, high = (np.array(m.corners.reshape(-1, 3)) for m in (one, other))
    low, high = np.maximum(low.min(0), high.min(0)), np.minimum(low.max(0), high.max(0))
    if (high - low <= TOUCH_M).any():
        return False
    near = [
        m.corners[((m.corners.max(1) >= low) & (m.corners.min(1) <= high)).all(axis=1)]
        for m in (one, other)
    ]
    if not all(map(len, near)):
        return False
    edges = np.stack([near[0], np.roll(near[0], -1, axis=1)], axis=2).reshape(-1, 1, 2, 3)
    a, u, v = near[1][:, 0], near[1][:, 1] - near[1][:, 0], near[1][:, 2] - near[1][:, 0]
    normal = np.cross(u, v)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    start, end = (((edges[:, :, k] - a) * normal).sum(axis=-1) for k in (0, 1))
    far = (start * end < 0) & (np.minimum(abs(start), abs(end)) > TOUCH_M)
    i, j = np.nonzero(far)
    share = start[i, j] / (start[i, j] - end[i, j])
    hit = edges[i, 0, 0] + share[:, None] * (edges[i, 0, 1] - edges[i, 0, 0]) - a[j]
    solved = np.linalg.solve(np.stack([u, v, normal], axis=2)[j], hit[..., None])[..., 0]
    return bool(((solved[:, :2] > 0).all(axis=1) & (solved[:, :2].sum(axis=1) < 1)).any())


def in_each_other(scene: Scene, times: tuple[float, ...] = (0.0,)) -> list[tuple[str, str]]:
    """Return the names of pairs of intersecting objects; pairs of walls or moving objects are left
    out.
    """
    found = []
    objects = scene.objects
    fixed = [isinstance(one, Wall) or getattr(one, "path", None) is not None for one in objects]
    for time in times:
        meshes = [object_mesh(scene, j, time) for j in range(len(objects))]
        for i, j in combinations(range(len(objects)), 2):
            if fixed[i] and fixed[j]:
                continue
            if any(pierces(meshes[a], meshes[b]) for a, b in ((i, j), (j, i))):
                found.append((scene.names[i], scene.names[j]))
    return found


@pytest.mark.parametrize("family", FAMILIES)
def test_objects_do_not_intersect(family):
    """The check, edges against triangles, is independent of how scenes are drawn."""
    for seed in range(2):
        scene = make_scene(family, seed)
        times = tuple(np.arange(0.0, 30.0, 7.4)) if scene.moves else (0.0,)
        assert in_each_other(scene, times) == [], seed


def test_random_objects_intersect_unless_they_are_moved_apart():
    """Otherwise ``test_objects_do_not_intersect`` could not fail."""
    drawn = [draw_scene(family, seed) for family in ("room", "tables") for seed in range(5)]
    assert sum(bool(in_each_other(scene)) for scene in drawn) >= 3


def test_scenes_without_intersections_do_not_change():
    for family in HARD_FAMILIES:
        for seed in range(2):
            drawn, mended = draw_scene(family, seed), make_scene(family, seed)
            moved = set(mended.objects) - set(drawn.objects)
            assert bool(moved) >= bool(in_each_other(drawn))
            assert replace(drawn, boxes=(), cylinders=(), models=()) == replace(
                mended, boxes=(), cylinders=(), models=()
            )


def test_the_smaller_of_two_intersecting_objects_moves_a_little():
    large, small = Box((2.0, 0.0), (1.0, 1.0, 1.0)), Cylinder((2.3, 0.2), 0.1, 0.5)
    clear = Cylinder((3.5, 0.0), 0.1, 0.5)
    scene = Scene(boxes=(large,), cylinders=(small, clear))
    mended = apart(scene, 3)
    assert mended.boxes == scene.boxes and mended.cylinders[1] == clear
    (x, y), (u, v) = mended.cylinders[0].center, small.center
    assert 0.1 < np.hypot(x - u, y - v) < 1.5
    assert gap(*(solid_of(object_mesh(mended, j, 0.0)).outlines[0] for j in (0, 1))) >= CLEAR_M
    assert apart(scene, 3) == mended != apart(scene, 4)


def test_objects_without_free_space_are_left_out():
    everywhere, small = Box((2.0, 0.0), (8.0, 8.0, 0.5)), Cylinder((2.0, 0.0), 0.1, 0.4)
    scene = Scene(boxes=(everywhere,), cylinders=(small,))
    assert apart(scene, 0) == replace(scene, cylinders=())


def test_objects_stay_in_front_of_walls_and_in_range():
    wall = Wall((3.0, -3.0), (3.0, 3.0))
    thing = Box((3.0, 0.0), (0.4, 0.4, 0.4))
    for seed in range(8):
        x, _ = apart(Scene(boxes=(thing,), walls=(wall,)), seed).boxes[0].center
        assert 0.9 <= x < 3.0 - 0.25


def test_standing_objects_avoid_the_paths_of_moving_ones():
    cart = Model("cart", path=Path((2.0, -1.5), np.pi / 2, 3.0, 1.0))
    thing = Box((2.0, 1.4), (0.3, 0.3, 2.0))
    mended = apart(Scene(boxes=(thing,), models=(cart,)), 0)
    assert mended.models == (cart,) and mended.boxes[0].center != thing.center
    assert in_each_other(mended, tuple(np.arange(0.0, 10.0, 0.5))) == []


@pytest.mark.parametrize(
    ("kind", "x", "expected"),
    [("cable_drum", 0.0, False), ("person", 0.0, True), ("person", 0.9, False)],
)
def test_objects_fit_under_a_table(kind, x, expected):
    table = solid_of(build_model("table", 1))
    assert intersect(table, solid_of(build_model(kind, 2).moved(shift(x)))) == expected


def test_boxes_that_touch_do_not_intersect_and_contained_ones_do():
    base = solid_of(box((1.0, 1.0, 0.5), WOOD))
    inside = solid_of(cylinder(0.1, 0.3, WOOD).moved(shift(z=0.1)))
    on_top = solid_of(box((0.5, 0.5, 0.5), WOOD, (0.0, 0.0, 0.5)))
    adjacent = solid_of(box((1.0, 1.0, 0.5), WOOD, (1.0, 0.0, 0.0)))
    into = solid_of(box((1.0, 1.0, 0.5), WOOD, (0.99, 0.0, 0.0)))
    assert [intersect(base, one) for one in (inside, on_top, adjacent, into)] == [
        True, False, False, True
    ]  # fmt: skip
    assert intersect(base, adjacent, CLEAR_M) and not intersect(base, on_top, CLEAR_M)


def test_distances_of_polygons_match_a_hand_calculation():
    turned = SQUARE @ np.array([[np.cos(0.7), np.sin(0.7)], [-np.sin(0.7), np.cos(0.7)]])
    assert gap(SQUARE, SQUARE + (2.5, 0.3)) == pytest.approx(0.5)
    assert gap(SQUARE, SQUARE + (1.9, 0.3)) == pytest.approx(-0.1)
    assert 0 < gap(SQUARE, turned + (2.5, 0.0)) < 0.5 and gap(SQUARE, SQUARE * 0.2) < -0.7
