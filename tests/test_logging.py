"""Logging of runs under the name ``jaxdet``, and the level shown by the command."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

import jaxdet
from jaxdet.cli import main


@pytest.fixture(autouse=True)
def level() -> Iterator[None]:
    """Restore the level of the logger, which the command sets."""
    logger = logging.getLogger("jaxdet")
    before = logger.level
    yield
    logger.setLevel(before)


@pytest.mark.parametrize(
    ("flags", "info", "debug"),
    [
        ([], False, False),
        (["-v"], True, False),
        (["-vv"], True, True),
        (["-q", "-vv"], False, False),
    ],
)
def test_flags_set_the_logging_level(
    flags: list[str],
    info: bool,
    debug: bool,
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log, out = str(drive / "drive.mcap"), str(tmp_path / "out")
    args = ["--workers", "1", "--batch-size", "16", "--pictures", "0"]
    assert main(["run", log, "--output", out, *args, *flags]) == 0
    lines = capsys.readouterr().err.splitlines()
    done = [line for line in lines if line.startswith("jaxdet: drive: done, 5 frames, ")]
    assert len(done) == info and ("jaxdet: drive: 5 of 5 frames" in lines) == debug


def test_programs_that_use_jaxdet_receive_the_log_records(
    drive: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    logs = [drive / "drive.mcap", tmp_path / "empty.mcap"]
    with caplog.at_level(logging.INFO, "jaxdet"):
        jaxdet.run(logs, tmp_path / "out", pictures=0, workers=1)
    texts = [record.getMessage() for record in caplog.records if record.name == "jaxdet"]
    assert [text.partition(",")[0] for text in texts if "drive" in text] == ["drive: done"]
    (failed,) = [text for text in texts if text.startswith("empty: failed: ")]
    assert "empty.mcap" in failed
    caplog.clear()
    with caplog.at_level(logging.INFO, "jaxdet"):
        (tmp_path / "late.mcap").hardlink_to(drive / "drive.mcap")
        jaxdet.run([*logs, tmp_path / "late.mcap"], tmp_path / "out", pictures=0, workers=1)
    texts = [record.getMessage() for record in caplog.records if record.name == "jaxdet"]
    assert texts[0] == "continuing: 2 of 3 logs are done"


def test_warnings_are_shown_without_flags(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = ["--output", str(tmp_path / "out"), "--workers", "64", "--memory", "2GiB"]
    assert main(["run", str(drive / "drive.mcap"), *args, "--pictures", "0"]) == 0
    assert " of 64 workers: 2048MiB of memory have no room" in capsys.readouterr().err
