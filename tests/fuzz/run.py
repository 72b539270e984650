"""Fuzzer for a limited time: ``scripts/fuzz logs --minutes N``.

Each core has its own process; crashes of processes count as failures. Failures are kept as files.
"""

import argparse
import faulthandler
import multiprocessing
import os
import resource
import sys
import threading
import time
from collections import Counter, defaultdict
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.fuzz.case import FAILURES, Case, Subject

SUBJECTS = {
    "logs": "Logs",
    "calibrations": "Calibrations",
    "calls": "Calls",
    "results": "HostileResults",
    "stops": "Stops",
}
"""Class of each subject, by the module in this package."""
MOST_BYTES = 4 << 30
"""Writable memory that a process may use in addition to that at its start [bytes]. Addresses that
threads only reserve, 64 MiB for each of up to eight allocators per core, do not count, so the limit
suits any number of cores."""
DIES_AFTER_S = 120
BLOCK = 500
"""Number of seeds that a process handles before it is replaced."""


def make(name: str, folder: Path) -> Subject:
    """Return the subject with a name; it writes its files into ``folder``."""
    return getattr(import_module(f"tests.fuzz.{name}"), SUBJECTS[name])(folder)


def work(
    name: str, core: int, seeds: range, until: float, corpus: Path, at: Any, ends: Any
) -> None:
    """Process seeds on one core until a time; put title, verdict and memory into ``ends``."""
    os.sched_setaffinity(0, {core})
    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with TemporaryDirectory(prefix="jaxdet-fuzz-", dir=memory) as folder:
        subject, plain = make(name, Path(folder)), _most_bytes()
        limit = _writable_bytes() + MOST_BYTES
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
        for seed in seeds:
            if time.monotonic() > until:
                break
            at.value = seed
            faulthandler.dump_traceback_later(DIES_AFTER_S, exit=True)
            case = subject.one(seed)
            faulthandler.cancel_dump_traceback_later()
            if case.verdict.failed:
                _keep(case, corpus)
            ends.put((case.title.partition(" ")[0], case.verdict.kind, _most_bytes() - plain))


def _most_bytes() -> int:
    """Return the peak resident memory of this process [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _writable_bytes() -> int:
    """Return the private writable memory of this process, used or only reserved [bytes]."""
    fields = dict(line.split(":") for line in Path("/proc/self/status").read_text().splitlines())
    return int(fields["VmData"].split()[0]) * 1024


def _keep(case: Case, corpus: Path) -> None:
    folder = corpus / case.title.replace(" ", "_")
    for name, data in case.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    kind, text = case.verdict
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "failure.txt").write_text(f"{case.title}: {kind}\n{text}\n", encoding="utf-8")
    print(f"{case.title}: {kind}: {text[-300:]}", flush=True)


class Crew:
    """Processes, one per core, among which seeds are divided.

    Args:
        name: Name of the subject.
        seeds: Seeds to process.
        until: Time at which work ends, by the monotonic clock [s].
        corpus: Folder for failures.
    """

    def __init__(self, name: str, seeds: range, until: float, corpus: Path) -> None:
        self.found: Counter[str] = Counter()
        self.forms: defaultdict[str, Counter[str]] = defaultdict(Counter)
        """Numbers of verdicts by the first word of a title, such as the format of a log."""
        self.most_bytes = 0
        """Peak memory of a process above that before its first case [bytes]."""
        self._name, self._left, self._until, self._corpus = name, seeds, until, corpus
        self._lock, self._context = threading.Lock(), multiprocessing.get_context("spawn")

    def run(self) -> None:
        """Process seeds until none or no time is left."""
        threads = [
            threading.Thread(target=self._use, args=(core,)) for core in os.sched_getaffinity(0)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def _use(self, core: int) -> None:
        seeds = range(0)
        while time.monotonic() < self._until:
            with self._lock:
                if not seeds:
                    seeds, self._left = self._left[:BLOCK], self._left[BLOCK:]
            if not seeds:
                return
            seeds = self._try(core, seeds)

    def _try(self, core: int, seeds: range) -> range:
        """Process seeds in a new process; return those after a seed that killed the process."""
        at, ends = self._context.Value("q", seeds[0]), self._context.SimpleQueue()
        job = self._name, core, seeds, self._until, self._corpus, at, ends
        process = self._context.Process(target=work, args=job)
        process.start()
        while process.is_alive():
            process.join(0.2)
            self._count(ends)
        self._count(ends)
        if not process.exitcode:
            return range(0)
        died = f"{self._name} seed {at.value}: the process died with {process.exitcode}"
        print(died, flush=True)
        with self._lock:
            self.found["crash"] += 1
        return range(at.value + 1, seeds.stop)

    def _count(self, ends: Any) -> None:
        with self._lock:
            while not ends.empty():
                form, kind, most_bytes = ends.get()
                self.found[kind] += 1
                self.forms[form][kind] += 1
                self.most_bytes = max(self.most_bytes, most_bytes)


def main() -> int:
    """Run the command line; return exit status 1 if there were failures."""
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("subject", choices=list(SUBJECTS))
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--count", type=int, default=1 << 40, help="maximum number of seeds")
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--corpus", type=Path, default=Path(".cache/fuzz"), help="failures")
    given = parser.parse_args()
    start = time.monotonic()
    seeds = range(given.seed, given.seed + given.count)
    crew = Crew(given.subject, seeds, start + 60 * given.minutes, given.corpus)
    crew.run()
    seconds = time.monotonic() - start
    print(
        f"{crew.found.total()} {given.subject} in {seconds:.0f} s: {dict(crew.found.most_common())}"
    )
    for form, found in sorted(crew.forms.items()):
        print(f"  {form}: {found.total()} {dict(found.most_common())}")
    print(f"most memory above the plain process: {crew.most_bytes >> 20} MiB")
    return 1 if FAILURES & crew.found.keys() else 0


if __name__ == "__main__":
    sys.exit(main())
