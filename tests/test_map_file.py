"""Maps of nav2's map_server: read by its rules, written, and compared with obstacles."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from jaxdet.cli import main
from jaxdet.errors import InputError
from jaxdet.results.map_file import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    Grid,
    KnownPlaces,
    read_map,
    write_map,
)

GREYS = np.array([[0, 89, 90, 204], [205, 206, 254, 255]], np.uint8)
ABOUT = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[-1.0, 2.0, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def save(folder: Path, picture: np.ndarray = GREYS, **about: str | None) -> Path:
    """Write a map, without the keys whose value is None."""
    values = ABOUT | about
    lines = [f"{key}: {value}" for key, value in values.items() if value is not None]
    path = folder / "map.yaml"
    path.write_text("\n".join(lines) + "\n")
    image = values["image"] or "map.pgm"
    cv2.imwrite(str(folder / image), picture)
    return path


def nav2_states(greys: np.ndarray, negate: bool, occupied: float, free: float) -> list[list[int]]:
    """Return the states by the trinary mode of nav2_map_server, pixel by pixel."""
    rows = []
    for line in greys[::-1].tolist():
        rows.append([])
        for grey in line:
            shade = grey / 255
            occupancy = shade if negate else 1 - shade
            state = OCCUPIED if occupancy > occupied else FREE if occupancy < free else UNKNOWN
            rows[-1].append(state)
    return rows


@pytest.mark.parametrize("negate", [False, True])
@pytest.mark.parametrize("limits", [(0.65, 0.196), (0.65, 0.25), (0.5, 0.5), (1.0, 0.0)])
def test_trinary_maps_are_read_as_nav2_reads_them(
    tmp_path: Path, negate: bool, limits: tuple[float, float]
) -> None:
    greys = np.arange(256, dtype=np.uint8).reshape(8, 32)
    occupied, free = map(str, limits)
    path = save(
        tmp_path, greys, negate=str(int(negate)), occupied_thresh=occupied, free_thresh=free
    )
    grid = read_map(path)
    assert grid.states.tolist() == nav2_states(greys, negate, *limits)
    assert (grid.origin, grid.cell_m, grid.yaw) == ((-1.0, 2.0), 0.05, 0.0)


def test_colour_and_transparent_pictures_are_read_and_other_modes_refused(tmp_path: Path) -> None:
    pixels = np.zeros((1, 4, 4), np.uint8)
    pixels[0, :, :3] = [[0, 0, 0], [255, 255, 255], [0, 0, 0], [0, 255, 0]]
    pixels[0, :, 3] = 255, 255, 0, 255
    for mode in ("scale", "trinary"):
        grid = read_map(save(tmp_path, pixels, image="map.png", mode=mode))
        assert grid.states.tolist() == [[OCCUPIED, FREE, UNKNOWN, OCCUPIED]]
    raw = read_map(save(tmp_path, np.array([[0, 19, 20, 66, 100, 101, 255]], np.uint8), mode="raw"))
    o, f, u = OCCUPIED, FREE, UNKNOWN
    assert raw.states.tolist() == [[f, f, u, o, o, u, u]]
    deep = np.array([[0, 65535, 52685]], np.uint16)
    assert read_map(save(tmp_path, deep, image="map.png")).states.tolist() == [[o, f, u]]


def test_yaml_of_other_programs_is_read(tmp_path: Path) -> None:
    """Such YAML has comments, quotes, multi-line lists and additional keys."""
    save(tmp_path)
    (tmp_path / "map.yaml").write_text(
        "# a map\nimage: 'map.pgm'  # next to it\nresolution: 0.05\norigin:\n  - -1.0\n"
        "  - 2\n  - 0.5\nnegate: false\noccupied_thresh: 6.5e-1\nfree_thresh: .196\nmore: {a: 1}\n"
    )
    grid = read_map(tmp_path / "map.yaml")
    assert (grid.origin, grid.yaw) == ((-1.0, 2.0), 0.5) and grid.states.shape == (2, 4)


@pytest.mark.parametrize("suffix", [".pgm", ".png"])
def test_written_maps_are_read_back(tmp_path: Path, suffix: str) -> None:
    states = np.random.default_rng(0).choice([OCCUPIED, FREE, UNKNOWN], (7, 11)).astype(np.int8)
    grid = Grid(states, (-3.25, 1e3), 0.02, -2.5)
    write_map(tmp_path / f"m{suffix}", grid, "log\nimage: other", "odom")
    read = read_map(tmp_path / "m.yaml")
    np.testing.assert_array_equal(read.states, states)
    assert read[1:] == grid[1:]


HEADS = {
    b"P5\n99999 99999\n255\n": "99,999 x 99,999 pixels",
    b"P5\n0 4\n255\n": "0 x 4 pixels",
    b"P5\n4 4\n255\nab": "is damaged",
    b"P6\n4 4\n255\n": "is not a PGM or PNG",
    b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\1\0\0\0\1\0\0": "65,536 x 65,536 pixels",
    b"\x89PNG\r\n\x1a\n": "is not a PGM or PNG",
    b"": "is not a PGM or PNG",
}


@pytest.mark.parametrize("data", HEADS)
def test_bad_pictures_are_clear_errors(tmp_path: Path, data: bytes) -> None:
    path = save(tmp_path)
    (tmp_path / "map.pgm").write_bytes(data + b"\0\0\0\0\0" * (data[-2:] == b"\0\0"))
    with pytest.raises(InputError, match=HEADS[data]) as caught:
        read_map(path)
    assert "map.pgm: " in str(caught.value) and "\n" not in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(
    ("about", "problem"),
    [
        ({"image": None}, "lacks image"),
        ({"origin": "", "negate": None}, "lacks origin, negate"),
        ({"resolution": "nan"}, "resolution is out of range"),
        ({"resolution": "-0.05"}, "resolution is out of range"),
        ({"resolution": "five"}, "has an invalid value"),
        ({"origin": "[0, 0]"}, "origin is out of range"),
        ({"origin": "[inf, 0, 0]"}, "origin is out of range"),
        ({"origin": "[1e300, 0, 0]"}, "origin is out of range"),
        ({"negate": "maybe"}, "has an invalid value"),
        ({"mode": "ternary"}, "mode ternary is out of range"),
        ({"free_thresh": "0.9"}, "occupied_thresh and free_thresh"),
        ({"occupied_thresh": "nan"}, "occupied_thresh and free_thresh"),
    ],
)
def test_bad_yaml_is_a_clear_error(tmp_path: Path, about: dict, problem: str) -> None:
    path = save(tmp_path, **about)
    with pytest.raises(InputError, match=problem) as caught:
        read_map(path)
    assert "map.yaml: " in str(caught.value) and "\n" not in str(caught.value)
    assert "map_server" in caught.value.remedy


def test_missing_files_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = save(tmp_path)
    (tmp_path / "map.pgm").unlink()
    results = str(tmp_path / "results")
    for missing, name in ((path, "map.pgm"), (tmp_path / "none.yaml", "none.yaml")):
        assert main(["track", results, "--map", str(missing)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert name in line and "No such file" in line
    for data in (b"\xff\xfe", b"image: " + b"x" * (1 << 17)):
        path.write_bytes(data)
        with pytest.raises(InputError, match=r"map\.yaml"):
            read_map(path)
    path.write_text("".join(f"{k}: {v}\n" for k, v in (ABOUT | {"image": "a\0b"}).items()))
    with pytest.raises(InputError, match="can't be read"):
        read_map(path)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
def test_distances_to_the_map_equal_those_of_a_search_over_all_cells(yaw: float) -> None:
    """The distances agree within one cell."""
    rng = np.random.default_rng(1)
    states = np.where(rng.random((30, 40)) < 0.01, OCCUPIED, FREE).astype(np.int8)
    grid = Grid(states, (2.0, -3.0), 0.05, yaw)
    points = grid.world(rng.uniform(-10, 50, (400, 2)))
    np.testing.assert_allclose(grid.world(grid.places(points)), points, atol=1e-12)
    row, column = np.nonzero(states == OCCUPIED)
    middles = np.stack([column, row], axis=1) + 0.5
    for reach in (0.0, 0.12, 0.5):
        near = KnownPlaces(grid).near(points, np.full(len(points), reach))
        away = np.abs(grid.places(points)[:, None] - middles).max(axis=2).min(axis=1) * 0.05
        assert near[away < reach + 0.024].all() and not near[away > reach + 0.051].any()
        assert near.any() and not near.all()
    assert not KnownPlaces(grid).near(np.array([[np.nan, 0], [1e9, 0]]), np.ones(2)).any()


def test_only_points_inside_of_unknown_cells_of_a_map_are_unknown() -> None:
    states = np.array([[FREE, UNKNOWN], [OCCUPIED, FREE]], np.int8)
    known = KnownPlaces(Grid(states, (2.0, -3.0), 0.5))
    points = [(2.6, -2.9), (2.1, -2.9), (2.1, -2.4), (3.1, -2.9), (2.6, -3.1), (np.nan, -2.9)]
    assert known.is_unknown(np.array(points)).tolist() == [True, *[False] * 5]
