"""Conversion of detections to rows: the values of each column."""

import hashlib
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pyarrow as pa
import pytest

from jaxdet.config import Config
from jaxdet.errors import FrameStatus
from jaxdet.floor.plane import unknown_plane
from jaxdet.io import Batch
from jaxdet.pipeline import detect
from jaxdet.presets import preset
from jaxdet.results.free_floor import FreeFloor
from jaxdet.results.metric import rectangle_distances
from jaxdet.results.rows import batch_rows, joined_inputs, map_leaves, row_inputs, used_slots
from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from jaxdet.results.summary import Counts
from jaxdet.results.tables import to_table
from jaxdet.types import Calibration, Refusal
from tests.scenes import frames, level, small

SCHEMAS = {"frames": FRAMES_SCHEMA, "obstacles": OBSTACLES_SCHEMA}
FREE = ("free_bearing_rad", "free_from_m", "free_to_m", "free_end")
POINT_COLUMNS = {
    "frames": (
        *("log", "frame", "stamp_ns", "status"),
        *("num_obstacles", "overflow", "camera_height_m", "camera_pitch_rad", "camera_roll_rad"),
    ),
    "obstacles": (
        *("log", "frame", "stamp_ns", "obstacle", "num_points", "u_min", "u_max", "v_min", "v_max"),
        *("x_min", "x_max", "y_min", "y_max", "z_min", "z_max", "x", "y", "z", "vertices"),
        *("corners_ground", "corners_world"),
    ),
}
"""Columns of obstacles made of points."""


