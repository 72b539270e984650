"""SUN RGB-D in the report: reading, comparison and pictures of a synthetic folder of scenes."""

import importlib.machinery
import importlib.util
import json
import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import savemat

pytest.importorskip("matplotlib")

from benchmarks.paper import section, sun_scenes, sunrgbd
from benchmarks.paper.lab import Lab
from benchmarks.paper.plan import Counts
from benchmarks.paper.sun_scenes import Polygon, find_scenes, labels_of_scene, read_scene
from jaxdet.errors import InputError
from jaxdet.floor.plane import down_vector
from jaxdet.io import open_log
from jaxdet.sim import SimConfig, load_obstacle_ids, write_log

WIDTH, HEIGHT = 320, 240
NAMES = ("wall", "floor", "chair1", "Boxes", "vase")


def write_scene(folder: Path, log: Path) -> np.ndarray:
    """Write the first frame of a simulated log as a scene; return its obstacles' ids ``(H, W)``."""
    ids = load_obstacle_ids(log, [0])[0]
    with open_log(str(log)) as opened:
        frames = opened.read([0], color=True).frames
    camera, depth = frames.calibration.image, frames.depth[0]
    for place in ("image", "depth", "extrinsics", "annotation2Dfinal"):
        (folder / place).mkdir(parents=True)
    assert frames.color is not None
    cv2.imwrite(str(folder / "image/0001.jpg"), frames.color[0, ..., ::-1])
    turned = np.left_shift(depth, 3) | np.right_shift(depth, 13)
    cv2.imwrite(str(folder / "depth/0001.png"), turned)
    np.savetxt(folder / "intrinsics.txt", camera.K)
    (folder / "scene.txt").write_text("office\n")
    return ids


def outline(mask: np.ndarray, name: int) -> dict[str, object]:
    """Return the convex outline of a mask as the dataset writes it."""
    v, u = np.nonzero(mask)
    hull = cv2.convexHull(np.stack([u, v], axis=1).astype(np.int32))[:, 0]
    return {"x": hull[:, 0].tolist(), "y": hull[:, 1].tolist(), "object": name}


def write_labels(folder: Path, polygons: list[object]) -> None:
    """Write a scene's labels."""
    objects = [{"name": name} for name in NAMES] + [None]
    text = json.dumps({"frames": [{"polygon": polygons}], "objects": objects})
    (folder / sun_scenes.LABELS).write_text(text)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Write a folder with a labelled scene, one without labels and one that can't be read."""
    root = tmp_path_factory.mktemp("sun")
    config = SimConfig(scene="row", frames=1, width=WIDTH, height=HEIGHT, depth_form="aligned")
    write_log(root / "row.mcap", config)
    scene = root / "kv1/a"
    ids = write_scene(scene, root / "row.mcap")
    extrinsics = np.hstack([np.eye(3), np.zeros((3, 1))])
    np.savetxt(scene / "extrinsics/20150101000000.txt", extrinsics)
    middle = HEIGHT // 2
    floor = {
        "x": [-5, WIDTH + 5, WIDTH + 5, -5],
        "y": [middle, middle, HEIGHT, HEIGHT],
        "object": 1,
    }
    things = [outline(ids == k, 2 + k % 2) for k in (1, 2, 3, 4)]
    above = {"x": [0, 60, 60, 0], "y": [0, 0, 40, 40], "object": 4}
    wall = {"x": [0, WIDTH, WIDTH, 0], "y": [0, 0, middle, middle], "object": 0}
    broken = {"x": 3, "y": 4, "object": 2}
    write_labels(scene, [wall, floor, *things, above, broken, {}, {**wall, "object": 99}])
    write_scene(root / "kv2/b", root / "row.mcap")
    write_scene(root / "xtion/c", root / "row.mcap")
    (root / "xtion/c/intrinsics.txt").write_text("300 0 160 0")
    return root


def test_a_scene_is_read_with_its_labels_and_gravity(made):
    folders = find_scenes(made)
    assert [path.relative_to(made).as_posix() for path in folders] == ["kv1/a", "kv2/b", "xtion/c"]
    scene = read_scene(folders[0], made)
    with open_log(str(made / "row.mcap")) as log:
        frames = log.read([0], color=True).frames
    assert (scene.frames.depth == frames.depth).all()
    assert pytest.approx(frames.calibration.image.K) == scene.frames.calibration.image.K
    assert (scene.name, scene.kind) == ("kv1/a", "office")
    assert scene.down is not None and scene.down.tolist() == [0, 1, 0]
    assert scene.polygons is not None
    assert [one.name for one in scene.polygons] == [
        "wall", "floor", "Boxes", "chair1", "Boxes", "chair1", "vase"
    ]  # fmt: skip
    assert read_scene(folders[1], made).polygons is None
    with pytest.raises(InputError, match="4 numbers where there must be 9"):
        read_scene(folders[2], made)


def test_polygons_of_a_scene_are_converted_to_boxes_and_masks(made):
    scene = read_scene(made / "kv1/a", made)
    every, standing = labels_of_scene(scene, standing=False), labels_of_scene(scene, standing=True)
    ids = load_obstacle_ids(made / "row.mcap", [0])[0]
    for k in range(4):
        v, u = np.nonzero(ids == k + 1)
        assert standing.boxes[k].tolist() == [u.min(), v.min(), u.max(), v.max()]
    assert len(standing.boxes) == 4 and (standing.distance_m > 0.3).all()
    assert every.floor.sum() > 5000 and not (every.floor & (ids > 0)).any()
    assert not every.known[5, 100:].any()  # wall


