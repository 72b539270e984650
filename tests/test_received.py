"""Results from others: tables with nulls or NaN, links in place of files."""

import json
import shutil
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxdet.cli import main
from jaxdet.results.manifest import write_manifest
from tests.export_results import sim_log
from tests.runs import run_logs


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return results of a log, with tracks."""
    folder = tmp_path_factory.mktemp("received")
    results = folder / "results"
    run_logs([sim_log(folder / "a.mcap", seed=0)], results, pictures=0)
    assert main(["track", str(results), "-q"]) == 0
    return results


def rewrite(table: Path, column: str, value: pa.Scalar, nullable: bool) -> None:
    """Put a value in the first row of a column."""
    rows = pq.read_table(table)
    at, kind = rows.schema.get_field_index(column), rows.schema.field(column)
    values = pa.array([value.as_py(), *rows[column].to_pylist()[1:]], kind.type)
    rows = rows.set_column(at, kind.with_nullable(nullable), values)
    pq.write_table(rows, table)


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        (
            "moving",
            pa.scalar(None, pa.bool_()),
            "column moving is missing, or not",
        ),
        ("max_speed_mps", pa.scalar(float("nan"), pa.float32()), "is not finite"),
    ],
)
def test_values_that_no_run_writes_are_errors_of_one_line(
    tracked, tmp_path, capsys, column, value, says
):
    results = tmp_path / "results"
    shutil.copytree(tracked, results)
    rewrite(results / "a/tracks.parquet", column, value, not value.is_valid)
    page = tmp_path / "page.html"
    assert main(["export", str(results), "--to", "html", "--output", str(page)]) == 1
    error = capsys.readouterr().err
    assert says in error and "jaxdet itself" not in error and not page.exists()


def test_a_table_without_a_column_is_an_error_of_one_line(tracked, tmp_path, capsys):
    results = tmp_path / "results"
    shutil.copytree(tracked, results)
    table = results / "a/track_links.parquet"
    pq.write_table(pq.read_table(table).drop_columns(["frame"]), table)
    assert main(["export", str(results), "--to", "nav2", "--output", str(tmp_path / "map")]) == 1
    error = capsys.readouterr().err
    assert "column frame is missing" in error and "jaxdet itself" not in error


@pytest.mark.parametrize("column", ["path", "speed_mps"])
@pytest.mark.parametrize("change", [lambda values: values[:-1], lambda values: []])
def test_paths_must_have_as_many_points_as_speeds(tracked, tmp_path, capsys, column, change):
    results = tmp_path / "results"
    shutil.copytree(tracked, results)
    table = results / "a/tracks.parquet"
    rows = pq.read_table(table)
    at, lists = rows.schema.get_field_index(column), rows[column].to_pylist()
    field = rows.schema.field(column)
    changed = pa.array([change(lists[0]), *lists[1:]], field.type)
    pq.write_table(rows.set_column(at, field, changed), table)
    for form in ("html", "foxglove"):
        out = str(tmp_path / form)
        assert main(["export", str(results), "--to", form, "--output", out]) == 1
        error = capsys.readouterr().err
        assert "tracks.parquet: a path has not two numbers for each of its speeds" in error
        assert "jaxdet itself" not in error


def test_tracks_are_not_written_through_a_broken_link(tracked, tmp_path):
    results, outside = tmp_path / "results", tmp_path / "outside"
    shutil.copytree(tracked, results)
    table = results / "a/tracks.parquet"
    table.unlink()
    table.symlink_to(outside)
    manifest = json.loads((results / "a/manifest.json").read_text("utf-8"))
    own = ("files", "format", "sha256")  # values of the existing files
    write_manifest(results / "a", {k: v for k, v in manifest.items() if k not in own})
    main(["track", str(results), "-q"])
    assert not outside.exists()


def test_inputs_in_a_received_manifest_are_checked(tracked, tmp_path, capsys):
    results = tmp_path / "results"
    shutil.copytree(tracked, results)
    manifest = json.loads((results / "a/manifest.json").read_text("utf-8"))
    own = ("files", "format", "sha256")
    content = {name: value for name, value in manifest.items() if name not in own}
    write_manifest(results / "a", content | {"inputs": ["drive.mcap"]})
    assert main(["verify", str(results)]) == 1
    message = capsys.readouterr()
    assert "inputs[0] must be dict" in message.out and "jaxdet itself" not in message.err
