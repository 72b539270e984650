"""Image boxes compared with labels: examples by hand, the recordings' script, and properties."""

import json
import subprocess
import sys

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scores.boxes import (
    BoxTally,
    FrameLabels,
    count_tagged,
    heights,
    labels_of_boxes,
    labels_of_image,
    on_known_ground,
    score_boxes,
    tally_boxes,
)
from jaxdet.camera import pixel_rays
from jaxdet.eval.boxes import box_iou, match_boxes, near_surface
from jaxdet.types import Intrinsics

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 20.0)
NONE = np.zeros((0, 4), np.int64)
boxes_drawn = st.lists(
    st.tuples(*[st.integers(0, 12)] * 2, *[st.integers(1, 12)] * 2), max_size=8
).map(lambda rows: np.array([(u, v, u + w, v + h) for u, v, w, h in rows], int).reshape(-1, 4))


def test_iou_counts_pixels():
    one = np.array([[2, 3, 2, 3]])
    assert box_iou(one, one).tolist() == [[1.0]]
    assert box_iou(one, np.array([[2, 3, 3, 3], [3, 3, 4, 3]])).tolist() == [[0.5, 0.0]]
    assert box_iou(NONE, one).shape == (0, 1)


def test_the_largest_overlap_is_paired_first():
    objects = np.array([[0, 0, 9, 9], [0, 0, 9, 5]])
    found = np.array([[0, 0, 9, 7]])
    assert match_boxes(objects, found, 0.5).tolist() == [0, -1]
    assert match_boxes(objects[::-1], found, 0.5).tolist() == [-1, 0]
    assert match_boxes(objects, found, 0.9).tolist() == [-1, -1]


@given(boxes_drawn, boxes_drawn, st.sampled_from([0.1, 0.3, 0.5]))
def test_pairs_are_one_to_one_and_complete(objects, found, least):
    pairs = match_boxes(objects, found, least)
    iou = box_iou(objects, found)
    used = pairs[pairs >= 0]
    assert len(set(used.tolist())) == len(used)
    assert (iou[np.flatnonzero(pairs >= 0), used] >= least).all()
    free = np.setdiff1d(np.arange(len(found)), used)
    assert (iou[np.ix_(pairs < 0, free)] < least).all()


def labels() -> FrameLabels:
    """Return labels of a post before a wall and a box on the floor, 40 x 20 pixels."""
    objects = np.array([[4, 2, 7, 11], [30, 8, 35, 13]])
    wall = np.array([[0, 0, 19, 9]])
    tags = frozenset({"path"}), frozenset({"low", "path"})
    return labels_of_boxes(objects, np.array([1.0, np.nan]), wall, 40, 20, tags)


def tally(found: list[tuple[int, int, int, int]], nearest: list[float]) -> BoxTally:
    kept = np.zeros((20, 40), bool)
    kept[15:] = True
    measured = np.ones((20, 40), bool)
    measured[:, 38:] = False
    boxes = np.array(found).reshape(-1, 4)
    return tally_boxes(labels(), boxes, np.array(nearest), kept, measured, 0.5)


def test_detections_on_unlabelled_walls_do_not_count():
    found = [(4, 2, 7, 10), (0, 0, 18, 9), (30, 8, 35, 13), (20, 15, 25, 19)]
    one = tally(found, [1.1, 1.2, 2.0, 0.5])
    assert one[:5] == (2, 3, 2, 0, 1)
    assert one.errors_m == pytest.approx((0.1,))
    floor = 800 - 200 - 4 * 2 - 36
    assert one.floor_pixels == floor - 2 * 20 and one.floor_kept == 5 * 38
    score = score_boxes([one, tally([], [])])
    assert (score.recall, score.precision) == (0.5, 2 / 3)
    assert (score.swamped, score.on_floor) == (0, 1)
    assert score.floor_kept == one.floor_kept / one.floor_pixels
    assert score.error_median_m == score.error_p90_m == pytest.approx(0.1)


def test_a_box_around_a_small_part_of_an_object_is_a_false_detection():
    one = tally([(4, 2, 7, 4)], [1.0])
    assert (one.detections, one.matched, one.on_floor) == (1, 0, 0)


def test_objects_are_counted_by_their_tags():
    each = [tally([(4, 2, 7, 11)], [1.0]), tally([(30, 8, 35, 13)], [2.0])]
    assert [count_tagged(each, tag) for tag in ("path", "low", "thin")] == [(2, 4), (1, 2), (0, 0)]


def test_a_box_over_more_than_half_of_the_floor_swamps_it():
    assert tally([(0, 0, 39, 19)], [0.3])[:5] == (2, 1, 0, 1, 1)
    assert tally([(20, 0, 39, 14)], [0.3]).swamped == 0