def test_the_last_word_decides_the_class():
    square = np.array([[0, 0], [9, 0], [9, 9]], np.float64)
    assert {name for name in ("chair 2", "glass", "book shelf", "floor lamp", "wall_clock")
            if Polygon(name, square).is_thing} == {
        "chair 2", "glass", "book shelf", "floor lamp", "wall_clock"}  # fmt: skip
    for name in ("Walls", "wall1", "window frame", "sliding door:closed door", "", "curtains"):
        assert not Polygon(name, square).is_thing
    assert Polygon("wooden floor", square).is_floor and Polygon("rugs", square).is_floor


def test_the_scenes_of_a_folder_are_scored_and_pictured(made, tmp_path):
    lab = Lab(Counts(), tmp_path)
    lab.quiet, lab.sunrgbd = True, made
    found = sunrgbd.run(lab)
    by_key = {figure.key: figure.value for figure in found.figures}
    assert by_key["sunrgbd.wheeled.standing.recall"] == 1
    assert by_key["sunrgbd.wheeled.standing.precision"] == 1
    assert 0 <= by_key["sunrgbd.paper.standing.recall"] <= 1
    text = str(found.blocks[0])
    assert "3 of 3 scenes; 1 have labels, 1 can't be read" in text and "intrinsics.txt" in text
    assert [block.name for block in found.blocks if isinstance(block, section.Picture)] == [
        "sunrgbd_scenes"
    ]
    lab.scenes = 1
    assert "1 of 3 scenes" in str(sunrgbd.run(lab).blocks[0])


def test_the_tilt_is_the_angle_between_floor_and_gravity(made):
    judged = sunrgbd.judge(sunrgbd.Task(made, made / "kv1/a", pictured=False))
    config = SimConfig(scene="row")
    down = down_vector(np.array([config.camera_pitch_rad]), np.zeros(1))[0]
    assert judged.tilt_rad == pytest.approx(math.acos(down[1]), abs=0.02)
    assert not judged.views


def test_without_a_folder_of_scenes_the_section_reports_the_reason(tmp_path):
    lab = Lab(Counts(), tmp_path)
    assert "Not run" in str(sunrgbd.run(lab).blocks[0])
    lab.sunrgbd = tmp_path
    assert "no scene of SUN RGB-D" in str(sunrgbd.run(lab).blocks[0])


@pytest.mark.parametrize("text", ['{"frames": []', "[]", '{"objects": [], "frames": []}'])
def test_a_file_without_labels_is_an_error(tmp_path, text):
    path = tmp_path / "index.json"
    path.write_text(text)
    with pytest.raises(InputError, match="no labels of SUN RGB-D"):
        sun_scenes.read_polygons(path)


def test_scenes_can_be_assembled_from_points(made, tmp_path):
    """A scene assembled from the points that VoteNet's preprocessing writes equals the original."""
    path = Path(__file__).parents[2] / "scripts/sunrgbd_scenes"
    loader = importlib.machinery.SourceFileLoader("sunrgbd_scenes", str(path))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    script = importlib.util.module_from_spec(spec)
    loader.exec_module(script)
    expected = read_scene(made / "kv1/a", made).frames
    camera, z = expected.calibration.image, expected.depth[0] / 1000
    v, u = np.nonzero(z)
    x, y = (u + 1 - camera.cx) / camera.fx, (v + 1 - camera.cy) / camera.fy
    lean = math.radians(10)
    turned = [[1, 0, 0], [0, math.cos(lean), math.sin(lean)], [0, -math.sin(lean), math.cos(lean)]]
    points = (np.stack([x, np.ones(len(x)), -y]) * z[v, u]).T @ np.array(turned).T
    savemat(tmp_path / "points.mat", {"instance": np.hstack([points, np.zeros_like(points)])})
    columns = [np.array(turned).T.ravel(), camera.K.T.ravel()]
    np.savetxt(tmp_path / "calib.txt", columns)
    (tmp_path / "boxes.txt").write_text("chair 10 20 30 40 1 2 3\n")
    (tmp_path / "image").mkdir()
    shutil.copy(made / "kv1/a/image/0001.jpg", tmp_path / "image")
    source = {"commit": "abc", "files": {"image": "image"}, "size": [WIDTH, HEIGHT]}
    source |= {"points": "points.mat", "calibration": "calib.txt", "boxes": "boxes.txt"}
    script.copy_files(source, tmp_path, tmp_path / "scene")
    script.convert_points(source, tmp_path, tmp_path / "scene")
    scene = read_scene(tmp_path / "scene", tmp_path)
    assert (scene.frames.depth == expected.depth).all()
    assert scene.polygons is not None and scene.polygons[0].name == "chair"
    assert scene.polygons[0].points.tolist() == [[10, 20], [40, 20], [40, 60], [10, 60]]
    assert scene.down == pytest.approx([0, math.cos(lean), math.sin(lean)])
    with pytest.raises(InputError, match="the recipe is for commit abc"):
        script.copy_files({**source, "files": {"image": "none"}}, tmp_path, tmp_path / "other")
