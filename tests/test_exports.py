"""All export formats: cameras, parts of a log, log times, bounded memory."""

import json
import re
import resource
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from jaxdet.cli import main
from jaxdet.errors import ConfigError, InputError, OutputError, TopicError
from jaxdet.export import FORMATS, export
from jaxdet.export.recordings import find, look_again
from jaxdet.io import LogOptions, find_logs, open_log
from jaxdet.results.reading import Results
from tests.camera_logs import join_cameras
from tests.export_results import run, sim_log
from tests.made_results import make_results

LATE_NS = 3_600_123_456_789
"""Offset of the clock of the recorder from that of the camera."""
CAMERAS = ("front", "rear")
FRAMES = [2, 4, 6]


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with ``both.mcap`` of two cameras, and results of a part of it."""
    folder = tmp_path_factory.mktemp("parts")
    logs = {"front": 0, "rear": 3}
    logs = {n: sim_log(folder / f"{n}.mcap", frames=7, seed=seed) for n, seed in logs.items()}
    both = join_cameras(logs, folder / "both.mcap", LATE_NS)
    run(both, folder / "results", options=LogOptions(start="0.6", every=2))
    return folder


def exported(parts: Path, to: str, output: Path) -> Path:
    with Results(parts / "results") as results:
        given = [str(parts / "both.mcap")] if FORMATS[to].of_logs else []
        export(results, to, output, find(results, given))
        assert [log.camera for log in results.logs] == list(CAMERAS)
        for log in results.logs:
            assert [f.row["frame"] for f in results.frames(log)] == FRAMES
    return output


@pytest.mark.parametrize(("to", "topic"), [("foxglove", "obstacles"), ("ros2", "detections")])
def test_sidecars_have_the_log_times_of_the_recording(
    to: str, topic: str, parts: Path, tmp_path: Path
) -> None:
    folder = exported(parts, to, tmp_path / "out")
    for camera in CAMERAS:
        with (parts / "both.mcap").open("rb") as stream:
            color = f"/{camera}/camera/color/image_raw"
            times = [m.log_time for *_, m in make_reader(stream).iter_messages([color])]
        with (folder / f"both@{camera}.jaxdet.mcap").open("rb") as stream:
            shown = [m for *_, m in make_reader(stream).iter_messages(f"/jaxdet/{camera}/{topic}")]
        assert [message.log_time for message in shown] == [times[i] for i in FRAMES]
    with Results(parts / "results") as results:
        for row, _ in results.frames():
            assert row["log_time_ns"] == row["stamp_ns"] + LATE_NS


@pytest.mark.parametrize("to", ["foxglove", "ros2"])
def test_sidecars_are_not_read_as_logs(to: str, parts: Path, tmp_path: Path) -> None:
    """Next to a log, sidecars are left out; by name or alone, they are refused as sidecars."""
    folder = exported(parts, to, tmp_path / "out")
    name = "both@rear.jaxdet.mcap"
    with pytest.raises(
        InputError, match=r"front\.jaxdet\.mcap: this is an export of jaxdet.*pass the original log"
    ):
        find_logs([str(folder)])
    (folder / "both.mcap").symlink_to(parts / "both.mcap")
    [log] = find_logs([str(folder)])
    assert log.name == "both" and log.note.endswith(f"{name} is left out: an export of jaxdet")
    with pytest.raises(TopicError, match=f"{name}: an export of jaxdet.*pass the original log"):
        open_log(str(folder / name))


def test_a_name_shared_by_several_cameras_is_an_error(parts: Path) -> None:
    with Results(parts / "results") as results:
        assert [results.log(f"both, {camera}").camera for camera in CAMERAS] == [*CAMERAS]
        with pytest.raises(InputError, match="no log 'both'; it holds both, front, both, rear"):
            results.log("both")


def test_ros2_points_belong_to_the_exported_part(parts: Path) -> None:
    with Results(parts / "results") as results:
        found = find(results, [str(parts / "both.mcap")])
        for log in results.logs:
            (seen,) = look_again(results, log, found["both"])
            assert seen.chunk.frames["frame"].to_pylist() == FRAMES


def test_nav2_export_has_a_map_per_camera(parts: Path, tmp_path: Path) -> None:
    folder = exported(parts, "nav2", tmp_path / "out")
    for camera in CAMERAS:
        name = f"both@{camera}"
        text = (folder / f"{name}.yaml").read_text()
        assert f"image: {name}.pgm" in text and f"both, {camera}" in text
        cells = np.frombuffer((folder / f"{name}.pgm").read_bytes().split(b"255\n", 1)[1], np.uint8)
        assert {0, 254} <= {*cells.tolist()}


def test_the_command_prints_how_to_open_the_export(
    parts: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for to in ("foxglove", "nav2", "html"):
        output = tmp_path / to
        assert main(["export", str(parts / "results"), "--to", to, "--output", str(output)]) == 0
        written, see = capsys.readouterr().err.splitlines()
        assert written == f"written: {output}" and see.startswith("to view it: ")
        for name in re.findall(rf"{output}/[\w.]+", see):
            pattern = Path(name).name.replace("LOG", "both@front")
            assert (output / pattern).is_file()


def test_an_html_report_must_be_a_file(
    parts: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A report never replaces a folder, even an empty one; a file name needs a suffix."""
    command = ["export", str(parts / "results"), "--to", "html", "--output"]
    (tmp_path / "folder").mkdir()
    assert main([*command, str(tmp_path / "folder")]) == 2
    printed = capsys.readouterr().err
    assert f"got a folder; choose a file, such as {tmp_path / 'folder' / 'report.html'}" in printed
    assert (tmp_path / "folder").is_dir() and not any((tmp_path / "folder").iterdir())
    assert main([*command, str(tmp_path / "folder" / "report")]) == 0
    assert "it may require the suffix .html" in capsys.readouterr().err
    assert (tmp_path / "folder" / "report").is_file()
    assert main([*command, str(tmp_path / "folder" / "report" / "page.html")]) == 1
    assert "report: expected a folder, got a file" in capsys.readouterr().err