def boxes() -> Batch:
    """Return three frames of chequered boxes in front of a wall, the second without depth."""
    calibration = small(160, 120)
    v, u = np.mgrid[0:120, 0:160]
    depth = np.full((3, 120, 160), 3000, np.uint16) + (5 * u).astype(np.uint16)
    for b, (left, z) in enumerate(((20, 900), (60, 1400), (100, 2000))):
        depth[b, 40:90, left : left + 40] = z + (u[40:90, left : left + 40] - left)
    depth[1] = 0
    grey = np.where((u // 5 + v // 7) % 2 == 0, 40 + u, 250 - u).astype(np.uint8)
    color = np.repeat(np.stack([grey, grey[::-1], grey[:, ::-1]])[..., None], 3, axis=3)
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[:, 0, 3] = 0.5, 1.0, np.nan
    given = frames(calibration, color, depth, T_world_camera=T, plane=level(3, 0.4))
    return Batch(given, (FrameStatus.OK,) * 3, ("",) * 3)


def columns(name: str, **options: Any) -> dict[str, dict]:
    batch, config = boxes(), preset(name)
    found = detect(batch.frames, config, backend="reference")
    rows = batch_rows(
        "log", "cam", batch, batch.frames.plane, ["flags"] * 3, row_inputs(found), config
    )
    return {"frames": rows.frames, "obstacles": rows.obstacles}


def digest(rows: dict[str, dict]) -> str:
    """Return a digest of the columns of points."""
    sums = hashlib.sha256()
    for part, schema in SCHEMAS.items():
        table = to_table(rows[part], schema)
        for name in POINT_COLUMNS[part]:
            sums.update(f"{name} {table[name].to_pylist()}\n".encode())
    return sums.hexdigest()[:16]


def test_columns_of_obstacles_made_of_points_have_not_changed() -> None:
    assert digest(columns("paper")) == "6dc978f12fdb04e7"


def test_obstacles_made_of_points_have_no_contour_and_no_free_floor() -> None:
    rows = columns("paper")
    frame, obstacle = (to_table(rows[k], s) for k, s in SCHEMAS.items())
    assert frame["floor_source"].to_pylist() == ["flags"] * 3
    for name in ("floor_refused", *FREE, "drop_m"):
        assert frame[name].to_pylist() == [None] * 3
    for name in ("bottom_m", "top_m", "contour"):
        assert obstacle[name].null_count == obstacle.num_rows > 0
    outline = np.array(obstacle["corners_ground"].to_pylist()).reshape(-1, 4, 2)
    near = np.linalg.norm(outline[:, :2], axis=-1).min(axis=1)
    np.testing.assert_allclose(obstacle["distance_m"].to_numpy(), near, atol=0.1)


def test_rectangles_behind_their_obstacle_are_counted() -> None:
    rows = columns("paper")
    begins = rectangle_distances(rows["obstacles"]["corners_ground"].reshape(-1, 4, 2))
    for nearer, short in ((0.0, 0), (0.019, 0), (0.021, len(begins))):
        counts = Counts()
        counts.count(rows["frames"], rows["obstacles"] | {"distance_m": begins - nearer})
        assert counts.short_rectangles == short


def test_obstacles_made_of_surfaces_have_contours_heights_and_free_floor() -> None:
    rows = columns("wheeled")
    frame, obstacle = (to_table(rows[k], s).to_pylist() for k, s in SCHEMAS.items())
    assert [row["status"] for row in frame] == ["ok", "no_depth", "ok"]
    assert frame[0]["floor_source"] == "flags" and frame[0]["floor_refused"] is not None
    assert frame[1]["floor_refused"] is None
    assert all(frame[1][name] is None for name in FREE)
    assert obstacle
    for row in obstacle:
        points = np.array(row["contour"]).reshape(-1, 2)
        assert row["distance_m"] == pytest.approx(np.linalg.norm(points, axis=1).min(), rel=1e-6)
        assert (np.diff(points[:, 0]) > 0).all() and row["bottom_m"] < row["top_m"]
    assert len({len(frame[0][name]) for name in FREE}) == 1
    ahead = np.abs(np.array(frame[0]["free_bearing_rad"])) < 0.9
    assert ahead.all() and (np.diff(frame[0]["free_bearing_rad"]) > 0).all()


def test_without_a_floor_distances_heights_and_contours_are_null() -> None:
    batch, config = boxes(), Config()
    config = replace(config, ground=replace(config.ground, source="none"))
    given = batch.frames._replace(plane=unknown_plane(3))
    found = detect(given, config, backend="reference")
    rows = batch_rows(
        "log", "cam", batch, unknown_plane(3), ["none"] * 3, row_inputs(found), config
    )
    frame, obstacle = (
        to_table(a, s) for a, s in zip((rows.frames, rows.obstacles), SCHEMAS.values(), strict=True)
    )
    assert frame["floor_source"].to_pylist() == ["none"] * 3
    assert frame["floor_refused"].null_count == 3 == frame["camera_height_m"].null_count
    for name in ("bottom_m", "top_m", "distance_m", "contour"):
        assert obstacle[name].null_count == obstacle.num_rows > 0
    assert obstacle["corners_world"].null_count == obstacle.num_rows
    assert rows.free_world is not None and not len(rows.free_world.frame)
    assert obstacle["z_min"].null_count == 0


def test_unusable_frames_have_null_columns() -> None:
    batch, config = boxes(), Config()
    found = row_inputs(detect(batch.frames, config, backend="reference"))
    assert found.scene is not None
    floor = found.scene.floor.copy()
    floor[:, 7] = Refusal.NONE  # all frames show their floor
    found = found._replace(overflow=np.ones(3, bool), scene=found.scene._replace(floor=floor))
    statuses = FrameStatus.DECODE_ERROR, FrameStatus.OK, FrameStatus.OK
    batch = batch._replace(status=statuses)
    rows = batch_rows("log", "cam", batch, batch.frames.plane, ["flags"] * 3, found, config)
    frame = to_table(rows.frames, FRAMES_SCHEMA).to_pylist()
    assert [row["status"] for row in frame] == ["decode_error", "no_depth", "ok"]
    assert [row["overflow"] for row in frame] == [False, False, True]
    assert [row["floor_source"] for row in frame] == ["flags", "flags", "frame"]
    assert [row["num_obstacles"] > 0 for row in frame] == [False, False, True]
    assert set(rows.obstacles["frame"].tolist()) == {frame[2]["frame"]}
    assert rows.free_world is not None and not len(rows.free_world.frame)


def tables(batch: Batch, found: Any, config: Config) -> list[pa.Table]:
    """Return both tables of a batch with a known floor."""
    plane = batch.frames.plane
    assert plane is not None
    rows = batch_rows("log", "cam", batch, plane, ["flags"] * len(batch.status), found, config)
    parts = zip((rows.frames, rows.obstacles), SCHEMAS.values(), strict=True)
    return [to_table(*part) for part in parts]


def frame_of(part: Any, b: int) -> Any:
    """Return frame ``b`` of nested named tuples of arrays, as a batch of one."""
    if part is None or isinstance(part, Calibration):
        return part
    if isinstance(part, tuple):
        return type(part)(*(frame_of(a, b) for a in part))
    return part[b : b + 1]


@pytest.mark.parametrize("name", ["wheeled", "paper"])
def test_rows_of_a_batch_equal_those_of_its_frames(name: str) -> None:
    batch, config = boxes(), preset(name)
    found = detect(batch.frames, config, backend="reference")
    together = tables(batch, row_inputs(found), config)
    singles, frames, held = [], [], []
    for b in range(3):
        one = Batch(frame_of(batch.frames, b), batch.status[b : b + 1], ("",))
        inputs = row_inputs(frame_of(found, b))
        singles.append(tables(one, inputs, config))
        frames.append(one.without_images())
        held.append(used_slots(inputs, 1))
        assert held[-1].obstacles.num_points.shape[1] == inputs.num_obstacles[0]
    for whole, parts in zip(together, zip(*singles, strict=True), strict=True):
        assert whole.equals(pa.concat_tables(parts).combine_chunks()) and whole.num_rows >= 2
    joined = Batch.joined(frames)
    assert joined.frames.color is None and not joined.frames.depth.size
    joined = joined._replace(frames=joined.frames._replace(plane=batch.frames.plane))
    assert tables(joined, joined_inputs(held), config) == together


@pytest.mark.parametrize("name", ["wheeled", "paper"])
def test_rows_do_not_change_if_their_inputs_are_reduced_to_the_used_slots(name: str) -> None:
    batch, config = boxes(), preset(name)
    found = detect(batch.frames, config, backend="reference")
    whole, most = row_inputs(found), int(found.num_obstacles.max())
    few = used_slots(jax.jit(row_inputs)(found), 3)
    assert few.obstacles.num_points.shape == (3, most) and few.num_obstacles.dtype == np.int32
    for one, other in zip(tables(batch, whole, config), tables(batch, few, config), strict=True):
        assert one.equals(other) and one.num_rows
    obstacles = map_leaves(lambda a: a[:, : most - 1], few.obstacles)
    short = few._replace(obstacles=obstacles)
    with pytest.raises(ValueError, match=f"{most} obstacles do not fit in {most - 1} slots"):
        tables(batch, short, config)


def free(to: list[float], end: list[int], start: float = 0.5) -> FreeFloor:
    """Return the free floor of one frame, with rays from -45 to 45 degrees."""
    n = len(to)
    bearing = np.linspace(-np.pi / 4, np.pi / 4, n)[None]
    seen = np.array([to]) > 0
    way = np.where(seen, np.sin(bearing) + 1j * np.cos(bearing), 0)
    return FreeFloor(seen, way, bearing, np.full((1, n), start), np.array([to]), np.array([end]))


def test_a_drop_requires_five_neighbouring_rays() -> None:
    assert np.isnan(free([1.0] * 4 + [2.0] + [1.0] * 4, [2] * 4 + [1] + [2] * 4).drop_m[0])
    assert free([0.7, 1.0, 1.2, 1.1, 1.0, 1.1, 3.0], [2] * 6 + [0]).drop_m[0] == 1.2
    assert np.isnan(free([1.0] * 4, [2] * 4).drop_m[0])


def test_free_polygons_cover_columns_with_visible_floor() -> None:
    found = free([2.0, 1.0, 3.0, 0.0, 2.0, 4.0], [1, 1, 0, 0, 3, 3])
    found = FreeFloor(*(np.concatenate([a, a, a]) for a in found))
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # the camera looks along world Y
    T[:, 0, 3] = 0.0, np.nan, 5.0
    polygons = found.in_world(T)
    assert polygons.corners.tolist() == [8, 4] * 2 and polygons.frame.tolist() == [0, 0, 2, 2]
    first, last, *others = np.split(polygons.points, np.cumsum(polygons.corners)[:-1])
    lengths = [1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5]
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), lengths)
    ways = found.bearing_rad[0, [0, 1, 1, 2, 2, 1, 1, 0]]
    np.testing.assert_allclose(np.arctan2(*first.T), ways, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(last, axis=1), [2.0, 2.0, 0.5, 0.5])
    np.testing.assert_allclose(np.concatenate(others), np.concatenate([first, last]) + [5.0, 0])
    nothing = free([0.5, 0.5], [1, 1]).in_world(T[:1])
    assert nothing.points.shape == (0, 2) and not nothing.frame.size


