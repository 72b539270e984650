"""Foxglove export: the sidecar is read by the mcap library, and its transforms are resolved."""

import json
import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from mcap_ros2.decoder import DecoderFactory as Ros2DecoderFactory
from scipy.spatial.transform import Rotation, Slerp

from jaxdet.export import export
from jaxdet.export.grid import last_grid
from jaxdet.io import LogOptions
from jaxdet.results.map_file import FREE, OCCUPIED
from jaxdet.results.reading import Results
from jaxdet.results.tables import Frame
from tests.camera_logs import join_cameras
from tests.export_results import run
from tests.runs import run_logs
from tests.test_io_image_folder import GIVEN, STAMPS, write_tum

SCENE, BOXES, MAP, TF = (f"/jaxdet/{name}" for name in ("obstacles", "boxes", "map", "tf"))
Topics = dict[str, list[tuple[int, Any]]]


def messages(path: Path) -> Topics:
    """Return the messages of a file with their log times, by topic."""
    found = defaultdict(list)
    with path.open("rb") as stream:
        factories = [DecoderFactory(), Ros2DecoderFactory()]
        reader = make_reader(stream, validate_crcs=True, decoder_factories=factories)
        for _, channel, message, decoded in reader.iter_decoded_messages():
            assert message.log_time == message.publish_time
            found[channel.topic].append((message.log_time, decoded))
    return found


def exported(folder: Path, to: Path) -> tuple[Topics, list[Frame]]:
    """Export results; return the messages of the sidecar and the frames of the results."""
    with Results(folder) as results:
        export(results, "foxglove", to, {})
        frames = list(results.frames())
        return messages(to / f"{results.logs[0].file_name}.jaxdet.mcap"), frames


def motion(place: Any, turn: Any) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    T[:3, 3] = place.x, place.y, place.z
    return T


def moved(T: np.ndarray, points: Any) -> np.ndarray:
    return np.array([[p.x, p.y, p.z] for p in points]) @ T[:3, :3].T + T[:3, 3]


def recorded_camera(topics: Topics, stamp_ns: int, camera: str) -> np.ndarray:
    """Return the pose of the camera in odom, interpolated in the TF of the recording."""
    edges: dict[str, tuple[str, list]] = {}
    for topic in ("/tf_static", "/tf"):
        for _, message in topics[topic]:
            for item in message.transforms:
                at = item.header.stamp.sec * 10**9 + item.header.stamp.nanosec
                T = motion(item.transform.translation, item.transform.rotation)
                parent = item.header.frame_id
                edges.setdefault(item.child_frame_id, (parent, []))[1].append((at, T))
    T = np.eye(4)
    while camera != "odom":
        camera, samples = edges[camera]
        T = interpolated(samples, stamp_ns) @ T
    return T


def interpolated(samples: list, stamp_ns: int) -> np.ndarray:
    if len(samples) == 1:
        return samples[0][1]
    times = np.array([at - stamp_ns for at, _ in samples]) / 1e9
    poses = np.array([T for _, T in samples])
    T = np.eye(4)
    T[:3, :3] = Slerp(times, Rotation.from_matrix(poses[:, :3, :3]))(0.0).as_matrix()
    T[:3, 3] = [np.interp(0.0, times, poses[:, i, 3]) for i in range(3)]
    return T


def outside(points: np.ndarray, corners: list[float]) -> float:
    """Return how far the points are outside of an outline at most [m], negative if inside."""
    ring = np.reshape(corners, (4, 2))
    sides = np.roll(ring, -1, axis=0) - ring
    inward = ring.mean(axis=0) - ring
    normal = np.stack([-sides[:, 1], sides[:, 0]], axis=1)
    normal *= np.sign((normal * inward).sum(axis=1, keepdims=True))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    depth = ((points[:, None] - ring) * normal).sum(axis=2)
    return float(-depth.min())


def in_world(obstacle: dict[str, Any]) -> np.ndarray:
    """Return the contour in the world, by the transform of corners_ground to corners_world."""
    ground, world = (
        np.reshape(obstacle[f"corners_{where}"], (4, 2)) for where in ("ground", "world")
    )
    affine, *_ = np.linalg.lstsq(np.c_[ground, np.ones(4)], world, rcond=None)
    contour = np.reshape(obstacle["contour"], (-1, 2))
    return np.c_[contour, np.ones(len(contour))] @ affine