def test_printed_commands_quote_any_name(tmp_path: Path) -> None:
    for to in ("ros2", "nav2", "rerun"):
        last = shlex.split(FORMATS[to].seen(tmp_path / "a b's"))[-1]
        assert str(Path(last.removeprefix("yaml_filename:=")).parent) == str(tmp_path / "a b's")


def test_logs_left_out_by_a_format_are_named(
    parts: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    shutil.copytree(parts / "results", results)
    summary = json.loads((results / "summary.json").read_text("utf-8"))
    for log in summary["logs"]:
        log["paths"] = ["/gone/both.mcap"]
    summary["logs"][1] |= {"map": None, "pictures": []}
    (results / "summary.json").write_text(json.dumps(summary), "utf-8")
    for to, printed in (
        ("nav2", "jaxdet: warning: both, rear is left out: it has no map"),
        ("html", "jaxdet: warning: no pictures of some frames: /gone/both.mcap: the log is not"),
    ):
        command = ["export", str(results), "--to", to, "--output", str(tmp_path / to)]
        assert main(command) == 0
        assert capsys.readouterr().err.startswith(printed)


def test_the_report_distinguishes_cameras_and_frames(parts: Path, tmp_path: Path) -> None:
    text = exported(parts, "html", tmp_path / "page.html").read_text("utf-8")
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert match
    data = json.loads(match[1])
    assert [log["log"] for log in data["logs"]] == [f"both, {camera}" for camera in CAMERAS]
    for number, log in enumerate(data["logs"]):
        shown = [frame for frame in data["frames"] if frame["log"] == number]
        assert log["frames"] == len(FRAMES) and all(frame["picture"] for frame in shown)
        assert sorted(frame["frame"] for frame in shown) == FRAMES


def test_rerun_has_a_recording_per_camera(parts: Path, tmp_path: Path) -> None:
    chunk = pytest.importorskip("rerun.chunk")
    folder = exported(parts, "rerun", tmp_path / "out")
    paths = sorted(folder.iterdir())
    assert [path.stem for path in paths] == [f"both@{c}" for c in CAMERAS]
    for path in paths:
        seen = set()
        for part in chunk.RrdReader(path).stream():
            if not part.is_static and part.entity_path.endswith("camera/color"):
                seen |= set(part.to_record_batch().column("frame").to_pylist())
        assert sorted(seen) == FRAMES


def test_coco_has_the_images_of_both_cameras(parts: Path, tmp_path: Path) -> None:
    folder = exported(parts, "coco", tmp_path / "out")
    images = json.loads((folder / "annotations.json").read_text())["images"]
    assert [(one["camera"], one["frame"]) for one in images] == [
        (camera, frame) for camera in CAMERAS for frame in FRAMES
    ]
    assert all((folder / one["file_name"]).is_file() for one in images)


@pytest.mark.parametrize("to", [name for name, form in FORMATS.items() if not form.of_logs])
def test_a_log_for_a_format_that_uses_no_logs_is_refused(
    to: str, parts: Path, tmp_path: Path
) -> None:
    with (
        Results(parts / "results") as results,
        pytest.raises(ConfigError, match=f"--to {to} does not use --log; omit --log"),
    ):
        export(results, to, tmp_path / "out", find(results, [str(parts / "both.mcap")]))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("to", ["foxglove", "html"])
def test_a_full_disk_is_reported_and_leaves_no_files(to: str, tmp_path: Path) -> None:
    make_results(tmp_path / "results", {"a": 200})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with Results(tmp_path / "results") as results:
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (64, limits[1]))
            with pytest.raises(OutputError, match=r"out: can't be written \(.*make room or pass"):
                export(results, to, tmp_path / "out", {})
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


