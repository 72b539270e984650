"""ROS 2 export: messages are read by rosbags, and the log is read again as in the run."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from jaxdet.cli import main
from jaxdet.errors import InputError
from jaxdet.export import FORMATS, export
from jaxdet.export.grid import last_grid
from jaxdet.export.recordings import find, images, look_again
from jaxdet.export.shapes import box, heights
from jaxdet.io import LogFiles, LogOptions
from jaxdet.results.reading import Results
from jaxdet.results.tables import Frame
from jaxdet.types import RAYS
from tests.export_results import run, sim_log

DETECTIONS, POINTS, MAP, SCAN, LOCAL = (
    f"/jaxdet/{name}" for name in ("detections", "points", "map", "scan", "local_map")
)
POINT = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("obstacle", "<u4")]
Captured = pytest.CaptureFixture[str]


def exported(folder: Path, to: Path, *logs: Path) -> tuple[dict[str, list], list[Frame]]:
    """Export results; return the messages with their times by topic, and the frames."""
    given = ["--log", *map(str, logs)] if logs else []
    assert main(["export", str(folder), "--to", "ros2", "--output", str(to), *given]) == 0
    with Results(folder) as results:
        frames = list(results.frames())
        path = to / f"{results.logs[0].file_name}.jaxdet.mcap"
    found: dict[str, list] = {}
    with AnyReader([path]) as reader:
        for connection, at, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((at, message))
            if connection.topic == MAP:
                ext: Any = connection.ext
                (qos,) = ext.offered_qos_profiles
                assert qos.durability.name == "TRANSIENT_LOCAL"
    return found, frames


def motion(place: Any, turn: Any) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    T[:3, 3] = place.x, place.y, place.z
    return T


def world(row: dict) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(row["camera_orientation_world"]).as_matrix()
    T[:3, 3] = row["camera_position_world"]
    return T


def cloud_of(message: Any) -> np.ndarray:
    assert [(f.name, f.offset, f.datatype) for f in message.fields] == [
        ("x", 0, 7),
        ("y", 4, 7),
        ("z", 8, 7),
        ("obstacle", 12, 6),
    ]
    cloud = np.frombuffer(message.data.tobytes(), POINT)
    assert (message.width, message.point_step) == (len(cloud), 16)
    return cloud


def test_detections_are_outlines_in_the_world(driven_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    assert [at for at, _ in topics[DETECTIONS]] == [f.row["stamp_ns"] for f in frames]
    for (at, message), (row, obstacles) in zip(topics[DETECTIONS], frames, strict=True):
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == at
        assert message.header.frame_id == row["camera_frame"]
        assert len(message.detections) == len(obstacles) > 0
        for found, obstacle in zip(message.detections, obstacles, strict=True):
            assert found.id == str(obstacle["obstacle"])
            assert found.results[0].hypothesis.class_id == "obstacle"
            size = found.bbox.size
            half = np.array([size.x, size.y]) / 2
            ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
            T = world(row) @ motion(found.bbox.center.position, found.bbox.center.orientation)
            corners = np.insert(ring, 2, 0.0, axis=1) @ T[:3, :3].T + T[:3, 3]
            want = np.reshape(obstacle["corners_world"], (4, 2))
            apart = np.linalg.norm(corners[:, None, :2] - want, axis=2)
            assert apart.min(axis=0).max() < 0.02 and apart.min(axis=1).max() < 0.02
            assert size.z == pytest.approx(obstacle["top_m"] - obstacle["bottom_m"], abs=1e-6)
            middle = (obstacle["top_m"] + obstacle["bottom_m"]) / 2
            assert T[2, 3] == pytest.approx(middle, abs=0.03)


def test_scans_equal_the_rays_of_the_table(driven_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    assert len(topics[SCAN]) == len(frames)
    for (at, message), (row, _) in zip(topics[SCAN], frames, strict=True):
        assert at == row["stamp_ns"]
        assert message.header.frame_id == f"{row['camera_frame']}_floor"
        angle = message.angle_min + np.arange(len(message.ranges)) * message.angle_increment
        assert angle[-1] == pytest.approx(message.angle_max, abs=1e-5)
        known = 0
        for bearing, stop, end in zip(
            row["free_bearing_rad"], row["free_to_m"], row["free_end"], strict=True
        ):
            turn = (angle - (np.pi / 2 - bearing) + np.pi) % (2 * np.pi) - np.pi
            (value,) = message.ranges[np.abs(turn) < 1e-3]
            seen = stop if stop <= message.range_max else np.inf
            want = {0: np.nan, 1: seen, 2: seen, 3: np.inf}[end]
            np.testing.assert_equal(value, np.float32(want))
            known += end != 0
        assert np.count_nonzero(~np.isnan(message.ranges)) == known > 50
        assert message.range_min == pytest.approx(min(row["free_from_m"]))
        assert message.range_min <= np.nanmin(message.ranges)


def test_each_frame_has_a_grid_around_its_ground_projection(
    driven_results: Path, tmp_path: Path
) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    for (_, message), (row, obstacles) in zip(topics[LOCAL], frames, strict=True):
        info, states = message.info, np.reshape(message.data, (message.info.height, -1))
        assert message.header.frame_id == f"{row['camera_frame']}_floor"
        assert set(np.unique(states)) <= {-1, 0, 100}

        def state(x: float, y: float, info: Any = info, states: Any = states) -> int:
            place = np.array([x - info.origin.position.x, y - info.origin.position.y])
            column, line = np.floor(place / info.resolution).astype(int).tolist()
            return int(states[line, column])

        for obstacle in obstacles:
            middle = np.reshape(obstacle["corners_ground"], (4, 2)).mean(axis=0)
            if np.abs(middle).max() < 0.9 * info.width * info.resolution / 2:
                assert state(*middle) == 100
        assert state(0.0, -1.0) == -1  # behind the camera
        least, most = free_between_rays(row)
        rows, columns = states.shape
        x = info.origin.position.x + (np.arange(columns) + 0.5) * info.resolution
        y = info.origin.position.y + (np.arange(rows)[:, None] + 0.5) * info.resolution
        sector = np.floor(np.arctan2(x, y) / (2 * np.pi / RAYS) + RAYS / 2).astype(int) % RAYS
        away, margin = np.hypot(x, y), info.resolution
        # Inside: grid cells that are free between three neighbouring pairs of rays. Outside: those
        # more than two cells away from the free floor of any ray nearby.
        first, last = (
            f([np.roll(a, i) for i in (-1, 0, 1)], axis=0)[sector]
            for f, a in ((np.max, least), (np.min, most))
        )
        inside = (away > first + 0.01) & (away < last - 0.01)
        assert inside.sum() > 500 and (states[inside] != -1).all()
        near = [np.roll(a, i) for a in (least, most) for i in range(-40, 41)]
        low, high = np.min(near[:81], axis=0)[sector], np.max(near[81:], axis=0)[sector]
        outside = (away > 2 * margin / np.radians(10)) & (
            (away < low - 2 * margin) | (away > high + 2 * margin)
        )
        assert outside.sum() > 500 and (states[outside] != 0).all()


def free_between_rays(row: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the ranges at which free floor begins and ends between adjacent rays."""
    start, stop = np.full(RAYS, np.inf), np.zeros(RAYS)
    number = np.rint(np.degrees(row["free_bearing_rad"]) * 4).astype(int) + RAYS // 2
    start[number], stop[number] = row["free_from_m"], row["free_to_m"]
    least, most = np.maximum(start, np.roll(start, -1)), np.minimum(stop, np.roll(stop, -1))
    return np.where(least < most, least, np.inf), np.where(least < most, most, 0.0)


