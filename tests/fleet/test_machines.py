"""Several processes and machines: runs with --share and races on S3; a Ray cluster of two nodes."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

import jaxdet
from jaxdet.fleet import download, result_files, spool
from jaxdet.fleet.place import open_place
from jaxdet.sim import SimConfig, write_log
from tests.fleet.conftest import ROOT, started
from tests.fleet.stub import JOURNAL, check_results, computed

pytestmark = pytest.mark.fleet


class Machines:
    """Driver processes that work on the logs of a bucket."""

    def __init__(self, url: str, journal: Path, scratch: Path) -> None:
        self.logs, self.results = f"{url}/logs", f"{url}/results"
        self.journal, self.scratch = journal, scratch
        self.spool = str(scratch / "spool")

    def start(self, on: str = "", share: str = "", results: str = "") -> subprocess.Popen:
        args = [self.logs, results or self.results, self.spool, on, share]
        command = [sys.executable, "-m", "tests.fleet.drive", *args]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)

    def end(self, driver: subprocess.Popen) -> dict[str, str]:
        out, _ = driver.communicate(timeout=240)
        assert driver.returncode == 0
        return json.loads(out)

    def run(self, *args, **kwargs) -> dict[str, str]:
        return self.end(self.start(*args, **kwargs))

    def wait_for(self, logs: int) -> None:
        """Wait until a number of computations have started."""
        until = time.monotonic() + 120
        while len(computed(self.journal)) < logs:
            assert time.monotonic() < until
            time.sleep(0.05)

    def check(self, results: str = "") -> dict[str, str]:
        """Assert that all results are complete; return the tables."""
        found = [url.split("/")[4] for url in result_files(results or self.results)]
        return {name: check_results(results or self.results, name, self.scratch) for name in found}

    def most(self) -> int:
        """Return the maximum number of computations per log."""
        return max(Counter(computed(self.journal)).values())

    def left(self) -> list[str]:
        base = spool.base_folder(self.spool)
        return os.listdir(base) if base.exists() else []


def names(count: int, prefix: str = "log") -> list[str]:
    return [f"{prefix}{i}" for i in range(count)]


@pytest.fixture
def machines(bucket, tmp_path, monkeypatch):
    journal = tmp_path / "journal"
    journal.mkdir()
    monkeypatch.setenv(JOURNAL, str(journal))
    return Machines(bucket, journal, tmp_path)


def test_four_simultaneous_attempts_at_a_log_give_one_result(machines, put):
    put(machines.logs, a="sleep=1")
    drivers = [machines.start() for _ in range(4)]
    states = Counter(machines.end(driver)["a"] for driver in drivers)
    assert states["done"] == 1 and states["there"] == 3
    assert {*machines.check()} == {"a"} and machines.left() == []


def test_simultaneous_shares_are_completed_after_one_is_killed_and_repeated(machines, put):
    put(machines.logs, **dict.fromkeys(names(9), "sleep=0.3"))
    drivers = [machines.start(share=f"{k}/3") for k in (1, 2, 3)]
    machines.wait_for(3)
    drivers[1].kill()
    drivers[1].communicate()
    found = machines.end(drivers[0]) | machines.end(drivers[2]) | machines.run(share="2/3")
    assert {*found} == {*names(9)} and {*found.values()} <= {"done", "there"}
    tables = machines.check()
    assert machines.most() <= 2
    assert {*tables} == {*names(9)} and machines.left() == []
    assert machines.run(results=machines.results + "-alone") == dict.fromkeys(names(9), "done")
    assert machines.check(machines.results + "-alone") == tables


@pytest.fixture(scope="module")
def cluster_environment(moto, tmp_path_factory):
    """Set the environment of all processes of the cluster: stub, journal, S3 server."""
    journals = tmp_path_factory.mktemp("journals")
    settings = {
        "PYTHONPATH": f"{ROOT / 'tests/fleet/site'}:{os.environ.get('PYTHONPATH', ROOT)}",
        "AWS_ENDPOINT_URL": moto,
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "AKIDEXAMPLE",
        "AWS_SECRET_ACCESS_KEY": "topsecretvalue",
        "AWS_REGION": "us-east-1",
        "NO_PROXY": "127.0.0.1,localhost",
        "RAY_DISABLE_IMPORT_WARNING": "1",
        "RAY_USAGE_STATS_ENABLED": "0",
        JOURNAL: str(journals),
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, value in settings.items():
            patch.setenv(name, value)
        yield journals


@pytest.fixture(scope="module")
def cluster(cluster_environment):
    """Start a head without cores and two nodes of one core, in up to three attempts."""
    pytest.importorskip("ray")
    made = started(_start_cluster)
    yield made
    made.shutdown()


def _start_cluster():
    from ray.cluster_utils import Cluster

    made = Cluster()
    try:
        made.add_node(num_cpus=0, include_dashboard=False)
        for _ in range(2):
            made.add_node(num_cpus=1)
    except BaseException:
        with suppress(Exception):
            made.shutdown()
        raise
    return made


@pytest.fixture
def fleet(cluster, bucket, cluster_environment, monkeypatch, tmp_path):
    monkeypatch.setenv("RAY_ADDRESS", cluster.address)
    for path in cluster_environment.iterdir():
        path.unlink()
    return Machines(bucket, cluster_environment, tmp_path)


@pytest.mark.filterwarnings("default")
def test_ray_retries_after_a_killed_worker_and_fails_a_log_that_kills_every_worker(fleet, put):
    logs = dict.fromkeys(names(6), "sleep=0.2")
    put(fleet.logs, **logs, once="kill=1", always="kill=99")
    found = fleet.run(on="ray")
    assert found == {**dict.fromkeys([*names(6), "once"], "done"), "always": "failed"}
    counts = Counter(computed(fleet.journal))
    assert counts.pop("always") == 3 and counts["once"] == 2 and max(counts.values()) <= 2
    tables = fleet.check()
    again = {**dict.fromkeys([*names(6), "once"], "there"), "always": "failed"}
    assert fleet.run(on="ray") == again and len(computed(fleet.journal)) == 3 + 2 + 6
    assert {*tables} == {*again} - {"always"}


@pytest.mark.filterwarnings("default")
def test_ray_completes_after_a_node_is_removed(fleet, cluster, put):
    put(fleet.logs, **dict.fromkeys(names(6), "sleep=2"))
    driver = fleet.start(on="ray")
    fleet.wait_for(2)
    cluster.remove_node(sorted(cluster.worker_nodes, key=str)[0], allow_graceful=False)
    assert fleet.end(driver) == dict.fromkeys(names(6), "done")
    assert {*fleet.check()} == {*names(6)} and fleet.most() <= 2
    cluster.add_node(num_cpus=1)


@pytest.mark.filterwarnings("default")
def test_ray_completes_after_the_driver_is_killed_and_the_command_repeated(fleet, put):
    put(fleet.logs, **dict.fromkeys(names(6), "sleep=1"))
    driver = fleet.start(on="ray")
    fleet.wait_for(3)
    driver.send_signal(signal.SIGKILL)
    driver.communicate()
    fleet.check()
    found = fleet.run(on="ray")
    assert {*found} == {*names(6)} and {*found.values()} <= {"done", "there"}
    assert {*fleet.check()} == {*names(6)} and fleet.most() <= 2


SAME = ("frames.parquet", "obstacles.parquet", "map.npz", "map.png", "pictures/")


@pytest.mark.filterwarnings("default")
def test_results_of_24_logs_are_the_same_bytes_on_each_scheduler_as_on_one_machine(fleet, tmp_path):
    """The logs are in a bucket. One process, three shares at once, Ray and Ray Data run them."""
    logs, alone = tmp_path / "logs", tmp_path / "alone"
    logs.mkdir()
    bucket = open_place(fleet.logs)
    for seed in range(24):
        path = logs / f"log{seed:02}.mcap"
        write_log(path, SimConfig(frames=3, width=96, height=72, seed=seed))
        bucket.put(path.name, path)
    assert not jaxdet.run(logs, alone).failed
    done = dict.fromkeys((path.stem for path in logs.glob("*.mcap")), "done")
    assert fleet.run(results=f"{fleet.results}/one") == done
    shares = [fleet.start(share=f"{k}/3", results=f"{fleet.results}/shares") for k in (1, 2, 3)]
    assert {name: state for one in shares for name, state in fleet.end(one).items()} == done
    assert fleet.run(on="ray", results=f"{fleet.results}/ray") == done
    assert fleet.run(on="ray.data", results=f"{fleet.results}/data") == done
    expected = contents(alone)
    assert len(expected) == 24 * (4 + 3)
    for way in ("one", "shares", "ray", "data"):
        for name in done:
            download(f"{fleet.results}/{way}", name, tmp_path / way / name)
        assert contents(tmp_path / way) == expected


def contents(folder: Path) -> dict[str, bytes]:
    """Return the bytes of tables, maps and pictures, by their paths in a folder."""
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*")}
    return {
        name: path.read_bytes()
        for name, path in files.items()
        if path.is_file() and name.split("/", 1)[-1].startswith(SAME)
    }
