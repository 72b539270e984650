"""Masks of the robot's own body, and their suggestion."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxdet.cli import main
from jaxdet.config_file import read_settings
from jaxdet.errors import ConfigError, InputError
from jaxdet.io import LogOptions, open_log
from jaxdet.io.body_mask import MAX_PIXELS, as_text
from jaxdet.sim import SimConfig, write_log
from tests.camera_logs import join_cameras
from tests.export_results import sim_log
from tests.rewritten import (
    Change,
    Message,
    changed,
    moved_camera,
    read_messages,
    write_messages,
)
from tests.runs import run_log

ARM = np.s_[90:, 60:100]
"""Pixels of the arm of the robot in depth images of 160x120."""
TABLES = "frames.parquet", "obstacles.parquet"


def in_depth(show: Callable[[np.ndarray], None]) -> Change:
    """Return a change that applies ``show`` to depth images."""

    def change(message: Message) -> None:
        if message.kind == "sensor_msgs/Image" and "depth" in message.topic:
            depth = message.pixels.copy()
            show(depth)
            message.show(depth)

    return change


def arm(depth: np.ndarray) -> None:
    """Show an arm 30 cm in front of the camera, with the noise of depth."""
    noise = np.random.default_rng(int(depth.sum()) % 1000)
    depth[ARM] = 300 + noise.integers(-3, 4, depth[ARM].shape)


def nothing(depth: np.ndarray) -> None:
    """Show no measurement where the arm is."""
    depth[ARM] = 0


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with logs of a drive: plain, with an arm, with a hole in place of it."""
    folder = tmp_path_factory.mktemp("drives")
    config = SimConfig(frames=16, width=160, height=120, rate_hz=4, depth_form="aligned")
    write_log(folder / "plain.mcap", config)
    messages = read_messages(folder / "plain.mcap")
    write_messages(folder / "arm.mcap", changed(messages, in_depth(arm)))
    write_messages(folder / "hole.mcap", changed(messages, in_depth(nothing)))
    return folder


@pytest.fixture
def mask(tmp_path: Path) -> Path:
    """Return the path of an image that masks the arm."""
    image = np.full((120, 160, 3), (0, 0, 255), np.uint8)
    image[ARM] = 0
    cv2.imwrite(str(path := tmp_path / "mask.png"), image)
    return path


def depths(path: Path, **options) -> np.ndarray:
    with open_log(path, LogOptions(**options)) as log:
        return log.read(range(log.num_frames)).frames.depth


@pytest.mark.parametrize("scan", [False, True])
def test_masked_pixels_are_not_measured(logs, mask, scan):
    masked = depths(logs / "arm.mcap", mask=str(mask), scan=scan)
    assert (masked == depths(logs / "hole.mcap")).all()
    assert (depths(logs / "arm.mcap")[:, *ARM] > 0).all()


@pytest.mark.parametrize(
    "form",
    [{"depth_form": "metres"}, {"depth_form": "aligned", "compression": "none"}, {"scene": "demo"}],
    ids=["floats", "not packed", "unaligned"],
)
def test_all_forms_of_depth_are_masked(tmp_path, mask, form):
    path = sim_log(tmp_path / "a.mcap", **form)
    plain, masked = depths(path), depths(path, mask=str(mask))
    assert not masked[:, *ARM].any() and plain[:, *ARM].any()
    plain[:, *ARM] = 0
    assert (masked == plain).all()


def test_a_masked_body_is_not_an_obstacle_and_hides_no_floor(logs, mask, tmp_path):
    how = {"pictures": 0, "workers": 1}
    run_log(logs / "arm.mcap", tmp_path / "arm", log=LogOptions(mask=str(mask)), **how)
    run_log(logs / "hole.mcap", tmp_path / "hole", **how)
    run_log(logs / "arm.mcap", tmp_path / "unmasked", **how)
    masked, hole, unmasked = (
        [pq.read_table(tmp_path / name / table).drop_columns(["log"]) for table in TABLES]
        for name in ("arm", "hole", "unmasked")
    )
    assert all(a.equals(b) for a, b in zip(masked, hole, strict=True))
    nearest = [table[1]["distance_m"].to_numpy() for table in (masked, unmasked)]
    assert (nearest[0] > 0.35).all() and (nearest[1] < 0.35).sum() >= 16


