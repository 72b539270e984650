"""People and chairs in the report: names, the detector's graph, counts on a synthetic recording."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from benchmarks.paper import detector, labelled, people, section
from benchmarks.paper.detector import CLASSES, Detected, load_detector, to_pixels, why_absent
from benchmarks.paper.lab import Lab
from benchmarks.paper.labelled import BOXES, Recording, read_boxes, read_names
from benchmarks.paper.people import Count, class_of
from benchmarks.paper.plan import Counts
from jaxdet.errors import InputError
from jaxdet.sim import SimConfig, load_obstacle_ids, write_log


@pytest.mark.parametrize("path", sorted(BOXES.glob("*.txt")), ids=lambda path: path.stem)
def test_each_box_of_a_label_file_has_a_name(path):
    boxes, names = read_boxes(path), read_names(path)
    assert {k: len(objects) for k, (objects, *_) in boxes.items()} == {
        k: len(mine) for k, mine in names.items()
    }


def test_names_of_labels_have_the_class_of_their_object():
    people_ = (
        "man with laptop",
        "bald man left",
        "person under a sheet",
        "woman behind",
        "man [cut]",
    )
    chairs = (
        "folding chair with game box",
        "chair, left",
        "black chair behind",
        "wing chair [low]",
    )
    others = (
        "leg of a man",
        "chair leg",
        "desk with draped chair on it",
        "bin behind the chair",
        "",
    )
    assert {class_of(name) for name in people_} == {"person"}
    assert {class_of(name) for name in chairs} == {"chair"}
    assert {class_of(name) for name in others} == {""}


def test_outputs_of_the_network_are_converted_to_boxes_of_the_image():
    rows = np.array([[0, 256, 128, 512, 0.9, 56], [10, 10, 20, 20, 0.29, 0]], np.float32)
    found = to_pixels(rows, (480, 640, 3))
    assert found.boxes.tolist() == [[0, 240, 160, 479]] and found.classes.tolist() == [56]


def coded(*names: str) -> dict[str, object]:
    """Return a graph attribute that is a list of strings."""
    return {"list": {"s": [base64.b64encode(name.encode()).decode() for name in names]}}


def fused(kind: str, after: tuple[str, ...]) -> dict[str, object]:
    """Return the node of a fused convolution with a stride of 512 pixels."""
    steps = {"list": {"i": ["1", "512", "512", "1"]}}
    attributes = {
        "T": {"type": "DT_FLOAT"},
        "data_format": {"s": base64.b64encode(b"NHWC").decode()},
        "dilations": {"list": {"i": ["1", "1", "1", "1"]}},
        "padding": {"s": base64.b64encode(b"VALID").decode()},
        "strides": steps,
        "fused_ops": coded(*after),
    }
    return {"name": "conv", "op": kind, "input": ["tower_0/images", "w", "b"], "attr": attributes}


def test_a_fused_node_is_split_into_its_parts():
    conv, bias, relu = detector.unfused(fused("FusedDepthwiseConv2dNative", ("BiasAdd", "Relu")))
    assert (conv["op"], conv["input"]) == ("DepthwiseConv2dNative", ["tower_0/images", "w"])
    assert (bias["op"], bias["input"]) == ("BiasAdd", [conv["name"], "b"])
    assert (relu["op"], relu["input"], relu["name"]) == ("Relu", [bias["name"]], "conv")


def write_network(folder: Path, last: str = "Reshape") -> tuple[np.ndarray, np.ndarray]:
    """Write a network of one convolution; return its weights ``(3, 6)`` and bias ``(6,)``."""
    rng = np.random.default_rng(0)
    w, b = rng.uniform(0, 1, (3, 6)).astype(np.float16), np.arange(6, dtype=np.float16)
    shape = np.array([1, 1, 6], np.int32)
    (folder / "centernet.bin").write_bytes(w.tobytes() + b.tobytes() + shape.tobytes())
    half = {"dtype": "float32", "quantization": {"dtype": "float16"}}
    manifest = [
        {"name": "w", "shape": [1, 1, 3, 6], **half},
        {"name": "b", "shape": [6], **half},
        {"name": "shape", "shape": [3], "dtype": "int32"},
    ]
    kinds = {"w": "DT_FLOAT", "b": "DT_FLOAT", "shape": "DT_INT32"}
    number, whole = {"type": "DT_FLOAT"}, {"type": "DT_INT32"}
    nodes = [
        {"name": "tower_0/images", "op": "Placeholder", "attr": {"dtype": number}},
        *({"name": k, "op": "Const", "attr": {"dtype": {"type": v}}} for k, v in kinds.items()),
        fused("_FusedConv2D", ("BiasAdd", "Relu")),
        {"name": "tower_0/detections", "op": last, "input": ["conv", "shape"],
         "attr": {"T": number, "Tshape": whole}},
    ]  # fmt: skip
    read = {"modelTopology": {"node": nodes}, "weightsManifest": [{"weights": manifest}]}
    (folder / "centernet.json").write_text(json.dumps(read))
    return w.astype(np.float32), b.astype(np.float32)


def test_the_output_of_a_network_of_one_convolution_by_hand(tmp_path):
    pytest.importorskip("tensorflow")
    w, b = write_network(tmp_path)
    image = np.full((512, 512, 3), (3, 20, 7), np.uint8)
    row = np.maximum(np.float32([3, 20, 7]) @ w + b, 0)
    expected = to_pixels(row[None], image.shape)
    found = load_detector(tmp_path)(image)
    assert found.boxes.tolist() == expected.boxes.tolist() and len(found.boxes) == 1
    assert found.classes.tolist() == expected.classes.tolist()


def test_a_network_that_could_read_files_is_refused(tmp_path):
    pytest.importorskip("tensorflow")
    write_network(tmp_path, "ReadFile")
    with pytest.raises(InputError, match="ReadFile"):
        load_detector(tmp_path)


def test_the_reason_for_a_missing_detector_is_reported(tmp_path, monkeypatch):
    assert "--detector" in why_absent(None)
    assert "no centernet.json" in why_absent(tmp_path)
    (tmp_path / "centernet.json").write_text("{}")
    monkeypatch.setattr(detector, "find_spec", lambda _: None)
    assert why_absent(tmp_path) == "TensorFlow is not installed"


@pytest.fixture
def made(tmp_path, monkeypatch) -> np.ndarray:
    """Write a simulated log of four boxes, labelled man, chair, chair and bin; return its boxes."""
    write_log(tmp_path / "row.mcap", SimConfig(scene="row", frames=1, width=320, height=240,
                                               depth_form="aligned"))  # fmt: skip
    ids = load_obstacle_ids(tmp_path / "row.mcap", [0])[0]
    places = [np.nonzero(ids == k) for k in (1, 2, 3, 4)]
    boxes = np.array([[u.min(), v.min(), u.max(), v.max()] for v, u in places])
    names = ("man left", "chair", "red chair with bag", "bin behind the chair")
    lines = [f"0 {' '.join(map(str, box))} 1.0 obstacle {name}\n"
             for box, name in zip(boxes.tolist(), names, strict=True)]  # fmt: skip
    (tmp_path / "row.txt").write_text("".join(lines))
    monkeypatch.setattr(people, "BOXES", tmp_path)
    monkeypatch.setattr(labelled, "RECORDINGS", (Recording("row", "row.mcap", 0.5),))
    return boxes


def test_detected_people_and_chairs_of_a_synthetic_recording_are_counted(
    made, tmp_path, monkeypatch
):
    chairs = np.array([made[1], made[3]])  # the second is the bin

    def fake(_: np.ndarray) -> Detected:
        classes = [CLASSES["person"], CLASSES["chair"], CLASSES["chair"], 39]
        return Detected(np.concatenate([made[:1], chairs, made[2:3]]), np.array(classes))

    monkeypatch.setattr(people, "load_detector", lambda _: fake)
    judged = people.judge(people.Task(labelled.RECORDINGS[0], tmp_path, tmp_path))
    assert judged.frames == 1
    assert judged.counts["centernet", "person"] == Count(1, 1, 1)
    assert judged.counts["centernet", "chair"] == Count(2, 1, 2)
    assert judged.counts["wheeled", "person"] == Count(1, 1, 0)
    assert judged.counts["wheeled", "chair"] == Count(2, 2, 0)
    lab, found = Lab(Counts(), tmp_path), section.Section("table3", "")
    lab.recordings, lab.detector = (tmp_path,), tmp_path
    monkeypatch.setattr(people, "why_absent", lambda _: "")
    people.add_people(lab, found)
    table = next(block for block in found.blocks if isinstance(block, section.Table))
    assert table.rows[0][4] == "1 of 2" and table.rows[0][6].startswith("50.0 %")
    assert table.rows[1][4] == "2 of 2" and table.rows[1][6] == "-"
    assert {len(row) for row in table.rows} == {len(table.header)}


def test_without_a_detector_the_section_reports_that_it_was_not_run(tmp_path):
    found = section.Section("table3", "")
    people.add_people(Lab(Counts(), tmp_path), found)
    assert "not run" in str(found.blocks[0]) and not found.figures
