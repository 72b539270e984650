"""The systems we compare with: by hand, against other code, and all through one scoring."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("sklearn")
pytest.importorskip("scipy")

from benchmarks.baselines import (
    BASELINES,
    Frame,
    detect_with,
    labels_of,
    points_of,
    prepare,
    run_frames,
    tune,
)
from benchmarks.baselines.dense import range_image
from benchmarks.baselines.detector import (
    Boxes,
    OnnxDetector,
    detector_baseline,
    label_boxes,
    letterbox,
    read_output,
    suppress,
)
from benchmarks.baselines.frames import MAX_POINTS, grid_features, labels_at, ordered
from benchmarks.baselines.rsc import nearest_neighbours, rsc_count, rsc_threshold
from jaxdet import reference
from jaxdet.config import Config
from jaxdet.eval import FrameTruth, score
from jaxdet.types import Calibration, Features, Frames, GroundPlane, Intrinsics

CAMERA = Intrinsics(160, 120, 120.0, 120.0, 79.5, 59.5)
CALIBRATION = Calibration(CAMERA)
LEVEL = GroundPlane(np.array([1.0]), np.zeros(1), np.zeros(1), np.array([True]))
CONFIG = Config()
BOXES = [(10, 40, 1200), (80, 110, 1600), (125, 150, 2600)]
"""Left and right columns and depth [mm] of three boards in rows 20 to 80."""
PARAMS = {
    "hierarchical_ward": {"distance_m": 3.0},
    "rsc": {"tau": 0.4},
    "rsc_member": {"tau": 0.4},
    "rsc_mean": {"tau": 0.4},
    "rsc_count": {"clusters": 3},
}
"""Where the defaults are not for three boards."""
seeds = st.integers(0, 2**32 - 1)


def board_picture():
    depth = np.full((120, 160), 6000, np.uint16)
    ids = np.zeros((120, 160), np.uint8)
    for number, (left, right, z) in enumerate(BOXES, 1):
        depth[20:80, left:right], ids[20:80, left:right] = z, number
    return depth, ids


@pytest.fixture(scope="module")
def frame():
    """Three boards whose features are a grid every 6 pixels, with 2 mm of noise."""
    depth, ids = board_picture()
    rng = np.random.default_rng(0)
    depth = np.where(ids > 0, depth + rng.integers(-2, 3, depth.shape), depth).astype(np.uint16)
    v, u = np.argwhere(ids[::6, ::6] > 0).T[:, None] * 6
    z = depth[v, u].astype(np.int32)
    x, y = (np.rint(a * z / 120).astype(np.int32) for a in (u - 79.5, v - 59.5))
    yes = np.ones(z.shape, bool)
    features = Features(
        u.astype(np.int32), v.astype(np.int32), x, y, z, yes, yes, np.zeros(1, bool)
    )
    keep = (depth < 4000) & (depth > 0)
    return Frame(np.zeros((120, 160, 3), np.uint8), depth, keep, features, LEVEL, CALIBRATION)


@pytest.fixture(scope="module")
def truth():
    _, ids = board_picture()
    z = np.array([[b[2] / 1000 for b in BOXES]])
    pixels = np.array([[(ids == i).sum() for i in (1, 2, 3)]])
    return FrameTruth(ids[None], pixels, z, z, np.zeros(3, bool))


def runnable(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reason = BASELINES[name].missing
    if reason:
        pytest.skip(reason)
    return BASELINES[name]


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_finds_the_boards(name, frame, truth):
    baseline = runnable(name)
    params = PARAMS.get(name, {})
    tallies = run_frames(baseline, [frame], truth, params)
    figures = score(tallies)
    assert figures.recall == 1 and figures.precision == 1
    assert figures.position_error_m < 0.01
    found = detect_with(baseline, frame, CONFIG, params)
    assert found.labels.labels.dtype == np.int32 and found.labels.num_obstacles.tolist() == [3]
    assert found.labels.labels[0, 0] in (0, 1, 2)
    few = replace(CONFIG, cluster=replace(CONFIG.cluster, min_points=10**6))
    assert detect_with(baseline, frame, few, params).labels.num_obstacles.tolist() == [0]


@pytest.mark.parametrize("name", BASELINES)
def test_every_baseline_bears_little(name, frame):
    baseline = runnable(name)
    for count in (0, 1, 2, 3, 11):
        kept = frame.features.kept & (np.arange(frame.features.kept.shape[1]) < count)
        few = frame._replace(features=frame.features._replace(kept=kept))
        found = detect_with(baseline, few, CONFIG)
        assert (found.labels.labels[~kept] == -1).all()
        if baseline.space == "image":
            empty = few._replace(keep=np.zeros_like(frame.keep))
            assert detect_with(baseline, empty, CONFIG, on="grid").labels.num_obstacles == [0]


def test_the_registry():
    assert next(iter(BASELINES)) == "ours"
    for name, baseline in BASELINES.items():
        assert baseline.name == name and baseline.citation and baseline.title
        assert set(baseline.grid) <= {*baseline.defaults, "depth_scale"}
        assert 5 <= len(baseline.trials()) <= 60


def test_ours_is_the_reference(frame):
    found = detect_with(BASELINES["ours"], frame, CONFIG)
    expected = reference.cluster(frame.features, 0.001, CONFIG)
    np.testing.assert_array_equal(found.labels.labels, expected.labels)
    outlines = reference.footprint(frame.features, expected, LEVEL, 0.001, CONFIG)
    for ours, theirs in zip(found.obstacles, outlines, strict=True):
        np.testing.assert_array_equal(ours[:, :3], theirs[:, :3])
        assert not ours[:, 3:].any()


def test_single_linkages_agree():
    rng = np.random.default_rng(3)
    points = rng.random((80, 2))
    one = labels_of(BASELINES["scipy_single"], points, CONFIG, {"distance_m": 0.1})
    two = labels_of(BASELINES["hierarchical_single"], points, CONFIG, {"distance_m": 0.1})
    x, z = points.T
    np.testing.assert_array_equal(ordered(one, z, x, 2), ordered(two, z, x, 2))
    scaled = {"distance_m": 0.1, "depth_scale": 2.0}
    twice = labels_of(BASELINES["scipy_single"], points, CONFIG, scaled)
    stretched = labels_of(BASELINES["scipy_single"], points * [1, 2], CONFIG, {"distance_m": 0.1})
    np.testing.assert_array_equal(twice, stretched)


def test_order_and_size():
    labels, z = np.array([4, 4, 2, 2, 2, 9, -1]), np.array([5, 3, 1, 9, 9, 0, 0])
    assert ordered(labels, z, z, 1).tolist() == [1, 1, 0, 0, 0, -1, -1]
    assert ordered(labels, z, z, 2).tolist() == [-1, -1, 0, 0, 0, -1, -1]


# --- RSC (our reading) ---


def naive_rsc(points, tau, root):
    """Level by level with dictionaries, as the module's text says it."""
    clusters = [([i], np.array(p, float)) for i, p in enumerate(points)]
    while len(clusters) > 1:
        centre = np.array([c for _, c in clusters])
        gap = np.sqrt(((centre[:, None] - centre) ** 2).sum(-1))
        np.fill_diagonal(gap, np.inf)
        nearest = gap.argmin(1)
        short = gap.min(1) <= tau
        if not short.any():
            break
        group = list(range(len(clusters)))
        for i in np.flatnonzero(short):
            a, b = group[i], group[nearest[i]]
            group = [a if g == b else g for g in group]
        merged = []
        for name in sorted(set(group), key=group.index):
            members = [i for i, g in enumerate(group) if g == name]
            leaves = [leaf for i in members for leaf in clusters[i][0]]
            place = clusters[members[0]][1]
            for i in members:
                j = int(nearest[i])
                if len(members) > 1 and nearest[j] == i and i < j:
                    place = centre[i] if root == "member" else (centre[i] + centre[j]) / 2
            if root == "mean":
                place = np.mean([points[leaf] for leaf in leaves], axis=0)
            merged.append((leaves, place))
        clusters = merged
    labels = np.zeros(len(points), int)
    for number, (leaves, _) in enumerate(clusters):
        labels[leaves] = number
    return labels


