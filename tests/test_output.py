"""Output folder of runs: finished logs are kept, and results of other runs refused."""

import json
import os
import pickle
import shutil
import signal
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from jaxdet import engine
from jaxdet.engine import process_log, run_one, scheduler
from jaxdet.errors import ConfigError, Interrupted, JaxdetError, OutputError, ResultsError
from jaxdet.io import Batch, find_logs
from jaxdet.results import durable as publishing
from jaxdet.results.layout import log_folders
from jaxdet.results.names import log_name
from jaxdet.results.reading import open_results
from jaxdet.sim import SimConfig, write_log
from tests.pools import same_results
from tests.runs import run_logs

HOW = {"pictures": 1, "preset": "wheeled"}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of three logs of three frames, one of them in a folder of its own."""
    folder = tmp_path_factory.mktemp("logs")
    (folder / "Day 2").mkdir()
    for seed, name in enumerate(("a", "b", "Day 2/c")):
        write_log(folder / f"{name}.mcap", SimConfig(frames=3, width=96, height=72, seed=seed))
    return folder


@pytest.fixture(scope="module")
def done(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of :func:`logs`."""
    output = tmp_path_factory.mktemp("done") / "out"
    assert not run_logs(logs, output, **HOW).failed
    return output


@pytest.fixture
def copy(done: Path, tmp_path: Path) -> Path:
    return shutil.copytree(done, tmp_path / "copy")


@pytest.fixture
def own(logs: Path, tmp_path: Path) -> Path:
    """Return a copy of the logs that a test may change."""
    return shutil.copytree(logs, tmp_path / "logs")


def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list to which the names of processed logs are appended."""
    names: list[str] = []

    def process_log(settings: Any, log: Any, *given: Any, **how: Any) -> Any:
        names.append(log.name)
        return real(settings, log, *given, **how)

    real = scheduler.process_log
    monkeypatch.setattr(scheduler, "process_log", process_log)
    return names


def test_the_folder_of_a_log_is_named_after_its_path(done: Path) -> None:
    folder = log_name("Day 2/c")
    assert folder.startswith("Day_2--c~") and {path.name for path in done.iterdir()} == {
        *("run.json", "a", "b", folder)
    }
    names = {path.name for path in (done / "a").iterdir()}
    tables = {"frames.parquet", "obstacles.parquet"}
    files = {"summary.json", "config.json", "manifest.json", "map.npz", "map.png", "pictures"}
    assert names == tables | files
    with open_results(done) as results:
        assert [log.name for log in results.logs] == ["Day 2/c", "a", "b"]
        frames, obstacles = results.tables()
        assert frames.num_rows == 9 and obstacles.num_rows > 9
        with open_results(done / "b") as one:
            assert [log.name for log in one.logs] == ["b"]
            rows = one.tables().obstacles.num_rows
            assert rows == results.tables(results.log("b")).obstacles.num_rows > 0


def test_all_files_are_flushed_to_the_disk(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a power failure could leave empty files under their final names."""
    flushed, fsync = set(), os.fsync

    def recorded(file: int) -> None:
        fsync(file)
        flushed.add(os.fstat(file).st_ino)

    monkeypatch.setattr(os, "fsync", recorded)
    output = tmp_path / "out"
    assert not run_logs(logs / "a.mcap", output, **HOW).failed
    missing = {path for path in output.rglob("*") if path.stat().st_ino not in flushed}
    assert not missing and output.stat().st_ino in flushed


def test_results_of_a_log_do_not_depend_on_other_logs(logs: Path, done: Path, tmp_path: Path):
    record = run_one(str(logs / "b.mcap"), tmp_path / "one", {**HOW, "name": "b"})
    assert (record["status"], record["name"], record["frames"], record["error"]) == (
        "done",
        "b",
        3,
        None,
    )
    assert json.loads(json.dumps(record)) == record
    same_results(tmp_path / "one", done / "b")
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"no log")
    record = run_one(str(bad), tmp_path / "two", HOW)
    assert record["status"] == "failed" and "not an MCAP file" in record["error"]
    assert (tmp_path / "two" / "failed.json").is_file()
    assert not (tmp_path / "two" / "manifest.json").exists()


