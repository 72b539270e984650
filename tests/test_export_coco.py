"""COCO export: read by pycocotools, compared with the boxes of the table and the ground truth."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet import preset
from jaxdet.cli import main
from jaxdet.errors import ConfigError, InputError
from jaxdet.export import export
from jaxdet.export.coco import run_lengths
from jaxdet.export.recordings import Seen, find, look_again
from jaxdet.io import open_log
from jaxdet.reference._cells import cell_boxes
from jaxdet.results.masks import label_image
from jaxdet.results.reading import ResultLog, Results
from jaxdet.sim import SimConfig, write_log
from jaxdet.types import Calibration, CellLabels, Cells, Extrinsics, Intrinsics
from tests.camera_logs import join_cameras
from tests.export_results import sim_log
from tests.made_results import make_results
from tests.runs import run_log, run_logs

# Arrays of pycocotools do not support the copy argument of NumPy 2.
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")


def coco_of(folder: Path, output: Path, *logs: str) -> Any:
    coco = pytest.importorskip("pycocotools.coco")
    with Results(folder) as results:
        export(results, "coco", output, find(results, logs))
    return coco.COCO(str(output / "annotations.json"))


def check(coco: Any, folder: Path, output: Path) -> list[tuple[dict, dict, np.ndarray]]:
    """Assert that each row is an annotation; return image, annotation and mask of each."""
    frames = pq.read_table(folder / "frames.parquet").to_pylist()
    rows = pq.read_table(folder / "obstacles.parquet").to_pylist()
    images = coco.loadImgs(coco.getImgIds())
    assert [image["frame"] for image in images] == [
        f["frame"] for f in frames if f["status"] == "ok"
    ]
    assert coco.loadCats(coco.getCatIds())[0]["name"] == "obstacle"
    for image in images:
        picture = cv2.imread(str(output / image["file_name"]))
        assert picture.shape[:2] == (image["height"], image["width"])
    found, rows = [], [row for row in rows if row["u_min"] is not None]
    for row, one in zip(rows, coco.loadAnns(coco.getAnnIds()), strict=True):
        (image,) = coco.loadImgs(one["image_id"])
        assert (image["frame"], one["obstacle"]) == (row["frame"], row["obstacle"])
        assert one["distance_m"] == row["distance_m"]
        left, top, width, height = one["bbox"]
        assert (left, top) == (row["u_min"], row["v_min"])
        assert (left + width - 1, top + height - 1) == (row["u_max"], row["v_max"])
        mask = coco.annToMask(one).astype(bool)
        assert mask.sum() == one["area"] > 0 and not one["iscrowd"]
        v, u = np.nonzero(mask)
        assert u.min() >= left and u.max() < left + width
        assert v.min() >= top and v.max() < top + height
        found.append((image, one, mask))
    return found


def test_annotations_of_a_simulated_log_cover_its_obstacles(drive: Path, tmp_path: Path) -> None:
    folder, truth = drive / "out", np.load(drive / "drive.mcap.truth.npz")
    found = check(coco_of(folder, tmp_path / "set"), folder, tmp_path / "set")
    with open_log(str(drive / "drive.mcap")) as log:
        colors = log.read([0], color=True).frames.color
    assert colors is not None
    color = colors[0].astype(int)
    picture = cv2.imread(str(tmp_path / "set" / found[0][0]["file_name"]), cv2.IMREAD_COLOR_RGB)
    assert np.abs(picture - color).mean() < 3 < np.abs(picture[..., ::-1] - color).mean()
    assert len(found) > 20
    share, taken = [], {}
    for image, _, mask in found:
        objects = truth[f"obstacle_id_{image['frame']:06d}"][mask]
        most = np.bincount(objects).argmax()
        assert most > 0  # an object, not the background
        share.append((objects == most).mean())
        other = taken.setdefault(image["id"], np.zeros_like(mask))
        assert not (other & mask).any()  # masks do not overlap
        other |= mask
    assert np.median(share) > 0.8 and np.min(share) > 0.6  # stereo smears depth over contours


def test_annotations_of_a_recorded_log_equal_the_table(aims_results: Path, tmp_path: Path) -> None:
    folder = aims_results
    found = check(coco_of(folder, tmp_path / "set"), folder, tmp_path / "set")
    boxes = [one["bbox"][2] * one["bbox"][3] for _, one, _ in found]
    around = [cv2.boundingRect(mask.astype(np.uint8)) for *_, mask in found]
    share = np.array([w * h for *_, w, h in around]) / boxes
    assert len(found) > 40 and share.mean() > 0.98


def test_each_camera_has_its_own_images(drive: Path, tmp_path: Path) -> None:
    """Recordings and reports distinguish the cameras, too."""
    write_log(tmp_path / "rear.mcap", SimConfig(frames=2, width=320, height=240, seed=5))
    both = {"front": drive / "drive.mcap", "rear": tmp_path / "rear.mcap"}
    log, folder = join_cameras(both, tmp_path / "two.mcap"), tmp_path / "out"
    run_log(log, folder, pictures=0)
    coco = coco_of(folder, tmp_path / "set", str(log))
    assert len(check(coco, folder, tmp_path / "set")) > 20
    cameras = [image["camera"] for image in coco.loadImgs(coco.getImgIds())]
    assert cameras == ["front"] * 5 + ["rear"] * 2
    with Results(folder) as results:
        export(results, "html", tmp_path / "page.html", find(results, [str(log)]))
        export(results, "rerun", tmp_path / "recordings", find(results, [str(log)]))
    page = (tmp_path / "page.html").read_text("utf-8")
    assert page.count('"log":"two, front"') == page.count('"log":"two, rear"') == 1
    assert page.count("data:image/webp") == 7 + page.count('"map":{')
    names = sorted(path.name for path in (tmp_path / "recordings").iterdir())
    assert names == ["two@front.rrd", "two@rear.rrd"]


def test_a_missing_log_and_another_log_are_errors(drive: Path, tmp_path: Path) -> None:
    other = tmp_path / "drive.mcap"
    write_log(other, SimConfig(frames=5, width=160, height=120, rate_hz=7))
    with pytest.raises(InputError, match=r"is not the log 'drive'.*--log"):
        coco_of(drive / "out", tmp_path / "set", str(other))
    renamed = join_cameras({"front": other}, tmp_path / "front.mcap")
    with pytest.raises(InputError, match=r"front.mcap: the file is not the log 'drive'.*--log"):
        coco_of(drive / "out", tmp_path / "set", str(renamed))
    gone = make_results(tmp_path / "out", {"gone": 3})
    with pytest.raises(InputError, match=r"gone.mcap: .* original path.*with --log"):
        coco_of(gone, tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_missing_and_truncated_logs_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other logs are exported and the missing ones named; a log given by name must exist."""
    logs = [sim_log(tmp_path / f"{name}.mcap", frames=2, seed=3) for name in "abc"]
    folder, output = tmp_path / "out", tmp_path / "set"
    run_logs(logs, folder, pictures=0)
    logs[0].rename(tmp_path / "moved.mcap")

    def torn(results: Results, log: ResultLog, *given: Any, **how: Any) -> Iterator[Seen]:
        yield from look_again(results, log, *given, **how)
        if log.name == "b":
            raise InputError("is torn", path=str(logs[1]))

    monkeypatch.setattr("jaxdet.export.coco.look_again", torn)
    assert main(["export", str(folder), "--to", "coco", "--output", str(output)]) == 0
    warnings = capsys.readouterr().err.splitlines()
    assert warnings[0].startswith(
        f"jaxdet: warning: a is left out: {logs[0]}: the log is not at its"
    )
    assert warnings[1] == f"jaxdet: warning: b is left out: {logs[1]}: is torn"
    dataset = json.loads((output / "annotations.json").read_text("utf-8"))
    assert [f"jaxdet: warning: {line}" for line in dataset["info"]["left_out"]] == warnings[:2]
    assert [image["log"] for image in dataset["images"]] == ["c", "c"] and dataset["annotations"]
    for entries in (dataset["images"], dataset["annotations"]):
        assert [entry["id"] for entry in entries] == [*range(1, 1 + len(entries))]
    kept = {image["file_name"] for image in dataset["images"]}
    assert {f"images/{path.name}" for path in (output / "images").iterdir()} == kept
    with pytest.raises(InputError, match="is torn"):
        coco_of(folder, tmp_path / "given", str(logs[1]), str(logs[2]))


