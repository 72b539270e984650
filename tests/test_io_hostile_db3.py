"""Crafted SQLite bags that would take much time or memory are clear errors."""

import sqlite3
import time
import tracemalloc
from contextlib import closing
from pathlib import Path

import pytest

from jaxdet.errors import InputError, JaxdetError
from jaxdet.io import open_log
from tests.io_helpers import convert_log, write_log

ENDLESS = "WITH RECURSIVE n(i) AS (VALUES(0) UNION ALL SELECT i + 1 FROM n)"
TOPICS = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
)
MESSAGES = "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)"
IMAGE = "sensor_msgs/msg/Image"
HOSTILE = {
    "endless messages": [
        TOPICS,
        f"CREATE VIEW messages AS {ENDLESS} SELECT i AS id, 1 AS topic_id, i AS timestamp, "
        "zeroblob(9) AS data FROM n",
    ],
    "endless topics": [
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data BLOB)",
        f"CREATE VIEW topics AS {ENDLESS} SELECT i AS id, 'a' AS name, 'b' AS type, "
        "'cdr' AS serialization_format FROM n",
    ],
    "generated blobs": [
        TOPICS,
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, "
        "data BLOB AS (zeroblob(900000000)))",
        "INSERT INTO messages(id, topic_id, timestamp) VALUES(1, 1, 1)",
    ],
    "generated times": [
        TOPICS,
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, data BLOB, "
        "timestamp INTEGER AS (length(hex(zeroblob(400000000)))))",
        "INSERT INTO messages(id, topic_id, data) VALUES(1, 1, x'00')",
    ],
    "no tables": ["CREATE TABLE other(id)"],
    "many topics": [
        TOPICS,
        MESSAGES,
        f"INSERT INTO topics {ENDLESS} SELECT i, '/t' || i, '{IMAGE}', 'cdr' FROM n LIMIT 300000",
    ],
    "many image topics": [
        TOPICS,
        MESSAGES,
        f"INSERT INTO topics {ENDLESS} SELECT i, '/t' || i, '{IMAGE}', 'cdr' FROM n LIMIT 9000",
        f"INSERT INTO messages {ENDLESS} SELECT i, i % 9000, i, x'00' FROM n LIMIT 20000",
    ],
    "many images": [
        TOPICS,
        MESSAGES,
        f"INSERT INTO topics VALUES(1, '/a', '{IMAGE}', 'cdr')",
        f"INSERT INTO messages {ENDLESS} SELECT i, 1, i, x'' FROM n LIMIT 300000",
    ],
    "many tables": [
        TOPICS,
        MESSAGES,
        "PRAGMA writable_schema = ON",
        f"INSERT INTO sqlite_master {ENDLESS} SELECT 'table', 'x' || i, 'x' || i, 2, "
        "'CREATE TABLE x' || i || '(a)' FROM n LIMIT 20000",
    ],
}


@pytest.mark.parametrize("name", HOSTILE)
def test_crafted_tables_are_clear_errors(tmp_path: Path, name: str):
    path = tmp_path / "x.db3"
    with closing(sqlite3.connect(path)) as file, file:
        for text in HOSTILE[name]:
            file.execute(text)
    ends_in_a_line(path)


def test_a_recording_without_its_write_ahead_log_names_it(tmp_path: Path):
    path = tmp_path / "x.db3"
    with closing(sqlite3.connect(tmp_path / "y.db3")) as file:
        for text in ("PRAGMA journal_mode = WAL", "PRAGMA wal_autocheckpoint = 0", TOPICS):
            file.execute(text)
        path.write_bytes((tmp_path / "y.db3").read_bytes())
    with pytest.raises(InputError, match=r"if its recorder was stopped, copy x\.db3-wal with it"):
        open_log(str(path))


@pytest.mark.parametrize(
    "definitions",
    [
        f"CREATE VIEW message_definitions AS {ENDLESS} SELECT i AS id, 'a' AS topic_type, "
        "'b' AS encoding, 'c' AS encoded_message_definition FROM n",
        None,
    ],
)
def test_malformed_definitions_are_ignored(tmp_path: Path, definitions: str | None):
    path = convert_log(write_log(tmp_path / "x.mcap"), tmp_path / "db")
    with closing(sqlite3.connect(path)) as file, file:
        file.execute("DROP TABLE message_definitions")
        if definitions:
            file.execute(definitions)
    with open_log(str(path)) as log:
        assert log.num_frames == 3


def test_a_huge_message_is_reported_as_damage(tmp_path: Path):
    path = convert_log(write_log(tmp_path / "x.mcap"), tmp_path / "db")
    with closing(sqlite3.connect(path)) as file, file:
        file.execute("UPDATE messages SET data = zeroblob(300000000) WHERE id = 3")
    ends_in_a_line(path, also_read=True)


@pytest.mark.parametrize("column", ["name", "type"])
def test_huge_texts_of_topics_are_not_read(tmp_path: Path, column: str):
    path = convert_log(write_log(tmp_path / "x.mcap"), tmp_path / "db")
    with closing(sqlite3.connect(path)) as file, file:
        file.execute(f"UPDATE topics SET {column} = printf('%.*c', 100000000, 'x') WHERE id <= 3")
    ends_in_a_line(path)


def ends_in_a_line(path: Path, also_read: bool = False) -> None:
    tracemalloc.start()
    begin = time.monotonic()
    try:
        with open_log(str(path)) as log:
            assert also_read and [batch.status for batch in log.batches(4)]
    except JaxdetError as error:
        assert "\n" not in str(error) and path.name in str(error)
    finally:
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert time.monotonic() - begin < 10 and most < 256 << 20
