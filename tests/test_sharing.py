"""A run that several machines share: whoever does what, the bytes are those of one machine."""

import os
import shutil
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jaxdet import engine
from jaxdet.cli import main
from jaxdet.config import Config, GroundConfig
from jaxdet.engine import device, log_run, sharing, unit
from jaxdet.engine.part_store import PartStore
from jaxdet.engine.plan import UnitSizes
from jaxdet.errors import CamerasError, ConfigError, Interrupted, OutputError
from jaxdet.io import LogFiles, LogOptions, find_logs
from jaxdet.sim import SimConfig, write_log
from tests.s3_server import Objects, s3_server
from tests.test_engine import FakeLog
from tests.test_workers import Odd, same_results

FRAMES = 14


@pytest.fixture(autouse=True, scope="module")
def small_units() -> Iterator[None]:
    """And what was computed once is not computed again."""
    known: dict[Any, Any] = {}

    def remembered(frames: Any, config: Config, *, backend: str, with_cells: bool) -> Any:
        planes = tuple(np.asarray(part).tobytes() for part in frames.plane)
        key = frames.depth.tobytes(), planes, config, with_cells
        if key not in known:
            known[key] = detect(frames, config, backend=backend, with_cells=with_cells)
        return known[key]

    detect = device.detect
    with pytest.MonkeyPatch.context() as patch:
        for module in (sharing, log_run):
            patch.setattr(module, "SIZES", UnitSizes(4, 0, 4))
        patch.setattr(device, "detect", remembered)
        yield


@pytest.fixture(scope="module")
def sim_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two logs, of four units and of one."""
    folder = tmp_path_factory.mktemp("shared")
    for seed, frames in enumerate((FRAMES, 3)):
        config = SimConfig(frames=frames, width=64, height=48, seed=seed)
        write_log(folder / f"{'ab'[seed]}.mcap", config)
    return folder


@pytest.fixture(scope="module")
def whole(sim_logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one machine makes of them."""
    output = tmp_path_factory.mktemp("whole") / "out"
    run(sim_logs, output)
    return output


@pytest.fixture
def objects() -> Iterator[Objects]:
    with s3_server() as found:
        yield found


def run(logs: Path, output: Path, **options: Any) -> engine.Summary:
    own = {name: options.pop(name) for name in ("say", "progress") if name in options}
    config = Config(ground=GroundConfig(source="estimate", sample_frames=1))
    how = {"batch_size": 2, "pictures": 3, "workers": 1, **options}
    given = find_logs([str(logs)]), config, LogOptions()
    observers = {"odd": Odd()}
    made = engine.RunOptions(output, "reference", **how)
    return engine.run(*given, made, observers=observers, **own)


def joined(logs: Path, output: Path, parts: str) -> str:
    """Joins the parts there; what is said of it."""
    said: list[str] = []
    summary = run(logs, output, parts=parts, say=said.append)
    assert not summary.failed and summary.logs[0].observed["odd"][0] == 0
    return said[-1]


def parts_in(place: Path) -> list[Path]:
    return sorted(place.rglob("*.part"))


def test_shares_of_several_machines_are_joined(sim_logs, whole, tmp_path, monkeypatch):
    """Each has the logs in a folder of its own; one is interrupted. The last only joins."""
    place, done = tmp_path / "parts", []
    for number in (1, 2, 3):
        logs = tmp_path / f"machine {number}"
        shutil.copytree(sim_logs, logs, copy_function=shutil.copyfile)
        how = {"parts": str(place), "share": f"{number}/3"}
        if number == 3:
            stop = lambda now: now.done and signal.raise_signal(signal.SIGTERM)  # noqa: E731
            with pytest.raises(Interrupted, match="1 of 4 units of a are done"):
                run(logs, logs / "out", progress=stop, **how)
        said: list[str] = []
        run(logs, logs / "out", say=said.append, **how)
        assert said[-1] == (
            f"share {number}/3 is in {place}; without --share the command joins them when all "
            "are there"
        )
        assert not (logs / "out").exists()
        done.append(len(parts_in(place)))
    assert done == [2, 4, 5]
    logs = tmp_path / "machine 1"
    monkeypatch.setattr(log_run, "decide_planes", None)
    monkeypatch.setattr(
        log_run.LogWork, "work_through", lambda self, units, ahead: (unit for unit in units)
    )
    assert joined(logs, tmp_path / "out", str(place)) == f"5 units were in {place}"
    same_results(tmp_path / "out", whole)


