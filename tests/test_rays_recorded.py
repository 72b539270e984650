"""Rays on recordings: they pass no obstacle and keep the free floor of columns."""

from pathlib import Path

import pytest

from benchmarks.free_rays import Figures, of_log
from jaxdet.presets import preset

OTHERS = "mcap_real"
"""Folder of logs without depth images."""


def figures_of(shared_data: Path, names: list[str]) -> Figures:
    found = [of_log(str(shared_data / name), preset("tabletop" if "mosd" in name else "wheeled"))
             for name in names]  # fmt: skip
    return Figures(*(sum(column) for column in zip(*found, strict=True)))


@pytest.mark.parametrize("name", ["bowls_gemini", "lounge_sun3d", "office_mannequin"])
def test_rays_pass_no_contour_and_no_pixel_above_the_step(shared_data: Path, name: str) -> None:
    found = figures_of(shared_data, [f"frames/{name}/{name}.mcap"])
    assert found.rays > 50
    assert (found.past_contour, found.past_pixel) == (0, 0)


@pytest.mark.slow
def test_rays_of_all_recordings_keep_the_free_floor(shared_data: Path) -> None:
    names = [str(path.relative_to(shared_data)) for path in sorted(shared_data.rglob("*.mcap"))]
    found = figures_of(shared_data, [name for name in names if OTHERS not in name])
    assert found.frames >= 100 and found.rays > 25_000
    assert (found.past_contour, found.past_pixel) == (0, 0)
    assert found.kept_m >= 0.95 * found.right_m