def test_points_equal_the_contours(driven_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    for (_, message), (row, obstacles) in zip(topics[POINTS], frames, strict=True):
        cloud = cloud_of(message)
        points = np.stack([cloud["x"], cloud["y"], cloud["z"]], axis=1).astype(np.float64)
        points = points @ world(row)[:3, :3].T + world(row)[:3, 3]
        for obstacle in obstacles:
            own = points[cloud["obstacle"] == obstacle["obstacle"]]
            assert len(own) == len(obstacle["contour"])
            heights = np.repeat([obstacle["bottom_m"], obstacle["top_m"]], len(own) // 2)
            np.testing.assert_allclose(own[:, 2], heights, atol=0.03)
            foot = world(row)[:2, 3]
            near = np.linalg.norm(own[:, :2] - foot, axis=1).min()
            assert near == pytest.approx(obstacle["distance_m"], abs=0.02)


def test_points_of_clusters_have_heights_with_a_camera_upside_down() -> None:
    row = {"camera_height_m": 1.0, "camera_pitch_rad": 0.0, "camera_roll_rad": np.pi}
    cluster = {"bottom_m": None, "x": 0.0, "z": 2.0, "y_min": -0.5, "y_max": 0.25}
    assert heights(row, cluster) == pytest.approx((0.5, 1.25))
    assert heights(row | {"camera_roll_rad": 0.0}, cluster) == pytest.approx((0.75, 1.5))


def test_an_outline_without_length_has_a_box_on_the_floor() -> None:
    """The box has the orientation of the floor."""
    T, size = box({"corners_ground": [1.0, 2.0] * 4}, 0.0, 0.5)
    np.testing.assert_allclose(T, [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 0.25], [0, 0, 0, 1]])
    assert size.tolist() == [0, 0, 0.5]


def test_points_come_from_the_depth_images_if_the_log_is_given(
    driven_log: Path, driven_results: Path, tmp_path: Path
) -> None:
    topics, frames = exported(driven_results, tmp_path / "out", driven_log)
    for (_, message), (_, obstacles) in zip(topics[POINTS], frames, strict=True):
        cloud = cloud_of(message)
        assert len(cloud) == sum(obstacle["num_points"] for obstacle in obstacles)
        for obstacle in obstacles:
            own = cloud[cloud["obstacle"] == obstacle["obstacle"]]
            assert len(own) == obstacle["num_points"]
            for axis in "xyz":
                assert own[axis].min() == pytest.approx(obstacle[f"{axis}_min"], abs=1e-6)
                assert own[axis].max() == pytest.approx(obstacle[f"{axis}_max"], abs=1e-6)


def test_the_map_is_an_occupancy_grid(driven_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    ((at, message),) = topics[MAP]
    with Results(driven_results) as results:
        grid = last_grid(results, results.logs[0])
    assert grid is not None and at == frames[0].row["stamp_ns"]
    info = message.info
    assert message.header.frame_id == "odom"
    cells = np.asarray(message.data).reshape(info.height, info.width)
    np.testing.assert_array_equal(cells, grid.states)
    assert info.resolution == pytest.approx(grid.cell_m)
    assert (info.origin.position.x, info.origin.position.y) == grid.origin


def test_without_poses_messages_are_in_the_floor_frame(
    aims_results: Path, shared_data: Path, tmp_path: Path
) -> None:
    topics, frames = exported(aims_results, tmp_path / "out", shared_data / "aims_slam")
    assert MAP not in topics and len(topics[DETECTIONS]) == len(frames) == 18
    for (_, message), (row, obstacles) in zip(topics[POINTS], frames, strict=True):
        assert message.header.frame_id == row["camera_frame"]
        assert len({*cloud_of(message)["obstacle"].tolist()}) >= 0.7 * len(obstacles)
    for _, message in topics["/tf"]:
        (edge,) = message.transforms
        assert edge.child_frame_id == "camera_depth_optical_frame_floor"


def test_tf_frames_have_one_parent_next_to_a_recording_with_odometry(
    driven_log: Path, tmp_path: Path
) -> None:
    found = run(driven_log, tmp_path / "results", "paper", LogOptions(odom="/odom"))
    topics, frames = exported(found, tmp_path / "out")
    name = f"{frames[0].row['camera_frame']}_jaxdet"
    ours = {(t.header.frame_id, t.child_frame_id) for _, m in topics["/tf"] for t in m.transforms}
    assert ours == {("odom", name), (name, f"{name}_floor")}
    for topic in (DETECTIONS, POINTS):
        assert {message.header.frame_id for _, message in topics[topic]} == {name}
    edge = topics["/tf"][0][1].transforms[-1].transform
    np.testing.assert_allclose(
        motion(edge.translation, edge.rotation), world(frames[0].row), atol=1e-9
    )


def test_the_log_is_read_again_with_the_options_of_the_run(
    driven_log: Path, driven_results: Path
) -> None:
    with Results(driven_results) as results:
        of, files = results.logs[0], find(results, [str(driven_log)])["sim"]
        for chunk, batch in images(results, of, files):
            stamps = batch.frames.stamp_ns[: chunk.frames.num_rows]
            assert stamps.tolist() == chunk.frames["stamp_ns"].to_pylist()
        (seen,) = look_again(results, of, files)
    assert seen.chunk.frames.num_rows == 6 < len(seen.batch.status)
    counts = seen.chunk.frames["num_obstacles"].to_pylist()
    assert seen.found.num_obstacles[:6].tolist() == counts
    boxes = [
        seen.found.obstacles.uv_min[i, label].tolist()
        for i, count in enumerate(counts)
        for label in range(count)
    ]
    columns = (seen.chunk.obstacles[name].to_pylist() for name in ("u_min", "v_min"))
    rows = [[0 if a is None else a for a in pair] for pair in zip(*columns, strict=True)]
    assert boxes == rows


def test_another_log_is_refused(driven_log: Path, driven_results: Path, tmp_path: Path) -> None:
    other = sim_log(tmp_path / "other.mcap", frames=6, seed=5)
    later = sim_log(tmp_path / "later.mcap", start_ns=10**18)
    short = sim_log(tmp_path / "short.mcap", frames=2)
    with Results(driven_results) as results:
        for path in (later, short):
            with pytest.raises(InputError, match="not the log 'sim'"):
                list(images(results, results.logs[0], LogFiles("sim", (path,))))
        with pytest.raises(InputError, match="not the log 'sim'"):
            list(look_again(results, results.logs[0], LogFiles("sim", (other,))))
        with pytest.raises(InputError, match="no log 'later'; their logs are sim"):
            find(results, [str(later), str(short)])
        with pytest.raises(InputError, match="not the log 'sim'"):
            export(results, "ros2", tmp_path / "out", find(results, [str(later)]))
    assert not (tmp_path / "out").exists() and not list(tmp_path.glob(".jaxdet-*"))


def test_the_command_explains_errors(
    driven_results: Path, tmp_path: Path, capsys: Captured
) -> None:
    def errors_of(*args: str) -> str:
        code = main(["export", *args])
        error = capsys.readouterr().err
        assert code in (1, 2) and error.count("\n") == 1
        return error

    out = str(tmp_path / "out")
    assert "no such folder" in errors_of(str(tmp_path / "x"), "--to", "nav2", "--output", out)
    message = errors_of(str(tmp_path), "--to", "nav2", "--output", out)
    assert "manifest.json and run.json are missing" in message
    with pytest.MonkeyPatch.context() as patch:
        patch.delitem(sys.modules, "jaxdet.export.foxglove", raising=False)
        patch.setitem(sys.modules, "mcap_protobuf.writer", None)
        message = errors_of(str(driven_results), "--to", "foxglove", "--output", out)
    assert "--to foxglove needs the package mcap_protobuf" in message
    taken = tmp_path / "taken"
    taken.write_text("mine")
    assert "exists already" in errors_of(
        str(driven_results), "--to", "ros2", "--output", str(taken)
    )
    assert taken.read_text() == "mine"
    assert "no such file" in errors_of(
        str(driven_results), "--to", "ros2", "--output", out, "--log", "x.mcap"
    )
    assert main(["export", str(driven_results), "--to", "pdf", "--output", out]) == 2
    error = capsys.readouterr().err
    assert all(name in error for name in FORMATS)
