"""Pictures: content and positions, and edge cases."""

from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from jaxdet.config import Config
from jaxdet.floor.plane import flat_plane, unknown_plane
from jaxdet.pipeline import detect
from jaxdet.presets import preset
from jaxdet.render import camera, canvas, draw_frame, draw_map, topview, write_png
from jaxdet.render.topview import View, ground_points
from jaxdet.results.metric import floors, rectangles
from jaxdet.results.occupancy import MapImage
from jaxdet.results.rows import to_host
from jaxdet.types import RAYS, Calibration, Extrinsics, Frames, Intrinsics

STILL = Extrinsics((1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), (0.0, 0.0, 0.0))


def scene(width: int = 160, height: int = 120) -> Frames:
    """Return a chequered box 1.2 m away, right of the centre; the camera is level at 0.5 m."""
    v, u = np.mgrid[0:height, 0:width]
    box = (u >= 90) & (u < 140) & (v >= 30) & (v < 80)
    depth = np.where(box, 1200, 0).astype(np.uint16)
    grey = np.where(box & ((u // 6 + v // 6) % 2 == 0), 220, 40).astype(np.uint8)
    camera = Intrinsics(width, height, 120.0, 120.0, width / 2, height / 2)
    one = np.ones(1)
    plane = flat_plane(0.5 * one, 0 * one, 0 * one)
    stamps = np.zeros(1, np.int64)
    color = np.repeat(grey[None, ..., None], 3, axis=3)
    calibration = Calibration(camera, camera, STILL)
    valid = np.ones(1, bool)
    return Frames(depth[None], calibration, stamps, stamps, valid, color, plane=plane)


def picture(frames: Frames) -> np.ndarray:
    config = Config()
    read = frames._replace(color=None)
    found = to_host(detect(read, config, backend="reference", with_cells=True))
    corners = rectangles(found.obstacles, 0.001, config.footprint)
    return draw_frame(frames, found, corners, 0, config, "name   frame 0")


def has_color(image: np.ndarray, color: canvas.Color) -> np.ndarray:
    return (np.abs(image.astype(int) - color).max(axis=2) < 8).any()


def test_a_frame_shows_its_obstacle_in_both_views() -> None:
    image = picture(scene())
    assert image.dtype == np.uint8
    assert 1200 < image.shape[1] < 1400
    half = image.shape[1] - 560
    for view in (image[:, :half], image[40:-40, half:]):
        assert has_color(view, canvas.color_of(0))
    assert not has_color(image[40:-40], canvas.color_of(1))


def test_a_frame_without_obstacles_and_floor_is_drawn() -> None:
    frames = scene()
    empty = frames._replace(depth=np.zeros_like(frames.depth), plane=unknown_plane(1))
    image = picture(empty)
    assert not has_color(image[40:-40], canvas.color_of(0))


def test_cells_of_an_obstacle_are_tinted_in_its_colour() -> None:
    frames = scene()
    image = picture(frames)[46:586, 10:730]
    assert frames.color is not None
    plain = cv2.resize(frames.color[0], (720, 540), interpolation=cv2.INTER_CUBIC)
    inside = image[200:300, 450:600].astype(int).mean(axis=(0, 1))
    was = 0.82 * plain[200:300, 450:600].astype(int).mean(axis=(0, 1))
    np.testing.assert_allclose(inside, was + 0.42 * (np.array(canvas.color_of(0)) - was), atol=3)
    outside = image[400:500, 50:300].astype(int).mean(axis=(0, 1))
    np.testing.assert_allclose(outside, 0.82 * plain[400:500, 50:300].mean(axis=(0, 1)), atol=2)


@pytest.mark.parametrize("why", ["none", "not read", "other size"])
def test_without_colour_the_picture_shows_depth(why: str) -> None:
    frames = scene()
    assert frames.color is not None
    shown = {
        "none": {"color": None},
        "not read": {"color": np.zeros_like(frames.color), "color_stamp_ns": np.array([-1])},
        "other size": {"color": frames.color[:, ::2, ::2]},
    }[why]
    calibration = frames.calibration
    if why == "other size":  # its alignment with depth is unknown
        calibration = Calibration(calibration.depth)
    given = frames._replace(**shown, calibration=calibration)
    assert not camera.has_color(given, 0) and camera.has_color(frames, 0)
    view = camera.shown_image(given, 0, Config())
    assert view.image.shape == (120, 160, 3) and view.calibration.color is None
    assert not view.image[frames.depth[0] == 0].any()
    image = picture(given)[46:586, 10:730]
    assert has_color(image, canvas.color_of(0)) and not has_color(image, canvas.color_of(1))


def test_near_depth_has_warm_colours_and_far_depth_cold_ones() -> None:
    depth = np.array([[0, 200, 1000, 3900, 60000]], np.uint16)
    none, near, middle, far, beyond = camera.depth_picture(depth, 0.001, 0.15, 4.0)[0].astype(int)
    assert not none.any() and near[0] > 150 > near[2] and far[2] > far[0]
    assert middle.tolist() not in (near.tolist(), far.tolist())
    assert np.abs(far - beyond).max() < 30


def test_a_box_outside_of_the_colour_image_is_not_drawn() -> None:
    frames = scene()
    calibration = frames.calibration
    aside = Extrinsics((1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), (-2.0, 0.0, 0.0))
    moved = frames._replace(calibration=calibration._replace(color_from_depth=aside))
    image = picture(moved)
    assert not has_color(image[46:586, 10:730], canvas.color_of(0))
    assert has_color(image[46:586, 740:], canvas.color_of(0))
    of_depth = picture(moved._replace(color=None))
    assert has_color(of_depth[46:586, 10:730], canvas.color_of(0))


@pytest.mark.parametrize("beyond", [(-60, 20), (310, 20), (10, -60), (10, 220)])
def test_an_outline_outside_of_the_picture_is_not_drawn(beyond: tuple[int, int]) -> None:
    image = canvas.canvas(200, 300)
    outline = np.array([[0, 0], [40, 0], [40, 30]]) + beyond
    canvas.polygon(image, outline, canvas.color_of(0), fill=0.3)
    np.testing.assert_array_equal(image, canvas.canvas(200, 300))


def test_the_preset_paper_shows_its_corners() -> None:
    frames, config = scene(), preset("paper")
    found = to_host(detect(frames, config, backend="reference"))
    corners = rectangles(found.obstacles, 0.001, config.footprint)
    image = draw_frame(frames, found, corners, 0, config, "")
    assert found.points is not None and found.num_obstacles[0]
    assert has_color(image[46:586, 10:730], canvas.color_of(0))


def test_a_wide_image_keeps_its_aspect_ratio() -> None:
    image = picture(scene(width=400, height=120))
    assert image.shape[1] < 1550


def test_top_view_has_x_to_the_right() -> None:
    view = View(center=100, bottom=200, scale=50)
    np.testing.assert_allclose(view.pixels(np.array([1.0, 2.0])), [150, 100])
    frames = scene()
    found = to_host(detect(frames, Config(), backend="reference", with_cells=True))
    assert frames.plane is not None and found.cells is not None
    own = found.cells.label[0].ravel() == 0
    xyz = (np.ravel(axis[0])[own] for axis in found.cells.cells[:3])
    points = ground_points(*xyz, 0, frames.plane, 0.001)
    assert len(points) and (points[:, 0] > 0).all()
    np.testing.assert_allclose(points[:, 1], 1.2, atol=2e-3)


def test_a_scene_shows_free_floor_and_drops() -> None:
    """A floor with a box ends 2 m away, where a lower floor begins."""
    frames, v = scene(), np.arange(120)[:, None]
    below = np.maximum(v - 60, 1e-3) / 120.0
    floor, lower = 500 / below, 900 / below
    depth = np.where(floor < 2000, floor, np.where(lower < 6000, lower, 0)) + np.zeros((1, 160))
    depth[30:80, 90:140] = 1200
    frames = frames._replace(depth=depth[None].astype(np.uint16))
    config = Config()
    found = to_host(detect(frames, config, backend="reference", with_cells=True))
    assert found.scene is not None and floors(found.scene, 0.001).own[0]
    corners = rectangles(found.obstacles, 0.001, config.footprint)
    image = draw_frame(frames, found, corners, 0, config, "")[46:-40]
    assert found.num_obstacles[0] == 1 and has_color(image, canvas.color_of(0))
    assert has_color(image[:, -540:], canvas.DROP)
    assert not has_color(image[:, :-550], canvas.DROP)
    above = image[:, -550:-10]
    free = np.rint(0.7 * np.array((44, 54, 68)) + 0.3 * np.array(canvas.FREE))
    rows, columns = np.nonzero((np.abs(above - free) < 16).all(axis=2))
    assert len(rows) > 2000 and abs(columns.mean() - 270) < 20


def test_free_floor_is_drawn_only_between_adjacent_rays() -> None:
    """The drawn floor is interrupted at rays without free floor."""
    free, ahead = np.zeros((1, RAYS, 2), np.int32), RAYS // 2
    free[0, ahead : ahead + 41] = free[0, ahead - 40] = 500, 2000
    image = np.zeros((200, 200, 3), np.uint8)
    scene: Any = SimpleNamespace(free=free, free_end=np.zeros((1, RAYS), np.int32))
    topview._draw_free(image, View(center=100, bottom=190, scale=80), scene, 0, 0.001)
    first, last = np.flatnonzero(image.any(axis=(0, 2)))[[0, -1]].tolist()
    right = 100 + 160 * np.sin(np.radians(10))  # 40 rays to the right of straight ahead
    assert abs(first - 100) <= 1 and abs(last - right) < 2


def test_labels_of_boxes_stay_in_the_picture() -> None:
    boxes = [(590.0, 5.0, 638.0, 90.0), (-3.0, -3.0, 20.0, 20.0), (592.0, 6.0, 636.0, 80.0)]
    texts = {0: "0   1.00 m", 1: "1   2.00 m", 2: "2   3.00 m"}
    chips = camera._chips(dict(enumerate(boxes)), texts, 640, 480)
    for chip in chips:
        left, top, right, bottom = chip.box
        assert 0 <= left < right <= 640 and 0 <= top < bottom <= 480
    assert not any(camera._overlap(a.box, b.box) for a, b in combinations(chips, 2))


@pytest.mark.parametrize("far", [1e7, -1e12])
def test_lines_to_distant_points_have_the_right_direction(far: float) -> None:
    image = np.zeros((20, 40, 3), np.uint8)
    canvas.line(image, np.array([[20.0, 10.0], [far, 10.0]]), (255, 0, 0))
    half, other = image[9:12, 22:], image[9:12, :18]
    if far < 0:
        half, other = other, half
    assert half[..., 0].max(axis=0).all() and not other.any()


def test_map_shows_free_cells() -> None:
    counts, free = np.zeros((2, 40, 80), np.int32)
    counts[:, 40:], free[:20] = 1, 3
    image = draw_map(MapImage(counts, free, (0.0, 0.0), 0.05, np.zeros((0, 2))), "n")
    rows, columns = np.nonzero((image[60:-60] == canvas.FREE).all(axis=2))
    assert rows.min() > 0.4 * (image.shape[0] - 120)
    assert columns.max() < 0.6 * image.shape[1]


def test_the_map_has_y_up_and_shows_the_trajectory(tmp_path: Path) -> None:
    counts = np.zeros((40, 80), np.int32)
    counts[30:40, 60:80] = 7  # large X, large Y: upper right
    counts[0, 0] = 1
    path = np.array([[0.0, 0.0], [1.0, 0.2], [2.0, 0.0]])
    image = draw_map(MapImage(counts, 0 * counts, (0.0, 0.0), 0.05, path), "name")
    heat = cv2.applyColorMap(np.full((1, 1), 240, np.uint8), cv2.COLORMAP_INFERNO)[0, 0, ::-1]
    rows, columns = np.nonzero((image[60:-60] == heat).all(axis=2))
    assert rows.mean() < image.shape[0] / 2
    assert columns.mean() > image.shape[1] / 2
    for color in ((80, 214, 120), (255, 92, 92), (64, 180, 255)):
        assert has_color(image[60:-60], color)
    write_png(tmp_path / "map.png", image)
    read = cv2.imread(str(tmp_path / "map.png"))
    np.testing.assert_array_equal(read[..., ::-1], image)


@pytest.mark.parametrize("path", [np.zeros((0, 2)), np.array([[500.0, -300.0]])])
def test_map_of_one_cell_is_drawn(path: np.ndarray) -> None:
    image = draw_map(MapImage(*np.ones((2, 1, 1), np.int32), (0.0, 0.0), 0.05, path), "n")
    assert max(image.shape) < 1200


def test_text_is_drawn_without_the_fonts_of_opencv_5(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another package may install OpenCV 4, which has only stroke fonts, in ASCII."""
    monkeypatch.setattr(canvas, "_HAS_FONTS", False)
    image = canvas.canvas(40, 300)
    canvas.write(image, "10.0° down", (290, 30), size=20, align="right")
    drawn = np.argwhere((image != canvas.BACKGROUND).any(axis=2))
    width, height = canvas.text_size("10.0° down", 20)
    assert 280 < drawn[:, 1].max() <= 292
    assert abs(np.ptp(drawn[:, 1]) - width) <= 6
    assert height <= np.ptp(drawn[:, 0]) <= height + 8