def test_messages_of_each_frame_replace_those_of_the_previous_one(
    driven_results: Path, tmp_path: Path
) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    stamps = [frame.row["stamp_ns"] for frame in frames]
    for topic in (TF, SCENE, BOXES):
        assert [at for at, _ in topics[topic]] == stamps
    for (at, update), (row, obstacles) in zip(topics[SCENE], frames, strict=True):
        (gone,) = update.deletions
        assert gone.type == gone.ALL and gone.timestamp.ToNanoseconds() == at
        assert len(update.entities) == len(obstacles) == row["num_obstacles"] > 0
        assert len({entity.id for entity in update.entities}) == len(obstacles)
        for entity, obstacle in zip(update.entities, obstacles, strict=True):
            assert entity.frame_id == row["camera_frame"] == "camera_depth_optical_frame"
            assert entity.timestamp.ToNanoseconds() == at and entity.lifetime.ToNanoseconds() == 0
            about = {item.key: item.value for item in entity.metadata}
            assert float(about["distance_m"]) == pytest.approx(obstacle["distance_m"], rel=1e-5)
            assert entity.texts[0].text.endswith(f"{obstacle['distance_m']:.2f} m")


def test_contours_have_their_position_in_the_world_of_the_recording(
    driven_log: Path, driven_results: Path, tmp_path: Path
) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    recording, walls = messages(driven_log), 0
    assert len(recording["/tf"]) > 5
    for (at, update), (row, obstacles) in zip(topics[SCENE], frames, strict=True):
        camera = recorded_camera(recording, at, row["camera_frame"])
        np.testing.assert_allclose(camera[:3, 3], row["camera_position_world"], atol=1e-6)
        for entity, obstacle in zip(update.entities, obstacles, strict=True):
            if not entity.triangles:
                continue  # the contour is a point
            (wall,) = entity.triangles
            walls += 1
            T = camera @ motion(wall.pose.position, wall.pose.orientation)
            points = moved(T, wall.points)
            edge = in_world(obstacle)
            np.testing.assert_allclose(points[:, :2], np.r_[edge, edge], atol=0.03)
            low, high = np.split(points[:, 2], 2)
            np.testing.assert_allclose(low, obstacle["bottom_m"], atol=0.03)
            np.testing.assert_allclose(high, obstacle["top_m"], atol=0.03)
            half = len(points) // 2
            assert {*wall.indices} == {*range(len(points))} and len(wall.indices) == 6 * (half - 1)
            (text,) = entity.texts
            shown = moved(camera, [text.pose.position])[0]
            assert shown[2] == pytest.approx(obstacle["top_m"] + 0.08, abs=0.03)
    assert walls > 0.8 * sum(len(frame.obstacles) for frame in frames)


def test_the_sidecar_has_the_poses_if_the_log_has_no_tf(driven_log: Path, tmp_path: Path) -> None:
    found = run(driven_log, tmp_path / "results", "paper", LogOptions(odom="/odom"))
    topics, frames = exported(found, tmp_path / "out")
    recording = messages(driven_log)
    theirs = {t.child_frame_id for _, m in recording["/tf_static"] for t in m.transforms}
    assert frames[0].row["camera_frame"] in theirs
    assert not {t.child_frame_id for _, m in topics[TF] for t in m.transforms} & theirs
    count = 0
    for (_, tree), (_, update), (row, obstacles) in zip(
        topics[TF], topics[SCENE], frames, strict=True
    ):
        edges = {(t.parent_frame_id, t.child_frame_id): t for t in tree.transforms}
        name = f"{row['camera_frame']}_jaxdet"
        assert {entity.frame_id for entity in update.entities} == {name}
        assert set(edges) == {("odom", name), (name, f"{name}_floor")}
        edge = edges["odom", name]
        camera = motion(edge.translation, edge.rotation)
        for entity, obstacle in zip(update.entities, obstacles, strict=True):
            (cube,) = entity.cubes
            half = np.array([cube.size.x, cube.size.y]) / 2
            ring = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
            T = camera @ motion(cube.pose.position, cube.pose.orientation)
            corners = np.insert(ring, 2, 0.0, axis=1) @ T[:3, :3].T + T[:3, 3]
            want = np.reshape(obstacle["corners_world"], (4, 2))
            apart = np.linalg.norm(corners[:, None, :2] - want, axis=2)
            assert apart.min(axis=0).max() < 0.002 and apart.min(axis=1).max() < 0.002
            count += 1
    assert count >= 6


