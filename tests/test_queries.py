"""Queries of the help page: pandas, polars and DuckDB return the same rows."""

import ast
import json
import math
import re
import shutil
from itertools import groupby
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxdet.results.schemas import FRAMES_SCHEMA, OBSTACLES_SCHEMA
from tests.export_results import sim_log
from tests.runs import run_logs

PAGE = Path(__file__).resolve().parents[1] / "jaxdet" / "help" / "queries.md"
TEXT = PAGE.read_text(encoding="utf-8")
SECTIONS = {
    part.splitlines()[0]: dict(re.findall(r"```(.*?)\n(.*?)```", part, re.S))
    for part in re.split(r"^## ", TEXT, flags=re.M)[1:]
}
START = SECTIONS.pop("The tables")
ENGINES = {"python pandas", "python polars", "sql"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results of two logs, edited to contain lost frames, drops and an overhang."""
    folder = tmp_path_factory.mktemp("queries")
    (folder / "logs").mkdir()
    for name in ("a", "b"):
        sim_log(folder / "logs" / f"{name}.mcap", seed=ord(name))
    run_logs(folder / "logs", folder / "results", pictures=1)
    rows = _rows(folder, "frames")
    for row in rows:
        row["color_stamp_ns"] += 85  # digits that float64 would lose
    for i, status in ((2, "timeout"), (5, "no_depth"), (9, "timeout"), (10, "timeout")):
        rows[i] |= {"status": status, "free_bearing_rad": None, "free_to_m": None}
        rows[i]["color_stamp_ns"] = None
    for i, drop in ((1, 1.25), (7, 1.5), (8, 3.0)):
        rows[i]["drop_m"] = drop
    rows[7]["camera_position_world"] = None
    _write(folder, "frames", rows, FRAMES_SCHEMA)
    rows = _rows(folder, "obstacles")
    rows[1]["bottom_m"], rows[3]["bottom_m"] = 0.5, 0.45
    rows[4] |= {"bottom_m": None, "top_m": None, "corners_world": None}
    _write(folder, "obstacles", rows, OBSTACLES_SCHEMA)
    return folder


def _rows(folder: Path, name: str) -> list[dict[str, Any]]:
    """Return the rows of a table of both logs."""
    paths = (folder / "results" / log / f"{name}.parquet" for log in "ab")
    return [row for path in paths for row in pq.read_table(path).to_pylist()]


def _write(folder: Path, name: str, rows: list[dict[str, Any]], schema: pa.Schema) -> None:
    for log in "ab":
        own = [row for row in rows if row["log"] == log]
        path = folder / "results" / log / f"{name}.parquet"
        pq.write_table(pa.Table.from_pylist(own, schema=schema), path)


def last_value(text: str, names: dict[str, Any]) -> Any:
    """Run a block of Python and return the value of its last line."""
    *body, last = ast.parse(text).body
    exec(compile(ast.Module(body, []), str(PAGE), "exec"), names)
    assert isinstance(last, ast.Expr)
    return eval(compile(ast.Expression(last.value), str(PAGE), "eval"), names)


def answer(engine: str, start: str, text: str) -> tuple[list[str], list[tuple]]:
    """Return the names of columns and the rows that a query returns."""
    if engine == "sql":
        with duckdb.connect() as database:
            database.execute(start)
            found = database.execute(text)
            return [column[0] for column in found.description], found.fetchall()
    names: dict[str, Any] = {}
    exec(compile(start, str(PAGE), "exec"), names)
    table = last_value(text, names)
    rows = table.itertuples(index=False) if engine.endswith("pandas") else table.iter_rows()
    return list(table.columns), [tuple(row) for row in rows]


def missing(value: Any) -> bool:
    return value is None or value is pd.NA or (not isinstance(value, str) and math.isnan(value))


def same(one: Any, other: Any) -> bool:
    """Return whether two values are equal, numbers in the precision of float32."""
    if missing(one) or missing(other) or isinstance(one, str):
        return one == other or (missing(one) and missing(other))
    return math.isclose(one, other, rel_tol=1e-6)


def test_the_page_has_ten_queries() -> None:
    assert len(SECTIONS) == 10
    assert all(set(blocks) == ENGINES for blocks in [START, *SECTIONS.values()])
    numbers = [int(title.split(".")[0]) for title in SECTIONS]
    assert numbers == list(range(1, 11))
    assert max(map(len, TEXT.splitlines())) <= 100


@pytest.mark.parametrize("title", SECTIONS)
def test_three_engines_return_the_same_rows(
    title: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    answers = {
        engine: answer(engine, START[engine], text) for engine, text in SECTIONS[title].items()
    }
    columns, rows = answers.pop("sql")
    assert len(rows) >= 2 and len(set(rows)) == len(rows)
    for engine, (names, found) in answers.items():
        assert names == columns, engine
        for row, other in zip(rows, found, strict=True):
            assert all(map(same, row, other)), engine


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_timestamps_are_exact_in_columns_with_nulls(
    engine: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    stamps = pa.chunked_array(
        [[row["color_stamp_ns"] for row in _rows(folder, "frames")]], pa.int64()
    )
    assert stamps.null_count and any(int(float(one)) != one for one in stamps.to_pylist() if one)
    text = {
        "python pandas": 'frames[["color_stamp_ns"]].dropna()',
        "python polars": 'frames.select("color_stamp_ns").drop_nulls()',
        "sql": "SELECT color_stamp_ns FROM frames WHERE color_stamp_ns IS NOT NULL",
    }[engine]
    _, rows = answer(engine, START[engine], text)
    assert [int(one) for (one,) in rows] == stamps.drop_null().to_pylist()


@pytest.mark.parametrize("engine", sorted(ENGINES))
def test_queries_run_on_results_without_pictures(
    engine: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such results are written with ``--pictures 0``."""
    shutil.copytree(folder / "results", tmp_path / "results")
    for path in (tmp_path / "results").glob("*/summary.json"):
        summary = json.loads(path.read_text())
        summary["logs"][0]["pictures"] = []
        path.write_text(json.dumps(summary))
    monkeypatch.chdir(tmp_path)
    (title,) = (title for title in SECTIONS if "Which frame does each picture show" in title)
    columns, rows = answer(engine, START[engine], SECTIONS[title][engine])
    assert columns == ["log", "camera", "frame", "picture", "distance_m"] and not rows


def test_answers_agree_with_the_tables(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    titles = list(SECTIONS)
    obstacles = _rows(folder, "obstacles")

    def sql(number: int) -> list[tuple]:
        return answer("sql", START["sql"], SECTIONS[titles[number - 1]]["sql"])[1]

    by_frame = groupby(obstacles, key=lambda row: (row["log"], row["camera"], row["frame"]))
    nearest = [(*key, min(row["distance_m"] for row in rows)) for key, rows in by_frame]
    assert sql(1) == nearest
    assert sum(count for *_, count in sql(2)) == sum(row["distance_m"] < 1 for row in obstacles)
    assert sum(count for _, count in sql(3)) == len(obstacles)
    pictures = {log: picture for log, _, _, picture, _ in sql(4)}
    assert pictures == dict.fromkeys("ab", "pictures/000000.png")
    lost = [(log, status, count) for log, _, status, count in sql(5)]
    assert lost == [("a", "no_depth", 1), ("a", "timeout", 1), ("b", "timeout", 2)]
    assert [bottom for *_, bottom, _ in sql(6)][:2] == [0.5, pytest.approx(0.45)]
    assert len(sql(7)) == 8 and [frames for *_, frames, _ in sql(8)] == [6, 6]
    assert [seconds for *_, seconds in sql(8)] == [2.5, 2.5]
    assert sum(seen for *_, seen in sql(9)) == len(obstacles) - 1
    assert [(log, frame, drop) for log, _, frame, drop, *_ in sql(10)] == [
        ("a", 1, 1.25),
        ("b", 1, 1.5),
    ]
    assert sql(10)[1][4:] == (None, None)


def test_the_schema_is_printed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    (block,) = re.findall(r"```python\n(.*?)```", TEXT, re.S)
    block = block.replace("results/drive/", "results/a/")
    exec(compile(block, str(PAGE), "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == len(OBSTACLES_SCHEMA)
    assert any(line.split()[:2] == ["distance_m", "m"] for line in lines)