def test_results_contain_the_mask(logs, mask, tmp_path, monkeypatch):
    monkeypatch.chdir(logs)
    results = tmp_path / "results"
    quiet = ["-q", "--pictures", "0"]
    given = ["run", "arm.mcap", "-o", str(results), "--log.mask", str(mask)]
    assert main([*given, *quiet]) == 0
    mask.unlink()
    assert main(["verify", str(results), "--sample", "2"]) == 0
    again = tmp_path / "again"
    settings = ["--config", str(results / "arm/config.json")]
    assert main(["run", "arm.mcap", "-o", str(again), *settings, *quiet]) == 0
    for table in TABLES:
        assert (again / "arm" / table).read_bytes() == (results / "arm" / table).read_bytes()


def test_each_camera_has_its_own_mask(logs, mask, tmp_path):
    both = join_cameras(
        {"left": logs / "arm.mcap", "right": logs / "arm.mcap"}, tmp_path / "both.mcap"
    )
    toml = tmp_path / "masks.toml"
    toml.write_text(f"[log]\nmask = 'left={mask}'\n", encoding="utf-8")
    text = read_settings(toml).log.mask
    left, right = (depths(both, camera=name, mask=text) for name in ("left", "right"))
    assert not left[:, *ARM].any() and right[:, *ARM].all()
    with pytest.raises(
        InputError, match="unknown camera 'front'; cameras of this log: left, right"
    ):
        depths(both, camera="left", mask=f"front={mask}")
    with pytest.raises(ConfigError, match="two masks for left"):
        LogOptions(mask=f"left={mask},left={mask}")


def test_a_mask_of_another_size_is_refused(logs, tmp_path):
    cv2.imwrite(str(path := tmp_path / "small.png"), np.zeros((60, 80), np.uint8))
    with pytest.raises(InputError, match=r"80x60, but its depth images are 160x120"):
        depths(logs / "arm.mcap", mask=str(path))


@pytest.mark.parametrize(
    "given",
    [
        *("none.png", ".", "", "left=", "\x00", "x" * 5000, "\x1b[31m\n.png"),
        *("4x4:15", "4x4:17", "0x4:0", "4x4:-1 17", f"{MAX_PIXELS}x1:1"),
    ],
)
def test_invalid_masks_are_refused(given, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match="mask") as caught:
        LogOptions(mask=given)
    assert str(caught.value).isprintable()


def test_damaged_images_and_other_files_are_refused_as_masks(mask):
    whole = mask.read_bytes()
    for data in (b"", b"P5 1 1 255 \x00", whole[:-30], whole[:40] + b"\x00" * 8 + whole[48:]):
        mask.write_bytes(data)
        with pytest.raises(ConfigError, match="mask"):
            LogOptions(mask=str(mask))


CORNERS = [[60, 90], [99, 90], [99, 119], [60, 119]]
"""Corners of the arm, x and y [pixel]."""


@pytest.mark.parametrize(
    "content",
    [
        {"width": 160, "height": 120, "polygons": [CORNERS]},
        {"width": 160, "height": 120, "polygons": [CORNERS[:3], CORNERS[2:] + CORNERS[:1]]},
        {"width": 160, "height": 120, "polygons": [[[60, 90], [99, 90], [99, 1e300], [60, 900]]]},
        {
            "version": "5.5.0",
            "shapes": [{"label": "arm", "points": CORNERS, "shape_type": "polygon", "flags": {}}],
            "imagePath": "depth.png",
            "imageHeight": 120,
            "imageWidth": 160,
        },
        {
            "shapes": [
                {"label": "a", "points": [[60, 90], [80, 119]], "shape_type": "rectangle"},
                {"label": "b", "points": [[99, 119.2], [79.6, 90]], "shape_type": "rectangle"},
            ],
            "imageHeight": 120,
            "imageWidth": 160,
        },
        {
            "images": [{"id": 1, "width": 160, "height": 120, "file_name": "a.png"}],
            "annotations": [{"image_id": 1, "segmentation": [np.ravel(CORNERS).tolist()]}],
        },
    ],
    ids=["polygon", "overlap", "outside", "labelme", "rectangles", "COCO"],
)
def test_polygons_are_masks(tmp_path, content):
    path = tmp_path / "mask.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    hidden = np.zeros((120, 160), bool)
    hidden[ARM] = True
    assert LogOptions(mask=str(path)).mask == as_text(hidden)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[" * 100_000,
        '{"width": 160, "height": 120}',
        '{"width": 160, "height": "120", "polygons": []}',
        '{"width": 1e9, "height": 1e9, "polygons": []}',
        '{"width": -160, "height": -120, "polygons": []}',
        '{"width": 160, "height": 120, "polygons": 3}',
        '{"width": 160, "height": 120, "polygons": [[[1, 2], [3, 4]]]}',
        '{"width": 160, "height": 120, "polygons": [[1, 2, 3, 4, 5, 6]]}',
        '{"width": 160, "height": 120, "polygons": [[[1, 2], [3, NaN], [5, 6]]]}',
        f'{{"width": 160, "height": 120, "polygons": [[[1, 2], [3, {10**400}], [5, 6]]]}}',
        '{"imageWidth": 9, "imageHeight": 9, "shapes": [{"points": [[1, 1]]}]}',
        '{"imageWidth": 9, "imageHeight": 9, "shapes": [{"shape_type": "circle", "points": []}]}',
        '{"imageWidth": 9, "imageHeight": 9, "shapes": [{}]}',
        '{"images": [{"width": 9, "height": 9}], "annotations": [{"segmentation": {"size": []}}]}',
        '{"images": [{"width": 9, "height": 9}], "annotations": [{}]}',
    ],
)
def test_json_without_polygons_is_refused(tmp_path, text):
    path = tmp_path / "mask.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"mask\.json: --log\.mask: can.t be read .*JSON"):
        LogOptions(mask=str(path))


