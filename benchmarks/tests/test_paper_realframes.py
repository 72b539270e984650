"""Labelled frames in the report: the labels, a synthetic recording, and the real ones."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import savemat

pytest.importorskip("matplotlib")

from benchmarks.paper import labelled, realframes, section, stills
from benchmarks.paper.lab import Lab
from benchmarks.paper.labelled import BOXES, RECORDINGS, Recording, find_recordings, read_boxes
from benchmarks.paper.plan import Counts
from jaxdet import reference
from jaxdet.config import Config
from jaxdet.errors import InputError
from jaxdet.io import open_log
from jaxdet.sim import SimConfig, load_obstacle_ids, write_log
from tests.runs import only_log, run_logs

FRAMES = {"aims_slam": 18, "d435_boxes_felixchenfy": 10}


@pytest.mark.parametrize("name", FRAMES)
def test_labels_of_the_project_are_complete_and_inside_of_the_image(name):
    boxes = read_boxes(BOXES / f"{name}.txt")
    assert sorted(boxes) == list(range(FRAMES[name]))
    for objects, distance, ignored, _ in boxes.values():
        assert len(objects) == len(distance) >= 1
        assert ((distance > 0.2) & (distance < 4)).all()
        every = np.concatenate([objects, ignored])
        assert (every[:, :2] <= every[:, 2:]).all() and (every >= 0).all()
        assert (every[:, 2] < 640).all() and (every[:, 3] < 480).all()
        assert (objects[:, 2:] - objects[:, :2] >= 16).all()


def test_a_malformed_label_line_is_an_error(tmp_path):
    path = tmp_path / "one.txt"
    good = "3 0 1 8 9 0.50 obstacle a box, open [low, cut]\n\n# no\n3 2 2 4 4 - ignore wall\n"
    path.write_text(good)
    objects, distance, ignored, tags = read_boxes(path)[3]
    assert (objects.tolist(), distance.tolist()) == ([[0, 1, 8, 9]], [0.5])
    assert ignored.tolist() == [[2, 2, 4, 4]] and tags == ({"low", "cut"},)
    for bad in ("3 0 1 8 9 0.5 box it", "3 0 1 8 9 - obstacle it", "3 5 1 4 9 1 obstacle it", "3"):
        path.write_text(good + bad)
        with pytest.raises(InputError, match="line 5 is not a label"):
            read_boxes(path)


@pytest.fixture
def made(tmp_path, monkeypatch) -> Path:
    """Write a simulated log of four boxes, with its truth as label images; walls are unknown."""
    config = SimConfig(scene="row", frames=3, width=320, height=240)
    write_log(tmp_path / "row.mcap", config)
    (tmp_path / "labels").mkdir()
    ids = load_obstacle_ids(tmp_path / "row.mcap", [0, 1, 2])
    for frame, image in enumerate(ids):
        cv2.imwrite(
            str(tmp_path / "labels" / f"{frame:03d}.png"), np.where(image <= 4, image + 1, 0)
        )
    one = Recording("row", "row.mcap", 0.5, "labels", least_pixels=20, held_out=3)
    monkeypatch.setattr(labelled, "RECORDINGS", (one,))
    return tmp_path


def test_all_objects_of_a_simulated_recording_are_found(made):
    lab = Lab(Counts(), made / "kept")
    lab.quiet, lab.recordings = True, (made,)
    found = realframes.run(lab)
    by_key = {figure.key: figure.value for figure in found.figures}
    stem = "realframes.row.{}.wheeled.{}"
    for part in ("tuning", "held_out"):
        assert by_key[stem.format(part, "recall")] == 1
        assert by_key[stem.format(part, "precision")] == 1
        assert by_key[stem.format(part, "swamped")] == 0
        assert by_key[stem.format(part, "floor_kept")] < 0.02
        # The smallest of many depths up to 3 m, where depth has a deviation of 3.6 cm.
        assert by_key[stem.format(part, "error_p90_m")] < 0.12
    table = next(block for block in found.blocks if isinstance(block, section.Table))
    assert [row[:3] for row in table.rows] == [
        ("row.tuning", "wheeled", "2"),
        ("row.held_out", "wheeled", "1"),
        ("row.tuning", "paper", "2"),
        ("row.held_out", "paper", "1"),
    ]
    assert {len(row) for row in table.rows} == {len(table.header)}
    pictures = [block.name for block in found.blocks if isinstance(block, section.Picture)]
    assert pictures == ["realframes_row"]


def test_a_frame_without_labels_is_left_out(made):
    (made / "labels" / "001.png").unlink()
    task = realframes.Task(labelled.RECORDINGS[0], made, Config(), 1)
    judged = realframes.judge(task)
    assert judged.numbers == [0, 2] and len(judged.tallies) == 2 and len(judged.views) == 1


def test_without_recordings_the_section_reports_that_it_was_not_run(tmp_path):
    found = realframes.run(Lab(Counts(), tmp_path))
    assert not found.figures and "Not run" in str(found.blocks[0])
    assert find_recordings([tmp_path]) == []


def test_the_folder_of_a_recording_can_be_given(made):
    (made / "deep").mkdir()
    assert [place for _, place in find_recordings([made / "deep"])] == [made]


@pytest.mark.parametrize("name", FRAMES)
def test_labelled_distances_occur_in_the_depth_images(shared_data, name):
    recording = next(one for one in RECORDINGS if one.name == name)
    boxes = read_boxes(BOXES / f"{name}.txt")
    with open_log(str(shared_data / recording.place)) as log:
        assert log.num_frames == FRAMES[name]
        for batch in log.batches(1):
            frames = batch.frames
            z_m = reference.paper.align(frames.depth, frames.calibration).z[0] * 1e-3
            objects, distance, _, _ = boxes[int(frames.number[0])]
            for (u, v, right, bottom), metres in zip(objects, distance, strict=True):
                part = z_m[v : bottom + 1, u : right + 1]
                assert (np.abs(part - metres) < 0.05).mean() > 0.02


def test_figures_equal_those_of_a_run_scored_by_the_script_of_the_recordings(shared_data, tmp_path):
    recording = next(one for one in RECORDINGS if one.name == "wheelchair")
    path, config = shared_data / recording.place, Config()
    run_logs(path, tmp_path, config, backend="reference", pictures=0)
    script = str(shared_data / "labelled" / "score.py")
    command = [sys.executable, script, str(only_log(tmp_path)), "wheelchair", "--json"]
    theirs = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    judged = realframes.judge(realframes.Task(recording, shared_data, config, 0))
    for key in ("objects", "detections", "matched"):
        assert sum(getattr(tally, key) for tally in judged.tallies) == theirs["all"][key]
    swamped = [n for n, t in zip(judged.numbers, judged.tallies, strict=True) if t.swamped]
    assert swamped == theirs["swamped_frames"]


TAGS = {"low", "thin", "glass", "dark", "shiny", "path", "cut"}


@pytest.mark.parametrize(
    ("recipe", "tags"),
    [(stills.ROOMS, set()), *((recipe, TAGS) for recipe in stills.PUBLIC)],
    ids=lambda value: getattr(value, "stem", ""),
)
def test_stills_have_labels_of_their_frames(recipe, tags):
    rooms, used = stills.read_recipe(recipe), set()
    files = {path.stem for path in BOXES.glob(f"{recipe.stem}_*.txt")}
    assert files == {f"{recipe.stem}_{room['name']}" for room in rooms}
    for room in rooms:
        labels = read_boxes(BOXES / f"{recipe.stem}_{room['name']}.txt")
        assert recipe not in stills.PUBLIC[1:] or len(labels) == len(room["frames"])
        for frame, mine in labels.items():
            assert 0 <= frame < len(room["frames"])
            assert (mine.distance_m > 0.2).all() and (mine.distance_m < 4.3).all()
            every = np.concatenate([mine.boxes, mine.ignored])
            assert (every[:, 2:] < room["size"]).all() and (every[:, 2:] > every[:, :2]).all()
            used.update(*mine.tags)
    assert used <= tags and bool(used) == bool(tags)


def test_recordings_are_found_by_their_group(tmp_path):
    """Each recording of public.json is in one of two parts, by its repository."""
    for room in stills.read_recipe(stills.PUBLIC[0]):
        path = tmp_path / "public" / f"{room['name']}.mcap"
        path.parent.mkdir(exist_ok=True)
        path.touch()
    learn, last = (
        [one for one, _ in find_recordings([tmp_path], [f"public.{part}"])]
        for part in ("learn", "last")
    )
    assert {one.name for one in learn} | {one.name for one in last} == {
        one.name for one, _ in find_recordings([tmp_path])
    }
    assert not set(learn) & set(last) and not any(one.learnt for one in last)
    assert {one.group for one in learn} == {
        f"public.learn.{place}" for place in ("room", "corridor", "table")
    }
    tables = [one for one in learn if one.group.endswith("table")]
    assert {one.presets for one in tables} == {("tabletop", "wheeled")}
    assert [one.name for one, _ in find_recordings([tmp_path], ["public_den"])] == ["public_den"]


def test_stills_of_repositories_are_converted_to_logs(tmp_path):
    """One recording has aligned depth in units of 0.2 mm, others a separate depth camera."""
    rooms = json.loads((BOXES / "rooms.json").read_text(encoding="utf-8"))
    names = "pioneer", "classroom", "profoffice", "pavement_a", "pavement_b"
    chosen = [room for room in rooms if room["name"] in names]
    rng, depths, pictures = np.random.default_rng(0), {}, {}
    for room in chosen:
        clone = tmp_path / "clones" / room["repository"].rsplit("/", 1)[1]
        for color, depth in room["frames"]:
            for name in (color, depth):
                (clone / name).parent.mkdir(parents=True, exist_ok=True)
            picture = rng.integers(0, 256, (480, 640, 3)).astype(np.uint8)
            image = rng.integers(500, 9000, (480, 640)).astype(np.uint16)
            if color.endswith(".npy"):
                image = (image + 0.25).astype(np.float32)
                image[0, 0] = 1e6  # farther than 16 bits can represent: read as missing
                np.save(clone / color, picture)
                np.save(clone / depth, image)
                pictures.setdefault(room["name"], picture)
            else:
                cv2.imwrite(str(clone / color), picture)
                if depth.endswith(".mat"):
                    savemat(clone / depth, {"depth_array": image})
                else:
                    cv2.imwrite(str(clone / depth), image)
            stored = np.rint(image * room["depth_unit_m"] * 1000)
            depths.setdefault(room["name"], np.where(stored < 65535, stored, 0))
    script = str(Path(__file__).parents[2] / "scripts" / "rooms_to_mcap")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, script, str(tmp_path / "clones"), str(tmp_path / "rooms")]
    run = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    assert run.stdout.count("no clone of") == len(rooms) - len(names)
    for name, frames in (("pioneer", 1), ("classroom", 4), ("pavement_a", 6)):
        with open_log(str(tmp_path / "rooms" / f"{name}.mcap")) as log:
            assert log.num_frames == frames
            batch = next(iter(log.batches(1, color=True)))
            np.testing.assert_array_equal(batch.frames.depth[0], depths[name])
            assert log.calibration.is_aligned == (name == "pioneer")
            if name in pictures:
                np.testing.assert_array_equal(batch.frames.color[0], pictures[name][..., ::-1])
    command[2] = str(tmp_path / "rooms")
    run = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert run.returncode == 2 and run.stderr.count("\n") == 1 and "no clone" in run.stderr


@pytest.mark.parametrize("path", stills.PUBLIC, ids=lambda path: path.stem)
def test_repositories_of_a_public_recipe_are_in_one_split(path):
    """Also over all public recipes, which have different frames of it; none is in rooms.json."""
    recipe = stills.read_recipe(path)
    others = [room for one in stills.PUBLIC if one != path for room in stills.read_recipe(one)]
    rooms = stills.read_recipe(stills.ROOMS)
    names = [room["name"] for room in recipe]
    assert len(set(names)) == len(names)
    assert not set(names) & {room["name"] for room in (*rooms, *others)}
    assert not {room["repository"] for room in recipe} & {room["repository"] for room in rooms}
    for room in recipe:
        assert room["place"] in ("room", "corridor", "outdoor", "table")
        assert len(room["color"]) == 4 and len(room["size"]) == 2 and 1 <= len(room["frames"]) <= 8
        assert len(room["commit"]) == 40 and 0.0001 <= room["depth_unit_m"] <= 1
        assert room["split"] in ("learn", "last")
        for other in (*recipe, *others):
            if other["repository"] == room["repository"] and other["name"] != room["name"]:
                assert other["split"] == room["split"]
                assert not {*map(tuple, room["frames"])} & {*map(tuple, other["frames"])}


def test_raw_frames_of_niviewer_are_read(tmp_path):
    """A header of 24 bytes with the image's size, then BGR or millimetres."""
    header = np.array([2, 4, 3, 0, 0, 0], np.uint32).tobytes()
    color = np.arange(36, dtype=np.uint8).reshape(3, 4, 3)
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4) * 100
    (tmp_path / "color.raw").write_bytes(header + color.tobytes())
    (tmp_path / "depth.raw").write_bytes(header + depth.tobytes())
    np.testing.assert_array_equal(stills.read_color(tmp_path / "color.raw"), color)
    np.testing.assert_array_equal(stills.read_depth(tmp_path / "depth.raw", 0.001), depth)
    for data in (b"", header, header + depth.tobytes()[:-2]):
        (tmp_path / "depth.raw").write_bytes(data)
        with pytest.raises(InputError, match="no frame of NiViewer"):
            stills.read_depth(tmp_path / "depth.raw", 0.001)


