"""Rerun export: recordings are read with Rerun and compared with the tables."""

import json
import shutil
import subprocess
from collections import Counter, defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxdet.errors import ConfigError
from jaxdet.export import export
from jaxdet.export.map_picture import FREE
from jaxdet.export.recordings import find
from jaxdet.render.canvas import PALETTE
from jaxdet.results.free_floor import RAY_RAD
from jaxdet.results.reading import Results
from tests.made_results import make_results

FLOOR, CAMERA = "/world/floor", "/world/floor/camera"


def recording_of(folder: Path, output: Path, *logs: str) -> dict[str, dict[str, dict[int, Any]]]:
    """Return values by entity, component and frame; static ones are at frame -1."""
    chunk = pytest.importorskip("rerun.chunk")
    with Results(folder) as results:
        export(results, "rerun", output, find(results, logs))
    (path,) = output.iterdir()
    reader = chunk.RrdReader(path)
    assert len(reader.recordings()) == 1 and len(reader.blueprints()) == 1
    found: dict[str, dict[str, dict[int, Any]]] = defaultdict(lambda: defaultdict(dict))
    for part in reader.stream():
        batch = part.to_record_batch()
        frames = [-1] * part.num_rows if part.is_static else batch.column("frame").to_pylist()
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            values = column.to_pylist()
            known = ((f, v) for f, v in zip(frames, values, strict=True) if v is not None)
            found[part.entity_path][name.rpartition(":")[2]].update(known)
    return found


def motion(found: Any, entity: str, frame: int) -> np.ndarray:
    """Return ``T_parent_entity`` ``(4, 4)``."""
    T = np.eye(4)
    T[:3, :3] = np.reshape(found[entity]["mat3x3"][frame], (3, 3), order="F")
    T[:3, 3] = np.ravel(found[entity]["translation"][frame])
    return T


def check(folder: Path, found: Any) -> None:
    """Assert that the recording agrees with the tables."""
    frames = pq.read_table(folder / "frames.parquet").to_pylist()
    rows = defaultdict(list)
    for row in pq.read_table(folder / "obstacles.parquet").to_pylist():
        rows[row["frame"]].append(row)
    boxes, flat = found[f"{FLOOR}/boxes"], found[f"{CAMERA}/color/boxes"]
    for frame in frames:
        number, parts = frame["frame"], rows[frame["frame"]]
        assert found["/obstacles"]["scalars"][number] == [len(parts)]
        nearest = found["/distance/nearest"]["scalars"].get(number)
        assert nearest == ([min(r["distance_m"] for r in parts)] if parts else None)
        assert boxes["labels"][number][0].startswith("0 ") and len(boxes["labels"][number]) == len(
            parts
        )
        centers, sizes = boxes["centers"][number], boxes["half_sizes"][number]
        for row, center, size in zip(parts, centers, sizes, strict=True):
            corners = np.reshape(row["corners_ground"], (4, 2))
            np.testing.assert_allclose(center[:2], corners.mean(axis=0), atol=1e-4)
            np.testing.assert_allclose(center[2] - size[2], row["bottom_m"], atol=1e-4)
            np.testing.assert_allclose(center[2] + size[2], row["top_m"], atol=1e-4)
            length = np.linalg.norm(corners[1] - corners[0])
            np.testing.assert_allclose(2 * size[0], length, atol=1e-4)
            if row["corners_world"]:
                T = motion(found, FLOOR, number)
                world = T @ [*center[:2], 0, 1]
                expected = np.reshape(row["corners_world"], (4, 2)).mean(axis=0)
                np.testing.assert_allclose(world[:2], expected, atol=1e-4)
        parts = [r for r in parts if r["u_min"] is not None]  # those in the colour image
        half = np.reshape(flat["half_sizes"][number], (-1, 2))
        low = np.reshape(flat["centers"][number], (-1, 2)) - half
        assert low.tolist() == [[r["u_min"], r["v_min"]] for r in parts]
        high = low + 2 * half
        assert high.tolist() == [[r["u_max"] + 1, r["v_max"] + 1] for r in parts]


