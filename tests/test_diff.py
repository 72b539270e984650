"""``jaxdet diff`` compares two runs, obstacle by obstacle."""

import re
import shutil
from collections import Counter
from pathlib import Path

import cv2
import pytest

from jaxdet.cli import main
from jaxdet.results.reading import Results
from jaxdet.verify.difference import difference
from tests.made_results import make_results


@pytest.fixture(scope="module")
def shorter(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results of the log of ``drive`` with a shorter depth range."""
    folder = tmp_path_factory.mktemp("shorter") / "out"
    log = str(drive / "drive.mcap")
    args = ["--output", str(folder), "--ground.max-depth-m", "2.5", "--pictures", "2", "-q"]
    assert main(["run", log, *args, "--workers", "1", "--batch-size", "16"]) == 0
    return folder


def test_equal_runs_have_no_differences(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = shutil.copytree(drive / "out", tmp_path / "copy")
    assert main(["diff", str(drive / "out"), str(other)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "equal"


def test_every_obstacle_is_counted_once(drive: Path, shorter: Path) -> None:
    with Results(drive / "out") as a, Results(shorter) as b:
        found = difference(a, b)
        of_a, of_b = ({f.row["frame"]: f for f in results.frames()} for results in (a, b))
    assert not found.equal and found.settings == [("ground.max_depth_m", 4.0, 2.5)]
    (log,) = found.logs
    assert log.frames == 5 and log.obstacles[0] > log.obstacles[1]
    assert len(log.different) == 5
    for frame in log.different:
        a, b = of_a[frame.frame].obstacles, of_b[frame.frame].obstacles
        assert frame.obstacles == (len(a), len(b)) and "free_to_m" in frame.columns
        counted = Counter(one.obstacle for one in (*frame.only_a, *(p[0] for p in frame.changed)))
        assert set(counted.values()) == {1}
        for one in frame.only_a:  # beyond the range of the second run, or cut by it
            assert one.distance_m == a[one.obstacle]["distance_m"] > 2.0
        equal = len(a) - len(frame.only_a) - len(frame.changed)
        assert equal == len(b) - len(frame.only_b) - len(frame.changed) >= 1


def test_the_command_prints_a_table_and_exits_with_1_if_runs_differ(
    drive: Path, shorter: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["diff", str(drive / "out"), str(shorter)]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "ground.max_depth_m: 4.0 in A, 2.5 in B" and lines[-1] == "different"
    assert "drive: 5 frames, 5 different" in lines
    assert sum(bool(re.match(r" +\d+ +\d+ +\d+  \d+ at \d\.\d\d m", line)) for line in lines) == 5
    assert max(map(len, lines)) <= 100


def test_pictures_show_both_runs_side_by_side(
    drive: Path, shorter: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "pictures"
    args = ["diff", str(drive / "out"), str(shorter), "--pictures", str(folder)]
    assert main(args) == 1 and not capsys.readouterr().err
    files = sorted(folder.iterdir())
    assert [file.name for file in files] == [f"drive_{n:06}.png" for n in range(5)]
    own = cv2.imread(str(drive / "out" / "pictures" / "000000.png"))
    both = cv2.imread(str(files[0]))
    assert both.shape[1] == 2 * own.shape[1]
    left = both[-len(own) :, : own.shape[1]]
    assert (left == own).all() and (both[-len(own) :, own.shape[1] :] != own).any()
    assert main(args) == 2
    assert capsys.readouterr().err.endswith(
        "pictures: the folder exists already; choose a new folder\n"
    )


def test_frames_in_only_one_run_are_listed(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    some = str(tmp_path / "some")
    how = ["--every", "2", "--workers", "1", "-q"]
    assert main(["run", str(drive / "drive.mcap"), "--output", some, *how]) == 0
    assert main(["diff", some, str(drive / "out")]) == 1
    out = capsys.readouterr().out
    assert "drive: 3 frames, 0 different" in out and "  2 frames only in B" in out


def test_runs_on_different_logs_are_refused(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = make_results(tmp_path / "one", {"a": 5})
    two = make_results(tmp_path / "two", {"b": 5, "c": 5})
    for other, problem in (
        (one, "frame 1 of drive has another timestamp in"),
        (two, "no log of .*out is in .*two; they have drive and b, c"),
        (tmp_path, "holds no results"),
        (tmp_path / "gone", "gone"),
    ):
        assert main(["diff", str(drive / "out"), str(other)]) == 2
        assert re.search(problem, capsys.readouterr().err), problem
    assert main(["diff", str(one / "a"), str(two / "b")]) in (0, 1)