@pytest.mark.parametrize("name", ["a,b.png", "a=b.png", "left=a,right=b.png", "=,.png", "é ü.png"])
def test_names_of_masks_may_contain_commas_and_equals_signs(tmp_path, monkeypatch, mask, name):
    monkeypatch.chdir(tmp_path)
    mask.rename(tmp_path / name)
    text = LogOptions(mask=name).mask
    assert text and text.startswith("160x120:")
    if name != "left=a,right=b.png":
        assert LogOptions(mask=f"front={tmp_path / name}").mask == f"front={text}"


def test_a_comma_before_a_camera_begins_its_mask(tmp_path, monkeypatch, mask):
    monkeypatch.chdir(tmp_path)
    mask.rename("a,b.png")
    text = LogOptions(mask="a,b.png").mask
    assert LogOptions(mask="left=a,b.png, right=a,b.png").mask == f"left={text},right={text}"
    with pytest.raises(ConfigError, match=r"c\.png: --log.mask: no such file.*CAMERA=FILE,CAMERA="):
        LogOptions(mask="left=a,b.png,right=c.png")


@pytest.mark.parametrize(
    ("shown", "expected"),
    [(255, "covers no pixel: it has no effect; the robot must be black"), (40, "covers no pixel")],
)
def test_a_mask_without_black_pixels_is_reported(logs, tmp_path, shown, expected):
    cv2.imwrite(str(path := tmp_path / "mask.png"), np.full((120, 160), shown, np.uint8))
    with open_log(logs / "arm.mcap", LogOptions(mask=str(path))) as log:
        assert [expected in text for text in log.description.warnings] == [True]


def test_a_mask_of_most_or_all_pixels_is_reported(logs, tmp_path):
    image = np.zeros((120, 160), np.uint8)
    image[ARM] = 255
    cv2.imwrite(str(path := tmp_path / "mask.png"), image)
    with open_log(logs / "arm.mcap", LogOptions(mask=str(path))) as log:
        (warning,) = log.description.warnings
    assert "--log.mask covers 94 % of the depth image; the robot must be black" in warning
    cv2.imwrite(str(path), 0 * image)
    with pytest.raises(InputError, match="covers all pixels; the robot must be black"):
        open_log(logs / "arm.mcap", LogOptions(mask=str(path)))


def test_the_text_form_of_a_mask_matches_an_example_by_hand():
    hidden = np.array([[True, True, False], [False, False, True]])
    assert as_text(hidden) == "3x2:0 2 3 1"
    assert LogOptions(mask=as_text(hidden)).mask == "3x2:0 2 3 1"
    assert as_text(~hidden) == "3x2:2 3 1"


def test_the_suggested_mask_covers_the_body_and_little_else(logs, tmp_path, capsys):
    path = tmp_path / "mask.png"
    assert main(["info", str(logs / "arm.mcap"), "--suggest-mask", str(path)]) == 0
    black = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) == 0
    assert black[ARM].all() and black.sum() < 1.3 * black[ARM].size
    assert f"--log.mask {path}" in capsys.readouterr().out


