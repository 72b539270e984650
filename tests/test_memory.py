"""Memory limit of a run: how it is written and divided among processes, and that runs obey it."""

import json
import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxdet.memory
from jaxdet.cli.main import main
from jaxdet.config import Config, GroundConfig
from jaxdet.engine import RunOptions
from jaxdet.engine.memory import (
    ALONE,
    BATCH,
    MIB,
    PARENT,
    TABLES,
    WORKER,
    Memory,
    MemoryPlan,
)
from jaxdet.errors import ConfigError, InputError
from jaxdet.io import LogOptions, open_log
from jaxdet.io.limits import ReadMemory, check_chunk, check_index
from jaxdet.memory import machine_memory, parse_size, size_text
from tests.io_helpers import (
    START,
    LogFile,
    Scene,
    make_scene,
    write_calibration,
    write_images,
    write_log,
)
from tests.pools import same_results
from tests.runs import run_logs

ROOT = Path(__file__).resolve().parents[1]
GIB = 1 << 30
FRAME = 640 * 480 * 5


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("800MiB", 800 << 20),
        ("1.5G", 3 << 29),
        ("2 gb", 2 * 10**9),
        ("4096", 4096),
        ("10k", 10 << 10),
        ("1TiB", 1 << 40),
        ("5B", 5),
    ],
)
def test_sizes_of_memory_are_parsed(text, size):
    assert parse_size(text, "--memory") == size
    assert parse_size(size_text(size), "--memory") in range(size, size + MIB)


NO_SIZES = ["", "x", "-1G", "1.2.3G", "1EiB", "nan", "1e9", "12 parsec", "9" * 400]


@pytest.mark.parametrize("text", NO_SIZES)
def test_invalid_sizes_are_errors(text):
    with pytest.raises(
        ConfigError, match=r"--memory: expected a size, got .*; pass a number .* 4GiB"
    ):
        RunOptions(memory=text)


@pytest.mark.parametrize(
    ("groups", "files", "expected"),
    [
        ("0::/a/b", {"a/b/memory.max": "max", "a/memory.max": str(GIB)}, GIB),
        ("0::/", {"memory.max": str(2 * GIB)}, 2 * GIB),
        ("9:cpu:/x\n4:memory:/a", {"memory/a/memory.limit_in_bytes": str(GIB)}, GIB),
        ("0::/a", {"a/memory.max": str(1 << 60)}, None),
        ("0::/../..", {}, None),
    ],
)
def test_limits_of_control_groups_are_used(tmp_path, monkeypatch, groups, files, expected):
    (tmp_path / "own").write_text(groups, encoding="utf-8")
    for name, text in files.items():
        (tmp_path / "groups" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "groups" / name).write_text(text, encoding="ascii")
    without = Path("/proc/meminfo").read_text(encoding="ascii").split()[1]
    monkeypatch.setattr(jaxdet.memory, "_OWN", tmp_path / "own")
    monkeypatch.setattr(jaxdet.memory, "_GROUPS", tmp_path / "groups")
    assert machine_memory() == min(expected or 1 << 60, int(without) << 10)


def used(memory: Memory, allotted: MemoryPlan, frame: int, index: int, rows: int) -> int:
    """Compute the memory of a plan independently, from the constants of the module."""
    processes = ALONE if allotted.workers == 1 else PARENT + allotted.workers * WORKER
    images = 5 * allotted.batch * frame
    all_images = allotted.workers * (images + memory.chunks)
    copies = 1 + allotted.workers + (allotted.workers > 1)
    return processes + all_images + index * copies + rows


@given(
    total=st.integers(704, 40_000),
    needs=st.tuples(st.integers(1, 200 * MIB), st.integers(0, 2 * GIB), st.integers(0, 2 * GIB)),
    batch=st.integers(1, 300),
    workers=st.integers(1, 40),
)
def test_the_plan_never_exceeds_the_memory(total, needs, batch, workers):
    memory = Memory(f"{total}MiB", workers)
    assert 1 <= memory.workers <= workers
    try:
        allotted = memory.allot(*needs, batch, workers, "a")
    except InputError as error:
        least = re.search(r"pass --memory (\d+MiB) or more", str(error))
        assert least
        more = Memory(least[1], workers)
        assert more.total > memory.total
        assert more.allot(*needs, batch, workers, "a").batch
        return
    assert 1 <= allotted.workers <= memory.workers and 1 <= allotted.batch <= batch
    assert used(memory, allotted, *needs) <= memory.total