@pytest.mark.parametrize("roll_deg", [180.0, 130.0])
def test_contours_of_a_camera_upside_down_go_from_left_to_right(roll_deg: float) -> None:
    batch, config = boxes(), preset("wheeled")
    frames = batch.frames
    plane = frames.plane._replace(roll=np.full_like(frames.plane.roll, np.radians(roll_deg)))
    turned = np.ascontiguousarray(frames.depth[:, ::-1, ::-1])
    batch = batch._replace(frames=frames._replace(depth=turned, plane=plane, T_world_camera=None))
    found = detect(batch.frames, config, backend="reference")
    rows = batch_rows("log", "cam", batch, plane, ["flags"] * 3, row_inputs(found), config)
    table = to_table(rows.obstacles, OBSTACLES_SCHEMA).to_pylist()
    assert table
    for row in table:
        right = np.array(row["contour"])[::2]
        assert right[0] < right[-1]
        assert roll_deg < 180 or (np.diff(right) > 0).all()


def test_a_box_outside_of_the_colour_image_is_null() -> None:
    batch, config = boxes(), preset("wheeled")
    found = row_inputs(detect(batch.frames, config, backend="reference"))
    first = np.array(found.obstacles.uv_max)
    first[0, 0] = -1
    low = np.array(found.obstacles.uv_min)
    low[0, 0] = 0
    found = found._replace(obstacles=found.obstacles._replace(uv_min=low, uv_max=first))
    _, obstacle = tables(batch, found, config)
    names = ("u_min", "u_max", "v_min", "v_max")
    assert [obstacle[name][0].as_py() for name in names] == [None] * 4
    assert all(obstacle[name].null_count == 1 < obstacle.num_rows for name in names)
    assert set(obstacle["box_image"].to_pylist()) == {"color"}
    alone = Calibration(batch.frames.calibration.depth)
    aligned = batch._replace(frames=batch.frames._replace(calibration=alone, color=None))
    found = row_inputs(detect(aligned.frames, config, backend="reference"))
    _, obstacle = tables(aligned, found, config)
    assert set(obstacle["box_image"].to_pylist()) == {"depth"}