def test_repeating_the_command_runs_only_the_remaining_logs(
    logs: Path, done: Path, copy: Path, monkeypatch: pytest.MonkeyPatch
):
    names = made(monkeypatch)
    shutil.rmtree(copy / "b")
    summary = run_logs(logs, copy, **HOW)
    assert names == ["b"] and summary.kept == {"a", "Day 2/c"} and summary.frames == 9
    same_results(copy, done)
    run_logs(logs, copy, **HOW)
    assert names == ["b"] and not (copy / ".jaxdet").exists()


def test_further_logs_are_added_to_the_results(logs: Path, done: Path, tmp_path: Path) -> None:
    for name in ("b.mcap", "a.mcap"):
        run_logs(logs / name, tmp_path / "out", **HOW)
    run_logs(logs, tmp_path / "out", **HOW)
    same_results(tmp_path / "out", done)


def test_a_stopped_run_is_resumed(
    logs: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def stop(now: engine.Progress) -> None:
        if now.logs_done == 2:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(Interrupted, match="interrupted; 2 of 3 logs are done; the same command"):
        run_logs(logs, tmp_path / "out", progress=stop, **HOW)
    assert not (tmp_path / "out" / ".jaxdet").exists()
    names = made(monkeypatch)
    run_logs(logs, tmp_path / "out", **HOW)
    assert names == ["b"]
    same_results(tmp_path / "out", done)


@pytest.mark.parametrize("change", [{"pictures": 0}, {"map": False}, {"preset": None}])
def test_another_configuration_is_refused_with_the_reason(
    logs: Path, copy: Path, change: dict[str, Any]
):
    (name,) = change
    with pytest.raises(
        ResultsError, match=rf"but {name} was .* and is .* now; choose another --output"
    ):
        run_logs(logs, copy, **(HOW | change))
    with pytest.raises(ConfigError, match=r"holds Day.*, which is not among the logs"):
        run_logs(logs / "Day 2", copy, **(HOW | change), overwrite=True)


def test_overwriting_replaces_the_results_of_another_configuration(
    logs: Path, done: Path, copy: Path
):
    other = HOW | {"pictures": 0}
    run_logs(logs, copy, overwrite=True, **other)
    assert not [*copy.glob("*/pictures")]
    run_logs(logs, copy, overwrite=True, **HOW)
    same_results(copy, done)


def test_a_run_that_overwrites_is_resumed_after_a_stop(
    logs: Path, done: Path, copy: Path, monkeypatch: pytest.MonkeyPatch
):
    """Each log is run once, and readers see only results of the new configuration."""

    def stop(now: engine.Progress) -> None:
        if now.logs_done == 1:
            raise Interrupted(signal.SIGINT)

    other = HOW | {"pictures": 0}
    with pytest.raises(Interrupted, match="the same command without --overwrite goes on"):
        run_logs(logs, copy, overwrite=True, progress=stop, **other)
    with open_results(copy) as results:
        assert [log.name for log in results.logs] == ["Day 2/c"] and results.stale == ["a", "b"]
    with pytest.raises(ResultsError, match="but pictures was 0 and is 1 now"):
        run_logs(logs, copy, **HOW)
    names = made(monkeypatch)
    run_logs(logs, copy, **other)
    assert names == ["a", "b"] and not (copy / ".jaxdet").exists()
    run_logs(logs, copy, overwrite=True, **other)
    assert names[2:] == ["Day 2/c", "a", "b"]


def test_a_changed_log_is_refused_and_run_again_by_an_update(
    own: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    output = tmp_path / "out"
    run_logs(own, output, **HOW)
    write_log(own / "a.mcap", SimConfig(frames=2, width=96, height=72, seed=7))
    with pytest.raises(
        ResultsError, match=r"holds results of a, but the log has changed.*--update"
    ):
        run_logs(own, output, **HOW)
    names = made(monkeypatch)
    assert run_logs(own, output, update=True, **HOW).frames == 8
    assert names == ["a"]
    assert run_logs(own, output, update=True, **HOW).kept == {"a", "b", "Day 2/c"}
    (own / "a.mcap").write_bytes(b"torn")
    assert len(run_logs(own, output, update=True, **HOW).failed) == 1
    with open_results(output) as results:  # the results of the original log are kept
        assert len(results.logs) == 3


def test_a_failed_log_is_run_again_only_by_an_update(
    own: Path, logs: Path, done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    output = tmp_path / "out"
    (own / "b.mcap").write_bytes(b"no log")
    assert [log.log for log in run_logs(own, output, **HOW).failed] == ["b"]
    record = json.loads((output / "b" / "failed.json").read_text("utf-8"))
    assert record["attempts"] == 1 and "not an MCAP file" in record["reason"]
    names = made(monkeypatch)
    assert [log.log for log in run_logs(own, output, **HOW).failed] == ["b"] and not names
    run_logs(own, output, update=True, **HOW)
    record = json.loads((output / "b" / "failed.json").read_text("utf-8"))
    assert record["attempts"] == 2 and names == ["b"]
    with open_results(output) as results:
        assert [(one.log, "MCAP" in one.reason) for one in results.failed] == [("b", True)]
    shutil.copy2(logs / "b.mcap", own / "b.mcap")
    assert not run_logs(own, output, update=True, **HOW).failed
    assert not (output / "b" / "failed.json").exists()


@pytest.mark.parametrize(
    ("now", "says"),
    [({"size": 1, "fingerprint": "0"}, "changed since the run began"), ({}, "can't be read any")],
)
def test_a_log_that_changes_or_cannot_be_read_when_it_is_opened_fails(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, now: dict[str, Any], says: str
):
    before, found = process_log.fingerprint, dict[Path, Any]()
    later = lambda path: now if path in found else found.setdefault(path, before(path))  # noqa: E731
    monkeypatch.setattr(process_log, "fingerprint", later)
    (failed,) = run_logs(logs / "a.mcap", tmp_path, **HOW).failed
    assert says in (failed.error or "")


class Odd:
    """Observer that fails."""

    def __call__(self, batch: Batch, found: Any) -> Any:
        raise ZeroDivisionError("by nothing")

    def summary(self, seen: Any) -> Any:
        return None


def test_an_internal_error_leaves_a_report(logs: Path, tmp_path: Path) -> None:
    summary = run_logs(logs / "a.mcap", tmp_path, observers={"odd": Odd()}, **HOW)
    assert (summary.failed[0].error or "").endswith("please send its developers a/report.txt")
    text = (tmp_path / "a" / "report.txt").read_text("utf-8")
    assert 'raise ZeroDivisionError("by nothing")' in text


def test_folders_that_are_not_results_are_refused_before_the_run(
    logs: Path, done: Path, tmp_path: Path
):
    output = tmp_path / "out"
    (output / "b").mkdir(parents=True)
    (output / "b" / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="b: was not written by a run; move it"):
        run_logs(logs, output, **HOW)
    assert not (output / "a").exists()
    shutil.rmtree(output)
    shutil.copytree(done, output)
    (output / "a" / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match=r"mine.txt: is not a file of the results"):
        run_logs(logs, output, overwrite=True, **HOW)
    with pytest.raises(ConfigError, match="holds results of an older version, or of one log"):
        run_logs(logs, output / "b", **HOW)
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="is a file"):
        run_logs(logs, tmp_path / "file", **HOW)


def test_two_logs_with_one_name_are_refused(logs: Path, tmp_path: Path) -> None:
    shutil.copy(logs / "a.mcap", tmp_path)
    with pytest.raises(ConfigError, match=r"a.mcap: has the name of .*name the folder that both"):
        run_logs([logs / "a.mcap", tmp_path / "a.mcap"], tmp_path / "out", **HOW)
    (log,) = find_logs([str(tmp_path / "a.mcap")])
    with pytest.raises(ConfigError, match=r"a.mcap: has the name of .*a.mcap"):
        run_logs([log, log], tmp_path / "out", **HOW)
    run_logs([tmp_path / "a.mcap"], tmp_path / "out", **HOW)


def test_code_in_received_results_is_never_executed(copy: Path, logs: Path, tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self) -> Any:
            return os.mkdir, (str(tmp_path / "evil"),)

    for place in (copy / ".jaxdet", copy / "a"):
        place.mkdir(exist_ok=True)
        for name in ("commit", "plan", "overwrite", "lock", "whole", "rows.arrow"):
            (place / name).write_bytes(pickle.dumps(Evil()))
    from jaxdet.tracks import track_results
    from jaxdet.verify import verify

    for use in (track_results, verify, lambda folder: run_logs(logs, folder, **HOW)):
        with suppress(JaxdetError):
            use(copy)
    assert not (tmp_path / "evil").exists()


def test_a_runner_keeps_its_processes_between_runs(logs: Path, tmp_path: Path) -> None:
    with engine.Runner(backend="reference", workers=2) as one:
        first = one.run(logs / "a.mcap", tmp_path / "out", preset="wheeled")
        assert one._pool.started
        workers = [worker.process.pid for worker in one._pool._workers]
        second = one.run(logs, tmp_path / "out", preset="wheeled")
        assert workers == [worker.process.pid for worker in one._pool._workers]
    assert not first.failed and not second.failed and second.kept == {"a"}


def test_options_of_a_runner_are_the_defaults_of_its_runs(logs: Path, tmp_path: Path) -> None:
    with engine.Runner(backend="reference", pictures=0) as one:
        assert not one.run(logs / "a.mcap", tmp_path / "none").logs[0].pictures
        assert len(one.run(logs / "a.mcap", tmp_path / "two", pictures=2).logs[0].pictures) == 2
        with pytest.raises(ConfigError, match="computes with reference, not jax"):
            one.run(logs / "a.mcap", tmp_path / "jax", backend="jax")
    assert not (tmp_path / "jax").exists()


@pytest.mark.parametrize("exchanged", [True, False])
def test_a_folder_is_replaced_atomically(
    logs: Path, done: Path, copy: Path, monkeypatch: pytest.MonkeyPatch, exchanged: bool
):
    if not exchanged:
        monkeypatch.setattr(publishing, "exchange", lambda one, other: False)
    run_logs(logs, copy, overwrite=True, **HOW)
    same_results(copy, done)
    assert not (copy / ".jaxdet").exists()


def test_a_folder_whose_replacement_was_interrupted_is_read_and_moved(
    logs: Path, done: Path, copy: Path, monkeypatch: pytest.MonkeyPatch
):
    """The file system cannot exchange folders, and the process ends during the replacement."""

    def broken(staged: Path, place: Path) -> bool:
        if not place.exists():
            raise OSError(5, "Input/output error")
        return False

    monkeypatch.setattr(publishing, "exchange", lambda one, other: False)
    with monkeypatch.context() as patch:
        patch.setattr(publishing, "rename_if_absent", broken)
        with pytest.raises(OutputError, match="Input/output error"):
            run_logs(logs, copy, overwrite=True, **(HOW | {"pictures": 0}))
    aside = log_folders(copy)[log_name("Day 2/c")]
    assert aside.parent.parent == copy / ".jaxdet"
    with open_results(aside) as results:
        assert results.tables().frames.num_rows == 3
    with open_results(copy) as results:
        assert len(results.stale) == 3
    publishing.finish(copy)
    assert log_folders(copy)[log_name("Day 2/c")] == copy / log_name("Day 2/c")
    run_logs(logs, copy, overwrite=True, **(HOW | {"pictures": 0}))
    assert not (copy / ".jaxdet").exists() and not [*copy.glob("*/pictures")]
    with open_results(copy) as results:
        assert len(results.logs) == 3 and not results.stale
