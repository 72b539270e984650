"""The ONNX detector: on a tiny model made here, suppression against OpenCV, boxes to obstacles."""

import numpy as np
import pytest

pytest.importorskip("sklearn")
pytest.importorskip("scipy")

from benchmarks.baselines import run_frames
from benchmarks.baselines.detector import (
    Boxes,
    OnnxDetector,
    detector_baseline,
    label_boxes,
    letterbox,
    read_output,
    suppress,
)
from jaxdet.eval import score
from tests.boards import board_frame, board_truth


@pytest.fixture(scope="module")
def frame():
    return board_frame()


@pytest.fixture(scope="module")
def truth():
    return board_truth()


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