def same_partition(a, b):
    pairs = np.unique(np.stack([a, b]), axis=1).shape[1]
    return pairs == len(np.unique(a)) == len(np.unique(b))


@given(
    seeds, st.integers(2, 40), st.floats(0.02, 0.6), st.sampled_from(["midpoint", "member", "mean"])
)
def test_rsc_equals_the_naive_form(seed, n, tau, root):
    points = np.random.default_rng(seed).random((n, 2))
    assert same_partition(rsc_threshold(points, tau, root), naive_rsc(points, tau, root))


def test_rsc_by_hand():
    line = np.array([[0.0], [1.0], [2.1], [10.0], [11.0], [30.0]])
    assert same_partition(rsc_threshold(line, 0.5), np.arange(6))
    assert same_partition(rsc_threshold(line, 1.0), np.array([0, 0, 2, 3, 3, 5]))
    assert same_partition(rsc_threshold(line, 1.1), np.array([0, 0, 0, 3, 3, 5]))
    # Roots 0.5 and 10.5: 10 apart; then 5.5 and 30.
    assert same_partition(rsc_threshold(line, 10.0), np.array([0, 0, 0, 0, 0, 5]))
    assert len(np.unique(rsc_threshold(line, 24.5))) == 1


@given(seeds, st.integers(2, 60), st.integers(1, 70), st.booleans())
def test_rsc_gives_the_count_and_nests(seed, n, clusters, grid):
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 4, (n, 2)).astype(float) if grid else rng.random((n, 2))
    labels = rsc_count(points, clusters)
    assert len(np.unique(labels)) == min(n, clusters)
    if clusters < n:
        finer = rsc_count(points, clusters + 1)
        assert np.unique(np.stack([labels, finer]), axis=1).shape[1] == clusters + 1


