"""Detector: rows equal those of ``jaxdet run`` for any type of input, and bad input is refused."""

import inspect
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

import jaxdet
from jaxdet import Config, Detector, Extrinsics, FrameResult, Intrinsics, Mount
from jaxdet.config import FloorConfig, GroundConfig
from jaxdet.errors import CalibrationError, ConfigError, FrameStatus, InputError, JaxdetError
from jaxdet.io import LogOptions
from jaxdet.sim import SimConfig, write_log
from tests.runs import only_log, run_logs
from tests.scenes import assert_equal, blocks, frames, level, small, smooth_depth

BATCH = 5
"""Frames per batch in most tests, as each batch size is compiled separately."""


@pytest.fixture(scope="module")
def sim_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("detector") / "sim.mcap"
    write_log(path, SimConfig(frames=7, width=320, height=240, rate_hz=5))
    return path


def run(path: Path, output: Path, config: Config) -> list[list[dict[str, Any]]]:
    run_logs(path, output, config, pictures=0, batch_size=BATCH)
    tables = (
        pq.read_table(only_log(output) / f"{name}.parquet") for name in ("frames", "obstacles")
    )
    return [table.to_pylist() for table in tables]


def rows_of(found: FrameResult) -> list[dict[str, Any]]:
    return [
        {
            "frame": found.number,
            "stamp_ns": found.stamp_ns,
            "obstacle": obstacle.label,
            "distance_m": obstacle.distance_m,
            "box": obstacle.box,
            "xyz_min": obstacle.xyz_min.tolist(),
            "xyz_max": obstacle.xyz_max.tolist(),
            "centroid": obstacle.centroid.tolist(),
            "bottom_m": obstacle.bottom_m,
            "top_m": obstacle.top_m,
            "num_points": obstacle.num_points,
            "contour": None if obstacle.contour is None else obstacle.contour.ravel().tolist(),
            "corners_ground": obstacle.corners.ravel().tolist(),
            "corners_world": (
                None if obstacle.corners_world is None else obstacle.corners_world.ravel().tolist()
            ),
        }
        for obstacle in found
    ]


def as_attributes(row: dict[str, Any]) -> dict[str, Any]:
    names = ("frame", "stamp_ns", "obstacle", "distance_m", "bottom_m", "top_m", "num_points")
    names += ("contour", "corners_ground", "corners_world")
    same = {name: row[name] for name in names}
    box = tuple(row[name] for name in ("u_min", "v_min", "u_max", "v_max"))
    return same | {
        "box": None if None in box else box,
        "xyz_min": [row[f"{axis}_min"] for axis in "xyz"],
        "xyz_max": [row[f"{axis}_max"] for axis in "xyz"],
        "centroid": [row[axis] for axis in "xyz"],
    }


def assert_rows_of_run(path: Path, output: Path, config: Config, **options: Any) -> None:
    of_frames, of_obstacles = run(path, output, config)
    with jaxdet.open_log(path) as log:
        detector = Detector.from_log(log, config=config, **options)
        found = list(detector.run(log, BATCH))
    seen = [row for one in found for row in rows_of(one)]
    assert seen == [as_attributes(row) for row in of_obstacles]
    assert len(of_obstacles) > 10 and len(found) == len(of_frames)
    for one, row in zip(found, of_frames, strict=True):
        assert (one.number, one.status, len(one)) == (
            row["frame"],
            row["status"],
            row["num_obstacles"],
        )
        assert (one.floor_source, one.floor_refused) == (row["floor_source"], row["floor_refused"])
        assert (one.drop_m, one.overflow) == (row["drop_m"], row["overflow"])
        if one.free_floor is None:
            assert row["free_to_m"] is None
        else:
            assert one.free_floor.to_m.tolist() == row["free_to_m"]
        height = row["camera_height_m"]
        assert (one.floor and np.float32(one.floor.height_m)) == height


@pytest.mark.parametrize("preset", ["wheeled", "paper"])
def test_a_log_gives_the_rows_of_jaxdet_run(preset, sim_log, tmp_path):
    assert_rows_of_run(sim_log, tmp_path / "results", jaxdet.preset(preset))


def test_a_recorded_log_gives_the_rows_of_jaxdet_run(shared_data, tmp_path):
    path = shared_data / "aims_slam" / "aims_slam_18frames.mcap"
    assert_rows_of_run(path, tmp_path / "results", Config())


