"""Decompression bombs end quickly, with little memory and a clear error."""

import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from tests.bombs import BOMBS
from tests.io_helpers import write_log

MOST_S, MOST_MIB = 10, 1024
"""Limits of a process: CPU time [s] and memory [MiB]."""
SAID = {
    "schema_memory": "",
    "schema_text": "schema .* has 14155787 bytes",
    "schema_comment": "messages can't be decoded",
    "schema_fields": "more than the maximum of 10000",
    "many_topics": "InputError.*at least 60005 topics",
    "empty_images": "InputError.* messages or more in",
    "tiny_images": "InputError.* messages or more in",
    "empty_transforms": "InputError.* messages or more in",
    "one_large_transform": "/tf: 1 of 1 messages can't be decoded",
    "many_messages": "InputError.* messages or more in",
    "empty_records": "damaged or torn record",
    "empty_records_inside": "chunk has invalid records",
    "summary_bomb": "missing messages can't be counted",
    "many_chunk_indexes": "chunk of the index is missing",
    "rvl_tail": "decode_error",
    "rvl_pixels": "5700x5700, but their calibration is for 32x24",
    "image_pixels": "Error",
    "deep_json": "messages can't be decoded",
    "wide_json": "messages can't be decoded",
    "jpeg_scans": "no_color",
}
"""Patterns of the expected error messages, by bomb."""

READ = """
import sys, time
from jaxdet.errors import JaxdetError
from jaxdet.io import open_log

def peak():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024

def read(path):
    with open_log(path) as log:
        message = [*log.description.warnings, *(f.text for f in log.description.integrity)]
        message += [topic.problem for topic in log.description.topics]
        for batch in log.batches(8, color=True, need_color=True):
            message += [f"{status} {text}" for status, text in zip(batch.status, batch.errors)]
    return " | ".join(dict.fromkeys(message))

plain, *paths = sys.argv[1:]
read(plain)
for path in paths:
    before, start = peak(), time.process_time()
    try:
        message = read(path)
    except JaxdetError as error:
        message = f"{type(error).__name__} {error}"
    print(time.process_time() - start, peak() - before, message)
"""
LARGE = {"schema_memory", "empty_transforms", "many_messages", "many_chunk_indexes", "rvl_tail"}
"""Bombs that take seconds in spite of the limits."""


def check(folder: Path, names: Iterable[str]) -> None:
    plain, names = write_log(folder / "plain.mcap"), sorted(names)
    paths = [BOMBS[name](folder / f"{name}.mcap") for name in names]
    command = [sys.executable, "-c", READ, str(plain), *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    for name, line in zip(names, done.stdout.splitlines(), strict=True):
        seconds, mib, message = line.split(" ", 2)
        assert float(seconds) < MOST_S and float(mib) < MOST_MIB, (name, line)
        assert re.search(SAID[name], message), (name, message)
        assert "\n" not in message and message.isprintable()


def test_decompression_bombs_end_quickly_with_an_error(tmp_path):
    check(tmp_path, BOMBS.keys() - LARGE)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(LARGE))
def test_large_decompression_bombs_end_within_seconds(tmp_path, name):
    check(tmp_path, [name])
