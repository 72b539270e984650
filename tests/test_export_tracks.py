"""Tracks in the exports: track numbers in each format, and trajectories of moving tracks."""

import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxdet.errors import InputError
from jaxdet.export import foxglove, ros2
from jaxdet.export.shapes import T_camera_floor
from jaxdet.results.reading import Results
from jaxdet.tracks import TrackConfig, track_results
from tests.export_results import run, sim_log
from tests.made_results import make_results
from tests.test_export_coco import coco_of
from tests.test_export_foxglove import exported
from tests.test_export_html import Opened, browser, page_of
from tests.test_export_rerun import recording_of
from tests.test_export_ros2 import exported as ros2_of

SEED = 3126
__all__ = ["browser"]  # a fixture


@pytest.fixture(scope="module")
def walkers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a log of a pedestrian, its results and its tracks."""
    folder = tmp_path_factory.mktemp("walkers")
    about = {"scene": "moving", "frames": 10, "seed": SEED, "rate_hz": 8.0, "camera_height_m": 0.5}
    log = sim_log(folder / "walkers.mcap", **about)
    run(log, folder / "out")
    track_results(folder / "out", TrackConfig())
    return folder


def linked(folder: Path) -> dict[int, list[int | None]]:
    """Return the track of each obstacle, by frame number."""
    found = defaultdict(list)
    for row in pq.read_table(folder / "track_links.parquet").to_pylist():
        found[row["frame"]].append(row["track"])
    return found


def test_foxglove_labels_obstacles_with_their_tracks(walkers: Path, tmp_path: Path) -> None:
    folder = walkers / "out"
    tracks, of = pq.read_table(folder / "tracks.parquet").to_pylist(), linked(folder)
    topics, frames = exported(folder, tmp_path / "to")
    assert any(track["moving"] for track in tracks)
    headed = 0
    for frame, (_, scene) in zip(frames, topics["/jaxdet/obstacles"], strict=True):
        number, row = frame.row["frame"], frame.row
        ids = [entity.id for entity in scene.entities]
        assert len(set(ids)) == len(ids)
        own = [f"track {t}" for t in of[number] if t is not None]
        assert {i for i in ids if i.startswith("track")} >= {*own}
        assert len([i for i in ids if not i.startswith("trajectory")]) == len(of[number])
        for entity in scene.entities:
            for text in entity.texts:  # labels above the nearest point
                p = text.pose.position
                about = {pair.key: float(pair.value) for pair in entity.metadata}
                place = np.linalg.inv(T_camera_floor(row)) @ [p.x, p.y, p.z, 1.0]
                assert np.hypot(*place[:2]) == pytest.approx(about["distance_m"], abs=2e-3)
                assert place[2] == pytest.approx(about["top_m"] + 0.08, abs=2e-3)
        there = [t for t in tracks if t["first_frame"] <= number <= t["last_frame"]]
        paths = {e.id: e for e in scene.entities if e.id.startswith("trajectory")}
        assert {*paths} == {f"trajectory of track {t['track']}" for t in there if t["moving"]}
        for track in there:
            if track["moving"]:
                entity = paths[f"trajectory of track {track['track']}"]
                at = number - track["first_frame"]
                (arrow,), (line,) = entity.arrows, entity.lines
                assert entity.frame_id == row["world_frame"]
                speed = arrow.shaft_length + arrow.head_length
                np.testing.assert_allclose(speed, track["speed_mps"][at], atol=1e-6)
                place = arrow.pose.position.x, arrow.pose.position.y
                np.testing.assert_allclose(place, track["path"][2 * at : 2 * at + 2], atol=1e-6)
                assert len(line.points) == at + 1
                path = np.reshape(track["path"], (-1, 2))[: at + 1]
                drawn = [(p.x + place[0], p.y + place[1]) for p in line.points]
                np.testing.assert_allclose(drawn, path, atol=1e-5)
                on_floor = row["camera_position_world"][2] - row["camera_height_m"]
                assert arrow.pose.position.z == pytest.approx(on_floor, abs=1e-6)
                turn, goes = arrow.pose.orientation, path[-1] - path[0]
                if np.hypot(*goes) > 0.3:
                    ahead = 2 * np.arctan2(turn.z, turn.w) - np.arctan2(goes[1], goes[0])
                    assert np.cos(ahead) > 0.8
                    headed += 1
    assert headed


def test_trajectories_in_the_world_require_poses(walkers: Path) -> None:
    """Without a pose, points would be in the floor frame of the camera."""
    with Results(walkers / "out") as results:
        frame = next(f for f in results.frames(results.logs[0]) if any(t.moving for t in f.tracks))
    assert any(entity.id.startswith("trajectory") for entity in foxglove.scene(frame).entities)
    frame.row.update(camera_position_world=None, camera_orientation_world=None)
    assert not any(entity.id.startswith("trajectory") for entity in foxglove.scene(frame).entities)


def test_ros2_and_coco_have_the_tracks(walkers: Path, tmp_path: Path) -> None:
    folder, log = walkers / "out", walkers / "walkers.mcap"
    of = linked(folder)
    topics, frames = ros2_of(folder, tmp_path / "ros2")
    for frame, (_, message) in zip(frames, topics["/jaxdet/detections"], strict=True):
        ids = [one.id for one in message.detections]
        assert ids == ["" if t is None else str(t) for t in of[frame.row["frame"]]]
    frame = next(frame for frame in frames if frame.obstacles)
    for track, name in ((None, ""), (0, "0"), (17, "17")):
        frame.obstacles[0] |= {"track": track, "obstacle": 5}
        assert ros2.detections(frame)["detections"][0]["id"] == name
    coco = coco_of(folder, tmp_path / "coco", str(log))
    found = [one["track_id"] for one in coco.loadAnns(coco.getAnnIds())]
    inside = [  # rows with a box in the colour image
        [o["u_min"] is not None for o in frame.obstacles] for frame in frames
    ]
    tracks = [zip(of[number], inside[at], strict=True) for at, number in enumerate(sorted(of))]
    assert found == [track for own in tracks for track, shown in own if shown]


def test_rerun_has_an_entity_for_each_moving_track(walkers: Path, tmp_path: Path) -> None:
    """The entity is shown from the first frame of the track to the last one."""
    folder = walkers / "out"
    found = recording_of(folder, tmp_path / "rerun")
    tracks = pq.read_table(folder / "tracks.parquet").to_pylist()
    moving = {f"/world/tracks/{t['track']}": t for t in tracks if t["moving"]}
    assert {name for name in found if name.startswith("/world/tracks")} == {*moving}
    for name, track in moving.items():
        strip = np.array(found[name]["strips"][track["first_frame"]][0])
        path = np.reshape(track["path"], (-1, 2))
        np.testing.assert_allclose(strip[:, :2], path, atol=1e-3)
        assert [*found[name]["strips"]] == [track["first_frame"]]
        assert [*found[name]["is_recursive"]] == [track["last_frame"] + 1]


def test_points_in_rerun_have_the_colours_of_their_boxes(walkers: Path, tmp_path: Path) -> None:
    (log,) = walkers.glob("*.mcap")
    found = recording_of(walkers / "out", tmp_path / "rerun", str(log))
    points = found["/world/floor/camera/points"]["colors"]
    boxes = found["/world/floor/boxes"]
    numbered = 0
    for number, colors in points.items():
        if colors:
            assert {*map(int, colors)} <= {*map(int, boxes["colors"][number])}
            numbered += any("#" in text for text in boxes["labels"][number])
    assert numbered > 5


def test_report_lists_tracks_and_draws_their_trajectories(
    walkers: Path, tmp_path: Path, browser: Any
) -> None:
    folder = walkers / "out"
    tracks = pq.read_table(folder / "tracks.parquet").to_pylist()
    data = page_of(folder, tmp_path / "page.html")
    moving = [t for t in tracks if t["moving"]]
    rows = data["logs"][0]["tracks"]["rows"]
    assert [row[:2] for row in rows] == [[t["track"], t["moving"]] for t in tracks]
    np.testing.assert_allclose(rows[0][8][:2], tracks[0]["path"][:2], atol=0.01)
    opened = Opened(browser, tmp_path / "page.html", viewport={"width": 1280, "height": 900})
    page = opened.page

    def shown() -> list[str]:
        return [line.split("\t")[0] for line in page.locator("#tracks tbody tr").all_inner_texts()]

    assert shown() == [str(t["track"]) for t in moving]
    assert page.locator("#map .way.end").count() == len(moving)
    page.get_by_role("radio", name="All tracks").click()
    assert shown() == [str(t["track"]) for t in tracks]
    assert page.locator("#map .way.end").count() == len(tracks)
    page.get_by_role("radio", name="Standing").click()
    assert shown() == [str(t["track"]) for t in tracks if not t["moving"]]
    opened.check()


def test_missing_and_foreign_tracks_are_reported(
    walkers: Path, driven_results: Path, tmp_path: Path
) -> None:
    with Results(driven_results) as results:
        assert not results.tracked(results.logs[0]) and not [*results.tracks(results.logs[0])]
        frame = next(results.frames())
        assert not frame.tracks and "track" not in frame.obstacles[0]
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in (walkers / "out").glob("*.*"):
        if path.is_file():
            (copy / path.name).write_bytes(path.read_bytes())
    links = pq.read_table(copy / "track_links.parquet")
    pq.write_table(
        pa.concat_tables([links.slice(1), links.slice(0, 1)]), copy / "track_links.parquet"
    )
    with Results(copy) as results, pytest.raises(InputError, match="don't belong together"):
        list(results.frames())
    pq.write_table(links.replace_schema_metadata(None), copy / "track_links.parquet")
    with Results(copy) as results, pytest.raises(InputError, match="format none"):
        list(results.frames())


def test_obstacles_have_the_tracks_of_their_log(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "many", {"a": 30, "b": 50, "c": 20})
    track_results(folder, TrackConfig(min_frames=1))
    links = {n: pq.read_table(folder / n / "track_links.parquet").to_pylist() for n in "abc"}
    wanted = {name: [row["track"] for row in links[name]] for name in "abc"}
    with Results(folder) as results:
        for log in reversed(results.logs):  # each log requires a seek
            (chunk,) = results.chunks(log)
            assert chunk.obstacles["track"].to_pylist() == wanted[log.name]
            (chunk,) = results.chunks(log, [], ["track", "distance_m"])
            assert chunk.obstacles.column_names[-2:] == ["distance_m", "track"]
            assert chunk.obstacles["track"].to_pylist() == wanted[log.name]
            (chunk,) = results.chunks(log, [], ["distance_m"])
            assert "track" not in chunk.obstacles.column_names
    assert len({*map(tuple, wanted.values())}) == 3


def test_a_missing_table_of_tracks_is_named(tmp_path: Path) -> None:
    folder = make_results(tmp_path / "out", {"a": 10})
    track_results(folder, TrackConfig(min_frames=1))
    (folder / "a" / "track_links.parquet").unlink()
    with Results(folder) as results, pytest.raises(InputError, match=r"track_links.parquet is mis"):
        next(results.chunks())


def test_tracks_of_other_results_are_refused(tmp_path: Path) -> None:
    """Version and configuration are the same, but not the log."""
    folder = make_results(tmp_path / "one", {"a": 10, "b": 12})
    track_results(folder, TrackConfig(min_frames=1))
    for name in ("tracks", "track_links"):
        shutil.copy2(folder / "a" / f"{name}.parquet", folder / "b")
    with Results(folder) as results:
        with pytest.raises(InputError, match="belongs to other results than those"):
            list(results.tracks(results.logs[1]))
        with pytest.raises(InputError, match="belongs to other results than those"):
            list(results.chunks(results.logs[1]))
