"""A few hundred logs damaged at random; ``scripts/fuzz logs`` continues with other seeds."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from jaxdet.io import mcap_file
from jaxdet.io.file_index import FileIntegrity
from tests.fuzz.formats import FORMATS
from tests.fuzz.logs import Logs
from tests.fuzz.mutations import MUTATIONS

SEEDS = 200
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory):
    return Logs(tmp_path_factory.mktemp("fuzz"))


def test_damaged_logs_give_right_frames_or_a_clear_error(fuzzer):
    found, failed, tried = Counter(), [], set()
    for seed in range(SEEDS):
        title, verdict, _ = fuzzer.one(seed)
        found[verdict.kind] += 1
        tried |= set(title.split()[:2])
        if verdict.failed:
            failed.append((title, verdict))
    assert not failed
    assert tried == {*FORMATS, *(name for ways in MUTATIONS.values() for name in ways)}
    kinds = {"clean", "lost", "error", "unseen", "frames"}  # repeated images count once
    assert kinds <= found.keys() <= {*kinds, "unchanged", "doubled"}


def test_a_wrong_pixel_or_a_frame_lost_silently_is_a_failure(fuzzer, monkeypatch):
    with monkeypatch.context() as patch:
        plain = mcap_file.read_chunk_head
        unchecked = lambda data, size: plain(data, size)._replace(crc=0)  # noqa: E731
        patch.setattr(mcap_file, "read_chunk_head", unchecked)
        assert any(fuzzer.one(seed).verdict.kind == "wrong pixels" for seed in range(60))
    with monkeypatch.context() as patch:
        patch.setattr(FileIntegrity, "recovered", False)
        assert any(fuzzer.one(seed).verdict.kind == "silently lost" for seed in range(60))


@pytest.mark.parametrize(
    ("subject", "count", "ways"),
    [
        ("calibrations", 12, ("clean", "error", "frames")),
        ("calls", 200, ("clean", "error")),
        ("results", 12, ("clean", "error")),
        ("stops", 3, ("interrupted",)),
    ],
)
def test_fuzzing_of_other_inputs_finds_no_failures(tmp_path, subject, count, ways):
    """Each subject runs in its own process, so that crashes are noticed."""
    command = ["tests.fuzz.run", subject, "--count", f"{count}", "--corpus", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stderr and "Warning" not in done.stderr
    assert done.stdout.startswith(f"{count} {subject} in ")
    assert all(f"'{way}': " in done.stdout for way in ways)