def test_lengths_of_the_preset_paper_refer_to_the_colour_camera() -> None:
    batch, config = boxes(), preset("paper")
    motion = batch.frames.calibration.color_from_depth
    assert motion is not None and batch.frames.T_world_camera is not None
    batch = batch._replace(camera_frame="depth", color_frame="color")
    found = row_inputs(detect(batch.frames, config, backend="reference"))
    frame, _ = tables(batch, found, config)
    assert frame["camera_frame"].to_pylist() == ["color"] * 3
    depth = batch.frames.T_world_camera[0]
    color = depth[:3, :3] @ np.linalg.inv(motion.T)[:3, 3] + depth[:3, 3]
    np.testing.assert_allclose(frame["camera_position_world"][0].as_py(), color)
    found = row_inputs(detect(batch.frames, Config(), backend="reference"))
    frame, _ = tables(batch, found, Config())
    assert frame["camera_frame"].to_pylist() == ["depth"] * 3
    np.testing.assert_allclose(frame["camera_position_world"][0].as_py(), depth[:3, 3])


def test_the_timestamp_of_colour_does_not_depend_on_whether_colour_is_read() -> None:
    batch = boxes()._replace(nearest_color_ns=np.array([7, -1, 9]))
    found = row_inputs(detect(batch.frames, Config(), backend="reference"))
    want = [7, None, 9]
    assert tables(batch, found, Config())[0]["color_stamp_ns"].to_pylist() == want
    without = batch._replace(frames=batch.frames._replace(color=None))
    assert tables(without, found, Config())[0]["color_stamp_ns"].to_pylist() == want
