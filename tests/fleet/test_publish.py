"""Publishing of results: crashes at every step, races, replaced versions."""

import json
import threading
from pathlib import Path

import pytest

from jaxdet.errors import InputError
from jaxdet.fleet import download, publish, result_files, spool
from jaxdet.fleet.place import Bucket, Folder, input_entry
from jaxdet.fleet.publish import BucketResults, Target, open_results, version_of
from jaxdet.results import durable as folders
from jaxdet.results.layout import log_folders
from tests.fleet.stub import check_complete, check_results, run_one

WRITES = ("put", "create", "swap", "delete")


@pytest.fixture(
    params=["bucket", "folder", "no_exchange", pytest.param("s3", marks=pytest.mark.fleet)]
)
def url(request, tmp_path, monkeypatch):
    """Return the address of results: a folder with or without atomic exchange, or a bucket."""
    if request.param == "no_exchange":
        monkeypatch.setattr(folders, "exchange", lambda one, other: False)
    if request.param in ("folder", "no_exchange"):
        return str(tmp_path / "results")
    if request.param == "s3":
        return request.getfixturevalue("bucket") + "/results"
    request.getfixturevalue("stores")
    return "s3://bucket/results"


def about(record: str) -> dict:
    """Return the part of a manifest about the log and the run."""
    return {"run": record, "inputs": [{"path": "log.mcap", "size": 3, "e_tag": record}]}


def target_of(record: str) -> Target:
    inputs = map(input_entry, about(record)["inputs"])
    return Target("log", version_of(record, inputs), record)


def stage(results, tmp_path: Path, attempt: str, record: str = "r1") -> Path:
    """Return a folder with the results of an attempt."""
    log = tmp_path / f"{attempt}.mcap"
    log.write_text(record)
    staged = results.stage(attempt, tmp_path / attempt)
    run_one([log], staged, {"name": "log", "about": about(record)})
    return staged


def table(url: str, tmp_path: Path) -> str:
    """Assert that the results agree with their manifest; return the table."""
    if url.startswith("s3:"):
        return check_results(url, "log", tmp_path)
    return check_complete(log_folders(Path(url))["log"])


class Death(BaseException):
    pass


def die_at(monkeypatch, step: int, before: bool) -> list[str]:
    """Make the process die before or after its ``step``-th write; return the list of writes."""
    seen: list[str] = []
    places = [(kind, name) for kind in (Bucket, Folder) for name in WRITES]
    for where, name in [*places, (folders, "rename_if_absent"), (folders, "exchange")]:
        real = getattr(where, name)

        def write(*args, real=real, name=name):
            seen.append(name)
            if len(seen) >= step and before:
                raise Death
            result = real(*args)
            if len(seen) >= step:
                raise Death
            return result

        monkeypatch.setattr(where, name, write)
    return seen


@pytest.mark.parametrize("before", [True, False])
@pytest.mark.parametrize("old", [False, True])
def test_a_crash_at_any_step_leaves_old_or_new_results(url, tmp_path, monkeypatch, old, before):
    steps = 0
    while _dies(f"{url}/{steps}", tmp_path / f"{steps}", monkeypatch, steps + 1, old, before):
        steps += 1
    assert steps >= (6 if url.startswith("s3:") else 1)


def _dies(url, tmp_path, monkeypatch, step, old, before) -> bool:
    """End publishing at a step and repeat it; return whether publishing has that step."""
    tmp_path.mkdir()
    results = open_results(url)
    target = target_of("r2")
    tables = []
    if old:
        first = target_of("r1")
        staged = stage(results, tmp_path, "a0", "r1")
        assert results.publish(first, "a0", staged, results.standing(first)) == "done"
        tables.append(table(url, tmp_path))
    seen = results.standing(target)
    assert seen.state == ("other" if old else "new")
    staged = stage(results, tmp_path, "a1", "r2")
    with monkeypatch.context() as patched:
        die_at(patched, step, before)
        try:
            results.publish(target, "a1", staged, seen)
            return False
        except Death:
            pass
    if old or result_files(url):
        assert table(url, tmp_path)
    seen = results.standing(target)
    if seen.state != "whole":
        staged = stage(results, tmp_path, "a2", "r2")
        assert results.publish(target, "a2", staged, seen) in ("done", "there")
    assert results.standing(target).state == "whole"
    assert table(url, tmp_path) not in tables and len(result_files(url)) == 1
    return True


