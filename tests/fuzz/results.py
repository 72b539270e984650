"""Edited results folders, processed by ``track``, ``export`` and ``verify``."""

import io
import json
import os
import shutil
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxdet.cli import main
from jaxdet.results.manifest import write_manifest
from tests.export_results import sim_log
from tests.fuzz.case import Case, Verdict, ended
from tests.runs import run_logs

FORMATS = "html", "nav2", "ros2", "foxglove", "coco"
COMMANDS = ("track", "verify", *(f"export {name}" for name in FORMATS))
OUTSIDE = "outside"
"""Name of a folder to which mutated paths lead; nothing may be written there."""
ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 0.5, -0.0, 1e308, 10**30, float("nan"), float("inf"), "", ".",
    "..", "/", "a/b", f"../{OUTSIDE}/x", f"../../{OUTSIDE}/x", "\x1b[31mred", "a\nb", "\x00",
    "\u202e", "<script>alert(1)</script>", "x" * 5000, [], {}, [[]], {"": None}, [None] * 3,
    ["a", 1], {"a": {"b": []}}, "2024-01-01", "track", "frames.parquet",
)  # fmt: skip


class HostileResults:
    """Mutate the results of two small logs, and run a command on them.

    Args:
        folder: Folder for all files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        logs = [sim_log(folder / f"{name}.mcap", seed=seed) for seed, name in enumerate("ab")]
        self._good = folder / "good"
        run_logs(logs, self._good, pictures=1)
        _run(["track", str(self._good)])
        _judged("export coco", self._good, folder / "coco")  # compile before the first case
        self._files = sorted(path for path in self._good.rglob("*") if path.is_file())

    def one(self, seed: int) -> Case:
        """Mutate one to three files, run a command, and judge how it ends."""
        random = Random(seed)
        place = self._folder / "case"
        shutil.rmtree(place, ignore_errors=True)
        results = place / "results"
        shutil.copytree(self._good, results)
        (place / OUTSIDE).mkdir()
        (place / OUTSIDE / "x").write_bytes(b"kept")
        what = []
        for good in random.sample(self._files, random.choice((1, 1, 1, 2, 3))):
            file = results / good.relative_to(self._good)
            what.append(f"{file.name}: {_mutate(file, random, place)}")
        if random.random() < 0.5:  # as somebody would who hides the changes
            _seal(results)
        command = random.choice(COMMANDS)
        title = f"{command.split()[-1]} {'+'.join(what)} seed {seed}".replace("/", "_")
        outside = _listing(place)
        verdict = ended(lambda: _judged(command, results, place / "out"))
        if _listing(place) != outside:
            verdict = Verdict("wrong results", "files outside of the output have changed")
        return Case(title[:150], verdict, {})


def _judged(command: str, results: Path, output: Path) -> Verdict:
    name, _, format_ = command.partition(" ")
    argv = [name, str(results)]
    if format_:
        argv += ["--to", format_, "--output", str(output)]
    code, text = _run(argv)
    if "an error in jaxdet itself" in text or "Traceback" in text or code not in (0, 1, 2):
        return Verdict("crash", f"exit {code}: {text[-300:]}")
    lines = text.replace("\r", "\n").split("\n")
    if not all(line.isprintable() for line in lines):
        return Verdict("bad message", ascii(text[-300:]))
    if code and not any("error" in line or "findings" in line or ": " in line for line in lines):
        return Verdict("bad message", f"exit {code} without a reason: {text[-300:]}")
    return Verdict("clean" if code == 0 else "error", text)


def _run(argv: list[str]) -> tuple[int, str]:
    """Run the command line in this process; return the exit code and what it printed."""
    output = io.StringIO()
    with redirect_stdout(output), redirect_stderr(output):
        code = main(argv)
    return code, output.getvalue()


def _seal(results: Path) -> None:
    """Rewrite the manifests with new checksums, which do not reveal the changes."""
    for path in filter(Path.is_file, results.glob("*/manifest.json")):
        with suppress(Exception):  # the file may no longer be a valid manifest
            about = json.loads(path.read_text(encoding="utf-8"))
            write_manifest(path.parent, {k: v for k, v in about.items() if k not in _OWN})


_OWN = {"files", "format", "sha256"}


def _listing(place: Path) -> dict[str, bytes]:
    """Return the contents of files outside of results and output, which no command may change."""
    found = {}
    for path in place.rglob("*"):
        inside = path.relative_to(place).parts[0]
        if inside not in ("results", "out") and path.is_file():
            found[str(path.relative_to(place))] = path.read_bytes()
    return found


def _mutate(file: Path, random: Random, place: Path) -> str:
    """Change a file in place; return how."""
    by_suffix: dict[str, Callable[[Path, Random, Path], str]] = {
        ".json": _mutate_json,
        ".parquet": _mutate_table,
        ".npz": _mutate_map,
    }
    if random.random() < 0.25:
        return random.choice((_flip, _cut, _replace))(file, random, place)
    return by_suffix.get(file.suffix, _flip)(file, random, place)


def _flip(file: Path, random: Random, place: Path) -> str:
    data = bytearray(file.read_bytes())
    for _ in range(random.choice((1, 4, 100))):
        if data:
            data[random.randrange(len(data))] ^= 1 << random.randrange(8)
    file.write_bytes(data)
    return "flipped"


def _cut(file: Path, random: Random, place: Path) -> str:
    data = file.read_bytes()
    file.write_bytes(data[: random.randrange(len(data) + 1)])
    return "cut"


def _replace(file: Path, random: Random, place: Path) -> str:
    file.unlink()
    kind = random.choice(("gone", "fifo", "folder", "link", "dangling"))
    if kind == "fifo":
        os.mkfifo(file)
    elif kind == "folder":
        file.mkdir()
    elif kind == "link":
        file.symlink_to(place / OUTSIDE / "x")
    elif kind == "dangling":
        file.symlink_to(place / OUTSIDE / "none")
    return kind


def _mutate_json(file: Path, random: Random, place: Path) -> str:
    if random.random() < 0.05:
        file.write_text("[" * 100_000, encoding="utf-8")
        return "brackets"
    tree = json.loads(file.read_text(encoding="utf-8"))
    spots: list[tuple[Any, Any]] = []
    _collect(tree, spots)
    if not spots:
        return "as it was"
    for _ in range(random.choice((1, 1, 2, 5))):
        holder, key = random.choice(spots)
        try:
            if random.random() < 0.2 and isinstance(holder, dict):
                holder.pop(key, None)
            elif random.random() < 0.1 and isinstance(holder, dict):
                holder[random.choice(("../x", "\x1b[0m", "extra", ""))] = holder.pop(key, 1)
            else:
                value = random.choice(ODD)
                absolute = str(place / OUTSIDE / "x")
                holder[key] = absolute if random.random() < 0.1 else value
        except (KeyError, IndexError):
            continue
    file.write_text(json.dumps(tree), encoding="utf-8")
    return "json"


def _collect(node: Any, spots: list[tuple[Any, Any]]) -> None:
    """Collect container and key of each value in a tree of dicts and lists."""
    items = node.items() if isinstance(node, dict) else enumerate(node)
    for key, value in items:
        spots.append((node, key))
        if isinstance(value, dict | list):
            _collect(value, spots)


def _mutate_table(file: Path, random: Random, place: Path) -> str:
    table = pq.read_table(file)
    number = random.randrange(table.num_columns)
    field, rows = table.schema.field(number), table.num_rows
    kinds = "dropped", "text", "null", "extreme", "nan", "short", "twice", "meta", "lists"
    kind = random.choice(kinds)
    if kind == "dropped":
        table = table.remove_column(number)
    elif kind == "text":
        table = table.set_column(number, field.name, pa.array(["../x\x1b"] * rows))
    elif kind == "null":
        table = table.set_column(number, field.name, pa.nulls(rows, field.type))
    elif kind in ("extreme", "nan") and pa.types.is_primitive(field.type):
        values: Any = [float("nan")] * rows
        if pa.types.is_integer(field.type):
            values = [-(2**31) if field.type.bit_width < 64 else 2**62] * rows
            values = [abs(v) % 2**7 for v in values] if field.type.bit_width < 32 else values
        elif pa.types.is_boolean(field.type):
            values = [random.random() < 0.5 for _ in range(rows)]
        elif kind == "extreme":
            values = [random.choice((1e30, -1e30, float("inf")))] * rows
        try:
            table = table.set_column(number, field, pa.array(values, field.type))
        except (pa.ArrowInvalid, OverflowError, TypeError):
            kind = "as it was"
    elif kind == "lists":
        table = _with_other_lists(table, random)
    elif kind == "short":
        table = table.slice(0, random.randrange(rows + 1))
    elif kind == "twice":
        table = pa.concat_tables([table, table])
    else:
        values = "", "{}", "\x1b", "[" * 9
        table = table.replace_schema_metadata({"jaxdet": random.choice(values)})
    pq.write_table(table, file)
    return f"{field.name} {kind}"


def _with_other_lists(table: pa.Table, random: Random) -> pa.Table:
    """Return a table in which some lists of a column have other lengths or extreme values."""
    listed = [n for n, field in enumerate(table.schema) if pa.types.is_list(field.type)]
    if not listed or not table.num_rows:
        return table
    number = random.choice(listed)
    kind = table.schema.field(number).type.value_type
    odd = random.choice((None, 0, 1, 100) if pa.types.is_integer(kind) else _NUMBERS)
    lists, count = table[number].to_pylist(), random.choice((1, 1, table.num_rows))
    for row in random.sample(range(len(lists)), count):
        values = lists[row] or []
        changed = [[], values[:-1], values[:1], [*values, odd], [odd] * len(values), None]
        if values:
            at = random.randrange(len(values))
            changed.append([*values[:at], odd, *values[at + 1 :]])
        lists[row] = random.choice(changed)
    field = table.schema.field(number)
    if None in lists or any(None in values for values in lists):  # the new type allows nulls
        field = pa.field(field.name, pa.list_(kind))
    return table.set_column(number, field, pa.array(lists, field.type))


_NUMBERS = None, 0.0, -1.0, 1e30, float("nan"), float("inf"), float("-inf")


def _mutate_map(file: Path, random: Random, place: Path) -> str:
    with np.load(file) as arrays:
        given = dict(arrays)
    name = random.choice(list(given))
    values: list[Any] = [
        np.zeros(0), np.zeros((1, 1)), np.zeros((3, 2, 1)), np.array("text"), np.full(2, np.nan),
        np.array(1e300), np.array(-1), np.full((2, 2), 2**60), np.zeros((0, 2)), np.array(0.0),
    ]  # fmt: skip
    if random.random() < 0.2:
        del given[name]
    else:
        given[name] = random.choice(values)
    np.savez_compressed(file, **given)
    return f"map {name}"
