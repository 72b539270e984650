"""Mutates logs for some minutes: ``scripts/fuzz --minutes N``. Failures are kept as files."""

import argparse
import faulthandler
import multiprocessing
import resource
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random

from tests.fuzz.formats import FORMATS, write_format
from tests.fuzz.judge import Truth, Verdict, judge, truth_of
from tests.fuzz.mutations import MUTATIONS, flip_bits

MOST_BYTES = 6 << 30
"""Of addresses above the memory that the fuzzer takes at first; threads reserve many."""


class Fuzzer:
    """Reads mutated logs in this process.

    Args:
        folder: Where the logs go.
        formats: Names of those mutated.
    """

    def __init__(self, folder: Path, formats: list[str]) -> None:
        self.folder = folder
        self.logs: dict[str, tuple[bytes, Truth]] = {}
        for name in formats:
            path = write_format(name, folder / f"{name}.mcap")
            self.logs[name] = path.read_bytes(), truth_of(path)

    def one(self, seed: int) -> tuple[str, bytes, Verdict]:
        """The log of a seed: its name, its bytes, and what came of it."""
        random = Random(seed)
        name, mutation = random.choice(list(self.logs)), random.choice(list(MUTATIONS))
        data, truth = self.logs[name]
        data = MUTATIONS[mutation](data, random)
        if random.random() < 0.25:
            data = flip_bits(data, random) if data else data
        path = self.folder / "mutated.mcap"
        path.write_bytes(data)
        title = f"{name} {mutation} seed {seed}"
        return title, data, judge(path, truth, name, mutation)


def count_up(folder: Path, formats: list[str], seeds: range, until: float, corpus: Path) -> Counter:
    """Judges the logs of some seeds until a time; keeps the failures in ``corpus``."""
    fuzzer, found = Fuzzer(folder, formats), Counter()
    limit = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    for seed in seeds:
        if time.monotonic() > until:
            break
        (folder / "seed.txt").write_text(str(seed))
        faulthandler.dump_traceback_later(60, exit=True)
        title, data, verdict = fuzzer.one(seed)
        faulthandler.cancel_dump_traceback_later()
        found[verdict.kind] += 1
        if verdict.failed:
            corpus.mkdir(parents=True, exist_ok=True)
            stem = corpus / title.replace(" ", "_")
            stem.with_suffix(".mcap").write_bytes(data)
            stem.with_suffix(".txt").write_text(f"{title}: {verdict.kind}\n{verdict.text}\n")
            print(f"{title}: {verdict.kind}: {verdict.text[-300:]}", flush=True)
    return found


def _worker(arguments: tuple) -> None:
    folder, formats, seeds, until, corpus, counts = arguments
    counts.put(count_up(folder, formats, seeds, until, corpus))


def main() -> int:
    """Mutates logs in a process that may die, again and again until the time is over."""
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0, help="of the first log")
    parser.add_argument("--formats", nargs="*", default=list(FORMATS), choices=list(FORMATS))
    parser.add_argument("--corpus", type=Path, default=Path(".cache/fuzz"), help="for failures")
    given = parser.parse_args()
    until, first, found = time.monotonic() + 60 * given.minutes, given.seed, Counter()
    work = given.corpus / "work"
    work.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    while time.monotonic() < until:
        counts = context.Queue()
        job = work, given.formats, range(first, first + 2000), until, given.corpus, counts
        process = context.Process(target=_worker, args=(job,))
        process.start()
        process.join()
        if process.exitcode:
            at = int((work / "seed.txt").read_text())
            kept = given.corpus / f"died_seed_{at}.mcap"
            kept.write_bytes((work / "mutated.mcap").read_bytes())
            print(f"seed {at}: the process died with {process.exitcode}; {kept}", flush=True)
            found["crash"] += 1
            found["not counted"] += at - first  # their counts died with it
            first = at + 1
            continue
        found += counts.get()
        first += 2000
        print(f"{sum(found.values())} logs: {dict(found.most_common())}", flush=True)
    bad = {"wrong pixels", "silently lost", "crash", "hang", "two lines"} & found.keys()
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