def check_points(folder: Path, found: Any) -> None:
    """Assert that the points of the nearest obstacle lie in its box on the floor.

    Frames in which another obstacle has its colour are left out.
    """
    rows = pq.read_table(folder / "obstacles.parquet").to_pylist()
    counts = Counter(row["frame"] for row in rows)
    unique = {frame for frame, count in counts.items() if count <= len(PALETTE)}
    assert len(unique) > len(counts) / 2
    for row in rows:
        number = row["frame"]
        if row["obstacle"] or number not in unique:
            continue
        T = motion(found, CAMERA, number)
        points, colors = (found[f"{CAMERA}/points"][k][number] for k in ("positions", "colors"))
        own = np.array(points)[np.array(colors) == found[f"{FLOOR}/boxes"]["colors"][number][0]]
        height = (own @ T[:3, :3].T + T[:3, 3])[:, 2]
        assert len(own) >= row["num_points"]
        np.testing.assert_allclose(height.min(), row["bottom_m"], atol=0.01)
        np.testing.assert_allclose(height.max(), row["top_m"], atol=0.01)


def test_recording_with_the_log_has_images_points_and_map(drive: Path, tmp_path: Path) -> None:
    log = str(drive / "drive.mcap")
    found = recording_of(drive / "out", tmp_path / "out", log)
    check(drive / "out", found)
    check_points(drive / "out", found)
    assert len(found[f"{CAMERA}/color"]["blob"]) == len(found[f"{CAMERA}/depth"]["blob"]) == 5
    shown = found["/world/map"]
    with np.load(drive / "out" / "map.npz") as map_:
        drawn = np.reshape(shown["data"][-1], (*map_["counts"].shape, 3))[::-1]  # Y up
        assert np.array_equal(
            (drawn == FREE).all(axis=-1), (map_["free"] > 0) & (map_["counts"] == 0)
        )
        np.testing.assert_allclose(
            np.ravel(shown["translation"][-1])[:2], map_["origin"], atol=1e-5
        )
    assert found["/world/path"] and found[f"{FLOOR}/free"]
    program = shutil.which("rerun") or str(Path(shutil.which("python") or "").with_name("rerun"))
    if Path(program).exists():
        file = next((tmp_path / "out").iterdir())
        env = {"HOME": str(tmp_path), "DO_NOT_TRACK": "1"}
        subprocess.run([program, "rrd", "verify", str(file)], check=True, env=env, timeout=60)


def test_recording_without_the_log_agrees_with_the_tables(drive: Path, tmp_path: Path) -> None:
    found = recording_of(drive / "out", tmp_path / "out")
    check(drive / "out", found)
    assert "blob" not in found[f"{CAMERA}/color"] and f"{CAMERA}/points" not in found


def test_recording_of_a_recorded_log_agrees_with_its_tables(
    aims_log: Path, aims_results: Path, tmp_path: Path
) -> None:
    log, folder = aims_log, aims_results
    found = recording_of(folder, tmp_path / "out", str(log))
    check(folder, found)
    check_points(folder, found)
    assert len(found[f"{CAMERA}/color"]["blob"]) == 18 and "/world/map" not in found


def rewrite(path: Path, change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]]) -> int:
    """Replace the rows of a table; return the number of new rows."""
    about = pq.read_metadata(path).metadata
    own = {key: value for key, value in about.items() if key.startswith(b"jaxdet.")}
    table = pq.read_table(path)
    rows = change(table.to_pylist())
    pq.write_table(pa.Table.from_pylist(rows, table.schema.with_metadata(own)), path)
    return len(rows)


