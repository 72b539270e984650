"""The C++ of kernels: each header is a file that a compiler takes alone, and is shipped."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from jaxdet.floor.frame import FLOOR_VALUES, FRAME_BITS
from jaxdet.reference._cells import MARGIN
from jaxdet.types import MAX_LABELS, MAX_SURFACES
from jaxdet_kernels import align, obstacles
from jaxdet_kernels.native_source import FOLDER, native

ROOT = Path(__file__).resolve().parents[1]
HEADERS = sorted(path.name for path in FOLDER.iterdir())
COMPILER = shutil.which("g++")
FLAGS = ["-std=c++17", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-x", "c++", "-"]


def faults(source: str) -> str:
    """What the compiler says of a file, with the headers' folder on its path."""
    command = [str(COMPILER), "-I", str(FOLDER), *FLAGS]
    return subprocess.run(command, input=source, capture_output=True, text=True).stderr


@pytest.mark.skipif(COMPILER is None, reason="no g++ on this machine")
@pytest.mark.parametrize("header", HEADERS)
def test_each_header_compiles_alone(header):
    # Included, as the main file of a compilation has no use for `#pragma once`.
    assert faults(f'#include "{header}"\n') == ""


@pytest.mark.skipif(COMPILER is None, reason="no g++ on this machine")
def test_a_name_that_is_not_declared_is_found():
    assert "missing" in faults('#include "team.h"\nint wrong(Team t) { return t.missing; }\n')


def test_headers_lie_in_the_wheel():
    with (ROOT / "pyproject.toml").open("rb") as file:
        build = tomllib.load(file)["tool"]["hatch"]["build"]
    # Every file of these folders that git does not ignore; nothing is left out by its name.
    assert build["targets"]["wheel"] == {"packages": ["jaxdet", "kernels/jaxdet_kernels"]}
    assert build.keys() == {"dev-mode-dirs", "targets"}
    assert FOLDER.relative_to(ROOT).as_posix() == "kernels/jaxdet_kernels/native"
    ignored = (ROOT / ".gitignore").read_text("utf-8").split("\n")
    assert {Path(name).suffix for name in HEADERS} == {".h"}
    assert not [line for line in ignored if "native" in line or line.endswith(".h")]


def test_each_header_is_used_and_each_twin_is_there():
    files = [*FOLDER.glob("*.h"), *FOLDER.parent.glob("*.py")]
    texts = [path.read_text("utf-8") for path in files]
    used = {name for text in texts for name in re.findall(r'"(\w+\.h)"', text)}
    assert used == set(HEADERS)
    twins = {name for text in texts for name in re.findall(r"jaxdet/\w+(?:/\w+)*\.py", text)}
    assert {name for name in twins if not (ROOT / name).is_file()} == set()
    assert twins


def test_kernels_get_the_structs_without_includes():
    text = native("grid.h", body="return 1;")
    assert text.index("struct Team") < text.index("struct Rows") < text.index("return 1;")
    assert "#include" not in text
    assert "#pragma once" not in text


def constant(header: str, name: str) -> int:
    """A number of an enum."""
    found = re.search(rf"\b{name} = (\d+)\b", (FOLDER / header).read_text(encoding="utf-8"))
    assert found, f"{header} has no {name}"
    return int(found[1])


def test_constants_agree() -> None:
    """Scratch memory is as large as the kernels take it for."""
    assert obstacles.MAX_SURFACES == MAX_SURFACES
    assert obstacles.MAX_LABELS == MAX_LABELS
    tile = align.TILE_BLOCK, align.TILE_ROWS, align.TILE_COLUMNS
    assert tile == tuple(
        constant("alignment.h", name) for name in ("THREADS", "TILE_ROWS", "TILE_COLUMNS")
    )
    assert constant("alignment.h", "FEW") + constant("alignment.h", "WIDE") == align.SPARE
    assert constant("projection.h", "PARAMETERS") == align.PARAMETERS
    assert constant("floor_frame.h", "VALUES") == FLOOR_VALUES
    assert constant("floor_frame.h", "BITS") == FRAME_BITS
    for header in ("floor.h", "surfaces.h", "obstacle_cells.h"):
        assert constant(header, "MARGIN") == MARGIN
