"""Results that are brought up to date: the bytes of a run over all logs, and no log done twice."""

import json
import os
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from jaxdet import engine
from jaxdet.cli.main import main
from jaxdet.cli.truth import TruthScore
from jaxdet.config import Config, GroundConfig
from jaxdet.engine import device, kept, log_run, record
from jaxdet.engine.known import LogIdentity, Matches, match_logs, places_of
from jaxdet.errors import (
    ConfigError,
    InputError,
    Interrupted,
    OutputError,
    ResultsError,
)
from jaxdet.io import LogFiles, LogOptions
from jaxdet.results.manifest import changed_manifest, fingerprint, read_manifest
from jaxdet.results.summary import LogSummary
from jaxdet.results.writer import write_json
from jaxdet.sim import SimConfig, write_log
from jaxdet.tracks import track_results
from jaxdet.verify import verify
from tests.killed_runs import named, remembered
from tests.test_engine_parts import sim_log as sim_log
from tests.test_engine_parts import two_cameras as two_cameras  # a fixture
from tests.test_resume import interrupt, stop_at
from tests.test_workers import same_results

COMPUTED = remembered(device.detect)
CONFIG = Config(GroundConfig(source="none"))


class Logs:
    """Logs of ten frames each, files of a few bytes, and which of them were opened."""

    def __init__(self, folder: Path, names: str) -> None:
        self.folder, self.opened, self.broken = folder, list[str](), set[str]()
        self.all = [self.add(name) for name in names]

    def add(self, name: str, content: str = "") -> LogFiles:
        path = self.folder / f"{name}.mcap"
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_bytes(os.fsencode(content or name))
        os.utime(path, ns=(0, 0))
        return LogFiles(name, (path,))

    def open(self, files: LogFiles, options: LogOptions, memory: Any) -> Any:
        self.opened.append(files.name)
        if files.name in self.broken:
            raise InputError("is torn", path=files.name)
        return named(files.name)

    def run(self, which: str, output: Path, **more: Any) -> list[str]:
        """Runs over the logs of these names; returns which were opened."""
        self.opened.clear()
        self.go([log for log in self.all if log.name in which], output, **more)
        return sorted(self.opened)

    def go(self, logs: list[LogFiles], output: Path, **more: Any) -> engine.Summary:
        own = {name: more.pop(name) for name in ("progress", "say") if name in more}
        config = more.pop("config", CONFIG)
        how = {"backend": "reference", "batch_size": 5, "pictures": 1, "workers": 1, **more}
        return engine.run(logs, config, LogOptions(), engine.RunOptions(output, **how), **own)


@pytest.fixture
def logs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Logs:
    made = Logs(tmp_path / "logs", "abcd")
    monkeypatch.setattr(log_run, "open_log", made.open)
    monkeypatch.setattr(device, "detect", COMPUTED)
    return made


def summary(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))


def rows(folder: Path) -> list[str]:
    """The logs of the frames."""
    return pq.read_table(folder / "frames.parquet", columns=["log"])["log"].to_pylist()


@pytest.mark.parametrize("more", [{}, {"copies": True}], ids=["links", "copies"])
def test_new_logs_before_between_and_behind(
    logs: Logs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, Any]
) -> None:
    if more:

        def refuse(self: Path, target: Path) -> None:
            raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(Path, "hardlink_to", refuse)
    output = tmp_path / "out"
    logs.run("b", output)
    before = summary(output)["logs"]
    assert logs.run("bd", output, update=True) == ["d"]
    assert logs.run("abcd", output, update=True) == ["a", "c"]
    assert logs.run("abcd", tmp_path / "whole") == ["a", "b", "c", "d"]
    same_results(output, tmp_path / "whole")
    assert [log for log in summary(output)["logs"] if log["log"] == "b"] == before
    assert (summary(output)["kept_logs"], summary(tmp_path / "whole")["kept_logs"]) == (2, 0)
    report = verify(output, sample=0)
    assert not [finding for finding in report.findings if finding.check != "log"]
    with pytest.raises(ResultsError) as caught:
        logs.run("abcd", output, update=True)
    assert caught.value.same
    assert not logs.opened
    assert not (output / ".jaxdet").exists()


def test_what_is_there_without_results_is_a_run(logs: Logs, tmp_path: Path) -> None:
    assert logs.run("ab", tmp_path / "out", update=True) == ["a", "b"]
    assert rows(tmp_path / "out") == ["a"] * 10 + ["b"] * 10