def test_a_detector_made_from_a_log_refuses_other_logs(sim_log, tmp_path):
    config = Config(ground=GroundConfig(source="none"))
    path = tmp_path / "other.mcap"
    path.write_bytes(sim_log.read_bytes())
    with jaxdet.open_log(sim_log) as log, jaxdet.open_log(path) as other:
        detector = Detector.from_log(log, config=config)
        with pytest.raises(InputError, match="created from 'sim', got 'other'"):
            next(detector.run(other))
        with jaxdet.open_log(sim_log) as again:
            assert next(detector.run(again, 1)).number == 0
            assert [one.number for one in detector.run(again, 1 << 40)] == list(range(7))
            for size in (0, -1):
                with pytest.raises(InputError, match=r"batch_size: must be at least 1"):
                    next(detector.run(again, size))


def test_detections_use_the_floor_of_their_time_window(sim_log, tmp_path):
    config = replace(Config(), ground=GroundConfig(window_s=0.5, sample_frames=2))
    config = replace(config, floor=FloorConfig(min_share=0.9))  # no frame shows its own floor
    assert_rows_of_run(sim_log, tmp_path / "results", config)


def test_frames_detected_one_by_one_equal_those_of_a_run(sim_log):
    with jaxdet.open_log(str(sim_log)) as log:
        detector = Detector.from_log(log)
        together = list(detector.run(log, BATCH))
        for frame, want in zip(log, together, strict=True):
            found = detector(
                frame.depth,
                frame.color,
                stamp_ns=frame.stamp_ns,
                T_world_camera=frame.T_world_camera,
            )
            assert [row | {"frame": want.number} for row in rows_of(found)] == rows_of(want)
        frame, want, calibration = log[-1], together[-1], log.calibration
    own = Detector(
        calibration.depth,
        color_K=calibration.color,
        T_color_depth=calibration.color_from_depth.T,
        mount=Mount(0.3, 0.17, 0.0),
    )
    found = own(frame.depth)
    assert len(found) == len(want) and found.floor_source == "frame"
    assert found.floor_refused is None
    assert found.nearest_m == min(obstacle.distance_m for obstacle in found)
    assert found.floor.pitch_rad == pytest.approx(0.1745, abs=0.01)


def test_a_log_is_a_sequence_of_frames(sim_log):
    with jaxdet.open_log(sim_log) as log:
        numbers = [frame.number for frame in log]
        assert numbers == list(range(7)) == list(range(len(log)))
        assert log[-1].number == 6 and np.array_equal(log[2].depth, log.read([2]).frames.depth[0])
        assert [frame.number for frame in log[1:6:2]] == [1, 3, 5]
        assert {frame.status for frame in log} == {FrameStatus.OK}
        with pytest.raises(IndexError, match="frame 7 is out of range"):
            log[7]
    with jaxdet.open_log(sim_log, LogOptions(every=3)) as log:
        assert [frame.number for frame in log] == [0, 3, 6] == [log[i].number for i in range(3)]
        assert len(log) == 3 and [frame.number for frame in log[1:]] == [3, 6]
        found = list(Detector.from_log(log).run(log, BATCH))
        assert [one.number for one in found] == [0, 3, 6]


def test_reprs_are_one_line(sim_log):
    with jaxdet.open_log(sim_log) as log:
        detector = Detector.from_log(log)
        found = next(detector.run(log, BATCH))
        shown = [repr(one) for one in (log, log[0], log[:2], detector, found, found[0])]
        assert log.name in shown[0] and log.name in shown[3] and "fx " in shown[3]
    assert all("\n" not in text and "array" not in text and len(text) < 160 for text in shown)
    assert shown[5].startswith(f"<Obstacle 0: {found[0].distance_m:.2f} m away")
    assert "ArrayLike" in str(inspect.signature(Detector))


def test_the_nearest_obstacle_has_the_smallest_distance(shared_data):
    with jaxdet.open_log(shared_data / "aims_slam" / "aims_slam_18frames.mcap") as log:
        frames = list(Detector.from_log(log).run(log))
    nearest = [min(found, key=lambda one: one.distance_m) for found in frames]
    assert [one.distance_m for one in nearest] == [found.nearest_m for found in frames]
    assert any(one.label != 0 for one in nearest)  # label 0 is not always the nearest


CALIBRATION = small(160, 120)
COLOR, DEPTH = blocks(3, 120, 160), smooth_depth(3, CALIBRATION.depth)


def detector(**options: Any) -> Detector:
    given = {
        "K": CALIBRATION.depth.K,
        "color_K": CALIBRATION.color,
        "T_color_depth": CALIBRATION.color_from_depth.T,
        "mount": Mount(0.4),
    }
    return Detector(**given | options)