def test_what_is_missing_or_damaged_is_done(sim_logs, whole, tmp_path):
    place = tmp_path / "parts"
    for share in ("1/2", "2/2"):
        run(sim_logs, tmp_path / "out", parts=str(place), share=share)
    first, second, third, *_ = parts_in(place)
    first.unlink()
    for path in (second, third.parent / "floors"):
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
    third.write_bytes(third.read_bytes()[:1000])
    assert joined(sim_logs, tmp_path / "out", place.as_uri()) == f"2 units were in {place.as_uri()}"
    same_results(tmp_path / "out", whole)


def test_parts_of_other_floors_are_not_taken(sim_logs, whole, tmp_path, monkeypatch):
    """They would come of a machine that computes otherwise."""
    place = tmp_path / "parts"
    with monkeypatch.context() as patch:
        decide = log_run.decide_planes

        def other(*given: Any, **how: Any) -> engine.Planes:
            planes = decide(*given, **how)
            return replace(planes, records=(replace(planes.records[0], height_m=0.3),))

        patch.setattr(log_run, "decide_planes", other)
        run(sim_logs, tmp_path / "out", parts=str(place), share="1/2")
    for path in place.rglob("floors"):
        path.unlink()
    assert joined(sim_logs, tmp_path / "out", str(place)) == f"0 units were in {place}"
    same_results(tmp_path / "out", whole)


def test_a_share_that_is_there_is_not_done_again(sim_logs, tmp_path):
    how: dict[str, Any] = {"parts": str(tmp_path / "parts"), "share": "1/1"}
    run(sim_logs, tmp_path / "out", **how)
    before = [path.stat().st_mtime_ns for path in parts_in(tmp_path / "parts")]
    doing: list[str] = []
    run(sim_logs, tmp_path / "out", progress=lambda now: doing.append(now.doing), **how)
    assert doing == ["opening", "opening"]
    assert [path.stat().st_mtime_ns for path in parts_in(tmp_path / "parts")] == before


def test_a_run_that_one_machine_began_alone(sim_logs, whole, tmp_path):
    """Its units are others; what it has not finished is left to all."""
    stop = lambda now: now.done and signal.raise_signal(signal.SIGINT)  # noqa: E731
    with pytest.raises(Interrupted):
        run(sim_logs, tmp_path / "out", progress=stop)
    said: list[str] = []
    run(sim_logs, tmp_path / "out", parts=str(tmp_path / "parts"), share="1/1", say=said.append)
    again = "a is done again: parts that machines share are of other frames"
    assert [text for text in said if "again" in text] == [again]
    assert joined(sim_logs, tmp_path / "out", str(tmp_path / "parts")).startswith("5 units")
    same_results(tmp_path / "out", whole)


def test_units_without_results_are_left_to_others(sim_logs, tmp_path, monkeypatch):
    def lost(part: Any) -> Any:
        return whole_part(part)._replace(lost="a, frames 0 to 3: worker_crashed (twice)")

    whole_part = unit._NewPart.whole
    with monkeypatch.context() as patch:
        patch.setattr(unit._NewPart, "whole", lost)
        said, how = [], {"parts": str(tmp_path / "parts"), "share": "1/4"}
        summary = run(sim_logs, tmp_path / "out", say=said.append, **how)
    assert summary.logs[0].lost == [f"a, frames 0 to 3: not in {tmp_path / 'parts'}"]
    assert not parts_in(tmp_path / "parts") and not said


