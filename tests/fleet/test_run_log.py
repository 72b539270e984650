"""Runs of logs from folders and buckets to folders and buckets, with the stub of the engine."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import jaxdet
from jaxdet.engine import Progress
from jaxdet.errors import ConfigError, Interrupted, OutputError
from jaxdet.fleet import list_logs, prepare, result_files, run_fleet, run_log, run_logs, spool
from jaxdet.fleet import place as places
from jaxdet.fleet.command import _of_a_node, _resources, _slots, chunks
from jaxdet.fleet.place import Bucket, is_url, open_place
from jaxdet.sim import SimConfig, write_log
from tests.fleet.stub import check_complete, check_results, computed

LOGS, RESULTS = "s3://bucket/logs", "s3://bucket/results"


def states(outcomes):
    return {outcome["name"]: outcome["state"] for outcome in outcomes}


def left(how) -> list[str]:
    """Return the files left on the local disk."""
    base = spool.base_folder(how["spool"])
    return sorted(path.name for path in base.iterdir()) if base.exists() else []


def test_each_log_is_run_once(stores, engine, how, put, tmp_path):
    put(LOGS, a="a", b="b", c="fail", d="bug")
    outcomes = run_fleet([LOGS], RESULTS, how)
    assert states(outcomes) == {"a": "done", "b": "done", "c": "failed", "d": "failed"}
    assert json.loads(json.dumps(outcomes)) == outcomes
    assert [o["error"] for o in outcomes[2:]] == [
        "no depth",
        "an error in jaxdet itself (KeyError: 'bug')",
    ]
    tables = {name: check_results(RESULTS, name, tmp_path) for name in "ab"}
    assert len({*tables.values()}) == 2
    again = run_fleet([LOGS], RESULTS, how)
    assert states(again) == {"a": "there", "b": "there", "c": "failed", "d": "failed"}
    assert computed(engine) == ["a", "b", "c", "d"]
    assert [url.split("/")[4] for url in result_files(RESULTS)] == ["a", "b"]
    assert left(how) == []
    assert not [e.key for e in open_place(RESULTS).list() if "attempts" in e.key]


def test_a_disk_that_fails_does_not_count_as_a_death(engine, how, put, tmp_path):
    put(str(tmp_path / "logs"), a="a")
    log, staged = list_logs(tmp_path / "logs")[0], tmp_path / "results/.fleet/staged"
    ready = prepare(tmp_path / "results", how)
    staged.write_text("not a folder", encoding="utf-8")
    with pytest.raises(OutputError):
        run_log(log, tmp_path / "results", ready)
    assert not [*(staged.parent / "a/attempts").glob("*/*")]
    staged.unlink()
    assert run_log(log, tmp_path / "results", ready)["state"] == "done"


def test_update_runs_failed_and_changed_logs_again(stores, engine, how, put, tmp_path):
    put(LOGS, a="a", b="b", c="fail")
    run_fleet([LOGS], RESULTS, how)
    put(LOGS, b="other")
    first = states(run_fleet([LOGS], RESULTS, how))
    assert first == {"a": "there", "b": "failed", "c": "failed"}
    old = check_results(RESULTS, "b", tmp_path)
    second = states(run_fleet([LOGS], RESULTS, {**how, "update": True}))
    assert second == {"a": "there", "b": "done", "c": "failed"}
    assert check_results(RESULTS, "b", tmp_path) != old
    assert computed(engine) == ["a", "b", "b", "c", "c"]
    kept = {e.key.split("/")[1] for e in open_place(RESULTS).list("b")}
    assert len(kept) == 2  # current.json and one attempt


@pytest.fixture(params=["bucket", "folder"])
def results(request, tmp_path):
    """Return the address of results in a bucket or a folder."""
    return RESULTS if request.param == "bucket" else str(tmp_path / "results")


def table(results: str, tmp_path: Path) -> str:
    """Assert that the results of log a are complete; return its table."""
    if is_url(results):
        return check_results(results, "a", tmp_path)
    assert not (Path(results) / "a/failed.json").exists()
    return check_complete(Path(results) / "a")


@pytest.mark.parametrize("changed", [True, False])
def test_results_are_kept_if_an_update_fails(changed, results, stores, engine, how, put, tmp_path):
    put(LOGS, a="lose fail=1")
    assert run_fleet([LOGS], results, how)[0]["lost"] == ["frame 1"]
    old = table(results, tmp_path)
    if changed:
        put(LOGS, a="fail")
        (outcome,) = run_fleet([LOGS], results, how)
        assert "another input; --update" in outcome["error"]
    update = {**how, "update": True}
    for runs in (2, 3):  # each update tries the log again
        (outcome,) = run_fleet([LOGS], results, update)
        assert (outcome["state"], outcome["error"]) == ("failed", "no depth")
        assert table(results, tmp_path) == old and len(computed(engine)) == runs
    ready = prepare(results, update)
    for _ in range(2):  # a scheduler repeats a call
        assert run_log(list_logs(LOGS)[0], results, ready)["state"] == "failed"
    assert len(computed(engine)) == 4
    put(LOGS, a="better")
    assert states(run_fleet([LOGS], results, update)) == {"a": "done"}
    assert table(results, tmp_path) != old


def test_a_camera_that_failed_does_not_fail_the_log(results, stores, engine, how, put, tmp_path):
    put(LOGS, a="rear")
    update = {**how, "update": True}
    for given, state in ((how, "done"), (how, "there"), (update, "done")):
        (outcome,) = run_fleet([LOGS], results, given)
        assert (outcome["state"], outcome["frames"]) == (state, 3)
        assert outcome["error"] == "s3://bucket/logs/a.mcap: rear camera: no depth"
        assert table(results, tmp_path)


def test_the_report_of_a_crash_is_published_and_attempts_are_counted(
    results, stores, engine, how, put
):
    put(LOGS, a="crash")
    for given in (how, how, {**how, "update": True}):
        (outcome,) = run_fleet([LOGS], results, given)
        assert (outcome["state"], outcome["error"]) == ("failed", "send a/report.txt")
    place = open_place(results)
    assert place.get("a/report.txt")[0] == b"traceback"
    found = place.get("a/current.json" if is_url(results) else "a/failed.json")
    content = json.loads(found[0])
    assert content.get("failure", content)["attempts"] == 2
    put(LOGS, a="a")
    assert states(run_fleet([LOGS], results, {**how, "update": True})) == {"a": "done"}
    assert place.get("a/report.txt") is None


def test_lost_frames_are_reported_again_until_an_update(results, stores, engine, how, put):
    put(LOGS, a="lose")
    given = [how, how, {**how, "update": True}, how]
    found = [run_fleet([LOGS], results, each)[0] for each in given]
    assert [one["state"] for one in found] == ["done", "there", "done", "there"]
    assert [one["lost"] for one in found] == [["frame 1"], ["frame 1"], [], []]
    assert computed(engine) == ["a", "a"]


def test_another_configuration_is_refused_unless_results_are_overwritten(
    results, stores, engine, how, put, tmp_path
):
    put(LOGS, a="a", b="b")
    run_fleet([LOGS], results, how)
    other = {**how, "config": {"ground": {"step_height_m": 0.05}}}
    with pytest.raises(ConfigError, match=r"ground\.step_height_m was 0\.03 and is 0\.05 now"):
        run_fleet([LOGS], results, other)
    old = table(results, tmp_path)
    begun = prepare(results, {**other, "overwrite": True})
    (log, rest) = list_logs(LOGS)
    assert run_log(log, results, begun)["state"] == "done"  # the run is killed here
    assert table(results, tmp_path) != old
    with pytest.raises(ConfigError):
        run_fleet([LOGS], results, how)
    assert [Path(url).relative_to(Path(results)).parts[0] for url in result_files(results)] == ["a"]
    assert states(run_fleet([LOGS], results, other)) == {"a": "there", "b": "done"}
    late = prepare(results, other)
    again = run_fleet([LOGS], results, {**other, "overwrite": True})
    assert states(again) == {"a": "done", "b": "done"}
    with pytest.raises(ConfigError, match="this machine"):
        run_log(rest, results, {**late, "overwrites": "else"})


def test_a_log_replaced_while_it_is_fetched_fails_without_a_record(
    stores, engine, how, put, monkeypatch
):
    put(LOGS, a="a" * 1000)
    monkeypatch.setattr(places, "RANGE_BYTES", 100)
    monkeypatch.setattr(places, "CONNECTIONS", 1)
    reached = Bucket._range

    def late(self, entry, start, file, stop):
        if start == 500:
            put(LOGS, a="b" * 1000)
        reached(self, entry, start, file, stop)

    monkeypatch.setattr(Bucket, "_range", late)
    (outcome,) = run_fleet([LOGS], RESULTS, how)
    assert outcome["state"] == "failed" and "replaced while" in outcome["error"]
    assert computed(engine) == [] and left(how) == []
    monkeypatch.setattr(Bucket, "_range", reached)
    assert states(run_fleet([LOGS], RESULTS, how)) == {"a": "done"}


def test_an_interrupted_upload_is_not_published(stores, engine, how, put, monkeypatch, tmp_path):
    put(LOGS, a="a")
    real = Bucket.put

    def cut(self, key, content):
        if "summary" in key:
            raise OutputError("can't be used (connection reset)", path=key)
        real(self, key, content)

    monkeypatch.setattr(Bucket, "put", cut)
    with pytest.raises(OutputError):
        run_fleet([LOGS], RESULTS, how)
    assert result_files(RESULTS) == [] and left(how) == []
    monkeypatch.setattr(Bucket, "put", real)
    assert states(run_fleet([LOGS], RESULTS, how)) == {"a": "done"}
    check_results(RESULTS, "a", tmp_path)


def test_splits_of_a_recording_are_fetched_together(stores, engine, how, tmp_path):
    place = open_place(LOGS)
    place.put("r/r_0.mcap", b"0")
    place.put("r/r_1.mcap", b"1")
    place.put("r/metadata.yaml", b"  relative_file_paths:\n  - r_0.mcap\n  - r_1.mcap\n")
    assert states(run_fleet([LOGS], RESULTS, how)) == {"r--r": "done"}
    check_results(RESULTS, "r--r", tmp_path)


@pytest.mark.parametrize(
    "key", ['a "b"/c\\d/x.mcap', "zero\u200bwidth/x.mcap", "n" * 300 + ".mcap"]
)
def test_odd_keys_of_logs_are_no_crash(key, stores, engine, how):
    open_place(LOGS).put(key, b"crash")
    (outcome,) = run_fleet([LOGS], RESULTS, how)
    assert outcome["state"] == "failed" and outcome["log"].isprintable()
    assert run_fleet([LOGS], RESULTS, how)[0]["error"] == outcome["error"]


def test_a_spool_folder_of_another_user_is_refused(stores, engine, how, put, tmp_path):
    put(LOGS, a="a")
    (tmp_path / "other").mkdir()
    base = tmp_path / f"jaxdet-spool-{os.getuid()}"
    base.symlink_to(tmp_path / "other")
    with pytest.raises(ConfigError, match="is a link, or belongs to another user"):
        run_fleet([LOGS], RESULTS, {**how, "spool": str(tmp_path)})


def test_the_next_log_is_fetched_during_a_run_within_the_limit_of_the_spool(
    stores, engine, how, put, monkeypatch
):
    put(LOGS, a="a" * 1000, b="sleep=0.5 " + "x" * 890, c="c" * 100, d="d" * 5000)
    held = []
    real = Bucket.fetch

    def fetch(self, entry, path, stop):
        real(self, entry, path, stop)
        files = spool.base_folder(how["spool"]).rglob("*.mcap")
        held.append(sum(path.stat().st_size for path in files))

    monkeypatch.setattr(Bucket, "fetch", fetch)
    outcomes = [*run_logs(list_logs(LOGS), RESULTS, {**how, "spool_size": 1500})]
    assert states(outcomes) == {"a": "done", "b": "done", "c": "done", "d": "failed"}
    assert "5000 bytes" in outcomes[3]["error"] and "--spool-size" in outcomes[3]["error"]
    assert max(held) <= 1500 and held == [1000, 900, 1000]


def test_files_of_a_killed_process_are_removed_and_counted(stores, engine, how, put):
    put(LOGS, a="a")
    (log,) = list_logs(LOGS)
    ready = prepare(RESULTS, how)
    run_log(log, RESULTS, ready)
    base = spool.base_folder(how["spool"])
    dead, far = base / f"{spool.machine()}-1-0-aaaa", base / "elsewhere-1-0-aaaa"
    for folder in (dead, far, base / f"{spool.process()}-aaaa"):
        folder.mkdir(parents=True)
    key = "b/v/attempts/x"
    open_place(RESULTS).put(key, b'{"process": "elsewhere-1-0", "time": 0}')
    (dead / "attempt.json").write_text(json.dumps({"url": RESULTS, "key": key}))
    assert spool.sweep(how["spool"]) == 1
    assert len(left(how)) == 2
    assert json.loads(open_place(RESULTS).get(key)[0])["killed"]


def test_logs_and_results_may_be_in_folders(engine, how, tmp_path):
    logs, results = tmp_path / "logs", tmp_path / "results"
    logs.mkdir()
    for name, text in {"a": "a", "b": "b", "c": "fail"}.items():
        (logs / f"{name}.mcap").write_text(text)
    shares = [run_fleet([logs], results, how, share=f"{k}/3") for k in (1, 2, 3)]
    found = {name: state for share in shares for name, state in states(share).items()}
    assert found == {"a": "done", "b": "done", "c": "failed"}
    assert sum(map(len, shares)) == 3
    for name in "ab":
        assert check_complete(results / name)
    assert json.loads((results / "c/failed.json").read_text())["reason"] == "no depth"
    assert states(run_fleet([logs], results, how))["a"] == "there"
    (logs / "a.mcap").write_text("changed")
    assert states(run_fleet([logs], results, how))["a"] == "failed"
    updated = states(run_fleet([logs], results, {**how, "update": True}))
    assert updated == {"a": "done", "b": "there", "c": "failed"}
    assert computed(engine) == ["a", "a", "b", "c", "c"]
    with pytest.raises(ConfigError, match="--share"):
        run_fleet([logs], results, {**how, "overwrite": True}, share="1/3")
    assert states(run_fleet([logs], results, {**how, "overwrite": True}))["b"] == "done"
    assert {path.name for path in results.iterdir()} == {"a", "b", "c", "run.json", ".fleet"}


def test_an_interrupted_local_run_keeps_the_run_json_of_simultaneous_shares(tmp_path):
    log, results = tmp_path / "a.mcap", tmp_path / "results"
    write_log(log, SimConfig(frames=2, width=96, height=72))
    how = {"pictures": 0, "preset": "wheeled", "spool": str(tmp_path)}
    ready = prepare(str(results), how)  # a share has begun

    def stop(_: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        jaxdet.run(log, results, pictures=0, progress=stop)
    assert run_log(list_logs(log)[0], str(results), ready)["state"] == "done"
    assert len(jaxdet.open_results(results).logs) == 1


KILLED = """
import sys
from jaxdet.signals import guard_process
from tests.fleet.stub import install
guard_process()
install()
from jaxdet.fleet import run_fleet
how = {"spool": sys.argv[3], "update": "--update" in sys.argv}
for outcome in run_fleet([sys.argv[1]], sys.argv[2], how):
    print(outcome["name"], outcome["state"], outcome["error"])