@given(seeds, st.integers(2, 200), st.integers(1, 5))
def test_nearest_of_equals_is_the_lowest_index(seed, n, values):
    points = np.random.default_rng(seed).integers(0, values, (n, 2)).astype(float)
    gap = np.sqrt(((points[:, None] - points) ** 2).sum(-1))
    np.fill_diagonal(gap, np.inf)
    nearest, length = nearest_neighbours(points)
    np.testing.assert_array_equal(nearest, gap.argmin(1))
    np.testing.assert_array_equal(length, gap.min(1))


# --- Dense methods ---


def test_range_image_by_hand(frame):
    labels = range_image(frame, 10.0)
    assert (labels[~frame.keep] == -1).all()
    names = [np.unique(labels[22:78, left + 2 : right - 2]) for left, right, _ in BOXES]
    assert all(len(n) == 1 for n in names) and len({int(n[0]) for n in names}) == 3
    # A wall seen at an angle whose depth grows by 8 mm a pixel: beta is 50 degrees at 1.2 m.
    slope = (1200 + 8 * np.arange(160)).astype(np.uint16)
    wall = frame._replace(z=np.tile(slope, (120, 1)), keep=np.ones((120, 160), bool))
    assert len(np.unique(range_image(wall, 30.0))) == 1
    assert len(np.unique(range_image(wall, 80.0))) > 100