def test_logs_of_several_cameras_and_scans(tmp_path, monkeypatch):
    """Frames of a log that is read as a whole may be others: their parts are kept apart."""
    opened: list[tuple[str, bool]] = []

    def open_log(files: Any, options: LogOptions, memory: Any) -> Any:
        if not options.camera:
            raise CamerasError(("front", "rear"))
        log = FakeLog()
        log.name, log.camera, log.label = files.name, options.camera, f"a, {options.camera}"
        opened.append((options.camera, options.scan))
        if options.camera == "rear" and not options.scan:
            monkeypatch.setattr(log, "batches", rescan, raising=False)
        return log

    def rescan(*_: Any, **how: Any) -> Any:
        raise log_run.RescanError("out of order", path="a.mcap")

    monkeypatch.setattr(log_run, "open_log", open_log)
    (tmp_path / "a.mcap").write_bytes(b"a log")
    logs = [LogFiles("a", (tmp_path / "a.mcap",))]
    config = Config(GroundConfig(source="none"))

    def go(name: str, **options: Any) -> engine.Summary:
        how = engine.RunOptions(tmp_path / name, "reference", 4, workers=1, **options)
        return engine.run(logs, config, LogOptions(), how)

    go("whole")
    for share in ("1/2", "2/2"):
        go("out", parts=str(tmp_path / "parts"), share=share)
    names = {path.parent.name for path in parts_in(tmp_path / "parts")}
    assert names == {"1", "2-scan"}
    opened.clear()
    go("out", parts=str(tmp_path / "parts"))
    assert opened == [("front", False), ("rear", False), ("rear", True)]
    same_results(tmp_path / "out", tmp_path / "whole")


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"parts": "", "share": None}, r"holds no parts of this run; do its shares first"),
        ({"parts": "x3://a/b"}, r"--parts x3://a/b: .*; give a folder, s3://BUCKET/PATH"),
        ({"parts": "s3:///a"}, r"--parts s3:///a: .*give a folder"),
        ({"parts": "s3://me:secret@b c/d"}, r"--parts s3://b c/d: .*URI: 's3://b c/d'"),
        ({"share": "0/2"}, r"--share 0/2 is no share; give one from 1/4 to 4/4"),
        ({"share": "3/2"}, r"--share 3/2 is no share"),
        ({"share": "1"}, r"--share 1 is no share"),
        ({"parts": None}, r"--share without a place for it; give --parts as well"),
    ],
)
def test_what_makes_no_sense(sim_logs, tmp_path, options, problem):
    how = {"parts": str(tmp_path / "parts"), "share": "1/2", **options}
    how["parts"] = str(tmp_path / "parts") if how["parts"] == "" else how["parts"]
    with pytest.raises(ConfigError, match=problem) as caught:
        run(sim_logs, tmp_path / "out", **how)
    assert "secret" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_bucket_that_cant_be_reached_is_no_bad_usage(sim_logs, tmp_path, monkeypatch):
    class Unreached:
        @staticmethod
        def from_uri(url: str) -> None:
            raise OSError(f"When resolving region for {url}: Could not resolve hostname")

    monkeypatch.setattr("pyarrow.fs.FileSystem", Unreached)
    said = (
        r"^s3://far/c: can't be used \(When resolving region for s3://far/c: Could.*check the addr"
    )
    with pytest.raises(OutputError, match=said):
        run(sim_logs, tmp_path / "out", parts="s3://me:secret@far/c", share="1/2")


