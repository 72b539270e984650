"""``--truth labels.json``: labelled boxes, in COCO format or as a plain list."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxdet.cli import main
from jaxdet.errors import InputError
from jaxdet.eval.boxes import BoxLabels, evaluate_boxes
from jaxdet.eval.labels import read_labels
from jaxdet.results.reading import open_results
from jaxdet.sim import load_depths

COCO = {
    "images": [
        {"id": 7, "file_name": "images/drive_000012.jpg", "width": 640, "height": 480},
        {"id": 8, "file_name": "left.png", "frame": 3},
        {"id": 9, "file_name": "right.png", "stamp_ns": 1_700_000_000_000_000_000},
    ],
    "annotations": [
        {"image_id": 7, "bbox": [10, 20, 30, 40]},
        {"image_id": 7, "bbox": [0.5, 0, 10, 10], "iscrowd": 1},
        {"image_id": 8, "bbox": [1, 2, 3, 4], "distance_m": 1.5},
    ],
}


def write(folder: Path, content: Any) -> Path:
    path = folder / "labels.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def test_labels_in_coco_format_are_read(tmp_path: Path) -> None:
    labels = read_labels(write(tmp_path, COCO))
    assert labels.keys() == {("frame", 12), ("frame", 3), ("stamp_ns", 1_700_000_000_000_000_000)}
    first = labels["frame", 12]
    assert first.boxes.tolist() == [[10, 20, 39, 59]] and first.size == (640, 480)
    assert first.ignored.tolist() == [[0.5, 0, 9.5, 9]] and np.isnan(first.distance_m).all()
    assert labels["frame", 3].distance_m.tolist() == [1.5] and labels["frame", 3].size is None
    assert labels["stamp_ns", 1_700_000_000_000_000_000].boxes.shape == (0, 4)


def test_labels_in_a_plain_list_are_read(tmp_path: Path) -> None:
    rows = [
        {"frame": 1, "box": [10, 20, 39, 59], "distance_m": 2},
        {"image": "rgb/frame-000001.png", "box": [0, 0, 4, 4]},
        {"frame": 1, "box": [50, 50, 59, 59], "ignore": True},
        {"frame": 2},
    ]
    labels = read_labels(write(tmp_path, rows))
    assert labels.keys() == {("frame", 1), ("frame", 2)}
    assert labels["frame", 1].boxes.tolist() == [[10, 20, 39, 59], [0, 0, 4, 4]]
    assert labels["frame", 1].ignored.tolist() == [[50, 50, 59, 59]]
    assert len(labels["frame", 2].boxes) == 0


BAD = {
    "not JSON": ("{", r"invalid JSON \(.*; pass a COCO file, or a list \[\{.frame.: 12"),
    "deep": ("[" * 100_000, "invalid JSON"),
    "a number": ("3", "not a list of labels"),
    "no images": ({"annotations": []}, "key 'images' is missing"),
    "no such image": (
        {"images": [], "annotations": [{"image_id": 4, "bbox": [0, 0, 1, 1]}]},
        "annotation 0: unknown image 4",
    ),
    "no frame": (
        [{"image": "left.png", "box": [0, 0, 1, 1]}],
        'label 0: the frame number .*add the key "frame"',
    ),
    "three numbers": ([{"frame": 0, "box": [0, 0, 1]}], r"label 0: box must be 4 numbers, got \[0"),
    "not finite": ('[{"frame": 0, "box": [0, 0, 1, NaN]}]', "box must be 4 numbers"),
    "maximum below minimum": (
        [{"frame": 0, "box": [5, 0, 1, 4]}],
        "label 0: box has a maximum below its minimum",
    ),
    "distance": ([{"frame": 0, "box": [0, 0, 1, 4], "distance_m": "2 m"}], "must be metres"),
    "a string": (["frame 12"], "labels.json: "),
}


@pytest.mark.parametrize("name", BAD)
def test_errors_name_the_file_and_the_entry(name: str, tmp_path: Path) -> None:
    content, problem = BAD[name]
    with pytest.raises(InputError, match=problem) as raised:
        read_labels(write(tmp_path, content))
    assert str(raised.value).startswith(str(tmp_path)) and "\n" not in str(raised.value)


def test_detections_are_matches_false_positives_or_ignored() -> None:
    boxes = np.array([[0, 0, 9, 9], [20, 0, 29, 9], [40, 0, 49, 9]], float)
    ignored = np.array([[100, 0, 119, 9]], float)
    labels = BoxLabels(boxes, np.array([1.0, 2.0, 3.0]), ignored)
    found = np.array([
        [0, 0, 9, 9],  # match
        [20, 0, 29, 9],  # matches an object that is not required
        [42, 0, 60, 9],  # IoU 8 / 21
        [110, 0, 125, 9],  # 10 of 16 columns are in the ignored box
        [115, 0, 130, 9],  # 5 of 16 columns are in the ignored box
        [0, 0, -1, -1],  # outside of the image
    ])  # fmt: skip
    required = np.array([True, False, True])
    tally = evaluate_boxes(labels, required, found, np.array([1.1, 2.0, 3.0, 1.0, 1.0, 1.0]))
    assert (tally.visible, tally.found, tally.matched, tally.detections) == (2, 1, 2, 6)
    assert (tally.false, tally.ignored) == (2, 3)
    errors = [case.nearest_error_m for case in tally.cases]
    assert errors[0] == pytest.approx(0.1) and np.isnan(errors[1])


@pytest.fixture
def scored(drive: Path, tmp_path: Path) -> Callable[[Any], dict[str, Any]]:
    """Return a function that scores the simulated drive against labels."""

    def run(labels: Any) -> dict[str, Any]:
        path, out = write(tmp_path, labels), tmp_path / "out"
        args = ["--output", str(out), "--workers", "1", "--batch-size", "16", "-q", "-y"]
        log = str(drive / "drive.mcap")
        assert main(["run", log, *args, "--pictures", "0", "--truth", str(path)]) == 0
        return json.loads((out / "drive" / "summary.json").read_text())["logs"][0]["score"]

    return run


def test_results_as_labels_have_a_perfect_score(
    drive: Path, scored: Callable[[Any], dict[str, Any]]
) -> None:
    with open_results(drive / "out") as results:
        obstacles = results.tables().obstacles.to_pandas()
    shown = obstacles[obstacles.u_min.notna()]
    sides = ["u_min", "v_min", "u_max", "v_max"]
    rows = [
        {"frame": row.frame, "box": [int(row[s]) for s in sides], "distance_m": row.distance_m}
        for _, row in shown.iterrows()
    ]
    score = scored(rows)
    assert score["frames"] == 5 and score["visible"] == score["found"] == len(shown) > 20
    assert score["recall"] == score["precision"] == 1 and score["false"] == 0
    assert score["nearest_error_p90_m"] < 1e-6
    half = [row for row in rows if row["frame"] != 2][::2] + [{"frame": 2}]
    score, empty = scored(half), (shown.frame == 2).sum()
    assert score["found"] == len(half) - 1 and score["recall"] == 1
    assert score["false"] == len(shown) - (len(half) - 1) >= empty
    everything = [{"frame": 3, "box": [0, 0, 319, 239], "ignore": True}]
    score = scored(everything)
    assert score["frames"] == 1 and score["false"] == 0 and score["precision"] is None
    assert score["ignored"] == (obstacles.frame == 3).sum()


def test_far_and_unmeasured_objects_are_not_required(
    drive: Path, scored: Callable[[Any], dict[str, Any]]
) -> None:
    depths = load_depths(drive / "drive.mcap", np.array([0]))[0]
    far = (depths[10:20] > 7).all(axis=0)  # columns of the far wall
    u = int(np.median(np.flatnonzero(np.convolve(far, np.ones(5), "same") == 5)))
    wall = [u - 2, 10, u + 2, 19]
    outside = [400, 300, 420, 320]
    score = scored([{"frame": 0, "box": wall}, {"frame": 0, "box": outside}])
    assert score["visible"] == 0 and score["recall"] is None and score["false"] > 0


def test_a_run_reports_the_score_on_labels(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = str(drive / "drive.mcap"), str(tmp_path / "out")
    coco = {
        "images": [{"id": 1, "frame": 0, "width": 640, "height": 480}],
        "annotations": [],
    }
    path = str(write(tmp_path, coco))
    args = ["--output", out, "--workers", "1", "--pictures", "0", "--truth", path]
    assert main(["run", log, *args]) == 1
    problem = (
        "labels.json: the labels are for images of 640 x 480 pixels, but the log has 320 x 240"
    )
    assert problem in capsys.readouterr().err
    other = tmp_path / "other.mcap"
    other.write_bytes((drive / "drive.mcap").read_bytes())
    assert main(["run", log, str(other), *args, "-y"]) == 2
    message = "labels refer to one log, got 2 logs; run the logs one by one"
    assert message in capsys.readouterr().err
    write(tmp_path, [{"frame": 0, "box": [100, 100, 140, 160]}])
    assert main(["run", log, *args, "-y"]) == 0
    assert "distance_m not compared: the floor or the true" in capsys.readouterr().out