def test_depth_may_have_another_size_than_colour(tmp_path):
    clone = tmp_path / "clones" / "one"
    clone.mkdir(parents=True)
    cv2.imwrite(str(clone / "color.png"), np.zeros((54, 96, 3), np.uint8))
    cv2.imwrite(str(clone / "depth.png"), np.full((42, 51), 1500, np.uint16))
    room = {"name": "one", "repository": "some/one", "size": [96, 54], "depth_size": [51, 42]}
    room |= {"color": [50, 50, 48, 27], "depth": [36, 36, 25, 21], "distortion": []}
    room |= {"depth_unit_m": 0.001, "frames": [["color.png", "depth.png"]]}
    room["color_from_depth"] = {"rotation": np.eye(3).ravel().tolist(), "translation": [0.05, 0, 0]}
    (tmp_path / "recipe.json").write_text(json.dumps([room]))
    script = str(Path(__file__).parents[2] / "scripts" / "rooms_to_mcap")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, script, str(tmp_path / "clones"), str(tmp_path / "out")]
    command += ["--recipe", str(tmp_path / "recipe.json")]
    subprocess.run(command, check=True, capture_output=True, env=environment)
    with open_log(str(tmp_path / "out" / "one.mcap")) as log:
        assert not log.calibration.is_aligned
        assert (log.calibration.depth.width, log.calibration.depth.height) == (51, 42)
        assert next(iter(log.batches(1))).frames.depth.shape == (1, 42, 51)