def test_grid_and_labels_at(frame):
    grid = grid_features(frame, 4)
    assert frame.keep[grid.v, grid.u].all() and (grid.u % 4 == 0).all()
    np.testing.assert_array_equal(grid.z, frame.z[grid.v, grid.u])
    full = frame._replace(keep=np.ones((120, 160), bool))
    assert MAX_POINTS / 3 < grid_features(full, 1).z.shape[1] <= MAX_POINTS
    image = np.full((5, 5), -1, np.int32)
    image[2, 2], image[2, 4] = 7, 8
    u, v = np.array([0, 3, 4, 0]), np.array([2, 2, 1, 0])
    assert labels_at(image, u, v).tolist() == [7, 7, 8, 7]
    assert labels_at(image, u, v, 1).tolist() == [-1, 7, 8, -1]
    with pytest.raises(ValueError, match="works on features"):
        detect_with(BASELINES["dbscan"], frame, on="grid")


# --- The detector ---

ROWS = np.zeros((1, 5, 7), np.float32)
ROWS[0, :, :5] = [
    [25, 50, 30, 60, 0.9],
    [26, 51, 30, 60, 0.8],
    [95, 50, 30, 60, 0.7],
    [95, 50, 30, 60, 0.6],
    [10, 10, 5, 5, 0.1],
]
ROWS[0, :, 5:] = [[1, 0], [1, 0], [1, 0], [0, 1], [1, 0]]


def save_model(path, output):
    """A model that says the same of every picture."""
    helper = pytest.importorskip("onnx.helper")
    numpy_helper = pytest.importorskip("onnx.numpy_helper")
    onnx = pytest.importorskip("onnx")
    kind = onnx.TensorProto.FLOAT
    given = helper.make_tensor_value_info("images", kind, [1, 3, 160, 160])
    result = helper.make_tensor_value_info("output", kind, list(output.shape))
    nodes = [
        helper.make_node("ReduceMax", ["images"], ["peak"], keepdims=0),
        helper.make_node("Sub", ["peak", "peak"], ["zero"]),
        helper.make_node("Add", ["rows", "zero"], ["output"]),
    ]
    rows = numpy_helper.from_array(output, "rows")
    graph = helper.make_graph(nodes, "tiny", [given], [result], [rows])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save(model, str(path))


def test_a_detector_by_onnxruntime(tmp_path, frame, truth):
    pytest.importorskip("onnxruntime")
    # The picture 160 x 120 lies 20 rows lower in the input of 160 x 160.
    save_model(tmp_path / "tiny.onnx", ROWS + np.eye(7, dtype=np.float32)[1] * 20)
    detector = OnnxDetector(tmp_path / "tiny.onnx")
    boxes = detector(frame.color)
    np.testing.assert_allclose(boxes.corners[0], [10, 20, 40, 80], atol=1e-3)
    assert boxes.classes.tolist() == [0, 0, 1]
    only = OnnxDetector(tmp_path / "tiny.onnx", classes=(1,))
    assert len(only(frame.color).scores) == 1
    baseline = detector_baseline(detector, "Tiny")
    assert baseline.missing is None
    for on in ("features", "grid"):
        figures = score(run_frames(baseline, [frame], truth, on=on))
        assert figures.recall == pytest.approx(2 / 3) and figures.precision == 1
    ended = np.array([[0, 10, 40, 40, 100, 3, 0.9], [0, 0, 20, 9, 30, 3, 0.1]], np.float32)
    save_model(tmp_path / "ended.onnx", ended)
    boxes = OnnxDetector(tmp_path / "ended.onnx")(frame.color)
    np.testing.assert_allclose(boxes.corners, [[10, 20, 40, 80]], atol=1e-3)
    assert boxes.classes.tolist() == [3]


def test_reading_outputs():
    boxes = read_output(ROWS.astype(float), 0.25, 0.45)
    assert boxes.scores == pytest.approx([0.9, 0.7, 0.6])
    assert boxes.corners[0].tolist() == [10, 20, 40, 80]
    assert len(read_output(np.zeros((1, 0, 85)), 0.25, 0.45).scores) == 0
    for bad in (np.zeros((1, 84)), np.zeros((2, 10, 85)), np.zeros((1, 10, 4))):
        with pytest.raises(ValueError, match="neither"):
            read_output(bad, 0.25, 0.45)