def test_the_sidecar_of_an_image_folder_has_its_poses(tmp_path: Path) -> None:
    """The poses come from groundtruth.txt, as an image folder has no TF."""
    found = run(write_tum(tmp_path / "room"), tmp_path / "results", options=GIVEN)
    topics, frames = exported(found, tmp_path / "out")
    assert len(frames) == len(STAMPS)
    for (_, tree), (row, _) in zip(topics[TF], frames, strict=True):
        edges = {(t.parent_frame_id, t.child_frame_id): t for t in tree.transforms}
        edge = edges[row["world_frame"], f"{row['camera_frame']}_jaxdet"]
        place = edge.translation.x, edge.translation.y, edge.translation.z
        np.testing.assert_allclose(place, row["camera_position_world"], atol=1e-6)


def test_a_log_with_topic_names_of_image_folders_is_not_an_image_folder(
    driven_log: Path, tmp_path: Path
) -> None:
    """A file without a suffix may use the topic names of image folders."""
    log = tmp_path / "drive"
    with driven_log.open("rb") as old, log.open("wb") as new:
        writer = Writer(new)
        writer.start()
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            topic = channel.topic.replace("/camera/camera/", "/camera/").replace("_raw", "")
            form = writer.register_schema(schema.name, schema.encoding, schema.data)
            to = writer.register_channel(topic, channel.message_encoding, form)
            writer.add_message(to, message.log_time, message.data, message.publish_time)
        writer.finish()
    with Results(run(log, tmp_path / "results")) as results:
        assert results.logs[0].topic("color") == "/camera/color/image"
        assert results.logs[0].poses_from_tf