def test_clusters_of_points_have_no_masks(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "out", {"a": 3}, preset("paper"))
    with pytest.raises(
        ConfigError, match="preset paper has no masks; run jaxdet run with another preset"
    ):
        coco_of(folder, tmp_path / "set")


def test_pixels_belong_to_the_nearest_cell() -> None:
    """Of three cells of two pixels, the nearer one in the middle is shifted to the right."""
    depth = Intrinsics(6, 2, 10.0, 10.0, 3.0, 1.0)
    color = Intrinsics(9, 2, 10.0, 10.0, 3.0, 1.0)
    motion = Extrinsics((1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), (0.1, 0.0, 0.0))
    calibration = Calibration(depth, color, motion)
    z, label = np.array([[[1000, 500, 1000]]], np.int32), np.array([[[0, -1, 2]]], np.int32)
    found = CellLabels(label, label >= 0, Cells(0 * z, 0 * z, z))
    first, last, _ = cell_boxes(z, calibration, 2)
    assert (first[0, 0, 1:, 0].tolist(), last[0, 0, 1:, 0].tolist()) == ([4, 5], [6, 7])
    left = int(first[0, 0, 0, 0])
    expected = [0 if left <= u < 4 else 2 if u == 7 else -1 for u in range(9)]
    assert label_image(found, 0, calibration, 2).tolist() == [expected] * 2
    hidden = found._replace(cells=found.cells._replace(z=z * [[[1, 0, 1]]]))
    assert label_image(hidden, 0, calibration, 2)[0, 5:8].tolist() == [2] * 3
    aligned = label_image(found, 0, Calibration(depth), 2)
    assert aligned.tolist() == [[0, 0, -1, -1, 2, 2]] * 2


def test_images_of_a_log_without_colour_show_depth(tmp_path: Path) -> None:
    log, folder = sim_log(tmp_path / "a.mcap", frames=2, seed=3), tmp_path / "out"
    depth = join_cameras({"front": log}, tmp_path / "depth.mcap", without=lambda t: "/color/" in t)
    run_log(depth, folder, pictures=0)
    coco = coco_of(folder, tmp_path / "set")
    assert len(check(coco, folder, tmp_path / "set")) > 2
    dataset = json.loads((tmp_path / "set" / "annotations.json").read_text("utf-8"))
    assert dataset["info"]["images_of_depth"] == len(dataset["images"]) == 2
    rows = pq.read_table(folder / "obstacles.parquet").to_pylist()
    assert {row["box_image"] for row in rows} == {"depth"}
    with Results(folder) as results:
        export(results, "rerun", tmp_path / "recordings", find(results, [str(depth)]))
        export(results, "html", tmp_path / "page.html", {})
    assert list((tmp_path / "recordings").iterdir())


@pytest.mark.parametrize("first", [0, 1])
def test_run_length_encoding_equals_pycocotools(first: int) -> None:
    mask = np.array([[first, 0], [1, 0], [1, 1]], bool)
    assert run_lengths(mask) == ([0, 3, 2, 1] if first else [1, 2, 2, 1])