def test_logs_that_are_not_named_stay(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.run("abc", output)
    (logs.folder / "a.mcap").unlink()
    assert logs.run("d", output, update=True) == ["d"]
    assert rows(output) == [name for name in "abcd" for _ in range(10)]
    assert [log["paths"] for log in summary(output)["logs"]] == [
        [str(logs.folder / f"{name}.mcap")] for name in "abcd"
    ]


@pytest.mark.parametrize("how", ["content", "time"])
def test_a_changed_log_is_done_again(logs: Logs, tmp_path: Path, how: str) -> None:
    output = tmp_path / "out"
    logs.run("abc", output)
    if how == "content":
        logs.add("b", "x")
    else:  # bytes in the middle of a large log may have changed
        os.utime(logs.folder / "b.mcap", ns=(1, 1))
    assert logs.run("abc", output, update=True) == ["b"]
    assert rows(output) == [name for name in "abc" for _ in range(10)]


def test_a_log_that_moved_stays(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.run("ab", output)
    moved = logs.folder.rename(tmp_path / "moved")
    there = [LogFiles(name, (moved / f"{name}.mcap",)) for name in "ab"]
    logs.go(there, output, update=True)
    assert [log["paths"] for log in summary(output)["logs"]] == [
        [str(moved / f"{name}.mcap")] for name in "ab"
    ]
    logs.opened.clear()
    with pytest.raises(ResultsError):
        logs.go(there, output, update=True)
    assert not logs.opened


def test_failed_logs_are_done_again(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"

    def errors() -> list[str | None]:
        return [log["error"] for log in summary(output)["logs"]]

    logs.broken = {"b", "d"}
    logs.run("abcd", output)
    assert logs.run("abcd", output, update=True) == ["b", "d"]
    assert errors() == [None, "b: is torn", None, "d: is torn"]
    logs.broken = set()
    assert logs.run("abc", output, update=True) == ["b"]  # d is not asked for, and still failed
    assert errors() == [None, None, None, "d: is torn"]
    assert logs.run("abcd", output, update=True) == ["d"]
    logs.run("abcd", tmp_path / "whole")
    same_results(output, tmp_path / "whole")


def test_a_failed_log_that_was_removed_is_left_out(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.broken = {"b"}
    logs.run("abc", output)
    (tmp_path / "logs" / "b.mcap").unlink()
    (tmp_path / "logs" / "c.mcap").unlink()
    assert logs.run("a", output, update=True) == []
    assert [log["log"] for log in summary(output)["logs"]] == ["a", "c"]
    assert rows(output) == ["a"] * 10 + ["c"] * 10


def test_logs_with_lost_frames_are_done_again(logs: Logs, tmp_path: Path, monkeypatch) -> None:
    output = tmp_path / "out"
    join = log_run.join_parts

    def losing(plan: Any, about: LogSummary, *room: int) -> Any:
        notes = join(plan, about, *room)
        about.lost.append("frames 0 to 4: a worker ended")
        return notes

    with monkeypatch.context() as patch:
        patch.setattr(log_run, "join_parts", losing)
        logs.run("a", output)
    assert logs.run("ab", output, update=True) == ["a", "b"]
    assert not any(log["lost"] for log in summary(output)["logs"])
    assert logs.run("abc", output, update=True) == ["c"]


def test_cameras_and_scores_stay(two_cameras: Path, sim_log: Path, tmp_path: Path) -> None:
    for path in (two_cameras, sim_log):
        shutil.copy2(path, tmp_path)
    shutil.copy2(f"{sim_log}.truth.npz", tmp_path)
    sim, two = tmp_path / sim_log.name, tmp_path / two_cameras.name
    how = ["--backend", "reference", "--pictures", "1", "--truth", str(sim), "--quiet"]
    assert main(["run", str(two), "--output", str(tmp_path / "out"), *how]) == 0
    before = summary(tmp_path / "out")["logs"]
    assert before[0]["score"]["frames"] != before[1]["score"]["frames"]
    assert main(["run", str(tmp_path), "--output", str(tmp_path / "out"), *how, "--update"]) == 0
    assert summary(tmp_path / "out")["logs"][1:] == before
    assert main(["run", str(tmp_path), "--output", str(tmp_path / "whole"), *how]) == 0
    same_results(tmp_path / "out", tmp_path / "whole")
    assert not verify(tmp_path / "out", sample=0).findings
    for told in summary(tmp_path / "out")["logs"]:
        assert LogSummary.from_dict(told).to_dict() == told


def test_another_truth_makes_other_results(tmp_path: Path) -> None:
    """A copy does not, as each of the machines that share a run has."""

    def told(log: str) -> dict[str, Any]:
        given = [], CONFIG, LogOptions(), engine.RunOptions(tmp_path)
        truth = {"score": TruthScore(tmp_path / log, CONFIG)}
        return record.make_record(*given, truth, None)["about"]["observed"]

    path = tmp_path / "log.mcap.truth.npz"
    path.write_bytes(b"one")
    before = told("log.mcap")
    assert before["score"]
    (tmp_path / "copy").mkdir()
    shutil.copy(path, tmp_path / "copy")
    assert told("copy/log.mcap") == before
    path.write_bytes(b"two")
    assert told("log.mcap") != before


def test_tracks_go_with_the_results_that_they_are_of(logs: Logs, tmp_path: Path) -> None:
    logs.run("a", tmp_path / "out")
    track_results(tmp_path / "out")
    logs.run("ab", tmp_path / "out", update=True)
    assert not list((tmp_path / "out").glob("track*"))


def test_tracks_stay_where_no_row_changed(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.broken = {"b"}
    logs.run("ab", output)
    track_results(output)
    before = {path.name: path.read_bytes() for path in output.glob("track*")}
    assert len(before) >= 2
    assert logs.run("ab", output, update=True) == ["b"]
    assert {path.name: path.read_bytes() for path in output.glob("track*")} == before
    assert not [one for one in verify(output, sample=0).findings if one.check != "log"]


def test_an_update_that_is_stopped_goes_on(logs: Logs, tmp_path: Path) -> None:
    output, said = tmp_path / "out", list[str]()
    logs.run("a", output)
    with pytest.raises(Interrupted, match=r"1 of 3 logs and 1 of 2 units of c are done"):
        logs.run("abcd", output, update=True, progress=stop_at("c", interrupt))
    assert rows(output) == ["a"] * 10
    with pytest.raises(ConfigError, match="holds results already"):
        logs.run("abcd", output)
    finer = Config(GroundConfig(source="none", step_height_m=0.06))
    with pytest.raises(ConfigError, match=r"brought up to date: ground\.step_height_m was 0\.05"):
        logs.run("abcd", output, update=True, config=finer)
    assert logs.run("abcd", output, update=True, say=said.append) == ["c", "d"]
    assert said == ["continuing: 1 of 3 logs and 1 of 2 units of c are there"]
    logs.run("abcd", tmp_path / "whole")
    same_results(output, tmp_path / "whole")


@pytest.mark.parametrize("first", ["", "a"], ids=["no-results", "results"])
def test_an_update_that_was_stopped_takes_other_logs(
    logs: Logs, tmp_path: Path, first: str
) -> None:
    """As logs arrive every day, and may be removed when they are done."""
    output, said = tmp_path / "out", list[str]()
    if first:
        logs.run("a", output)
        (logs.folder / "a.mcap").unlink()
    with pytest.raises(Interrupted):
        logs.run("bc", output, update=True, progress=stop_at("c", interrupt))
    logs.add("c", "changed")
    new = logs.add("0")
    logs.opened.clear()
    logs.go([*logs.all[1:], new], output, update=True, say=said.append)
    assert (logs.opened, said) == (["0", "c", "d"], ["continuing: 1 of 4 logs are there"])
    assert rows(output) == [name for name in f"0{first}bcd" for _ in range(10)]
    assert not (output / ".jaxdet").exists()


def test_an_update_in_a_folder_with_a_run_of_another_kind(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.run("a", output)
    finer = Config(GroundConfig(source="none", step_height_m=0.06))
    with pytest.raises(Interrupted):
        logs.run("b", output, config=finer, overwrite=True, progress=stop_at("b", interrupt))
    with pytest.raises(ConfigError, match=rf"unfinished .*or remove {output / '.jaxdet'}$"):
        logs.run("b", output, update=True)


def test_what_can_not_be_brought_up_to_date(logs: Logs, tmp_path: Path, monkeypatch) -> None:
    output = tmp_path / "out"
    logs.run("ab", output)

    def refused(match: str, go: Callable[[], Any]) -> None:
        before = {path: path.read_bytes() for path in output.rglob("*") if path.is_file()}
        with pytest.raises(ConfigError, match=f"be brought up to date: {match}; give") as caught:
            go()
        assert "--overwrite for results of these logs alone" in str(caught.value)
        assert {path: path.read_bytes() for path in output.rglob("*") if path.is_file()} == before

    def update(which: str = "abc", **more: Any) -> Callable[[], Any]:
        return lambda: logs.run(which, output, update=True, **more)

    step = Config(GroundConfig(source="none", step_height_m=0.06))
    refused(r"ground.step_height_m was 0.05 and is 0.06 now", update(config=step))
    refused("pictures was 1 and is 2 now", update(pictures=2))
    with monkeypatch.context() as patch:
        patch.setattr("jaxdet.__version__", "0.2.0")
        refused('jaxdet was "0.1.0" and is "0.2.0" now', update())
    with monkeypatch.context() as patch:
        older = {k: v for k, v in read_manifest(output).items() if k != "pictures"}
        patch.setattr("jaxdet.results.manifest.read_manifest", lambda folder: older)
        write_json(output / "manifest.json", changed_manifest(output, (), {}))
    refused("they are of another version", update())


def test_logs_keep_the_names_that_they_have_in_the_results(logs: Logs, tmp_path: Path) -> None:
    """Names depend on which logs are found together."""
    output = tmp_path / "out"
    first = logs.add("may/drive")
    logs.go([first._replace(name="drive")], output)
    second = logs.add("june/drive")
    logs.opened.clear()
    logs.go([second._replace(name="drive")], output, update=True)
    third, copied = logs.add("july/drive"), logs.add("july/copy", "may/drive")
    every = [first, second, third, copied]
    logs.go(every, output, update=True)
    assert logs.opened == ["june/drive", "july/copy", "july/drive"]
    told = {log["log"]: Path(log["paths"][0]) for log in summary(output)["logs"]}
    assert told == {
        "drive": first.paths[0],
        "july/copy": copied.paths[0],
        "july/drive": third.paths[0],
        "june/drive": second.paths[0],
    }
    with pytest.raises(ResultsError):
        logs.go(every, output, update=True)
    with pytest.raises(ResultsError):
        logs.go([copied._replace(name="drive")], output, update=True)
    assert len(logs.opened) == 3


def test_a_log_that_took_the_place_of_another(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.go([logs.add("drive", "old")], output)
    both = [logs.add("drive", "new"), logs.add("drive.1", "old")]
    logs.opened.clear()
    logs.go(both, output, update=True)
    assert logs.opened == ["drive", "drive.1"]
    assert rows(output) == ["drive"] * 10 + ["drive.1"] * 10


def test_a_log_that_took_the_place_of_one_while_another_has_its_content(
    logs: Logs, tmp_path: Path
) -> None:
    output = tmp_path / "out"
    logs.run("ab", output)
    logs.add("a", "b")
    assert logs.run("a", output, update=True) == ["a"]
    assert [(log["log"], log["paths"]) for log in summary(output)["logs"]] == [
        (name, [str(logs.folder / f"{name}.mcap")]) for name in "ab"
    ]


@pytest.mark.parametrize("beside", [False, True], ids=["alone", "beside-one-that-can"])
def test_logs_that_can_not_be_read_are_not_one(logs: Logs, tmp_path: Path, beside: bool) -> None:
    def gone(name: str) -> LogFiles:
        log, more = logs.add(name), logs.add(f"{name}-2", "same").paths
        log.paths[0].unlink()
        return log._replace(paths=(*log.paths, *more[:beside]))

    output, (first, second) = tmp_path / "out", (gone("lost"), gone("missing"))
    logs.broken = {"lost", "missing"}
    logs.go([logs.all[0], first], output)
    first.paths[0].touch()  # it is there again, or it would be left out
    logs.go([logs.all[0], second], output, update=True)
    told = {log["log"]: log["paths"][0] for log in summary(output)["logs"]}
    assert told == {log.name: str(log.paths[0]) for log in (logs.all[0], first, second)}


def test_two_new_logs_that_would_get_one_name(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.go([logs.add("may/drive")._replace(name="drive")], output)
    new = [logs.add("x/june/drive"), logs.add("y/june/drive")]
    names = "drive", "june/drive"
    new = [log._replace(name=name) for log, name in zip(new, names, strict=True)]
    logs.go(new, output, update=True)
    told = {log["log"]: Path(log["paths"][0]) for log in summary(output)["logs"]}
    assert told == {
        "drive": logs.folder / "may/drive.mcap",
        "june/drive": new[0].paths[0],
        "y/june/drive": new[1].paths[0],
    }
    assert rows(output) == ["drive"] * 10 + ["june/drive"] * 10 + ["y/june/drive"] * 10


def split(logs: Logs, *numbers: int, name: str = "rec") -> LogFiles:
    """A recording of some of its split files."""
    paths = [logs.folder / f"rec_{number}.mcap" for number in numbers]
    for path in paths:
        if not path.exists():
            logs.add(path.stem)
    return LogFiles(name, tuple(paths))


def test_logs_that_became_one_recording(logs: Logs, tmp_path: Path) -> None:
    output, alone = tmp_path / "out", [split(logs, n, name=f"rec_{n}") for n in (0, 1)]
    logs.go(alone, output)
    logs.go([split(logs, 0, 1)], output, update=True)
    assert rows(output) == ["rec"] * 10
    logs.go(alone, output, update=True)  # their schemas may have turned out to differ
    assert rows(output) == ["rec_0"] * 10 + ["rec_1"] * 10


def test_a_recording_that_goes_on(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.go([split(logs, 0, name="rec_0")], output)
    for numbers in ((0, 1), (0, 1, 2)):
        logs.opened.clear()
        logs.go([split(logs, *numbers)], output, update=True)
        assert logs.opened == rows(output)[:1] == ["rec_0"]


def test_a_recording_that_goes_on_in_a_file_that_can_not_be_read(
    logs: Logs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its rows are of the files that it had, and so is what is told of it."""
    output = tmp_path / "out"
    logs.go([split(logs, 0, 1)], output)
    monkeypatch.setattr(record, "fingerprint", unreadable(logs.folder / "rec_2.mcap"))
    logs.go([split(logs, 0, 1, 2), logs.all[0]], output, update=True)
    assert rows(output) == ["a"] * 10 + ["rec"] * 10
    assert len(read_manifest(output)["inputs"]["rec"]) == 2
    assert [len(log["paths"]) for log in summary(output)["logs"]] == [1, 2]


def test_some_files_of_a_recording(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.go([split(logs, 0, 1, 2)], output)
    (logs.folder / "rec_0.mcap").unlink()  # it may be removed when it is done
    logs.opened.clear()
    with pytest.raises(ResultsError):
        logs.go([split(logs, 1, 2)], output, update=True)
    logs.go([split(logs, 2, name="rec_2"), logs.all[0]], output, update=True)
    assert logs.opened == ["a"]
    assert len(summary(output)["logs"][1]["paths"]) == 3
    lost = "rec_0.mcap: is not among the logs now, but others of the log rec are; name it as well"
    with pytest.raises(ConfigError, match=lost):
        logs.go([split(logs, 1, 2, 3)], output, update=True)
    logs.add("rec_1", "other")
    with pytest.raises(ConfigError, match=lost):
        logs.go([split(logs, 1, 2)], output, update=True)
    assert rows(output) == ["a"] * 10 + ["rec"] * 10


def test_some_files_of_a_recording_that_failed(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.broken = {"rec"}
    logs.go([split(logs, 0, 1), logs.all[0]], output)
    logs.broken.clear()
    logs.go([split(logs, 1)], output, update=True)
    assert rows(output) == ["a"] * 10 + ["rec"] * 10


def test_a_recording_that_failed_is_there_in_another_format(logs: Logs, tmp_path: Path) -> None:
    """As far as it could be converted: it has no rows to be lost."""
    output = tmp_path / "out"
    logs.broken = {"rec"}
    made = [logs.add(f"rec_{number}").paths[0] for number in (0, 1)]
    paths = tuple(path.rename(path.with_suffix(".db3")) for path in made)
    logs.go([LogFiles("rec", paths), logs.all[0]], output)
    logs.broken.clear()
    converted = LogFiles("rec", logs.add("rec_0", "converted").paths)
    logs.go([converted], output, update=True)
    assert rows(output) == ["a"] * 10 + ["rec"] * 10


def test_a_recording_that_is_there_in_another_format(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    old = logs.add("x/drive")
    logs.go([old._replace(paths=(old.paths[0].rename(old.paths[0].with_suffix(".db3")),))], output)
    logs.go([logs.add("x/drive", "converted")], output, update=True)
    assert rows(output) == ["x/drive"] * 10
    assert summary(output)["logs"][0]["paths"] == [str(logs.folder / "x/drive.mcap")]
    logs.go([LogFiles("drive", (logs.folder / "x/drive",))], output, update=True)  # of images
    assert len(rows(output)) == 20


@pytest.mark.parametrize(
    ("old", "new", "lacks"),
    [
        (("rec_0", "rec_1"), ("rec_0",), "rec_1.db3"),
        (("rec",), ("rec_0", "rec_1"), "rec.db3"),
        (("rec_0", "rec_1"), ("rec_0", "rec_1"), ""),
    ],
)
def test_files_of_a_recording_in_another_format(
    logs: Logs, tmp_path: Path, old: tuple, new: tuple, lacks: str
) -> None:
    output = tmp_path / "out"
    paths = [log.paths[0].rename(log.paths[0].with_suffix(".db3")) for log in map(logs.add, old)]
    logs.go([LogFiles("rec", tuple(paths))], output)
    converted = LogFiles("rec", tuple(logs.add(name, f"new {name}").paths[0] for name in new))
    if lacks:
        with pytest.raises(
            ConfigError, match=rf"{lacks}: the recording of the log rec is given in"
        ):
            logs.go([converted], output, update=True)
        return
    logs.go([converted], output, update=True)
    assert rows(output) == ["rec"] * 10
    assert len(summary(output)["logs"][0]["paths"]) == 2


@pytest.mark.parametrize("link", [False, True], ids=["relative", "link"])
def test_other_ways_to_name_places(logs: Logs, tmp_path: Path, monkeypatch, link: bool) -> None:
    output = tmp_path / "out"
    logs.go([split(logs, 0, 1), logs.all[0]], output)
    (logs.folder / "below").mkdir()
    monkeypatch.chdir(logs.folder / "below")
    (tmp_path / "link").symlink_to(logs.folder)
    way = tmp_path / "link" if link else Path("..")
    logs.add("a", "changed")
    given = [LogFiles("rec_0", (way / "rec_0.mcap",)), LogFiles("a", (way / "a.mcap",))]
    logs.opened.clear()
    logs.go(given, output, update=True)
    assert (logs.opened, rows(output)) == (["a"], ["a"] * 10 + ["rec"] * 10)


def test_a_folder_that_could_not_be_listed(logs: Logs, tmp_path: Path) -> None:
    output, inside = tmp_path / "out", logs.add("in/x")
    logs.broken = {"in"}
    logs.go([LogFiles("in", (logs.folder / "in",)), logs.all[0]], output)
    logs.go([inside, logs.all[0]], output, update=True)
    assert [(log["log"], log["error"]) for log in summary(output)["logs"]] == [
        ("a", None),
        ("in/x", None),
    ]


def test_what_is_done_of_logs_that_are_not_named_is_kept(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    with pytest.raises(Interrupted):
        logs.run("ab", output, progress=stop_at("b", interrupt))
    for which, lacks in (("b", "a"), ("a", "b"), ("c", "a")):
        with pytest.raises(ConfigError, match=f"unfinished run, but the log {lacks} was among its"):
            logs.run(which, output, update=True)
    assert logs.run("abc", output, update=True) == ["b", "c"]


def test_a_log_that_vanishes_costs_no_other(logs: Logs, tmp_path: Path) -> None:
    """Also where a log that is done was removed before."""
    output = tmp_path / "out"
    logs.run("a", output)
    (logs.folder / "a.mcap").unlink()
    opened = logs.open

    def vanish(files: LogFiles, options: LogOptions, memory: Any) -> Any:
        if files.name == "b":
            files.paths[0].unlink(missing_ok=True)
            raise InputError("can't be read", path=str(files.paths[0]))
        return opened(files, options, memory)

    logs.open = vanish
    log_run.open_log = vanish  # put back by the fixture
    logs.run("bc", output, update=True)
    assert [bool(log["error"]) for log in summary(output)["logs"]] == [False, True, False]
    (logs.folder / "c.mcap").unlink()
    logs.add("b")
    with pytest.raises(InputError, match="is not there any more"):  # perhaps its disk
        logs.run("b", output, update=True)


def test_a_log_that_can_not_be_read_now_stays(logs: Logs, tmp_path: Path, monkeypatch) -> None:
    output, said = tmp_path / "out", list[str]()
    logs.run("abc", output)
    monkeypatch.setattr(record, "fingerprint", unreadable(logs.folder / "b.mcap"))
    assert logs.run("abcd", output, update=True, say=said.append) == ["d"]
    assert said == [f"{logs.folder / 'b.mcap'} can't be read; its results stay as they are"]
    assert rows(output) == [name for name in "abcd" for _ in range(10)]
    monkeypatch.undo()
    assert read_manifest(output)["inputs"]["b"] == [fingerprint(logs.folder / "b.mcap")]


def unreadable(path: Path) -> Callable[[Path], dict[str, Any]]:
    """``fingerprint`` on a disk that reads all files but one."""
    return lambda file: {"path": str(file)} if file == path else fingerprint(file)


@pytest.mark.parametrize("strange", ["\u3000", "\n", "\udcff"])
def test_paths_that_can_not_be_printed(logs: Logs, tmp_path: Path, strange: str) -> None:
    output, place = tmp_path / "out", f"x{strange}y/a"
    logs.broken = {"bad"}
    bad = logs.add(f"x{strange}y/bad")._replace(name="bad")
    logs.go([logs.add(place)._replace(name="a"), bad], output)
    logs.go([logs.add(place, "changed")._replace(name="a")], output, update=True)
    assert rows(output) == ["a"] * 10
    assert [log["log"] for log in summary(output)["logs"]] == ["a", "bad"]


def test_equal_logs_that_moved(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.go([logs.add(f"x/{name}", "same")._replace(name=name) for name in "ab"], output)
    (logs.folder / "x").rename(logs.folder / "y")
    moved = [LogFiles(name, (logs.folder / f"y/{name}.mcap",)) for name in "ab"]
    logs.opened.clear()
    logs.go(moved, output, update=True)
    assert (rows(output), logs.opened) == (["a"] * 10 + ["b"] * 10, [])
    assert summary(output)["batch_size"] == 5


def test_another_way_to_name_the_same_logs(logs: Logs, tmp_path: Path, monkeypatch) -> None:
    logs.run("a", tmp_path / "out")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ResultsError) as caught:
        logs.go([LogFiles("a", (Path("logs/a.mcap"),))], tmp_path / "out", update=True)
    assert caught.value.same


def test_reports_of_logs_that_stay(logs: Logs, tmp_path: Path, monkeypatch) -> None:
    output = tmp_path / "out"

    def torn(files: LogFiles, *rest: Any) -> Any:
        if files.name == "b":
            raise ZeroDivisionError
        return logs.open(files, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(log_run, "open_log", torn)
        logs.run("ab", output)
    report = (output / "report_b.txt").read_bytes()
    logs.run("c", output, update=True)
    assert (output / "report_b.txt").read_bytes() == report
    logs.run("abc", output, update=True)
    assert not (output / "report_b.txt").exists()


def test_many_logs_are_known_again_in_little_time(tmp_path: Path) -> None:
    names = [f"{i:05d}" for i in range(20_000)]
    files = {name: [{"size": 1, "fingerprint": name, "mtime_ns": 0}] for name in names}
    old = [LogIdentity(name, (f"/old/{name}.mcap",), files[name]) for name in names]
    for folder in ("old", "new"):
        given = [LogFiles(name, (Path(f"/{folder}/{name}.mcap"),)) for name in names]
        start = time.process_time()
        there = [LogIdentity(log.name, places_of(log.paths), files[log.name]) for log in given]
        matches = match_logs(there, old)
        assert time.process_time() - start < 5
        assert matches == Matches(dict(zip(names, names, strict=True)), {}, set())


def test_names_that_no_folder_makes_different() -> None:
    log = LogFiles("a/drive", (Path("/x/y/drive.mcap"),))
    assert kept._free_name(log, set()) == "a/drive"
    assert kept._free_name(log, {"a/drive"}) == "y/drive"
    assert kept._free_name(log, {"a/drive", "y/drive"}) == "x/y/drive"
    every = {"a/drive", "y/drive", "x/y/drive", "a/drive (2)"}
    assert kept._free_name(log, every) == "a/drive (3)"


def test_names_of_files_stay(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.go([logs.add("a_b")], output)
    with pytest.raises(ConfigError, match="files of the log a_b would be called a_b_2"):
        logs.go([logs.add("a b")], output, update=True)


def test_names_of_files_of_logs_that_are_done_again_may_change(logs: Logs, tmp_path: Path) -> None:
    output = tmp_path / "out"
    logs.go([logs.add("a_b")], output)
    both = [logs.add("a_b", "new"), logs.add("a b")]
    logs.go(both, output, update=True)
    logs.go(both, tmp_path / "whole")
    same_results(output, tmp_path / "whole")


@pytest.mark.parametrize("name", ["obstacles.parquet", "pictures/a_000000.png", "summary.json"])
def test_damaged_results_are_refused(logs: Logs, tmp_path: Path, name: str) -> None:
    output = tmp_path / "out"
    logs.run("ab", output)
    content = bytearray((output / name).read_bytes())
    content[len(content) // 2] ^= 1
    (output / name).write_bytes(content)
    with pytest.raises(InputError, match=re.escape(name)):
        logs.run("abc", output, update=True)
    assert bytes(content) == (output / name).read_bytes()
    (output / name).unlink()
    with pytest.raises(InputError, match=re.escape(name)):
        logs.run("abc", output, update=True)


def test_no_memory_for_rows_that_stay(logs: Logs, tmp_path: Path, monkeypatch) -> None:
    logs.run("a", tmp_path)

    def full(*_: object) -> Any:
        raise MemoryError

    monkeypatch.setattr(kept, "Tables", full)
    with pytest.raises(OutputError, match="no memory for its rows"):
        logs.run("ab", tmp_path, update=True)
    assert rows(tmp_path) == ["a"] * 10


def test_flags_that_exclude_each_other(tmp_path: Path) -> None:
    for more in ({"overwrite": True}, {"parts": str(tmp_path)}):
        with pytest.raises(ConfigError, match=f"--update with --{next(iter(more))}"):
            engine.RunOptions(tmp_path, update=True, **more)


def test_what_the_command_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "logs").mkdir()
    for name in "ab":
        write_log(tmp_path / "logs" / f"{name}.mcap", SimConfig(frames=2, width=160, height=120))
    (tmp_path / "logs" / "c.mcap").write_bytes(b"no log")
    run = ["run", str(tmp_path / "logs"), "--output", str(tmp_path / "out"), "--backend"]
    run += ["reference", "--pictures", "0"]
    (tmp_path / "logs" / "b.mcap").rename(tmp_path / "b.mcap")
    assert main(run) == 1
    capsys.readouterr()
    assert main(run) == 1
    said = capsys.readouterr().err
    assert "holds the results of this command already" in said
    assert said.endswith("jaxdet: --update does again what failed or was lost\n")
    (tmp_path / "b.mcap").rename(tmp_path / "logs" / "b.mcap")
    assert main(run) == 2
    said = capsys.readouterr().err
    assert "the log b was not among its logs; give another --output" in said
    assert said.endswith(
        "--overwrite to replace them; or --update to do new logs alone and keep the rest\n"
    )
    assert main([*run, "--update"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "b"
    assert re.fullmatch(r"1 log as before: 2 frames, \d+ obstacles", lines[-3])
    assert re.fullmatch(r"2 frames, \d+ obstacles in .* 1 of 3 logs failed", lines[-2])
    run[1] += "/a.mcap"
    assert main([*run, "--update"]) == 1
    said = capsys.readouterr().err
    assert "holds the results of this command already" in said and "--update does" not in said
    write_log(tmp_path / "logs" / "d.mcap", SimConfig(frames=3, width=160, height=120))
    assert main(["track", str(tmp_path / "out")]) == 0
    assert main([*run[:1], str(tmp_path / "logs" / "d.mcap"), *run[2:], "--update"]) == 1
    said = capsys.readouterr().err
    assert "jaxdet: tracks were of the old tables and are gone: jaxdet track makes" in said
    (tmp_path / "logs" / "c.mcap").unlink()
    capsys.readouterr()
    assert main(["run", str(tmp_path / "logs"), *run[2:], "--update"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("3 logs as before: 7 frames")
    assert re.fullmatch(r"nothing new in \d+\.\d s", lines[1])
