"""Logs of all formats, damaged at random."""

import shutil
from pathlib import Path
from random import Random
from tempfile import mkdtemp

from tests.fuzz.case import Case, Verdict
from tests.fuzz.formats import FORMATS, write_format
from tests.fuzz.judge import Truth, judge, truth_of
from tests.fuzz.mutations import MUTATIONS, Files


class Logs:
    """Read mutated logs.

    Args:
        folder: Folder for logs.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._logs: dict[str, tuple[Files, Truth]] = {}
        self._there: dict[str, Files] = {}
        """Files that are in the folder of each format."""
        for name, form in FORMATS.items():
            path = write_format(name, Path(mkdtemp(dir=folder)) / f"log{form.suffix}")
            self._logs[name] = _files(path), truth_of(path)
            shutil.rmtree(path.parent)

    def one(self, seed: int) -> Case:
        """Read the log of a seed."""
        random = Random(seed)
        name = random.choice(list(FORMATS))
        ways = MUTATIONS[FORMATS[name].suffix]
        mutation = random.choice(list(ways))
        whole, truth = self._logs[name]
        files = ways[mutation](whole, random)
        if random.random() < 0.25:
            files = ways["flip_bits"](files, random)
        title = f"{name} {mutation} seed {seed}"
        if files == whole:
            return Case(title, Verdict("unchanged"), {})
        return Case(title, judge(self._write(name, files), truth, name, mutation), files)

    def _write(self, name: str, files: Files) -> Path:
        """Write a log to the folder that all logs of its format use, except unchanged files."""
        folder, there = self._folder / name, self._there.setdefault(name, {})
        for file in there.keys() - files.keys():
            (folder / file).unlink()
        for file, data in files.items():
            if there.get(file) != data:
                (folder / file).parent.mkdir(parents=True, exist_ok=True)
                (folder / file).write_bytes(data)
        self._there[name] = files
        return folder / f"log{FORMATS[name].suffix}" if FORMATS[name].suffix else folder


def _files(path: Path) -> Files:
    if path.is_file():
        return {path.name: path.read_bytes()}
    found = sorted(file for file in path.rglob("*") if file.is_file())
    return {file.relative_to(path).as_posix(): file.read_bytes() for file in found}