"""


def test_a_log_that_kills_three_processes_is_recorded_as_failed(engine, how, tmp_path):
    logs, results = tmp_path / "logs", tmp_path / "results"
    logs.mkdir()
    (logs / "a.mcap").write_text("kill=9 " + "x" * 100)
    (logs / "b.mcap").write_text("b")
    command = [sys.executable, "-c", KILLED, str(logs), str(results), how["spool"]]
    codes = [subprocess.run(command, check=False).returncode for _ in range(3)]
    assert codes == [-9, -9, -9]
    run = subprocess.run(command, check=True, capture_output=True, text=True)
    assert run.stdout == "a failed 3 processes that worked on it died\nb done None\n"
    failure = json.loads((results / "a/failed.json").read_text())
    assert failure["attempts"] == 3
    assert computed(engine, "a") == ["a"] * 3 and left(how) == []
    assert os.listdir(results / ".fleet/staged") == []


def test_an_attempt_that_a_signal_ends_does_not_count_as_killed(engine, how, tmp_path):
    """The guard ends the process, as a signal can't interrupt the stub."""
    logs, results = tmp_path / "logs", tmp_path / "results"
    logs.mkdir()
    (logs / "a.mcap").write_text("sleep=60")
    command = [sys.executable, "-c", KILLED, str(logs), str(results), how["spool"]]
    with subprocess.Popen(command) as run:
        while not computed(engine):
            time.sleep(0.05)
        run.terminate()
    assert run.returncode == 128 + signal.SIGTERM
    assert [*(results / ".fleet").glob("a/attempts/*")]
    assert not [*(results / ".fleet").glob("a/attempts/*/*")]