def test_a_frame_lost_in_the_run_has_images_and_no_points(drive: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(drive, tmp_path / "drive") / "out"

    def lost(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        assert rows[2]["num_obstacles"] > 0
        rows[2] |= {"num_obstacles": 0, "status": "worker_crashed"}
        return rows

    rewrite(folder / "frames.parquet", lost)
    left = rewrite(folder / "obstacles.parquet", lambda rows: [r for r in rows if r["frame"] != 2])
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    summary["obstacles"] = summary["logs"][0]["obstacles"] = left
    (folder / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    found = recording_of(folder, tmp_path / "out", str(drive / "drive.mcap"))
    assert 2 in found[f"{CAMERA}/color"]["blob"] and 2 in found[f"{CAMERA}/depth"]["blob"]
    assert sorted(found[f"{CAMERA}/points"]["positions"]) == [0, 1, 3, 4]


POSE = "camera_position_world", "camera_orientation_world"
FLOOR_OF_FRAME = "camera_height_m", "camera_pitch_rad", "camera_roll_rad"


@pytest.mark.parametrize("columns", [POSE, FLOOR_OF_FRAME])
def test_frames_without_pose_or_floor_have_no_position(
    drive: Path, tmp_path: Path, columns: tuple[str, ...]
) -> None:
    """Positions of the previous frame are cleared; the boxes in the image stay."""
    folder = shutil.copytree(drive, tmp_path / "drive") / "out"
    pose = dict.fromkeys(columns)

    def lost(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
        for row in rows:
            if row["frame"] == 2:
                row |= {"corners_world": None} if "obstacle" in row else pose
        return rows

    for name in ("frames", "obstacles"):
        rewrite(folder / f"{name}.parquet", lost)
    found = recording_of(folder, tmp_path / "out", str(drive / "drive.mcap"))
    for name, what in (("boxes", "centers"), ("contours", "strips"), ("free", "vertex_positions")):
        entity = found[f"{FLOOR}/{name}"]
        assert sorted(entity[what]) == [0, 1, 3, 4] and sorted(entity["is_recursive"]) == [2]
    assert sorted(found[f"{CAMERA}/points"]["positions"]) == [0, 1, 3, 4]
    assert sorted(found[f"{CAMERA}/color/boxes"]["labels"]) == [0, 1, 2, 3, 4]
    rewrite(folder / "frames.parquet", lambda rows: [row | pose for row in rows])
    found = recording_of(folder, tmp_path / "none", str(drive / "drive.mcap"))
    assert sorted(found[f"{FLOOR}/boxes"]["centers"]) == [0, 1, 2, 3, 4]


def test_each_log_has_a_recording_with_its_lost_frames(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    folder = make_results(tmp_path / "results", {"a/b": 60, "c": 5})
    with Results(folder) as results:
        export(results, "rerun", tmp_path / "out", {})
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a--b.rrd", "c.rrd"]


def test_free_floor_equals_that_of_the_map() -> None:
    """Free floor is not interpolated over unknown rays, and ends at the nearer of two rays."""
    show = pytest.importorskip("jaxdet.export.rerun")._free
    bearing = [RAY_RAD * i for i in (-5, -4, -3, 3, 4, 5)]
    row = {"free_bearing_rad": bearing, "free_from_m": [0.5] * 6, "free_to_m": [2.0] * 5 + [1.0]}
    mesh = show(row)
    place = np.array(mesh.vertex_positions.as_arrow_array().to_pylist())
    corners = place[np.array(mesh.triangle_indices.as_arrow_array().to_pylist())]
    angle, far = np.arctan2(corners[..., 0], corners[..., 1]), np.hypot(*corners.T[:2]).T
    assert np.ptp(angle, axis=1).max() < 1.1 * RAY_RAD and not place[:, 2].any()
    assert far[(angle > 4.1 * RAY_RAD).any(axis=1)].max() == pytest.approx(1.0) and far.max() > 1.99
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2
    assert area == pytest.approx(np.sin(RAY_RAD) / 2 * (3 * 3.75 + 0.75), rel=1e-6)
    nothing = dict.fromkeys(row)
    assert type(show(nothing)) is type(show({name: [1.0] for name in row}))


def test_missing_package_names_the_extra(drive: Path, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    monkeypatch.delitem(__import__("sys").modules, "jaxdet.export.rerun", raising=False)
    with Results(drive / "out") as results, pytest.raises(ConfigError, match=r"jaxdet\[rerun\]"):
        export(results, "rerun", tmp_path / "out", {})