def test_suppression_equals_opencv():
    cv2 = pytest.importorskip("cv2")
    rng = np.random.default_rng(2)
    low = rng.integers(0, 60, (60, 2)).astype(float)
    size = rng.integers(5, 40, (60, 2)).astype(float)
    scores = rng.permutation(60) / 60 + 0.01
    boxes = Boxes(np.hstack([low, low + size]), scores, np.zeros(60, np.int64))
    theirs = cv2.dnn.NMSBoxes(np.hstack([low, size]).tolist(), scores.tolist(), 0.0, 0.45)
    assert suppress(boxes, 0.45).tolist() == np.ravel(theirs).tolist()
    apart = boxes._replace(classes=np.arange(60))
    assert len(suppress(apart, 0.45)) == 60


def test_boxes_to_labels(frame):
    corners = np.array([[5.0, 15, 90, 85], [60, 15, 115, 85], [-5, -5, -1, -1]])
    boxes = Boxes(corners, np.ones(3), np.zeros(3, np.int64))
    labels = label_boxes(boxes._replace(corners=np.maximum(corners, 0)), frame, 0.05)
    assert set(np.unique(labels[20:80, 10:40])) == {0}
    assert set(np.unique(labels[20:80, 80:110])) == {1}
    assert (labels[~frame.keep] == -1).all() and labels.max() == 1


def test_letterbox():
    picture, scale, left, top = letterbox(np.full((60, 120, 3), 9, np.uint8), 64, 64)
    assert picture.shape == (64, 64, 3) and (left, top) == (0, 16)
    assert scale == pytest.approx(64 / 120)
    assert (picture[:16] == 114).all() and (picture[16:48] == 9).all()


# --- Tuning and preparing ---


def test_tune(frame, truth):
    baseline = replace(BASELINES["scipy_single"], grid={"distance_m": (0.01, 0.2, 0.3, 9.0)})
    best = tune(baseline, [frame], truth)
    assert best.params == {"distance_m": 0.2} and best.value == 1
    assert [value for _, value in best.trials] == [
        pytest.approx(v, nan_ok=True) for v in (0, 1, 1, 0)
    ]
    worst = tune(baseline, [frame], truth, lambda figures: -figures.f1)
    assert worst.params == {"distance_m": 0.01}


def test_prepare_is_the_pipeline():
    depth, _ = board_picture()
    rng = np.random.default_rng(1)
    color = rng.integers(0, 255, (2, 120, 160, 3), np.uint8)
    zeros = np.zeros(2, np.int64)
    plane = GroundPlane(*(np.repeat(a, 2) for a in LEVEL))
    frames = Frames(
        color, np.stack([depth, depth]), CALIBRATION, zeros, zeros, zeros,
        np.array([True, False]), plane=plane,
    )  # fmt: skip
    prepared = prepare(frames)
    assert len(prepared) == 1
    aligned = reference.align(frames.depth, CALIBRATION)
    keep = reference.ground(aligned, plane, CALIBRATION, CONFIG)
    expected = reference.features(color, aligned, keep, CALIBRATION, CONFIG.features)
    np.testing.assert_array_equal(prepared[0].features.u[0], expected.u[0])
    np.testing.assert_array_equal(prepared[0].keep, keep.mask[0])
    n = int(expected.kept[0].sum())
    assert points_of(prepared[0]).shape == (n, 2) and points_of(prepared[0], "xyz").shape == (n, 3)
    flags = replace(CONFIG, ground=replace(CONFIG.ground, camera_height_m=1.0))
    again = prepare(frames._replace(plane=None), flags)
    np.testing.assert_array_equal(again[0].keep, prepared[0].keep)
    none = replace(CONFIG, ground=replace(CONFIG.ground, source="none"))
    assert not prepare(frames._replace(plane=None), none)[0].plane.valid[0]


def test_a_missing_module_is_named():
    lost = replace(BASELINES["dbscan"], needs=("no_such_module",))
    assert "no_such_module" in str(lost.missing)
    assert BASELINES["dbscan"].missing is None