def test_images_and_pictures_for_labelling_are_written(tmp_path):
    clone = tmp_path / "clones" / "some+one"
    clone.mkdir(parents=True)
    color = np.full((120, 200, 3), (10, 20, 30), np.uint8)
    cv2.imwrite(str(clone / "color.png"), color)
    millimetres = np.zeros((60, 100), np.uint16)
    millimetres[10:50, 20:70] = 1501
    cv2.imwrite(str(clone / "depth.png"), (millimetres << 3) | (millimetres >> 13))
    room = {"name": "one", "repository": "some/one", "size": [100, 60], "split": "last"}
    room |= {
        "depth_unit_m": 0.001,
        "depth_coding": "sunrgbd",
        "frames": [["color.png", "depth.png"]],
    }
    (tmp_path / "recipe.json").write_text(json.dumps([room]))
    script = str(Path(__file__).parents[2] / "scripts" / "rooms_to_mcap")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, script, str(tmp_path / "clones"), str(tmp_path / "out"), "--look"]
    command += ["--recipe", str(tmp_path / "recipe.json")]
    subprocess.run(command, check=True, capture_output=True, env=environment)
    frame = tmp_path / "out" / "frames" / "one_0"
    np.testing.assert_array_equal(np.load(frame / "depth.npy"), millimetres)
    assert (cv2.imread(str(frame / "color.png")) == (10, 20, 30)).all()
    assert "split" not in json.loads((frame / "meta.json").read_text())
    look = cv2.imread(str(tmp_path / "out" / "look" / "one_0.png"))
    assert look.shape[0] == stills.PICTURE_HEIGHT + stills.MARGIN


def test_depth_arrays_may_have_a_last_axis_of_one(tmp_path):
    depth = np.arange(12, dtype=np.uint16).reshape(3, 4) * 100
    np.save(tmp_path / "depth.npy", depth[..., None])
    np.testing.assert_array_equal(stills.read_depth(tmp_path / "depth.npy", 0.0001), depth // 10)