def test_figures_without_objects_and_detections_are_nan():
    score = score_boxes([BoxTally()])
    assert np.isnan([score.recall, score.precision, score.floor_kept, score.error_p90_m]).all()


def test_the_near_surface_ignores_single_nearer_depths():
    assert np.isnan(near_surface(np.zeros(0)))
    deep = np.concatenate([np.full(50, 2.0), np.full(30, 1.5), [0.1]])
    assert near_surface(deep) == 1.5


def tilted(low_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return labels and depth of a floor 0.5 m below a tilted camera, with blocks on it."""
    down = np.array([0.1, 0.9, 0.42])
    down /= np.linalg.norm(down)
    slope = np.stack([*pixel_rays(CAMERA), np.ones((48, 64))], axis=-1) @ down
    image, height = np.zeros((48, 64), np.uint8), np.zeros((48, 64))
    image[20:] = 1
    for key, u, up in ((2, 5, low_m), (3, 30, 0.1)):
        image[25:35, u : u + 10], height[25:35, u : u + 10] = key, up
    return image, np.where(image > 0, (0.5 - height) / np.where(image > 0, slope, 1), 0)


def test_heights_over_a_tilted_floor():
    image, z_m = tilted(0.03)
    z_m[40, :9] *= 0.9
    height_m = heights(z_m, image == 1, CAMERA)
    np.testing.assert_allclose(height_m[image == 2], 0.03, atol=1e-9)
    np.testing.assert_allclose(height_m[image == 3], 0.1, atol=1e-9)
    with pytest.raises(ValueError, match="only 0 floor pixels have depth"):
        heights(z_m, image == 9, CAMERA)


def test_label_images_give_objects_with_a_minimum_size_and_height():
    image, z_m = tilted(0.03)
    every = labels_of_image(image, z_m, CAMERA)
    assert every.boxes.tolist() == [[5, 25, 14, 34], [30, 25, 39, 34]]
    assert every.distance_m[1] == near_surface(z_m[image == 3])
    assert np.array_equal(every.known, image > 0) and np.array_equal(every.floor, image == 1)
    high = labels_of_image(image, z_m, CAMERA, least_height_m=0.05)
    assert high.boxes.tolist() == [[30, 25, 39, 34]]
    assert not high.known[image == 2].any() and high.known[image == 3].all()
    assert on_known_ground(every, every.boxes).tolist() == [True, True]
    assert on_known_ground(high, every.boxes).tolist() == [False, True]
    assert labels_of_image(image, z_m, CAMERA, least_pixels=101).boxes.shape == (0, 4)
    image[image == 3] = 0
    assert labels_of_image(image, z_m, CAMERA, least_height_m=0.05).boxes.shape == (0, 4)


@pytest.mark.parametrize(
    ("name", "least_pixels", "least_iou"), [("mosd", 300, 0.5), ("wheelchair", 150, 0.3)]
)
def test_counts_equal_the_script_of_the_recordings(
    shared_data, tmp_path, name, least_pixels, least_iou
):
    folder, rng = shared_data / "labelled", np.random.default_rng(5)
    rows, mine = [], []
    for frame, path in enumerate(sorted((folder / f"{name}_labels").glob("*.png"))):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        size = image.shape[::-1] * 2
        truth = labels_of_image(
            image, np.zeros(image.shape), Intrinsics(*size[:2], 1, 1, 0, 0), least_pixels
        )
        off = rng.normal(0, 12, (3, *truth.boxes.shape)).round().astype(int)
        drawn = np.sort(rng.integers(0, size, (3, 4)).reshape(3, 2, 2), axis=1).reshape(3, 4)
        boxes = np.concatenate([*(truth.boxes + off), drawn])
        boxes = np.clip(boxes, 0, np.array(size) - 1)
        boxes[:, 2:] = np.maximum(boxes[:, 2:], boxes[:, :2])
        nothing = np.zeros(image.shape, bool)
        mine.append(tally_boxes(truth, boxes, np.zeros(len(boxes)), nothing, nothing, least_iou))
        rows += [(f"logs/{name}", frame, *box) for box in boxes.tolist()]
    columns = ("log", "frame", "u_min", "v_min", "u_max", "v_max")
    table = pa.table(dict(zip(columns, map(list, zip(*rows, strict=True)), strict=True)))
    pq.write_table(table, tmp_path / "obstacles.parquet")
    command = [sys.executable, str(folder / "score.py"), str(tmp_path), name, "--json"]
    theirs = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    counts = {key: sum(getattr(one, key) for one in mine) for key in BoxTally._fields[:3]}
    assert {key: theirs["all"][key] for key in counts} == counts
    assert min(counts.values()) > 0
    assert [frame for frame, one in enumerate(mine) if one.swamped] == theirs["swamped_frames"]