def test_results_are_kept_if_the_changed_log_kills_three_processes(engine, how, tmp_path):
    logs, results = tmp_path / "logs", tmp_path / "results"
    logs.mkdir()
    (logs / "a.mcap").write_text("a")
    command = [sys.executable, "-c", KILLED, str(logs), str(results), how["spool"], "--update"]
    ends = []
    for text in (None, *["kill=9"] * 5):
        (logs / "a.mcap").write_text(text or "a")
        os.utime(logs / "a.mcap", (1, 1))
        run = subprocess.run(command, check=False, capture_output=True, text=True)
        ends.append(run.stdout.strip() or run.returncode)
    assert ends[:4] == ["a done None", -9, -9, -9]
    assert ends[4:] == ["a failed 3 processes that worked on it died", -9]
    assert check_complete(results / "a")


def test_credentials_are_never_written_or_printed(stores, engine, how, put, monkeypatch, capfd):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "topsecretvalue")
    put(LOGS, a="a", b="fail")
    with pytest.raises(ConfigError) as raised:
        run_fleet(["s3://AKID:topsecretvalue@bucket/logs"], RESULTS, how)
    outcomes = run_fleet([LOGS], RESULTS, how)
    place = open_place(RESULTS)
    texts = [place.get(entry.key)[0].decode(errors="replace") for entry in place.list()]
    texts += [str(raised.value), json.dumps(outcomes), *capfd.readouterr()]
    assert not [text for text in texts if "topsecretvalue" in text]


