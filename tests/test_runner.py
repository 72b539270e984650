"""``jaxdet.run`` and ``jaxdet.Runner`` in programs of all kinds."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import jaxdet
from jaxdet.engine import Progress
from jaxdet.errors import ConfigError, InputError
from jaxdet.sim import SimConfig, write_log

SCRIPT = """
import multiprocessing, os, jaxdet

OPTIONS = {"backend": "reference", "workers": 2, "pictures": 0, "map": False}

class Here:
    pass

def run(output, **changes):
    return jaxdet.run("logs", output, **{**OPTIONS, **changes}).frames

with multiprocessing.get_context("fork").Pool(1) as pool:
    print(pool.map(run, ["by_daemon"]))
print(run("by_run"))
runner = jaxdet.Runner(**OPTIONS)
print(runner.run("logs", "by_runner").frames)
print(jaxdet.run("logs/a.mcap", "by_jax", pictures=0).frames)
with multiprocessing.get_context("fork").Pool(1) as pool:
    for changes in ({}, {"backend": "jax", "workers": 1}):
        try:
            pool.apply(run, ["by_fork"], changes)
        except jaxdet.JaxdetError as error:
            print(error)
os.chdir("elsewhere")
print(runner.run((f"../logs/{name}.mcap" for name in "ab"), "after_chdir").frames)
try:
    runner.run("../logs", "by_runner", observers={"here": Here()})
except jaxdet.JaxdetError as error:
    print(error)
"""
"""Program without ``if __name__ == "__main__":`` that doesn't close its runner."""
GUARDED = """
import jaxdet

class FrameCounter:
    def __call__(self, batch, found):
        return len(batch.frames.number)

    def summary(self, seen):
        return sum(seen)

if __name__ == "__main__":
    with jaxdet.Runner(backend="reference", workers=2, pictures=0, map=False) as runner:
        runner.run("logs/a.mcap", "without")
        summary = runner.run("logs", "with", observers={"counter": FrameCounter()})
        print([log.to_dict()["counter"] for log in summary.logs])
"""
"""Script that defines an observer."""
NO_FORK = (
    "workers can't be started in a process forked from one that started some; "
    "start processes with spawn"
)
NO_JAX = (
    "JAX can't be used in a process forked from one that used it; "
    "start processes with spawn, or use the backend reference"
)
IN_MAIN = (
    "observers can't be sent to other processes (the program that defines them is not a file); "
    "define their classes in a module"
)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runner") / "logs"
    folder.mkdir()
    for seed, name in enumerate("ab"):
        write_log(folder / f"{name}.mcap", SimConfig(frames=2, width=96, height=72, seed=seed))
    return folder


def test_programs_of_all_kinds_can_start_workers(logs, tmp_path):
    (tmp_path / "logs").symlink_to(logs)
    (tmp_path / "elsewhere").mkdir()
    found = subprocess.run(
        [sys.executable, "-"],
        input=SCRIPT,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=120,
    )
    lines = ["[4]", "4", "4", "2", NO_FORK, NO_JAX, "4", IN_MAIN]
    assert found.stdout.splitlines() == lines, found.stderr
    assert not (tmp_path / "by_fork").exists()
    assert (tmp_path / "elsewhere/after_chdir/b/manifest.json").exists()


def test_scripts_with_a_main_guard_can_define_observers(logs, tmp_path):
    (tmp_path / "logs").symlink_to(logs)
    script = tmp_path / "script.py"
    script.write_text(GUARDED, encoding="utf-8")
    found = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, cwd=tmp_path, timeout=120
    )
    assert found.stdout == "[2, 2]\n", found.stderr


@pytest.mark.parametrize(
    ("given", "error"),
    [
        ({"logs": []}, "logs: no logs are named; pass at least one"),
        ({"logs": iter([])}, "logs: no logs are named; pass at least one"),
        ({"logs": [1]}, "inputs: expected a path, got int; pass strings or paths"),
        ({"output": None}, "output: expected a path, got of type NoneType; pass that of a folder"),
        ({"output": ""}, "output: expected a path, got ''; pass that of a folder"),
        (
            {"output": "s3://bucket/results"},
            "s3://bucket/results: is not a folder; write to addresses with the command jaxdet run",
        ),
        ({"log": {"every": 2}}, "log: expected LogOptions, got dict"),
        ({"workers": "2"}, "run.workers: expected an integer or None, got str"),
        ({"backend": "torch"}, "run.backend: expected 'jax' or 'reference', got 'torch'"),
        ({"overwrite": "no"}, "run.overwrite: expected True or False, got str"),
        ({"memory": 4}, "run.memory: expected a string or None, got int"),
    ],
)
def test_wrong_arguments_are_named(logs, tmp_path, given: dict[str, Any], error):
    kind = InputError if "logs" in given else ConfigError
    with pytest.raises(kind) as found:
        jaxdet.run(**{"logs": logs, "output": tmp_path / "out", **given})
    assert str(found.value) == error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("workers", [1, 2])
def test_an_exception_of_the_progress_callback_ends_the_run(logs, tmp_path, workers):
    def stop(now: Progress) -> None:
        raise error from cause

    error, cause = RuntimeError("stop"), KeyError("cause")
    options = {"backend": "reference", "pictures": 0}
    with pytest.raises(RuntimeError) as found:
        jaxdet.run(logs, tmp_path / "out", workers=workers, progress=stop, **options)
    assert found.value is error and error.__cause__ is cause
    assert not list(tmp_path.iterdir())
