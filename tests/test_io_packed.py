"""Compressed recordings are read through a decompressed copy; errors name the compressed file."""

import bz2
import gzip
import os
import sqlite3
import subprocess
import sys
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import zstandard

from jaxdet.errors import InputError, JaxdetError
from jaxdet.io import Log, find_logs, open_log
from tests.io_helpers import Scene, convert_log, make_scene, write_log

SCENE = make_scene(40)
FORMS = ("mcap", "db3", "bag")
ZSTD = zstandard.ZstdCompressor().compress
BZIP2 = partial(bz2.compress, compresslevel=1)  # in blocks of 100 kB
KILLED_WORKER = """
import multiprocessing, os, sys, tempfile
from jaxdet.io import open_log

def work(path):
    open_log(path)
    os._exit(1)

if __name__ == "__main__":
    worker = multiprocessing.get_context("spawn").Process(target=work, args=sys.argv[1:])
    worker.start()
    worker.join()
    print(os.listdir(tempfile.gettempdir()))
"""
PACK = {".zstd": ZSTD, ".zst": ZSTD, ".bz2": BZIP2, ".gz": gzip.compress}


def write(folder: Path, form: str) -> Path:
    """Write 40 frames in one of ``FORMS``, in small chunks."""
    mcap = write_log(folder / "drive.mcap", SCENE, chunk_size=6000)
    if form == "mcap":
        return mcap
    found = convert_log(mcap, folder / ("drive" if form == "db3" else "drive.bag"))
    mcap.unlink()
    return found


def packed_file(source: Path, ending: str) -> Path:
    target = source.with_name(source.name + ending)
    target.write_bytes(PACK[ending](source.read_bytes()))
    source.unlink()
    return target


def cut(path: Path, share: float) -> Path:
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * share)])
    return path


def depths(log: Log) -> np.ndarray:
    return log.read(range(log.num_frames)).frames.depth


@pytest.mark.parametrize("ending", PACK)
@pytest.mark.parametrize("form", FORMS)
def test_compressed_files_are_read(tmp_path, form, ending):
    packed = packed_file(write(tmp_path, form), ending)
    with open_log(str(packed)) as log:
        assert log.name == "drive"
        np.testing.assert_array_equal(depths(log), SCENE.depth)
    [found] = find_logs([packed.parent])
    assert found.paths == (packed,) and found.name == "drive"


@pytest.mark.parametrize("ending", PACK)
@pytest.mark.parametrize("form", FORMS)
def test_files_are_read_by_their_content_not_their_suffix(tmp_path, form, ending):
    packed = packed_file(write(tmp_path, form), ending)
    for name in ("x.mcap", "x.bag", "x.db3", "x", f"x{ending}"):
        with open_log(str(packed.rename(packed.with_name(name)))) as log:
            np.testing.assert_array_equal(depths(log), SCENE.depth)
        packed = packed.with_name(name)


def test_compressed_splits_are_one_recording(tmp_path):
    for number, rows in enumerate((slice(0, 20), slice(20, 40))):
        part = Scene(*(values[rows] for values in SCENE))
        packed_file(write_log(tmp_path / f"run_{number}.mcap", part), ".zstd")
    with open_log(str(tmp_path)) as log:
        assert log.name == "run"
        np.testing.assert_array_equal(depths(log), SCENE.depth)


@pytest.mark.parametrize("ending", PACK)
def test_bombs_are_clear_errors(tmp_path, ending):
    bomb = tmp_path / f"bomb.mcap{ending}"
    bomb.write_bytes(PACK[ending](bytes(80 << 20)))
    with pytest.raises(InputError, match=r"bomb.*exceeds \d+MiB"):
        open_log(str(bomb))


@pytest.mark.parametrize("ending", PACK)
@pytest.mark.parametrize("form", ["mcap", "db3"])
def test_frames_before_the_end_of_a_truncated_compressed_file_are_read(tmp_path, form, ending):
    packed = cut(packed_file(write(tmp_path, form), ending), 0.75)
    with open_log(str(packed)) as log:
        assert 8 < log.num_frames < 40
        np.testing.assert_array_equal(depths(log), SCENE.depth[: log.num_frames])
        warnings = log.description.warnings
    assert any("compressed file is truncated or damaged (Truncated" in text for text in warnings)
    assert all(str(packed) in text for text in warnings if "drive" in text)


@pytest.mark.parametrize("ending", PACK)
def test_a_truncated_compressed_bag_names_the_truncation(tmp_path, ending):
    packed = cut(packed_file(write(tmp_path, "bag"), ending), 0.75)
    with pytest.raises(InputError) as error:
        open_log(str(packed))
    assert str(error.value).startswith(f"{packed}: the compressed file is truncated or damaged (")
    assert "reindex" not in str(error.value)


@pytest.mark.parametrize("form", ["db3", "bag"])
def test_errors_name_the_compressed_file(tmp_path, form):
    packed = packed_file(cut(write(tmp_path, form), 0.03), ".zst")
    with pytest.raises(JaxdetError) as error:
        open_log(str(packed))
    assert str(packed) in str(error.value) and "jaxdet-unpacked" not in str(error.value)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("ending", ["", ".zst"])
def test_bytes_after_the_end_are_reported(tmp_path, form, ending):
    path = write(tmp_path, form)
    path.write_bytes(path.read_bytes() + bytes(4096))
    path = packed_file(path, ending) if ending else path
    with open_log(str(path)) as log:
        np.testing.assert_array_equal(depths(log), SCENE.depth)
        text = f"{path}: 4096 bytes after the end of the recording are not read"
        assert log.description.warnings == (text,)


def test_a_compressed_database_without_tables_is_named(tmp_path):
    with closing(sqlite3.connect(tmp_path / "x.db3")) as file, file:
        file.execute("CREATE TABLE other(id)")
    packed = packed_file(tmp_path / "x.db3", ".zstd")
    with pytest.raises(InputError, match=rf"{packed}: not a rosbag2 recording"):
        open_log(str(packed))


def test_copies_of_killed_workers_are_removed(tmp_path):
    packed = packed_file(write(tmp_path, "mcap"), ".zst")
    script, folder = tmp_path / "x.py", tmp_path / "tmp"
    script.write_text(KILLED_WORKER)
    folder.mkdir()
    shown = subprocess.check_output(
        [sys.executable, "-P", str(script), str(packed)],
        env={**os.environ, "TMPDIR": str(folder)},
        text=True,
    )
    assert "jaxdet-unpacked-" in shown and not [*folder.iterdir()]