def test_the_largest_logs_are_first_and_a_task_has_few_logs():
    logs = [{"name": f"{i:03}", "files": [{"size": i}]} for i in range(100)]
    found = chunks(logs, 2)
    assert sorted(log["name"] for chunk in found for log in chunk) == [log["name"] for log in logs]
    assert found[0] == [logs[99]] and max(map(len, found)) <= 8
    assert sum(map(len, chunks(logs[:1], 0))) == 1 and chunks([], 2) == []


def test_tasks_request_the_resources_of_the_smallest_node():
    nodes = [
        {"Alive": True, "Resources": {}},
        {"Alive": True, "Resources": {"CPU": 8.0}},
        {"Alive": False, "Resources": {"CPU": 2.0}},
        {"Alive": True, "Resources": {"CPU": 4.0}},
    ]
    assert _of_a_node(nodes) == {"num_cpus": 4.0, "num_gpus": 0.0}
    nodes.append({"Alive": True, "Resources": {"CPU": 16.0, "GPU": 2.0}})
    assert _of_a_node(nodes) == {"num_cpus": 16.0, "num_gpus": 2.0}
    slots = [_slots(nodes, {"num_cpus": cpus}) for cpus in (1, 4, 5, 17)]
    assert slots == [28, 7, 4, 0] and _slots(nodes, {"num_cpus": 8, "num_gpus": 1}) == 2
    assert _resources("ray") == {}
    assert _resources("ray:num_cpus=16,num_gpus=1") == {"num_cpus": 16.0, "num_gpus": 1.0}
    wrong = (
        "dask ray:x=1 ray:num_cpus ray:num_cpus=a ray:num_cpus=0 ray:num_gpus=-1 ray:num_cpus=nan"
    )
    for where in wrong.split():
        with pytest.raises(ConfigError):
            _resources(where)


def test_a_log_missing_on_this_machine_is_not_recorded_as_failed(engine, how, tmp_path):
    log = tmp_path / "a.mcap"
    log.write_text("a")
    logs = list_logs(log)
    log.rename(tmp_path / "b.mcap")
    outcome = run_log(logs[0], str(tmp_path / "results"), how)
    assert outcome["state"] == "failed" and "not on this machine" in outcome["error"]
    (tmp_path / "b.mcap").rename(log)
    assert run_log(logs[0], str(tmp_path / "results"), how)["state"] == "done"


def test_local_logs_are_not_copied(engine, how, tmp_path):
    log = Path(tmp_path / "a.mcap")
    log.write_text("a")
    (outcome,) = run_fleet([log], tmp_path / "results", how)
    assert outcome["state"] == "done" and left(how) == []