def test_a_run_reports_that_a_mask_can_be_suggested(logs, mask, tmp_path):
    """No mask is suggested if there is one, or if nothing is near."""
    arm_log = logs / "arm.mcap"
    for name, path, options in (
        ("arm", arm_log, LogOptions()),
        ("masked", arm_log, LogOptions(mask=str(mask))),
        ("plain", logs / "plain.mcap", LogOptions()),
    ):
        [log] = run_log(path, tmp_path / name, log=options).logs
        found = [text for text in log.notes if "--suggest-mask mask.png" in text]
        assert len(found) == (name == "arm")
        assert not found or f"robot itself: jaxdet info {arm_log} --suggest" in found[0]


@pytest.mark.parametrize("lower_m, pitch_deg", [(0, 0), (0.1, -20), (-0.4, 0), (0, 20)])
def test_no_mask_is_suggested_for_a_floor(logs, tmp_path, capsys, lower_m, pitch_deg):
    """The floor is found even if TF has a wrong mount."""
    turn = moved_camera(lower_m, np.radians(pitch_deg))
    log = write_messages(tmp_path / "a.mcap", changed(read_messages(logs / "plain.mcap"), turn))
    path = tmp_path / "mask.png"
    assert main(["info", str(log), "--suggest-mask", str(path)]) == 0
    assert "no mask is needed" in capsys.readouterr().out and not path.exists()


def test_a_suggested_mask_is_for_one_camera_of_several(logs, tmp_path, capsys):
    cameras = {"left": logs / "arm.mcap", "right": logs / "plain.mcap"}
    both = join_cameras(cameras, tmp_path / "both.mcap")
    suggest = ["info", str(both), "--suggest-mask", str(tmp_path / "mask.png")]
    assert main([*suggest, "--camera", "left"]) == 0
    assert f"--log.mask left={tmp_path / 'mask.png'}" in capsys.readouterr().out
    assert main(suggest) == 1
    assert "choose one with --camera" in capsys.readouterr().err


def test_no_mask_is_suggested_for_parts_that_move(logs, tmp_path, capsys):
    places = iter(range(0, 128, 8))

    def moving(depth: np.ndarray) -> None:
        left = next(places)
        depth[90:110, left : left + 20] = 300

    log = tmp_path / "moving.mcap"
    write_messages(log, changed(read_messages(logs / "plain.mcap"), in_depth(moving)))
    assert main(["info", str(log), "--suggest-mask", str(tmp_path / "mask.png")]) == 0
    assert "no mask is needed" in capsys.readouterr().out


def test_a_still_camera_before_a_near_box_gets_no_suggestion(logs, tmp_path, capsys):
    """Nothing except for the box is above the floor, and the floor looks the same everywhere."""

    def bare(depth: np.ndarray) -> None:
        rows = np.arange(120)[:, None]
        # The floor of a camera 0.3 m up, 30° down, with 60° of view; above it nothing is measured.
        down = np.radians(30) + np.arctan((rows - 59.5) / 139)
        depth[:] = np.where(down > 0.1, 300 * np.cos(down - np.radians(30)) / np.sin(down), 0)
        depth[50:80, 60:100] = 350

    log = tmp_path / "box.mcap"
    write_messages(log, changed(read_messages(logs / "plain.mcap"), in_depth(bare)))
    how = ["--ground.camera-height-m", "0.3", "--ground.camera-pitch", "30deg"]
    assert main(["info", str(log), "--suggest-mask", str(tmp_path / "mask.png"), *how]) == 1
    assert "the camera does not move" in capsys.readouterr().err


def test_no_mask_is_suggested_if_body_and_scene_look_alike(logs, tmp_path, capsys):
    messages = read_messages(logs / "arm.mcap")
    first = next(m for m in messages if m.kind == "sensor_msgs/Image" and "depth" in m.topic)
    still = changed(messages, in_depth(lambda depth: np.copyto(depth, first.pixels)))
    log = write_messages(tmp_path / "still.mcap", still)
    suggest = ["--suggest-mask", str(tmp_path / "mask.png")]
    assert main(["info", str(log), *suggest]) == 1
    assert "the camera does not move" in capsys.readouterr().err
    how = ["--ground.source", "none"]
    assert main(["info", str(logs / "arm.mcap"), *suggest, *how]) == 1
    assert "the floor is unknown" in capsys.readouterr().err
    assert main(["info", str(logs), *suggest]) == 2
    assert main(["info", str(log), "--suggest-mask", str(log)]) == 2
