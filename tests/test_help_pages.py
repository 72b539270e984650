"""Pages of ``jaxdet help`` and the README: all snippets run, links and names are right.

``tests/test_queries.py`` runs those of the page on queries, ``tests/test_readme.py`` the README's
example in Python.
"""

import io
import os
import pty
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import duckdb
import pyarrow as pa
import pytest
from rich.console import Console

from jaxdet.cli import main
from jaxdet.cli.help import formatted, pages, title_of
from jaxdet.engine import placement
from jaxdet.errors import FrameStatus
from jaxdet.presets import preset
from jaxdet.results.schemas import FRAMES_SCHEMA, LINKS_SCHEMA, OBSTACLES_SCHEMA, TRACKS_SCHEMA
from jaxdet.results.summary import LogSummary, Summary
from jaxdet.sim import SimConfig, write_log

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = {path.stem: path for path in sorted((ROOT / "jaxdet/help").glob("*.md"))}
DOCUMENTS["README"] = ROOT / "README.md"
CONSOLE = (
    "pip ",
    "jaxdet run drive.mcap ",
    'eval "$(jaxdet complete ',
    "jaxdet complete fish",
    "python",
    "ros2 launch ",
    "rosbags-convert ",
    "source /opt/ros/",
    "scripts/",
    ".venv/bin/",
)
"""Beginnings of commands that the tests do not run: installation, other programs, example logs."""
OTHERS = ("--dst", "--dst-storage", "--src", "--system-site-packages", "--only", "--seeds")
OTHERS += ("--array", "--array-properties", "--container-properties", "--cpus-per-task", "--gres")
OTHERS += ("--job-definition", "--job-definition-name", "--job-name", "--job-queue", "--requeue")
OTHERS += ("--retry-strategy", "--type")
OTHERS += ("--detector", "--judge", "--laws", "--rivals", "--scenes", "--sunrgbd")
OTHERS += ("--launch-file", "--ros-args")
"""Flags of other programs, and of ``python -m jaxdet.ros2``."""


@pytest.mark.parametrize("columns", [40, 100])
def test_tables_are_not_cut_at_the_width_of_the_terminal(columns):
    """Long flags in tables continue on the next line."""
    for name, text in pages().items():
        shown = io.StringIO()
        Console(file=shown, width=columns).print(formatted(text))
        assert shown.getvalue().count("…") == text.count("…"), name


UNLESS_THERE = "test -e drive.mcap || "
"""Prefix of a command that makes the log; a shell skips the command if the log exists."""
SIM = "sim drive.mcap --frames 8 --width 320"
"""Command that makes the log which the other pages use."""

FEWER = {"--frames": "8", "--rate-hz": "0.8"}
"""Values of flags with which the drives on the pages have fewer frames."""


def blocks(text: str) -> Iterator[tuple[str, str]]:
    """Yield the language and text of each fenced block."""
    for match in re.finditer(r"^```([^\n]*)\n(.*?)^```$", text, re.S | re.M):
        yield match[1], match[2]


def commands(block: str) -> list[list[str]]:
    """Return the command lines of a shell block, split into words."""
    joined = block.replace("\\\n", " ").replace(UNLESS_THERE, "")
    return [words for line in joined.splitlines() if (words := shlex.split(line, comments=True))]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("help") / "drive.mcap"
    write_log(path, SimConfig(frames=8, width=320, height=240))
    return path


@pytest.mark.parametrize("name", sorted(DOCUMENTS.keys() - {"queries"}))
def test_every_snippet_runs(name, drive, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(placement, "BATCH", 8)  # one compiled program for all pages
    text = DOCUMENTS[name].read_text(encoding="utf-8")
    names: dict[str, object] = {"__name__": name}
    for language, block in blocks(text):
        if language == "sh":
            for program, *args in commands(block):
                assert program == "jaxdet"
                if " ".join(args[:6]) == SIM and name != "logs":
                    (tmp_path / "drive.mcap").hardlink_to(drive)
                    continue
                args = [FEWER.get(flag, word) for flag, word in pairwise(("", *args))]
                expected = 1 if args[0] == "diff" else 0  # the runs differ
                assert main(args) == expected, (args, capsys.readouterr().err)
        elif language == "sql":
            assert duckdb.sql(block).fetchall()
        elif language == "python":
            if name != "README":
                exec(compile(block, f"{name}.md", "exec"), names)
        elif language == "toml":
            file = re.match(r"# (\w+\.toml)\n", block)
            assert file
            (tmp_path / file[1]).write_text(block, encoding="utf-8")
        elif language == "console":
            assert all(line.startswith(CONSOLE) for line in block.splitlines() if line.strip())
        else:
            assert language == "text", f"a block of {language or 'no language'}"


def test_pages_are_shown_in_the_pager_of_the_user():
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "PAGER": "sed s/^/paged:/", "COLUMNS": "80"}
    command = [sys.executable, "-m", "jaxdet", "help", "tracks"]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, env=environment):
        os.close(theirs)
        shown = b""
        with suppress(OSError):  # end of the terminal on Linux
            while read := os.read(ours, 1 << 16):
                shown += read
    os.close(ours)
    assert shown.count(b"paged:") == shown.count(b"\n") > 40
    assert b"Tracks: obstacles over time" in shown and b"# Tracks" not in shown