def test_one_of_four_simultaneous_attempts_is_published(url, tmp_path):
    results = open_results(url)
    target = target_of("r1")
    staged = [stage(results, tmp_path, f"a{i}") for i in range(4)]
    seen = results.standing(target)
    gate, found = threading.Barrier(4), []

    def attempt(number: int) -> None:
        gate.wait()
        found.append(results.publish(target, f"a{number}", staged[number], seen))

    threads = [threading.Thread(target=attempt, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(found) == ["done", "there", "there", "there"]
    assert table(url, tmp_path)
    assert not any(path.exists() for path in staged if not url.startswith("s3:"))
    if isinstance(results, publish.BucketResults):
        kept = {entry.key.split("/")[1] for entry in results.place.list("log")}
        assert len(kept) == 2  # current.json and one attempt


def test_a_late_attempt_does_not_replace_a_newer_version(url, tmp_path):
    results = open_results(url)
    old, new = target_of("r1"), target_of("r2")
    late = results.standing(old)
    staged = stage(results, tmp_path, "a0", "r1")
    fresh = stage(results, tmp_path, "a1", "r2")
    assert results.publish(new, "a1", fresh, results.standing(new)) == "done"
    before = table(url, tmp_path)
    assert results.publish(old, "a0", staged, late) == "replaced"
    assert table(url, tmp_path) == before
    results.fail(old, {"reason": "late", **about("r1")}, late)
    assert table(url, tmp_path) == before
    assert not [*results.place.list("log/a0")]


def test_downloads_do_not_write_outside_of_their_folder(stores, tmp_path):
    url = "s3://bucket/results"
    results, target = open_results(url), target_of("r1")
    staged = stage(results, tmp_path, "a0")
    manifest = json.loads((staged / "manifest.json").read_text())
    manifest["files"]["../outside"] = manifest["files"]["summary.json"]
    (staged / "manifest.json").write_text(json.dumps(manifest))
    results.publish(target, "a0", staged, results.standing(target))
    results.place.put("log/outside", b"secret")
    with pytest.raises(InputError, match=r"manifest.json: was changed"):
        download(url, "log", tmp_path / "copy")
    results.place.put("log/current.json", b"{")
    with pytest.raises(InputError, match=r"s3://bucket/results/log/current.json: is not JSON"):
        results.standing(target)


def test_a_failure_does_not_replace_results(url, tmp_path):
    results = open_results(url)
    target = target_of("r1")
    seen = results.standing(target)
    staged = stage(results, tmp_path, "a0")
    assert results.publish(target, "a0", staged, seen) == "done"
    results.fail(target, {"reason": "late", **about("r1")}, seen)
    assert results.standing(target).state == "whole" and table(url, tmp_path)


def test_results_replace_a_failure(url, tmp_path):
    results = open_results(url)
    target = target_of("r1")
    failure = {"reason": "no depth", **about("r1")}
    results.fail(target, failure, results.standing(target))
    seen = results.standing(target)
    assert seen.state == "failed" and seen.current["failure"] == failure
    assert result_files(url) == []
    results.reopen(target, seen)
    assert results.standing(target).state == "new"
    staged = stage(results, tmp_path, "a0")
    assert results.publish(target, "a0", staged, results.standing(target)) == "done"
    assert results.standing(target).state == "whole" and table(url, tmp_path)


def test_crashes_and_lost_machines_are_counted_separately(url, monkeypatch):
    results = open_results(url)
    target = target_of("r1")
    running = results.begin(target, "a0", "c0")
    assert results.deaths(target) == (0, 0)
    names = {"a1": f"{spool.machine()}-1-0", "a2": "elsewhere-7-7"}
    for attempt, name in names.items():
        monkeypatch.setattr(publish, "process", lambda name=name: name)
        results.begin(target, attempt, attempt)
    assert results.deaths(target) == (1, 1)
    assert results.deaths(target, "a1") == (1, 0) and results.deaths(target, "c0") == (0, 0)
    monkeypatch.setattr(publish, "_DAY_S", -1.0)
    assert results.deaths(target) == (1, 0)  # attempts of lost machines expire
    monkeypatch.setattr(spool, "machine", lambda: "elsewhere")
    assert results.deaths(target)[0] == 2  # a1, and a2, whose machine is now this one
    results.end(running)


def test_an_attempt_that_stalls_after_publishing_keeps_files_of_a_later_one(
    url, tmp_path, monkeypatch
):
    """The later attempt of another version begins while the first one cleans up."""
    if not url.startswith("s3:"):
        pytest.skip("folders have one attempt at a time")
    first, later = open_results(url), open_results(url)
    assert isinstance(first, BucketResults)
    old, new = target_of("r1"), target_of("r2")
    real = first._point

    def stall(*args):
        state = real(*args)
        assert (
            later.publish(new, "b", stage(later, tmp_path, "b", "r2"), later.standing(new))
            == "done"
        )
        return state

    monkeypatch.setattr(first, "_point", stall)
    assert first.publish(old, "a", stage(first, tmp_path, "a"), first.standing(old)) == "done"
    assert table(url, tmp_path) and later.standing(new).state == "whole"