def test_the_floor_frame_agrees_with_the_table(driven_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    for (_, tree), (row, _) in zip(topics[TF], frames, strict=True):
        (edge,) = tree.transforms  # the TF of the log connects camera and world
        T = motion(edge.translation, edge.rotation)
        assert np.linalg.norm(T[:3, 3]) == pytest.approx(row["camera_height_m"], abs=1e-6)
        # The optical axis points below the horizon of the floor by the pitch, and the x axis of
        # the image by the roll.
        axis, right = np.linalg.inv(T)[:3, 2], np.linalg.inv(T)[:3, 0]
        assert -np.arcsin(axis[2]) == pytest.approx(row["camera_pitch_rad"], abs=1e-6)
        down = np.sin(row["camera_roll_rad"]) * np.cos(row["camera_pitch_rad"])
        assert -right[2] == pytest.approx(down, abs=1e-6)
        assert axis[0] == pytest.approx(0.0, abs=1e-6) and axis[1] > 0.9


def test_boxes_are_inside_of_the_colour_image(driven_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    tops = [text for _, shown in topics[BOXES] for text in shown.texts]
    assert min(text.position.y - text.font_size for text in tops) >= 0  # lower left corner
    boxes = [[o for o in obstacles if o["u_min"] is not None] for _, obstacles in frames]
    assert any(o["v_min"] < tops[0].font_size for own in boxes for o in own)
    assert sum(map(len, boxes)) < sum(len(obstacles) for _, obstacles in frames)
    for (at, shown), own in zip(topics[BOXES], boxes, strict=True):
        for box, text, o in zip(shown.points, shown.texts, own, strict=True):
            assert box.timestamp.ToNanoseconds() == text.timestamp.ToNanoseconds() == at
            u, v = zip(*((p.x, p.y) for p in box.points), strict=True)
            edges = min(u), max(u), min(v), max(v)
            assert text.position.x == o["u_min"] and text.position.y >= o["v_min"]
            assert edges == (o["u_min"], o["u_max"] + 1, o["v_min"], o["v_max"] + 1)
            assert box.type == box.LINE_LOOP and text.text == f"{o['obstacle']}   " + text.text[-6:]


def test_the_map_is_a_grid_with_its_pose_in_the_world(driven_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(driven_results, tmp_path / "out")
    ((at, grid),) = topics[MAP]
    assert at == frames[0].row["stamp_ns"] and grid.frame_id == "odom"
    with Results(driven_results) as results:
        want = last_grid(results, results.logs[0])
    assert want is not None
    assert [field.name for field in grid.fields] == ["red", "green", "blue", "alpha"]
    assert grid.row_stride == 4 * want.states.shape[1]
    cells = np.frombuffer(grid.data, np.uint8).reshape(-1, grid.row_stride)
    cells = cells.reshape(-1, grid.column_count, grid.cell_stride)
    assert (cells[..., 3] > 0).tolist() == (want.states >= 0).tolist()
    red = cells[..., 0].astype(int) - cells[..., 1]
    assert ((red > 0) == (want.states == OCCUPIED)).all()
    assert ((red < 0) == (want.states == FREE)).all()
    assert (grid.pose.position.x, grid.pose.position.y) == want.origin
    assert grid.cell_size.x == grid.cell_size.y == want.cell_m


def test_the_layout_has_panels_for_the_existing_topics(
    driven_log: Path, driven_results: Path, tmp_path: Path
) -> None:
    topics, _ = exported(driven_results, tmp_path / "out")
    layout = json.loads((tmp_path / "out" / "layout.json").read_text())
    panels = layout["configById"]
    assert {layout["layout"]["first"], layout["layout"]["second"]} == set(panels)
    scene, image = panels["3D!jaxdet"], panels["Image!jaxdet"]["imageMode"]
    assert set(scene["topics"]) | set(image["annotations"]) <= set(topics)
    assert image["imageTopic"] in messages(driven_log) and scene["followTf"] == "odom"


def test_logs_with_other_topics_have_separate_layouts(driven_log: Path, tmp_path: Path) -> None:
    logs = [tmp_path / f"{name}.mcap" for name in ("a", "b", "c")]
    for log in logs[:2]:
        shutil.copy(driven_log, log)
    join_cameras({"rear": driven_log}, logs[2])
    run_logs(logs, tmp_path / "results", pictures=0)
    with Results(tmp_path / "results") as results:
        export(results, "foxglove", tmp_path / "out", {})
    names = {path.name for path in (tmp_path / "out").glob("*.json")}
    assert names == {"layout.json", "c.layout.json"}
    for name, log in (("layout.json", logs[0]), ("c.layout.json", logs[2])):
        panels = json.loads((tmp_path / "out" / name).read_text())["configById"]
        assert panels["Image!jaxdet"]["imageMode"]["imageTopic"] in messages(log)


def test_without_poses_results_are_in_the_floor_frame(aims_results: Path, tmp_path: Path) -> None:
    topics, frames = exported(aims_results, tmp_path / "out")
    assert MAP not in topics and len(frames) == 18
    entities = [entity for _, update in topics[SCENE] for entity in update.entities]
    assert len(entities) == sum(len(frame.obstacles) for frame in frames) > 30
    for (_, tree), (_, update), (_, obstacles) in zip(
        topics[TF], topics[SCENE], frames, strict=True
    ):
        (edge,) = tree.transforms
        T = np.linalg.inv(motion(edge.translation, edge.rotation))  # camera to floor
        for entity, obstacle in zip(update.entities, obstacles, strict=True):
            middle = T @ [obstacle["x"], obstacle["y"], obstacle["z"], 1.0]
            assert outside(middle[None, :2], obstacle["corners_ground"]) < 0.05
            # One frame has a ramp of 5 % downhill; its heights are above the ramp.
            assert obstacle["bottom_m"] - 0.08 < middle[2] < obstacle["top_m"] + 0.02
            for wall in entity.triangles:
                points = moved(T @ motion(wall.pose.position, wall.pose.orientation), wall.points)
                near = np.linalg.norm(points[:, :2], axis=1).min()
                assert near == pytest.approx(obstacle["distance_m"], abs=1e-5)
    layout = json.loads((tmp_path / "out" / "layout.json").read_text())
    assert layout["configById"]["3D!jaxdet"]["followTf"] == "camera_depth_optical_frame_floor"