_STOPPED = """
import signal, sys
from jaxdet.cli import main
from jaxdet.export import html
from jaxdet.tracks import folder
from tests.stops import stop

def stopped(path):
    path.touch()
    stop(signal.SIGTERM)

html.export = lambda results, output, recordings: stopped(output)
folder.write_tracks = lambda results, config, staging: stopped(staging / "half")
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("command", ["export --to html --output", "track"])
def test_a_signal_leaves_no_partial_export(command: str, tmp_path: Path) -> None:
    make_results(tmp_path / "results", {"a": 20})
    name, *more = command.split()
    given = [str(tmp_path / "results"), *more, *[str(tmp_path / "out")] * bool(more)]
    before = sorted(tmp_path.rglob("*"))
    code = [sys.executable, "-c", _STOPPED, name, *given]
    done = subprocess.run(code, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (143, "jaxdet: error: interrupted\n")
    assert sorted(tmp_path.rglob("*")) == before


_PEAK = """
import sys
from pathlib import Path
from jaxdet.export import export
from jaxdet.results.reading import Results
folder, to = Path(sys.argv[1]), sys.argv[2]
with Results(folder / "results") as results:
    export(results, to, folder / "out", {})
status = Path("/proc/self/status").read_text()  # resource would count the parent's memory too
print(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))
"""


@pytest.mark.slow
@pytest.mark.parametrize("to", ["foxglove", "ros2", "rerun", "html"])
def test_memory_of_exports_is_bounded(to: str, tmp_path: Path) -> None:
    """100,000 frames use no more memory than 66,000, which fill two row groups of the tables."""
    peaks = []
    for count in (66_000, 100_000):
        folder = tmp_path / str(count)
        make_results(folder / "results", {"a": count})
        command = [sys.executable, "-c", _PEAK, str(folder), to]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        peaks.append(int(done.stdout) / 1024)
    assert peaks[1] < peaks[0] + 20, peaks