def attributes(found: FrameResult) -> list[dict[str, Any]]:
    assert found.status == "ok" and len(found) > 0
    return rows_of(found)


class Exchanged:
    """Array of a library that supports DLPack but not NumPy."""

    def __init__(self, values: np.ndarray) -> None:
        self.values = values

    def __dlpack__(self, **options: Any) -> Any:
        return self.values.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self.values.__dlpack_device__()


class OnGpu:
    """Tensor on a GPU, which NumPy cannot read."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        raise TypeError("can't convert cuda:0 device type tensor to numpy. Use Tensor.cpu()")


def test_frames_of_common_array_types_are_accepted():
    plain = detector()
    want = [attributes(found) for found in plain.batch(DEPTH, COLOR)]
    assert [attributes(plain(*pair)) for pair in zip(DEPTH, COLOR, strict=True)] == [
        [row | {"frame": 0} for row in rows] for rows in want
    ]
    forms = {
        "lists of frames": plain.batch(list(DEPTH), list(COLOR)),
        "arrays of JAX": plain.batch(jnp.asarray(DEPTH), jnp.asarray(COLOR)),
        "metres": plain.batch(np.where(DEPTH, DEPTH / 1000.0, np.nan), COLOR),
        "metres in float32": plain.batch(DEPTH * np.float32(0.001)),
        "BGR": detector(color_order="bgr").batch(DEPTH, COLOR[..., ::-1]),
        "every second row": plain.batch(
            np.repeat(DEPTH, 2, axis=2)[..., ::2], np.repeat(COLOR, 2, axis=1)[:, ::2]
        ),
        "without colour": plain.batch(DEPTH),
        "fx fy cx cy": detector(K=CALIBRATION.depth[2:6]).batch(DEPTH, COLOR),
        "high byte first": plain.batch(DEPTH.astype(">u2"), COLOR),
        "DLPack alone": plain.batch(Exchanged(DEPTH), Exchanged(COLOR)),
        "masked": plain.batch(np.ma.masked_array(np.maximum(DEPTH, 7), DEPTH == 0)),
        "another unit": detector(depth_unit_m=0.0005).batch(DEPTH / 1000.0),
    }
    for name, found in forms.items():
        if name != "another unit":
            assert [attributes(one) for one in found] == want, name
    assert forms["another unit"][0][0].distance_m == pytest.approx(
        want[0][0]["distance_m"], abs=0.01
    )
    sky, hole = DEPTH[0] / 1000.0, DEPTH[0].copy()
    sky[:20], hole[:20] = 1000.0, 0  # farther than 16 bits reach
    assert rows_of(plain(sky)) == rows_of(plain(hole))
    grey = np.asarray(COLOR[..., 1])
    of_grey = plain(DEPTH[0], grey[0])
    three = plain(DEPTH[0], np.repeat(grey[0, ..., None], 3, axis=2))
    assert np.array_equal(of_grey.draw(), three.draw())


class Tensor:
    """Array of another library, with the interface of torch."""

    def __init__(self, values: Any) -> None:
        self.values = np.asarray(values)

    def size(self) -> tuple[int, ...]:
        return self.values.shape

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self.values.astype(dtype)


def test_camera_matrices_of_other_libraries_are_accepted():
    K = [[60.0, 0, 48], [0, 60, 30], [0, 0, 1]]
    assert Intrinsics.from_matrix(Tensor(K), 96, 60) == Intrinsics.from_matrix(K, 96, 60)
    motion = np.eye(4)
    assert Extrinsics.from_matrix(Tensor(motion)) == Extrinsics.from_matrix(motion)
    plain = Intrinsics.from_matrix(K, 96, 60)
    assert Intrinsics.from_matrix(K, 96, 60, None) == plain  # the shape that OpenCV uses
    eight = [0.4, -2.5, 0.0, 0.0, 1.4, 0.3, -2.3, 1.3]
    rational = Intrinsics.from_matrix(K, 96, 60, eight)
    assert Intrinsics.from_matrix(K, 96, 60, np.array([[*eight, *[0.0] * 6]])) == rational
    with pytest.raises(CalibrationError, match=r"14 distortion coefficients .* maximum of 8"):
        Intrinsics.from_matrix(K, 96, 60, [*eight, 0.1, *[0.0] * 5])


def test_aligned_depth_and_lens_models_are_accepted():
    camera = CALIBRATION.color
    depth = smooth_depth(1, camera)[0]
    aligned = Detector(camera.K, mount=Mount(0.4))
    lens = Intrinsics.from_matrix(camera.K, 160, 120, [0.1, -0.2, 0.001, 0.002, 0.05])
    bent = Detector(lens, mount=Mount(0.4))
    flat, curved = attributes(aligned(depth, COLOR[0])), attributes(bent(depth))
    assert flat != curved and flat == attributes(aligned(depth))


def test_points_and_masks_belong_to_their_obstacle():
    found = detector()(DEPTH[0], COLOR[0])
    covered = np.zeros((120, 160), bool)
    for obstacle in found:
        points, mask = obstacle.points, obstacle.mask()
        assert len(points) == obstacle.num_points and obstacle.box is not None
        assert np.array_equal(points.min(axis=0), obstacle.xyz_min)
        assert np.array_equal(points.max(axis=0), obstacle.xyz_max)
        v, u = np.nonzero(mask)
        left, top, right, bottom = obstacle.box
        assert left <= u.min() and u.max() <= right and top <= v.min() and v.max() <= bottom
        assert mask.sum() > 0.5 * (right - left) and not (covered & mask).any()
        covered |= mask
        assert obstacle.bottom_m is not None and obstacle.bottom_m < (obstacle.top_m or 0)
    assert np.array_equal(covered, found.labels >= 0)
    nothing = detector()(np.zeros_like(DEPTH[0]), COLOR[0])
    assert (nothing.status, len(nothing), nothing.nearest_m) == ("no_depth", 0, None)
    assert not (nothing.labels >= 0).any() and nothing.points.shape == (0, 3)
    paper = detector(config="paper", backend="reference")(DEPTH[0], COLOR[0])
    assert [len(one.points) for one in paper] == [one.num_points for one in paper] != []
    with pytest.raises(ConfigError, match="another preset"):
        paper[0].mask()


def test_overlapping_masks_go_to_the_nearer_obstacle():
    """Pixels of a pillar belong to the pillar, those around it to the wall behind."""
    depth = np.full((120, 160), 3000, np.uint16)
    depth[:, 60:100] = 1000
    found = Detector([120, 120, 80, 60])(depth, COLOR[0])
    pillar, *walls = found
    assert pillar.xyz_min[2] < 1.1 and walls and min(wall.xyz_min[2] for wall in walls) > 2.5
    assert pillar.distance_m is None and "~1.00 m away" in repr(pillar)
    assert (found.labels[:, 62:98] == 0).all()
    assert (found.labels[:, 2:58] > 0).all() and (found.labels[:, 102:158] > 0).all()


def test_cells_of_both_backends_are_equal(device):
    given = frames(CALIBRATION, COLOR, DEPTH, plane=level(3))
    want = jaxdet.detect(given, backend="reference", with_cells=True)
    found = jaxdet.detect(given, with_cells=True)
    assert (want.cells.label >= 0).any()
    assert_equal(found, want)


def test_results_do_not_change_if_images_are_overwritten():
    """Camera drivers reuse memory, and XLA does not copy aligned arrays."""
    compiled = detector()
    memory = np.zeros(DEPTH[0].nbytes + 64, np.uint8)
    start = -memory.ctypes.data % 64
    depth = memory[start : start + DEPTH[0].nbytes].view(np.uint16).reshape(DEPTH[0].shape)
    depth[:] = DEPTH[0]
    found = compiled(depth, COLOR[0])
    depth[:] = 0
    assert attributes(found) == attributes(detector(backend="reference")(DEPTH[0], COLOR[0]))


def test_drawn_pictures_equal_those_of_the_run():
    found = detector()(DEPTH[0], COLOR[0])
    picture = found.draw()
    assert picture.dtype == np.uint8 and picture.shape[2] == 3 and picture.std() > 10
    assert np.array_equal(found.draw(COLOR[0]), picture)
    without = detector()(DEPTH[0])
    assert np.array_equal(without.draw(COLOR[0]), picture)
    assert without.draw().shape == picture.shape and not np.array_equal(without.draw(), picture)
    bgr = detector(color_order="bgr")(DEPTH[0], COLOR[0][..., ::-1])
    assert np.array_equal(bgr.draw(), picture)
    assert np.array_equal(bgr.draw(COLOR[0][..., ::-1]), picture)


def test_mounts_are_used_as_prior_of_the_floor():
    assert Mount.from_gravity(0.5, [0, 3.0, 3.0]).pitch_rad == pytest.approx(np.pi / 4)
    assert Mount.from_gravity(0.5, [1e-3, 0.0, 0.0]).roll_rad == pytest.approx(np.pi / 2)
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[2, 3] = 0.7
    assert Mount.from_transform(T) == Mount(0.7, 0.0, 0.0)
    one, two = detector(mount=Mount(0.4)), detector(mount=None)
    assert rows_of(one(DEPTH[0], COLOR[0])) == rows_of(two(DEPTH[0], COLOR[0], mount=Mount(0.4)))
    ground = GroundConfig(camera_height_m=0.4, camera_pitch_rad=0.0)
    told_by_config = detector(mount=None, config=replace(Config(), ground=ground))
    assert rows_of(told_by_config(DEPTH[0], COLOR[0])) == rows_of(one(DEPTH[0], COLOR[0]))
    unasked = detector(config=replace(Config(), ground=GroundConfig(source="none")))
    assert unasked(DEPTH[0], COLOR[0]).floor is None


def test_configurations_are_given_by_preset_file_or_object(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('preset = "d455"\n[ground]\nmax_depth_m = 3\n')
    for source in (file, str(file)):
        ground = detector(config=source).config.ground
        assert (ground.min_depth_m, ground.max_depth_m) == (0.4, 3.0)
    assert detector(config="tabletop").config == jaxdet.preset("tabletop")
    with pytest.raises(ConfigError, match=r"unknown preset 'a{40}'; use one of wheeled") as caught:
        detector(config="a" * 5000)
    assert len(str(caught.value)) < 300
    with pytest.raises(ConfigError, match="unknown preset 'wheled'; did you mean wheeled"):
        detector(config="wheled")
    with pytest.raises(ConfigError, match=r"none\.toml: can't be read"):
        detector(config="none.toml")


K, T = CALIBRATION.depth.K, CALIBRATION.color_from_depth.T
MM, TURNED = T.copy(), T.copy()
MM[:3, 3] *= 1000
TURNED[:3, :3] *= 2
REFUSED_ARGUMENTS = {
    "translation in mm": ({"T_color_depth": MM}, r"T_color_depth: .*maximum of 10 m .*metres"),
    "no rotation": ({"T_color_depth": TURNED}, "T_color_depth: the rotation .* rigid transform"),
    "three by four": (
        {"T_color_depth": T[:3]},
        r"T_color_depth: expected a homogeneous \(4, 4\) matrix, got shape \(3, 4\)",
    ),
    "NaN": ({"T_color_depth": np.full((4, 4), np.nan)}, "T_color_depth: "),
    "T of text": ({"T_color_depth": "T"}, "T_color_depth: "),
    "T alone": ({"color_K": None}, "T_color_depth needs color_K"),
    "color_K alone": ({"T_color_depth": None}, "color_K needs T_color_depth"),
    "transposed": ({"K": K.T}, "K: .* is not a camera matrix"),
    "scaled": ({"K": 2 * K}, "K: .* is not a camera matrix"),
    "fx NaN": ({"K": [np.nan, 1, 2, 3]}, "K: .* not calibrated .* pixels$"),
    "fx negative": ({"K": [-600, 600, 80, 60]}, "K: .* not calibrated"),
    "fx zero": ({"color_K": [0, 0, 80, 60]}, "color_K: .* not calibrated"),
    "fx alone scaled": ({"K": [6e5, 600, 80, 60]}, "K: fx 600000 and fy 600 .* factor of 4"),
    "three numbers": (
        {"K": [600, 80, 60]},
        r"K: expected a camera matrix of shape \(3, 3\), got \(3,\)",
    ),
    "a file name": ({"K": "camera.json"}, "K: expected a matrix, got str; pass a"),
    "K of text": ({"K": "600"}, "K: "),
    "size in floats": (
        {"K": CALIBRATION.depth._replace(width=160.0)},
        "K: width of the depth camera: expected integer, got float",
    ),
    "another lens": (
        {"K": CALIBRATION.depth._replace(distortion="fisheye")},
        "K: the depth camera's lens model 'fisheye' is unknown; use one of none",
    ),
    "unit of text": ({"depth_unit_m": "mm"}, "depth_unit_m: expected an array of numbers, got str"),
    "unit 0": ({"depth_unit_m": 0.0}, "depth_unit_m: .* 0.001 for millimetres"),
    "unit in mm": ({"depth_unit_m": 1.0}, "depth_unit_m: "),
    "unknown order": (
        {"color_order": "rgba"},
        "color_order: unknown value 'rgba'; use one of rgb, bgr",
    ),
    "unknown backend": (
        {"backend": "torch"},
        "backend: unknown value 'torch'; use one of reference, jax",
    ),
    "a height": ({"mount": 0.4}, r"mount: must be a jaxdet.Mount, got 0.4; pass jaxdet.Mount"),
}


@pytest.mark.parametrize("name", REFUSED_ARGUMENTS)
def test_invalid_camera_arguments_are_named(name):
    options, message = REFUSED_ARGUMENTS[name]
    with pytest.raises(JaxdetError, match=message) as caught:
        detector(**options)
    assert "--" not in str(caught.value)


REFUSED_IMAGES = {
    "no batch axis": ("batch", DEPTH[0], COLOR[0], r"color: .*shape .*|depth: .*"),
    "a batch": ("call", DEPTH[0], COLOR, "color: expected a frame of shape .* Detector.batch"),
    "a batch of depth": ("call", DEPTH, None, r"depth: expected a frame of shape \(Hd, Wd\)"),
    "RGBA": ("call", DEPTH[0], np.zeros((120, 160, 4), np.uint8), r"color: .*\[..., :3\]"),
    "float colour": (
        "call",
        DEPTH[0],
        COLOR[0] / 255.0,
        "color: expected uint8 images, got float64",
    ),
    "depth in bytes": (
        "call",
        DEPTH[0].astype(np.uint8),
        None,
        "depth: expected a depth image, got uint8; .* first",
    ),
    "depths in bytes": (
        "batch",
        DEPTH.astype(np.uint8),
        None,
        "depth: expected depth images, .* first",
    ),
    "depth in int32": ("call", DEPTH[0].astype(np.int32), None, "depth: expected .*, got int32"),
    "millimetres in floats": ("call", DEPTH[0] * 1.0, None, "depth: all depths exceed .* metres"),
    "other colour": ("call", DEPTH[0], COLOR[0][:60], "color: images have 160x60 .* 160x120"),
    "fewer colours": ("batch", DEPTH, COLOR[:2], "color: expected 3 entries as for depth, got 2"),
    "too large": (
        "call",
        DEPTH[0],
        np.broadcast_to(np.uint8(0), (1 << 13, (1 << 12) + 1, 3)),
        "color: an image of shape .* maximum of 33554432 pixels; scale the image",
    ),
    "no frames": ("batch", DEPTH[:0], None, "depth: expected at least one frame, got none"),
    "an empty list": ("batch", [], [], "depth: expected at least one frame, got none"),
    "frames of two sizes": ("batch", DEPTH[:2], [COLOR[0], COLOR[0][:60]], "color: frames differ"),
    "a generator": (
        "batch",
        (d for d in DEPTH),
        None,
        "depth: expected .* a list of .* generator",
    ),
    "a tensor on a GPU": (
        "call",
        OnGpu(),
        None,
        "depth: expected .* got OnGpu; .*Tensor.cpu",
    ),
    "colour first": (
        "call",
        COLOR[0],
        DEPTH[0],
        r"depth: expected a depth image, got uint8; pass depth first: detector\(depth, color\)",
    ),
    "colour first, a batch": (
        "batch",
        COLOR,
        DEPTH,
        "depth: expected depth images, .* depth first",
    ),
    "depth twice": (
        "call",
        DEPTH[0],
        DEPTH[0],
        "color: expected uint8 images, got uint16; .* depth first",
    ),
    "None": ("call", None, DEPTH[0], "depth: expected a frame"),
    "text": ("call", "image.png", DEPTH[0], "depth: expected a frame"),
}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"stamp_ns": "now"}, "stamps_ns: expected integers"),
        ({"stamp_ns": 1 << 70}, "stamps_ns: expected integers"),
        ({"stamp_ns": np.datetime64("NaT", "ns")}, "stamps_ns: must not be NaT"),
        ({"stamp_ns": (1 << 64) - 1}, "stamps_ns: expected integers"),
        (
            {"stamp_ns": 1714557600.25},
            "stamps_ns: expected integers .* in nanoseconds, got float64",
        ),
        ({"T_world_camera": np.eye(3)}, "T_world_camera: expected shape .* got"),
        ({"T_world_camera": "T"}, "T_world_camera: .*numbers"),
        ({"T_world_camera": 2 * np.eye(4)}, "T_world_camera: expected rigid transforms"),
        ({"T_world_camera": np.diag([1, 1, -1, 1])}, "T_world_camera: expected rigid transforms"),
        ({"mount": 0.3}, "mount: must be a jaxdet.Mount, got 0.3"),
    ],
)
def test_invalid_frame_arguments_are_named(given, message):
    with pytest.raises(JaxdetError, match=message):
        detector()(DEPTH[0], COLOR[0], **given)


@pytest.mark.parametrize("name", REFUSED_IMAGES)
def test_invalid_images_are_named(name):
    how, depth, color, message = REFUSED_IMAGES[name]
    given = detector()
    with pytest.raises(JaxdetError, match=message):
        (given if how == "call" else given.batch)(depth, color)


def test_the_calibration_must_fit_the_images():
    given = Detector([600.0, 600.0, 320.0, 240.0], backend="reference")
    with pytest.raises(CalibrationError, match=r"K: the optical centre \(320, 240\) is outside"):
        given(smooth_depth(1, CALIBRATION.color)[0], COLOR[0])
    given = Detector([6e4, 6e4, 80.0, 60.0], backend="reference")
    with pytest.raises(CalibrationError, match=r"K: the field of view .* is 0.153° .* in pixels$"):
        given(smooth_depth(1, CALIBRATION.color)[0], COLOR[0])
    with pytest.raises(CalibrationError, match=r"color: .* not aligned .* pass color_K"):
        Detector(K, backend="reference")(DEPTH[0][:60], COLOR[0])
    with pytest.raises(CalibrationError, match=r"color_K: the size .*Intrinsics.from_matrix"):
        detector(color_K=K, backend="reference")(DEPTH[0])
    sized = detector(color_K=K, backend="reference")
    assert len(sized(DEPTH[0], COLOR[0])) == len(sized(DEPTH[0]))
    with pytest.raises(InputError, match="preset paper needs colour images"):
        Detector(K, config="paper", backend="reference")(DEPTH[0])
    given = Detector(K, backend="reference")
    given(smooth_depth(1, CALIBRATION.color)[0], COLOR[0])
    with pytest.raises(CalibrationError, match=r"depth: images have 80x60 .* per image size"):
        given(DEPTH[0][::2, ::2], COLOR[0][::2, ::2])
    with pytest.raises(InputError, match="not created from a log"):
        next(given.run([]))


@pytest.mark.parametrize("name", ["K", "color_K"])
def test_lens_coefficients_that_cannot_be_inverted_are_named(name):
    lens = Intrinsics.from_matrix(CALIBRATION.color.K, 160, 120, [50.0, 0, 0, 0])
    wide = Intrinsics(160, 120, 19.0, 19.0, 80.0, 60.0)
    for camera, message in ((lens, "can't be inverted"), (wide, "too wide")):
        given = detector(**{"backend": "reference", name: camera})
        depth = smooth_depth(1, CALIBRATION.color)[0]
        with pytest.raises(CalibrationError, match=f"^{name}: .*{message}") as caught:
            given(depth, COLOR[0])
        assert "--" not in str(caught.value)


def test_implausible_mounts_are_refused():
    for wrong, message in (
        ({"height_m": 300}, "height_m: .*metres"),
        ({"height_m": 0}, "height_m"),
        ({"height_m": 10**400}, "height_m: number is too large; pass metres"),
        ({"height_m": "0.3"}, "height_m: expected a number .*, got '0.3'"),
        ({"height_m": float("nan")}, "height_m"),
        (
            {"height_m": 0.3, "pitch_rad": 10},
            "pitch_rad: expected radians .* got 10; .*math.radians",
        ),
        ({"height_m": 0.3, "roll_rad": float("nan")}, "roll_rad"),
    ):
        with pytest.raises(ConfigError, match=message):
            Mount(**wrong)
    for gravity in ([0, 0, 0], [1, 2], [np.nan, 0, 1]):
        with pytest.raises(ConfigError, match="gravity"):
            Mount.from_gravity(0.3, gravity)
    with pytest.raises(InputError, match="height_m: number is too large"):
        Mount.from_gravity(10**400, [0, 1, 0])
    assert Mount.from_gravity(0.3, [0, 1e300, 1e300]).pitch_rad == pytest.approx(np.pi / 4)
    for T in (np.eye(3), np.zeros((4, 4)), np.diag([2.0, 2, 2, 1]), np.full((4, 4), np.nan)):
        with pytest.raises(InputError, match=r"T_base_camera: .*pass a \(4, 4\) matrix"):
            Mount.from_transform(T)


def test_mounts_may_be_given_for_some_frames_only():
    """Frames without a mount, as between samples of a slow IMU, use that of the detector if set."""
    both = [Mount(0.4), Mount(0.9, 0.3)]
    for own in (None, Mount(0.4)):
        given = detector(mount=own)
        want = [given(DEPTH[0], COLOR[0], mount=mount) for mount in (both[1], None)]
        found = given.batch(DEPTH[[0, 0]], COLOR[[0, 0]], mounts=[both[1], None])
        assert [one.floor for one in found] == [one.floor for one in want]
        assert [one.floor_source for one in found] == [one.floor_source for one in want]
        assert [len(one) for one in found] == [len(one) for one in want]
        assert [one.floor_refused for one in found] == [one.floor_refused for one in want]
    with pytest.raises(ConfigError, match=r"mount: must be a jaxdet.Mount, got 0\.3"):
        detector().batch(DEPTH[:2], COLOR[:2], mounts=[Mount(0.4), 0.3])


@pytest.mark.parametrize("transform", [jax.jit, jax.vmap])
def test_transformations_of_jax_are_refused(transform):
    given = detector()
    depth = jnp.asarray(DEPTH if transform is jax.vmap else DEPTH[0])
    with pytest.raises(InputError, match=r"can't be called under jax\.jit"):
        transform(lambda one: given(one)[0].distance_m)(depth)


@pytest.mark.parametrize(("config", "frames"), [("wheeled", 1), ("wheeled", 3), ("paper", 1)])
def test_calls_from_traced_functions_are_refused(config, frames):
    """Results computed from NumPy images inside of a traced function would be traced as well."""
    given = detector(mount=None, config=config)

    def scaled(scale: jax.Array) -> jax.Array:
        return scale * len(given.batch(DEPTH[:frames], COLOR[:frames])[0])

    with pytest.raises(InputError, match=r"under jax\.jit, .*; call it outside") as caught:
        jax.jit(scaled)(2)
    assert "\n" not in str(caught.value)
    assert scaled(2) > 0


def test_low_level_functions_name_the_wrong_argument():
    given = frames(CALIBRATION, COLOR, DEPTH)
    with pytest.raises(ConfigError, match=r"expected a Config, got 'wheeled'; .*jaxdet.preset"):
        jaxdet.detect(given, "wheeled")
    assert jaxdet.flat_plane(0.63, 0.34, 0.18).height.tolist() == [0.63]
    with pytest.raises(InputError, match=r"the shapes \(2,\), \(1,\), \(1,\), \(2,\); pass \(B,\)"):
        jaxdet.flat_plane([0.3, 0.4], 0.1, 0.0)
    with pytest.raises(InputError, match="have the shapes"):
        jaxdet.flat_plane([0.3, 0.4], [0.1, 0.1], [0.0, 0.0], np.ones(1, bool))
    fit = jaxdet.find_floors(given, backend="reference")
    assert len(fit.own) == 3
    motion = Extrinsics.from_matrix(T)
    assert np.array_equal(motion.T, T) and hash(motion)
    with pytest.raises(CalibrationError, match="set model to one of none, plumb_bob"):
        Intrinsics.from_matrix(K, 160, 120, [0.1, 0.2, 0.3])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_detection_in_a_forked_process_is_an_error():
    """Otherwise detection would wait forever for threads that fork does not copy."""
    code = """
import os, numpy as np, jaxdet
images = (np.full((120, 160), 2.0),)
used = {name: jaxdet.Detector([120, 120, 80, 60], backend=name) for name in ("jax", "reference")}
for number in (1, 2):
    if not (child := os.fork()):
        for name, detector in used.items():
            try:
                print(number, name, len(detector(*images)), flush=True)
            except jaxdet.JaxdetError as error:
                print(number, name, error, flush=True)
        os._exit(0)
    os.waitpid(child, 0)
    used["jax"](*images)
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=True
    )
    first, *others, last = done.stdout.splitlines()
    assert (first, others[0], last) == ("1 jax 1", "1 reference 1", "2 reference 1")
    assert others[1].startswith("2 jax JAX can't be used in a process forked from one that used it")
    assert others[1].endswith("start processes with spawn, or use the backend reference")


def test_nothing_is_written_to_standard_output(tmp_path):
    code = (
        "import numpy as np, jaxdet\n"
        "found = jaxdet.Detector([120, 120, 80, 60])(np.full((120, 160), 2.0))\n"
        "assert len(found) == 1, found\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
