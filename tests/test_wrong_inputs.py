"""Failure classes of recordings from the field that other tests do not cover."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from jaxdet.cli import main
from jaxdet.errors import InputError, TopicError
from jaxdet.io import LogOptions, open_log
from jaxdet.io.declarations import ChannelInfo
from jaxdet.io.decode_messages import MessageDecoder
from jaxdet.io.messages import ImageMessage
from tests.io_helpers import (
    COLOR,
    COLOR_FRAME,
    DEPTH,
    DEPTH_FRAME,
    START,
    STORE,
    LogFile,
    assert_holds,
    make_scene,
    ros_image,
    write_calibration,
    write_images,
)
from tests.mcap_bytes import MAGIC
from tests.runs import only_log

IMAGE = "sensor_msgs/msg/Image"


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"", "is empty"),
        (MAGIC, "has no records"),
        (MAGIC[:5], "not an MCAP"),
        (b"x" * 99, "not an MCAP"),
    ],
)
def test_errors_for_files_that_are_not_logs_name_the_file(tmp_path, data, error):
    (tmp_path / "one.mcap").write_bytes(data)
    with pytest.raises(InputError, match=rf"one\.mcap: .*{error}"):
        open_log(str(tmp_path / "one.mcap"))


@pytest.mark.parametrize("encodings", [("smoke", "ros2msg"), ("cdr", "smoke"), ("cdr", "ros2idl")])
def test_unknown_encodings_are_named_and_other_topics_are_read(tmp_path, encodings):
    message, schema = encodings
    scene, text = make_scene(3), STORE.generate_msgdef(IMAGE, ros_version=2)[0].encode()
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        write_images(log, scene)
        log._schemas.clear()
        log.raw("/other/image", message, (IMAGE, schema, text), b"\0" * 40, START)
    with open_log(str(tmp_path / "x.mcap")) as log:
        assert_holds(log, scene)
        [error] = [text for text in log.description.warnings if "/other/image" in text]
        assert "smoke" in error or "ros2idl" in error


@pytest.mark.parametrize("little", [True, False])
def test_fields_are_read_by_the_schema_of_the_log(little):
    """The schema of Image differs from that of ROS: an additional field and another order."""
    text = STORE.generate_msgdef(IMAGE, ros_version=2)[0]
    text = text.replace(
        "uint32 height\nuint32 width\n", "float64 extra\nuint32 width\nuint32 height\n"
    )
    assert "extra" in text
    store = get_typestore(Stores.ROS2_JAZZY)
    own = {k: v for k, v in get_types_from_msg(text, IMAGE).items() if k == IMAGE}
    store.types.pop(IMAGE)
    store.fielddefs.pop(IMAGE)
    store.register(own)
    plain = ros_image(make_scene(1).color[0], "rgb8", START, "f")
    values = {
        name: getattr(plain, name) for name in plain.__dataclass_fields__ if name != "__msgtype__"
    }
    message = store.types[IMAGE](extra=0.5, **values)
    data = bytes(store.serialize_cdr(message, IMAGE, little_endian=little))
    decoder = MessageDecoder(ChannelInfo("/i", "cdr", IMAGE, "ros2msg", text.encode()))
    found = decoder.decode(memoryview(data))
    assert isinstance(found, ImageMessage)
    assert (found.width, found.height, found.frame_id) == (40, 30, "f")
    assert bytes(found.data) == make_scene(1).color[0].tobytes()


@pytest.mark.parametrize("given", [{}, {"color": COLOR}])
def test_timestamps_before_1970_are_reported(tmp_path, given):
    """Such timestamps come from robots whose clock was not set."""
    scene = make_scene(3)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        for color, depth, at in zip(scene.color, scene.depth, scene.color_ns.tolist(), strict=True):
            early = at - START - 10**12
            log.ros(COLOR, ros_image(color, "rgb8", early, COLOR_FRAME), at)
            log.ros(DEPTH, ros_image(depth, "16UC1", early, DEPTH_FRAME), at)
    error = r"3 of 3 messages can't be decoded: header timestamp \(-\d+ s, .*1970"
    with pytest.raises(TopicError, match=error):
        open_log(str(tmp_path / "x.mcap"), LogOptions(**given))


def test_depth_at_another_rate_or_clock_is_paired_with_its_colour(tmp_path, capsys):
    """Depth at half the rate has two frames; depth of another clock has four, by log times."""
    for late_s, every, frames in ((0, 1, 4), (0, 2, 2), (5, 1, 4)):
        scene, path = make_scene(4), tmp_path / f"{late_s}_{every}.mcap"
        with LogFile(path) as log:
            write_calibration(log)
            stamps = scene.color_ns.tolist()
            for n, (color, depth, at) in enumerate(
                zip(scene.color, scene.depth, stamps, strict=True)
            ):
                log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
                if n % every == 0:
                    late = at + late_s * 1_000_000_000
                    log.ros(DEPTH, ros_image(depth, "16UC1", late, DEPTH_FRAME), at)
        out = tmp_path / path.stem
        run = ["run", str(path), "--output", str(out), "--backend", "reference"]
        assert main([*run, "--pictures", "0"]) == 0
        capsys.readouterr()
        rows = pq.read_table(only_log(out) / "frames.parquet").to_pylist()
        assert [row["status"] for row in rows] == frames * ["ok"]
        assert [row["color_stamp_ns"] for row in rows] == stamps[::every]


@pytest.mark.parametrize("form", ["millimetres in floats", "tenths of millimetres"])
def test_a_wrong_depth_unit_causes_a_warning(tmp_path, capsys, form):
    scene, path = make_scene(4), tmp_path / "x.mcap"
    with LogFile(path) as log:
        write_calibration(log)
        for color, depth, at in zip(scene.color, scene.depth, scene.color_ns.tolist(), strict=True):
            kind, wrong = "32FC1", depth.astype(np.float32)
            if form == "tenths of millimetres":
                kind, wrong = "16UC1", depth.clip(500, 6000) * np.uint16(10)
            log.ros(DEPTH, ros_image(wrong, kind, at, DEPTH_FRAME), at)
            log.ros(COLOR, ros_image(color, "rgb8", at, COLOR_FRAME), at)
    run = ["run", str(path), "--output", str(tmp_path / "out"), "--backend", "reference"]
    main([*run, "--pictures", "0"])
    assert "frames have no depth in range: check the depth unit" in capsys.readouterr().out