def test_enough_memory_keeps_all_workers_and_the_batch():
    memory = Memory("64GiB", 16)
    needs = FRAME, 10 * MIB, TABLES
    assert memory.allot(*needs, BATCH, 16, "a") == (16, BATCH)
    assert memory.allot(*needs, BATCH, 1, "a") == (1, BATCH)
    assert memory.reading.chunk == 256 * MIB


def test_less_memory_reduces_workers_first_and_batches_second():
    found = []
    for size in ("8GiB", "4GiB", "2GiB", "1GiB", "800MiB"):
        memory = Memory(size, 8)
        allotted = memory.allot(FRAME, 0, 0, BATCH, memory.workers, "a")
        found.append((allotted.workers, allotted.batch))
    assert found == sorted(found, reverse=True) and len(set(found)) > 3
    assert found[0][0] == 8 and found[-1][0] == 1


def test_larger_chunks_reduce_the_workers():
    """The fewer workers remain, the larger chunks each may read."""
    memory = Memory("2GiB", 8)
    seen = [(memory.workers, memory.reading.chunk)]
    while memory := memory.with_fewer_workers():
        seen.append((memory.workers, memory.reading.chunk))
    assert [workers for workers, _ in seen] == [5, 2, 1]
    chunks = [chunk for _, chunk in seen]
    assert chunks == sorted(set(chunks)) and chunks[0] == 32 * MIB


def test_the_limit_of_chunks_follows_the_memory():
    """More memory allows larger chunks, up to the configured limit."""
    for largest in (1 * MIB, 256 * MIB, 1024 * MIB):
        memory = Memory("64GiB", 2, largest=largest)
        assert memory.reading.chunk == max(largest, 32 * MIB)
        assert memory.with_fewer_workers().reading.chunk == memory.reading.chunk
    little, more = (Memory(size, 1, largest=1024 * MIB) for size in ("4GiB", "5GiB"))
    assert 256 * MIB < little.reading.chunk < more.reading.chunk


def test_memory_for_a_worker_and_this_process_is_reserved():
    """After a run that crashed, a log is read by a separate worker if memory permits."""
    whole, apart = Memory("1GiB", 1), Memory("1GiB", 1, apart=True)
    assert apart.apart and whole.room - apart.room == PARENT + WORKER - ALONE
    assert not Memory("704MiB", 1, apart=True).apart


@pytest.mark.parametrize("early", [False, True])
def test_a_log_of_large_chunks_is_read_by_fewer_workers(tmp_path, monkeypatch, early):
    """The chunk is read when the log is opened or by a worker."""
    monkeypatch.setattr("jaxdet.engine.memory.LEAST_CHUNKS", 60_000)
    scene, text = make_scene(30), ("std_msgs/msg/String", "ros2msg", b"string data")
    with LogFile(tmp_path / "a.mcap", chunk_size=12_000) as log:
        write_calibration(log)
        write_images(log, Scene(*(part[:26] for part in scene)))
        # The chunk has a depth image, as chunks with colour only are not read.
        log.raw("/note", "cdr", text, bytes(2 if early else 50_000), START)
        write_images(log, Scene(*(part[26:] for part in scene)))
    if early:
        write_log(tmp_path / "a.mcap", scene, chunk_size=100_000)
    config = Config(GroundConfig(source="none"))

    def run(name: str, **options: Any) -> Any:
        how = {"backend": "reference", "batch_size": 5, "pictures": 0, **options}
        return run_logs(tmp_path / "a.mcap", tmp_path / name, config, **how)

    many = run("a", workers=5, memory="2GiB")
    assert not many.failed and many.workers == 2
    run("b", workers=1)
    same_results(tmp_path / "a", tmp_path / "b")
    (failed,) = run("c", workers=1, memory=f"{ALONE + 33 * MIB}").failed
    assert re.search(
        r"a chunk of \d+ bytes needs .* are available; raise --memory by \d+MiB$", failed.error
    )


