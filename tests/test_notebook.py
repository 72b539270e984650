"""Representations for notebooks, pandas tables, and configurations from dictionaries."""

import numpy as np
import pytest

import jaxdet
from jaxdet.config import Config
from jaxdet.config_file import find_config
from jaxdet.errors import ConfigError
from jaxdet.notebook import MOST_ROWS, table
from jaxdet.presets import preset

WALL, NOTHING = np.full((60, 80), 2000, np.uint16), np.zeros((60, 80), np.uint16)


@pytest.fixture(scope="module")
def found() -> jaxdet.BatchResult:
    detector = jaxdet.Detector([500.0, 500.0, 40.0, 30.0], backend="reference")
    return detector.batch(np.stack([NOTHING, WALL]))


def test_html_tables_are_escaped_and_have_a_maximum_length():
    html = table("<b>", {"a": ["<script>"] * (MOST_ROWS + 3), "b": [0.5] * (MOST_ROWS + 3)})
    assert "<script>" not in html and "&lt;script&gt;" in html
    assert html.count("<td>0.50</td>") == MOST_ROWS and "and 3 more" in html


def test_a_batch_is_shown_as_a_table_of_frames(found):
    html = found._repr_html_()
    assert "<td>no_depth</td>" in html and "<td>~2.00 m</td>" in html


def test_obstacles_convert_to_a_pandas_table(found):
    pytest.importorskip("pandas")
    rows = found.to_pandas()
    assert rows.frame.tolist() == [1] * len(found[1]) and len(rows) > 0
    assert rows.distance_m.tolist() == [one.distance_m for one in found[1]]
    assert rows[["u_min", "v_min", "u_max", "v_max"]].iloc[0].tolist() == list(found[1][0].box)
    assert found[0].to_pandas().columns.tolist() == rows.columns.tolist()[1:]


def test_a_preset_accepts_parameters_and_sections():
    one = preset("d435", max_depth_m=3, cell_rad=0.01)
    assert one.ground.max_depth_m == 3.0 and one.surface.cell_rad == 0.01
    assert one.ground.min_depth_m == preset("d435").ground.min_depth_m
    mounted = preset("wheeled", camera_height_m=0.4, camera_pitch="10deg").ground
    assert (mounted.camera_height_m, round(mounted.camera_pitch_rad, 2)) == (0.4, 0.17)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"max_dept_m": 3}, "max_depth_m"),
        ({"min_cells": 3}, "name the section"),
        ({"ground": 3}, "expected a dictionary"),
        ({"max_depth_m": "far"}, "must be a number"),
        ({"ground": {"colour": 1}}, "unknown key 'colour'"),
    ],
)
def test_invalid_parameters_are_named(changes, says):
    with pytest.raises(ConfigError, match=says):
        preset("d435", **changes)


def test_a_dictionary_is_accepted_as_configuration():
    given = {"preset": "d435", "ground": {"max_depth_m": 3.0}}
    assert find_config(given) == preset("d435", max_depth_m=3.0)
    assert find_config({}) == Config() and given["preset"] == "d435"
    with pytest.raises(ConfigError, match="unknown section"):
        find_config({"grund": {}})
    detector = jaxdet.Detector([500.0, 500.0, 40.0, 30.0], config=given, backend="reference")
    assert detector.config.ground.max_depth_m == 3.0
