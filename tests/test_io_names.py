"""Logs of files and folders: names, splits, links; and names of topics."""

import errno
import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxdet.errors import InputError, TopicError
from jaxdet.io import LogFiles, LogOptions, files, find_logs, open_log
from jaxdet.io.files import listed_recordings, missing_splits, siblings
from jaxdet.io.splits import Signature, signature
from tests.io_helpers import (
    COLOR_FRAME,
    COLOR_INFO,
    COLOR_K,
    COLOR_SIZE,
    DEPTH_FRAME,
    DEPTH_INFO,
    DEPTH_K,
    DEPTH_SIZE,
    START,
    T_DEPTH_COLOR,
    LogFile,
    Scene,
    make_scene,
    ros_compressed,
    ros_image,
    ros_info,
    ros_tf,
    write_calibration,
    write_log,
)


def touch(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")


def moved(scene: Scene, later_ns: int) -> Scene:
    return scene._replace(color_ns=scene.color_ns + later_ns, depth_ns=scene.depth_ns + later_ns)


def splits(folder: Path, *later_s: float, name: str = "run") -> None:
    """Write numbered files of two frames, 0.1 s apart, with these delays [s]."""
    folder.mkdir(exist_ok=True)
    for number, later in enumerate(later_s):
        write_log(folder / f"{name}_{number}.mcap", moved(make_scene(2), int(later * 10**9)))


def list_files(folder: Path, *names: str) -> None:
    """Write the ``metadata.yaml`` of rosbag2 for a recording."""
    files = "".join(f"    - {name}\n" for name in names)
    text = f"rosbag2_bagfile_information:\n  version: 9\n  relative_file_paths:\n{files}"
    (folder / "metadata.yaml").write_text(f"{text}  message_count: 4\n")


def test_names_are_paths_relative_to_the_given_folder(tmp_path):
    touch(tmp_path, "a/run_0.mcap", "a/one.mcap", "b/run_0.mcap", "b/solo_3.mcap", "b/readme.txt")
    list_files(tmp_path / "a", "run_0.mcap", "run_9.mcap", "run_10.mcap")
    touch(tmp_path, "a/run_10.mcap", "a/run_9.mcap")
    logs = find_logs([str(tmp_path)])
    assert [log.name for log in logs] == ["a/one", "a/run", "b/run_0", "b/solo_3"]
    assert [path.name for path in logs[1].paths] == ["run_0.mcap", "run_9.mcap", "run_10.mcap"]
    again = find_logs([str(tmp_path / "b"), str(tmp_path / "a" / "*.mcap"), str(tmp_path)])
    assert again == logs, "a file that is named twice has its longest name"
    for named, names in (
        ("b", ["run_0", "solo_3"]),
        ("b/solo_3.mcap", ["solo_3"]),
        ("*/solo_3.mcap", ["b/solo_3"]),
        ("b/*", ["run_0", "solo_3"]),
    ):
        assert [log.name for log in find_logs([str(tmp_path / named)])] == names


def test_image_folders_are_logs_with_the_name_of_the_folder(tmp_path, monkeypatch):
    for name in ("attic/data", "hall/run7/data", "hall/run8"):
        touch(tmp_path, *(f"{name}/{kind}/000001.png" for kind in ("rgb", "depth")))
    names = {log.name for log in find_logs([str(tmp_path)])}
    assert names == {"attic/data", "hall/run7/data", "hall/run8"}
    assert [log.name for log in find_logs([str(tmp_path / "attic" / "data")])] == ["data"]
    monkeypatch.chdir(tmp_path / "hall" / "run8")
    assert [log.name for log in find_logs(["."])] == ["run8"]


def test_numbered_recordings_are_separate_logs(tmp_path):
    """Trials are 45 s, 5 s or 1.5 s apart, or a number is missing between them."""
    splits(tmp_path / "far", 0, 45, 90)
    splits(tmp_path / "near", 0, 1.6, 3.2)
    splits(tmp_path / "gap", 0, 0.2, 0.4)
    (tmp_path / "gap" / "run_1.mcap").unlink()
    for name, count in (("far", 3), ("near", 3), ("gap", 2)):
        logs = find_logs([str(tmp_path / name)])
        assert [len(log.paths) for log in logs] == [1] * count, name
        assert all("different recordings" in log.about and not log.note for log in logs)


def test_consecutive_splits_are_one_recording_and_reported(tmp_path):
    splits(tmp_path, 0, 0.2, 0.4)
    [log] = find_logs([str(tmp_path)])
    assert log.name == "run" and len(log.paths) == 3
    assert log.about.startswith("joined 3 files, run_0.mcap to run_2.mcap, whose topics and times")
    with open_log(log) as opened:
        assert log.about in opened.description.notes
    apart = find_logs([str(tmp_path)], join=False)
    assert [one.name for one in apart] == ["run_0", "run_1", "run_2"]


def test_metadata_defines_the_files_of_a_recording(tmp_path):
    """Pauses between the files do not matter; a file that is not listed is another recording."""
    splits(tmp_path, 0, 45, 90, 90.2)
    list_files(tmp_path, "run_0.mcap", "bag/run_1.mcap", "'run_2.mcap'")
    logs = find_logs([str(tmp_path)])
    assert [len(log.paths) for log in logs] == [3, 1]
    assert logs[0].about == "joined 3 files listed in metadata.yaml"


def test_files_with_unreadable_times_are_separate_logs(tmp_path):
    splits(tmp_path, 0, 0.2)
    (tmp_path / "run_1.mcap").write_bytes((tmp_path / "run_1.mcap").read_bytes()[:2000])
    logs = find_logs([str(tmp_path)])
    assert [len(log.paths) for log in logs] == [1, 1]
    assert "don't have the times of the images" in logs[0].about


def test_a_split_without_index_belongs_to_its_recording(tmp_path):
    """A recorder that is killed writes neither the index of its last file nor metadata.yaml."""
    splits(tmp_path, 0, 0.2)
    last = tmp_path / "run_1.mcap"
    write_log(last, moved(make_scene(2), 200_000_000), use_chunking=False)
    last.write_bytes(last.read_bytes()[: last.stat().st_size * 3 // 4])
    [log] = find_logs([str(tmp_path)])
    with open_log(log) as opened:
        assert len(log.paths) == 2 and opened.num_frames == 4
        assert any("run_1.mcap: recovered" in text for text in opened.description.warnings)


def test_splits_of_ros_1_have_times_in_their_names(tmp_path):
    """Two recordings of two files each, whose names begin alike; then one without a prefix."""
    names = []
    for start, late_s in (
        ("10-00-00_0", 0),
        ("10-00-01_1", 0.2),
        ("11-00-00_0", 3600),
        ("11-00-01_1", 3600.2),
    ):
        names.append(f"run_2024-05-01-{start}.mcap")
        write_log(tmp_path / names[-1], moved(make_scene(2), int(late_s * 10**9)))
    logs = find_logs([str(tmp_path)])
    assert [log.name for log in logs] == ["run_2024-05-01-10-00-00", "run_2024-05-01-11-00-00"]
    assert [path.name for log in logs for path in log.paths] == names
    for number, other in enumerate((1, 0, 3, 2)):
        [log] = find_logs([str(tmp_path / names[number])])
        assert [path.name for path in siblings(log)] == [names[other]]
    for name in names:
        (tmp_path / name).rename(tmp_path / name.removeprefix("run_"))
    assert [log.name for log in find_logs([str(tmp_path)])] == [
        *("2024-05-01-10-00-00", "2024-05-01-11-00-00")
    ]


def test_links_have_their_own_names(tmp_path):
    touch(tmp_path, "blobs/a0", "blobs/b1", "drives/one.mcap")
    for number, blob in enumerate(("a0", "b1")):
        (tmp_path / f"drives/run_{number}.mcap").symlink_to(tmp_path / "blobs" / blob)
    (tmp_path / "drives/latest.mcap").symlink_to("one.mcap")
    logs = find_logs([str(tmp_path / "drives")])
    assert [(log.name, len(log.paths)) for log in logs] == [
        *(("one", 1), ("run_0", 1), ("run_1", 1))
    ]
    one = str(tmp_path / "drives/one.mcap")
    latest = find_logs([str(tmp_path / "drives/latest.mcap")])
    assert [log.name for log in latest] == ["latest"]
    assert find_logs([one, str(tmp_path / "drives/latest.mcap")]) == find_logs([one])


def test_links_whose_targets_are_inaccessible_do_not_affect_others(tmp_path):
    touch(tmp_path, "a.mcap")
    for name in ("b.mcap", "notes"):
        (tmp_path / name).symlink_to("x" * 300)  # too long for a name
    [log] = find_logs([str(tmp_path)])
    assert log.name == "a" and log.note == "b.mcap is left out: a broken link"


def test_an_unreadable_folder_is_a_failed_log(tmp_path, monkeypatch):
    """Either its content cannot be listed or its files cannot be accessed."""
    touch(tmp_path, "a.mcap", "unlisted/b.mcap", "unsearched/c.mcap", "z.mcap")

    def refusing(call, *shut):
        def guarded(path=".", *rest, **options):
            if str(path).endswith(shut):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return call(path, *rest, **options)

        return guarded

    for name in ("scandir", "listdir"):
        monkeypatch.setattr(os, name, refusing(getattr(os, name), "unlisted"))
    monkeypatch.setattr(os, "stat", refusing(os.stat, "unsearched/.", "unsearched/c.mcap"))
    logs = find_logs([str(tmp_path)])
    assert [log.name for log in logs] == ["a", "unlisted", "unsearched", "z"]
    [alone] = find_logs([str(tmp_path / "unlisted")])
    assert alone == logs[1]
    with pytest.raises(InputError, match=r"unlisted: can't be read \(Permission denied\); check"):
        open_log(alone)


@pytest.mark.parametrize("pattern", ["x/*", "**", "x/**"])
def test_files_matched_twice_by_a_glob_are_read_once(tmp_path, pattern):
    touch(tmp_path, "x/a.mcap", "x/a.db3", "x/b.svo", "x/y/c.mcap")
    logs = find_logs([str(tmp_path / pattern)])
    assert [log.name.rpartition("/")[2] for log in logs] == ["a", "c"]
    assert logs[0].note.count("a.db3 is left out") == logs[0].note.count("b.svo is left out") == 1


def test_the_other_splits_of_a_given_split_are_found(tmp_path):
    touch(tmp_path, "run_0.mcap", "run_2.mcap", "run_1.mcap", "other_0.mcap")
    list_files(tmp_path, "run_0.mcap", "run_1.mcap", "run_2.mcap")
    [log] = find_logs([str(tmp_path / "run_1.mcap")])
    assert log.name == "run_1"
    assert [path.name for path in siblings(log)] == ["run_0.mcap", "run_2.mcap"]


def test_opening_one_of_many_numbered_recordings_reads_few_files(tmp_path, monkeypatch):
    """Only the file itself and its neighbours are read, up to the first other recording."""
    hour = 3600 * 10**9
    for number in range(10):
        write_log(tmp_path / f"run_{number}.mcap", moved(make_scene(2), number * hour))
    logs, looked = find_logs([str(tmp_path)]), []
    monkeypatch.setattr(
        "jaxdet.io.splits.signature",
        lambda path: looked.append(path) or signature(path),
    )
    assert [siblings(log) for log in logs] == [()] * 10
    assert len(looked) <= 4 * len(logs)


@pytest.mark.parametrize(
    ("names", "taken"),
    [
        ("x_0.mcap x_0.bag x_1.bag", "x_0.mcap x_1.bag"),
        ("x_1.bag x_2.mcap", "x_1.bag x_2.mcap"),
        ("x_0.bag x_1.bag x.mcap", "x.mcap"),
        ("x.bag x_0.mcap x_1.mcap", "x_0.mcap x_1.mcap"),
        ("x_0.db3 x_0.bag x.bag", "x_0.db3"),
        ("y_0.db3 y_1.db3 y_2.db3 y_5.db3 y_0.mcap", "y_0.mcap y_5.db3"),
    ],
)
def test_a_split_that_exists_in_another_format_is_left_out(tmp_path, monkeypatch, names, taken):
    """A split is kept if the files in the other format cover other times.

    Split ``n`` covers second ``n``; only the MCAP file ``y_0`` covers the first three seconds.
    """

    def fake_signature(path: Path) -> Signature:
        second = int(path.stem.partition("_")[2] or 0)
        span = 0 if path.name == "y_0.mcap" else second, 2.9 if path.name == "y_0.mcap" else second
        return Signature({}, frozenset(), (int(span[0] * 1e9), int(span[1] * 1e9 + 9e8)), {})

    monkeypatch.setattr(files, "signature", fake_signature)
    touch(tmp_path, *names.split())
    found = [path.name for log in find_logs([str(tmp_path)]) for path in log.paths]
    assert sorted(found) == taken.split()


def test_times_and_dates_in_names_are_not_numbers_of_splits(tmp_path):
    """The images of the two files are 300 s apart, and so are the times in their names."""
    for name, later_s in (("100000", 0), ("100500", 300)):
        scene = moved(make_scene(2), later_s * 10**9)
        write_log(tmp_path / f"drive_2024-05-01_{name}.mcap", scene)
    touch(tmp_path, "run_20240501100000.mcap", "run_20250501100000.bag", "run_1714557600123.db3")
    logs = find_logs([str(tmp_path)])
    assert [(len(log.paths), log.note) for log in logs] == [(1, "")] * 5
    assert missing_splits(LogFiles("run", logs[2].paths + logs[4].paths)) == ()


def test_numbers_of_splits_may_begin_with_zeros(tmp_path):
    touch(tmp_path, "run_000000.mcap", "run_000002.mcap", "run_000001.mcap")
    list_files(tmp_path, *(f"run_00000{number}.mcap" for number in range(3)))
    [log] = find_logs([str(tmp_path)])
    assert [path.stem for path in log.paths] == [f"run_00000{number}" for number in range(3)]


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_listed_files_that_do_not_exist_are_missing(tmp_path, newline):
    touch(tmp_path, "run_1.mcap", "run_2.mcap")
    list_files(tmp_path, *(f"run_{number}.mcap" for number in range(4)))
    path = tmp_path / "metadata.yaml"
    path.write_bytes(path.read_text().replace("\n", newline).encode())
    [log] = find_logs([str(tmp_path)])
    assert missing_splits(log) == (0, 3)
    touch(tmp_path, "run_0.mcap")
    assert missing_splits(log) == (3,)  # run_0 is only not part of this log


def test_neighbouring_splits_continue_where_the_log_ends(tmp_path):
    for number in range(6):
        scene = moved(make_scene(2), (number + 100 * (number > 3)) * 10**9)
        write_log(tmp_path / f"run_{number}.mcap", scene)
    paths = [tmp_path / f"run_{number}.mcap" for number in range(6)]
    assert siblings(LogFiles("run", tuple(paths[1:3]))) == (paths[0], paths[3])
    assert siblings(LogFiles("run", tuple(paths[:4]))) == ()
    assert siblings(LogFiles("run", tuple(paths[5:]))) == (paths[4],)


def test_an_empty_name_is_an_error(tmp_path, monkeypatch):
    touch(tmp_path, "x.mcap")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="path of a log is empty"):
        find_logs([""])
    assert [log.name for log in find_logs(["."])] == ["x"]


def test_unsupported_archives_and_several_logs_are_refused(tmp_path):
    touch(tmp_path, "x/run_0.zstd")
    with pytest.raises(InputError, match=r"run_0\.zstd.*NAME\.mcap\.zstd"):
        find_logs([str(tmp_path)])
    touch(tmp_path, "z/run.tar.zst")
    for given in (tmp_path / "z", tmp_path / "z/run.tar.zst"):
        with pytest.raises(InputError, match=r"run\.tar\.zst: \.tar files are not .*; unpack it"):
            find_logs([str(given)])
    touch(tmp_path, "y/a.mcap", "y/b.mcap")
    with pytest.raises(InputError, match="expected one log, found 2"):
        open_log(str(tmp_path / "y"))


def test_topics_of_compressed_images_are_read(tmp_path):
    scene = make_scene(2)
    with LogFile(tmp_path / "x.mcap") as log:
        write_calibration(log)
        for color, depth, at in zip(scene.color, scene.depth, scene.color_ns.tolist(), strict=True):
            png = cv2.imencode(".png", np.ascontiguousarray(color[..., ::-1]))[1].tobytes()
            message = ros_compressed(png, "rgb8; png compressed bgr8", at, COLOR_FRAME)
            log.ros("/cam/color/image_raw/compressed", message, at)
            body = struct.pack("<iff", 0, 0, 0) + cv2.imencode(".png", depth)[1].tobytes()
            message = ros_compressed(body, "16UC1; compressedDepth png", at, DEPTH_FRAME)
            log.ros("/cam/depth/image_rect_raw/compressedDepth", message, at)
    with open_log(str(tmp_path / "x.mcap")) as log:
        frames = log.read([0, 1], color=True).frames
        np.testing.assert_array_equal(frames.color, scene.color)
        np.testing.assert_array_equal(frames.depth, scene.depth)


def test_big_endian_cdr_is_read(tmp_path):
    scene = make_scene(1)
    with LogFile(tmp_path / "x.mcap") as log:
        for topic, message in (
            (COLOR_INFO, ros_info(COLOR_SIZE, COLOR_K, START, COLOR_FRAME)),
            (DEPTH_INFO, ros_info(DEPTH_SIZE, DEPTH_K, START, DEPTH_FRAME)),
            ("/tf_static", ros_tf((DEPTH_FRAME, COLOR_FRAME, *T_DEPTH_COLOR))),
            ("/cam/color/image_raw", ros_image(scene.color[0], "rgb8", START, COLOR_FRAME)),
            ("/cam/depth/image_rect_raw", ros_image(scene.depth[0], "16UC1", START, DEPTH_FRAME)),
        ):
            log.ros(topic, message, START, little_endian=False)
    with open_log(str(tmp_path / "x.mcap")) as log:
        assert log.stamps_ns.tolist() == [START]
        np.testing.assert_array_equal(log.read([0]).frames.depth[0], scene.depth[0])


def test_a_topic_that_is_not_depth_is_refused(tmp_path):
    path = str(write_log(tmp_path / "x.mcap"))
    with pytest.raises(TopicError, match="is not a supported depth encoding"):
        open_log(path, LogOptions(depth="/cam/color/image_raw"))


def test_control_characters_in_topic_names_are_escaped(tmp_path):
    with LogFile(tmp_path / "x.mcap") as log:
        image = ros_image(make_scene().color[0], "rgb8", START, COLOR_FRAME)
        log.ros("/a\n\x1b[31m../../b", image, START)
    with pytest.raises(TopicError) as caught:
        open_log(str(tmp_path / "x.mcap"))
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("names", "logs"),
    [
        ("drive.bag drive.mcap drive.db3", "drive.mcap"),
        ("drive_0.db3 drive_1.db3 drive.mcap", "drive.mcap"),
        ("drive.bag drive_0.mcap drive_1.mcap", "drive_0.mcap drive_1.mcap"),
        ("drive_0.db3 drive_1.db3 drive_0.mcap", "drive_0.mcap drive_1.db3"),
        ("drive_0.db3.zstd drive_0.db3 drive_1.mcap", "drive_0.db3 drive_1.mcap"),
        ("a_0.bag b_0.mcap", "a_0.bag b_0.mcap"),
    ],
)
def test_a_bucket_and_a_folder_prefer_the_same_files(tmp_path, names, logs):
    for name in names.split():
        (tmp_path / name).touch()
    found = [path.name for log in find_logs(tmp_path) for path in log.paths]
    listed, _ = listed_recordings([tmp_path / name for name in names.split()], {})
    assert sorted(found) == sorted(path.name for item in listed for path in item) == logs.split()