def test_a_split_read_only_for_transforms_has_the_same_limit_of_chunks(tmp_path):
    """The static transforms that are found do not depend on the available memory."""
    scene = make_scene(12)
    for number in (0, 1):
        with LogFile(tmp_path / f"a_{number}.mcap", chunk_size=100_000) as log:
            write_calibration(log, tf=number == 0)
            write_images(log, Scene(*(part[8 * number :][:8] for part in scene)))
    second = str(tmp_path / "a_1.mcap")
    with open_log(second, memory=ReadMemory(60_000)) as log:
        assert log.description.warnings[-1].endswith("were read from the split a_0.mcap")
    with pytest.raises(InputError, match=r"a_0.mcap: a chunk of .*; raise --memory by .*MiB"):
        open_log(second, memory=ReadMemory(30_000))
    (tmp_path / "a_0.mcap").write_bytes(b"no log")
    with open_log(second) as log:  # depth only, as there are no extrinsics
        assert not log.has_color and log.color_problem


@pytest.mark.parametrize("total", [704, 1100, 1371, 1500])
def test_the_memory_that_an_error_message_requests_is_sufficient(total):
    """Up to 1376 MiB the limit of a chunk is its minimum; only memory beyond that raises it."""
    memory = Memory(f"{total}MiB", 1)
    chunk, index = memory.reading.chunk + 5 * MIB, memory.reading.messages // 64 + 5000
    for check, size in (check_chunk, chunk), (check_index, index):
        with pytest.raises(InputError, match="raise --memory by") as caught:
            check(size, "a.mcap", memory.reading)
        more = re.search(r"by (\d+)MiB$", str(caught.value))
        assert more
        check(size, "a.mcap", Memory(f"{total + int(more[1])}MiB", 1).reading)


def test_the_default_memory_is_always_sufficient(monkeypatch):
    monkeypatch.setattr("jaxdet.engine.memory.machine_memory", lambda: 400 * MIB)
    assert Memory(None, 4).workers == 1
    with pytest.raises(ConfigError, match="100M is too little for any log; pass --memory 704MiB"):
        Memory("100M", 4)
    assert Memory("704MiB", 4).total == 704 * MIB


def test_too_little_memory_is_an_error(tmp_path, capsys):
    log = write_log(tmp_path / "a.mcap", make_scene(2))
    given = ["run", str(log), "--output", str(tmp_path / "out"), "--memory", "100MiB", "--quiet"]
    assert main(given) == 2
    message = capsys.readouterr().err
    assert message.splitlines()[-1].endswith("too little for any log; pass --memory 704MiB or more")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("scan", [False, True])
def test_a_chunk_that_exceeds_the_memory_is_refused(tmp_path, scan):
    log = write_log(tmp_path / "a.mcap", make_scene(4))
    options = LogOptions(scan=scan)

    def read(memory: ReadMemory) -> list[str]:
        with open_log(log, options, memory) as opened:
            again = pickle.loads(pickle.dumps(opened))
            with again:
                return [str(status) for batch in again.batches(2) for status in batch.status]

    assert read(ReadMemory()) == ["ok"] * 4
    with pytest.raises(InputError, match=r"a chunk of .* needs .*; raise --memory by .*MiB"):
        read(ReadMemory(chunk=1000))
    with pytest.raises(InputError, match=r"an index of .* needs .*; raise --memory by .*MiB"):
        read(ReadMemory(messages=100))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no procfs")
def test_a_run_stays_within_its_memory(tmp_path):
    def run(memory: str) -> dict[str, Any]:
        command = [sys.executable, "-m", "tests.memory_run", str(tmp_path / f"o{memory}"), memory]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        assert not done.returncode, done.stderr
        return json.loads(done.stdout.splitlines()[-1])

    small, large = run("1GiB"), run("4GiB")
    assert small["peak"] < GIB < large["peak"]
    assert small["batch"] < large["batch"]
    assert small["rows"] == large["rows"]