def test_parts_of_another_run_are_refused(sim_logs, tmp_path):
    place = str(tmp_path / "parts")
    run(sim_logs, tmp_path / "out", parts=place, share="1/2")
    for share in ("2/2", None):
        text = r"parts: holds parts of another run: pictures was 3 and is 2 now; give another"
        with pytest.raises(ConfigError, match=text):
            run(sim_logs, tmp_path / "out", parts=place, share=share, pictures=2)
    for odd in (b"", b"[]", b'{"about": 3}', b"\xff"):
        (tmp_path / "odd" / "a").mkdir(parents=True, exist_ok=True)
        (tmp_path / "odd" / "mine.txt").touch()
        (tmp_path / "odd" / "a" / "run.json").write_bytes(odd)
        with pytest.raises(ConfigError, match=r"another run: |holds no parts of this run"):
            run(sim_logs, tmp_path / "out", parts=str(tmp_path / "odd"))
    logs = shutil.copytree(sim_logs, tmp_path / "logs")
    content = bytearray((logs / "a.mcap").read_bytes())
    content[9] ^= 1
    (logs / "a.mcap").write_bytes(content)
    with pytest.raises(ConfigError, match=r"another run: a\.mcap has changed"):
        run(logs, tmp_path / "out", parts=place, share="2/2")


def test_a_bucket(sim_logs, whole, tmp_path, objects):
    """By S3's protocol, from workers."""
    run(sim_logs, tmp_path / "out", parts=objects.url, share="1/1", workers=2)
    keys = [key for key in objects.puts if key.endswith(".part")]
    assert len(keys) == len(set(keys)) == 5 and keys[0].startswith("/bucket/some/place/")
    said = joined(sim_logs, tmp_path / "out", objects.url)
    assert said == "5 units were in s3://bucket/some/place"
    same_results(tmp_path / "out", whole)


def test_a_bucket_that_is_not_ours(sim_logs, tmp_path, objects):
    objects.refused = 403
    with pytest.raises(OutputError, match=r"can't be used \(.*; check the address") as caught:
        run(sim_logs, tmp_path / "out", parts=objects.url, share="1/2")
    assert "secret" not in str(caught.value) and not (tmp_path / "out").exists()
    objects.refused = 0

    def stop(now: engine.Progress) -> None:
        objects.refused = 403 * (now.done > 0)

    with pytest.raises(OutputError, match="the same command goes on: 0 of 2 logs and 2 of 4"):
        run(sim_logs, tmp_path / "out", parts=objects.url, share="1/1", progress=stop)
    objects.refused = 0
    run(sim_logs, tmp_path / "out", parts=objects.url, share="1/1")
    assert sum(key.endswith(".part") for key in objects.held) == 5


def test_a_place_is_written_to_whole_or_not(tmp_path, monkeypatch):
    store = PartStore(str(tmp_path / "a")).within("b")
    assert store.names() == set() and store.get("x") is None
    store.put("x", b"old")

    def broken(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", broken)
        with pytest.raises(OutputError, match=r"No space left.*give another --parts"):
            store.put("x", b"new")
    assert store.get("x") == b"old"
    store.put("x", b"new")
    assert store.get("x") == b"new"
    contents = [bytes([number]) * 300_000 for number in range(8)]
    with ThreadPoolExecutor(8) as machines:  # whose processes may have equal numbers
        for done in [machines.submit(store.put, "x", content) for content in contents * 3]:
            assert store.get("x") in [b"new", *contents]
            done.result()
    assert store.names() == {"x"}


def test_the_command(sim_logs, tmp_path, capsys):
    command = ["run", str(sim_logs), "--backend", "reference", "--pictures", "0", "--tracks"]
    command += ["--parts", str(tmp_path / "parts"), "--output"]
    assert main([*command, str(tmp_path / "1"), "--share", "1/1"]) == 0
    said = capsys.readouterr()
    assert not said.out and said.err.splitlines()[-1].startswith("jaxdet: share 1/1 is in ")
    assert main([*command, str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert f"jaxdet: 5 units were in {tmp_path / 'parts'}" in said.err
    assert "obstacles are in one" in said.out
    assert main([*command, str(tmp_path / "out"), "--share", "1/2"]) == 0
    assert "holds the results of this command already" in capsys.readouterr().err
