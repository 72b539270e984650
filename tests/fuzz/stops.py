"""Runs of the command that are interrupted by Ctrl-C at a random time.

Before code of jaxdet runs, the signal ends the process. Later the command ends within
:data:`MOST_S`, with exit status 130, or 0 if the results are complete. Repeating the command then
writes the results of an uninterrupted run.
"""

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from random import Random
from typing import NamedTuple

import pyarrow.parquet as pq

from jaxdet.results.layout import log_folders
from jaxdet.results.reading import open_results
from jaxdet.sim import SimConfig, write_log
from tests.fuzz.case import Case, Verdict

MOST_S = 2.0
"""Maximum time from the signal to the end [s]; one of :data:`TRIES` runs must meet it."""
TRIES = 3
HANGS_S = 60.0
WORKERS = 1, 1, 1, 1, 1, 1, 1, 2
"""Numbers of workers to choose from."""
TICKS = os.sysconf("SC_CLK_TCK")
SLACK_S = 0.05
"""Uncertainty of the time of a signal, and of the time at which a folder is renamed [s]."""
INTERRUPTED = 128 + signal.SIGINT


class Ending(NamedTuple):
    """End of an interrupted command."""

    code: int | None
    """Exit code as in :mod:`subprocess`; None if the process had to be killed."""
    delay_s: float
    """Time from the signal to the end [s]."""
    sent_at: float
    """Time of the signal; 0 if the command had ended before."""
    errors: str


class Stops:
    """Interrupt ``jaxdet run`` on a small log.

    Args:
        folder: Folder for all files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._log, self._errors = folder, folder / "log.mcap", folder / "errors"
        write_log(self._log, SimConfig(frames=6, width=160, height=120))
        self._complete(folder / "first", 1)  # a first run may compile
        self._cpu_s = {1: self._complete(folder / "1", 1)}
        """CPU time of the main process of an uninterrupted run, by the number of workers [s]."""
        self._good = _tables(folder / "1" / "log")

    def one(self, seed: int) -> Case:
        """Interrupt a run at a time that depends on the seed."""
        random = Random(seed)
        workers = random.choice(WORKERS)
        if workers not in self._cpu_s:
            self._cpu_s[workers] = self._complete(self._folder / f"{workers}", workers)
        cpu_s = random.uniform(0, 1.1 * self._cpu_s[workers])
        wait_s = random.uniform(0, 0.05)  # so that some signals arrive while the process waits
        output = self._folder / "out"
        title = f"{workers}-workers at {cpu_s:.2f} s seed {seed}"
        verdict = Verdict("hang")
        for _ in range(TRIES):
            shutil.rmtree(output, ignore_errors=True)
            ending = self._interrupt(output, workers, cpu_s, wait_s)
            verdict = self._judge(ending, output, workers)
            if verdict.kind != "hang":
                break
        return Case(title, verdict, {})

    def _interrupt(self, output: Path, workers: int, cpu_s: float, wait_s: float) -> Ending:
        """Start a run; interrupt it ``wait_s`` after it has used a CPU time of ``cpu_s``."""
        process = self._start(output, workers)
        while process.poll() is None and _cpu_time(process.pid) < cpu_s:
            time.sleep(0.004)
        time.sleep(wait_s)
        sent_at, start = 0.0, time.monotonic()
        if process.poll() is None:
            sent_at = time.time()
            os.killpg(process.pid, signal.SIGINT)
        try:
            code = process.wait(timeout=HANGS_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            code = None
        return Ending(code, time.monotonic() - start, sent_at, self._errors.read_text())

    def _judge(self, ending: Ending, output: Path, workers: int) -> Verdict:
        code, delay_s, sent_at, errors = ending
        text = f"exit {code} {delay_s:.2f} s after the signal: {errors[-300:]}"
        if not sent_at:
            return Verdict("finished" if code == 0 else "crash", text)
        complete_at = _complete_at(output)
        if not self._is_right(output):
            return Verdict("wrong results", text)
        if code is None:
            return Verdict("hang", text)
        begun = complete_at or "jaxdet: " in errors
        if code == -signal.SIGINT and not begun:
            return Verdict("not begun", text)
        if code == 1 and "KeyboardInterrupt" in errors and not begun and "/jaxdet/" not in errors:
            return Verdict("not begun", text)  # while Python starts
        if code not in (0, INTERRUPTED) or "Traceback" in errors or "jaxdet itself" in errors:
            return Verdict("crash", text)
        if code == 0 and complete_at > sent_at + SLACK_S:
            return Verdict("swallowed", text)
        if code and complete_at and complete_at < sent_at - SLACK_S:
            return Verdict("denied", text)
        if delay_s > MOST_S:
            return Verdict("hang", text)
        if output.exists():
            self._complete(output, workers)
        if output.exists() and _tables(output / "log") != self._good:
            return Verdict("wrong results", f"after the same command again; {text}")
        return Verdict("interrupted" if code else "complete", text)

    def _is_right(self, output: Path) -> bool:
        """Return whether a reader finds no results, or those of an uninterrupted run."""
        folders = log_folders(output)
        if not folders:
            return True
        with open_results(output) as results:
            results.tables()
        return all(_tables(folder) == self._good for folder in folders.values())

    def _complete(self, output: Path, workers: int) -> float:
        """Run the command to its end; return the CPU time of its main process [s]."""
        process, seconds = self._start(output, workers), 0.0
        while process.poll() is None:
            seconds = _cpu_time(process.pid)
            time.sleep(0.01)
        assert process.returncode == 0, self._errors.read_text()
        return seconds

    def _start(self, output: Path, workers: int) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-P", "-m", "jaxdet", "run", str(self._log), "-o", str(output)]
        with self._errors.open("wb") as errors:  # a file, as workers may keep a pipe open
            return subprocess.Popen(
                [*command, "--pictures", "0", "--workers", str(workers)],
                env={**os.environ, "JAX_PLATFORMS": "cpu"},
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
                preexec_fn=_as_in_a_terminal,
            )


def _as_in_a_terminal() -> None:
    """Give SIGINT its default action, and remove the memory limit of the fuzzer."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (hard, hard))


def _cpu_time(pid: int) -> float:
    """Return the CPU time of a process that runs, or has ended but was not waited for [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def _complete_at(output: Path) -> float:
    """Return the time when the results of the log got their final name; 0 if there are none."""
    return max((folder.stat().st_ctime for folder in log_folders(output).values()), default=0.0)


def _tables(folder: Path) -> dict[str, bytes]:
    """Return maps and rows of tables by file name, without the metadata of the run."""
    found = {path.name: path.read_bytes() for path in folder.glob("map.*")}
    for path in folder.glob("*.parquet"):
        found[path.name] = repr(pq.read_table(path).to_pylist()).encode()
    return found