LINKS = [
    (name, target)
    for name, path in DOCUMENTS.items()
    for target in re.findall(r"\]\(([^)#:]+)\)", path.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize(("name", "target"), LINKS)
def test_links_have_targets(name, target):
    assert (DOCUMENTS[name].parent / target).exists()


def test_flags_on_pages_exist(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    flag = r"(?<![\w-])--[a-z](?:[\w.-]*\w)?"
    for command in (
        "run --help-all",
        "track --help-all",
        "export -h",
        "verify -h",
        "diff -h",
        "info -h",
        "sim -h",
        "doctor -h",
    ):
        assert main(command.split()) == 0
    known = {*re.findall(flag, capsys.readouterr().out), *OTHERS}
    for path in DOCUMENTS.values():
        assert {*re.findall(flag, path.read_text(encoding="utf-8"))} <= known, path.name


def test_parameters_of_the_paper_equal_those_of_the_preset():
    paper = preset("paper")
    now = {
        cells[0].split(":")[0].split(",")[0]: cells[3] for cells in rows("paper", "Every parameter")
    }
    corners, cluster = paper.features, paper.cluster
    assert now["Canny thresholds"] == f"**{corners.canny_low:g}, {corners.canny_high:g}**"
    assert now["minimum distance between corners"].startswith(f"**{corners.min_distance:g}**")
    assert now["maximum number of corners; minimum quality"] == (
        f"{corners.max_corners}; {corners.quality_level:g}"
    )
    assert now["N"] == f"**{cluster.min_points}**"
    assert [now["d_z"], now["d_x"]] == [f"**{gap_m:.2f} m**" for gap_m in cluster.gaps_m]


SCHEMAS = {
    "frames": FRAMES_SCHEMA,
    "obstacles": OBSTACLES_SCHEMA,
    "tracks": TRACKS_SCHEMA,
    "track_links": LINKS_SCHEMA,
}


def rows(name: str, section: str) -> list[list[str]]:
    """Return the cells of the table in a section of a page, without the heading."""
    text = DOCUMENTS[name].read_text(encoding="utf-8")
    (found,) = re.findall(rf"^## {section}\n(.*?)(?=^## |\Z)", text, re.S | re.M)
    lines = [line for line in found.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def type_name(field: pa.Field) -> str:
    """Return the name that the page uses for the type of a field."""
    kind, null = field.type, ", nullable" if field.nullable else ""
    many = ""
    if pa.types.is_fixed_size_list(kind):
        many, kind = f"{kind.list_size} ", kind.value_type
    elif pa.types.is_list(kind):
        many, kind = "list of ", kind.value_type
    return many + str(kind).replace("float", "float32").replace("double", "float64") + null


@pytest.mark.parametrize("table", SCHEMAS)
def test_every_column_is_explained(table):
    named = [(re.findall(r"`(\w+)`", cells[0]), cells[1]) for cells in rows("tables", table)]
    explained = {name: kind for names, kind in named for name in names}
    assert sum(len(names) for names, _ in named) == len(explained)
    assert explained == {field.name: type_name(field) for field in SCHEMAS[table]}


def test_columns_in_the_readme_exist():
    named = {
        *re.findall(r"`(\w+)`", " ".join(cells[0] for cells in rows("README", "What you get")))
    }
    assert "distance_m" in named
    assert named <= {*OBSTACLES_SCHEMA.names}


def test_each_status_is_explained():
    text = DOCUMENTS["logs"].read_text(encoding="utf-8")
    assert all(f"| `{status}` |" in text for status in FrameStatus)


def test_each_key_of_the_summary_is_explained():
    text = DOCUMENTS["runs"].read_text(encoding="utf-8")
    keys = {**Summary("jax", 1).to_dict(), **LogSummary("a", ()).to_dict()}
    assert [key for key in keys if f"`{key}`" not in text] == []


def test_pages_that_texts_refer_to_exist():
    found = pages()
    assert {*found} == {path.stem for path in (ROOT / "jaxdet/help").glob("*.md")}
    for path in DOCUMENTS.values():
        for name in re.findall(r"`jaxdet help (\w+)`", path.read_text(encoding="utf-8")):
            assert name in found


def test_help_lists_and_shows_the_pages(capsys):
    assert main(["help"]) == 0
    listed = capsys.readouterr().out
    for name, text in pages().items():
        assert f"  {name}" in listed and title_of(text) in listed
        assert main(["help", name]) == 0
        assert capsys.readouterr().out == text
