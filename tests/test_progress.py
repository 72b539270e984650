"""Progress of runs: rates, the slowest step, warnings and failures."""

import os
import re
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path

import pytest

from jaxdet.cli.progress import _bars, _Lines, _slowest, _steps, _text, _thousands, reporting
from jaxdet.cli.report import MANY_LOGS, ground_text, summary_lines
from jaxdet.cli.terminal import tell
from jaxdet.engine import GroundRecord, Progress
from jaxdet.results.summary import LogSummary, Summary, failure


def about(workers: int, devices: int, **busy_s: float) -> LogSummary:
    found = LogSummary("a", (), workers=workers, devices=devices)
    found.frames, found.busy_s = 1200, Counter(busy_s)
    return found


def test_rates_of_one_process_add_up_over_its_steps() -> None:
    found = about(2, 0, read=1.0, decode=4.0, compute=3.0, write=0.5)
    assert found.bottleneck == "decode"
    assert found.rates == {"read": 2400, "decode": 600, "compute": 800, "write": 4800}


def test_rates_of_gpus_and_workers_are_separate() -> None:
    busy = {"read": 10.0, "decode": 20.0, "write": 2.0, "wait": 90.0, "transfer": 1.0}
    assert about(16, 1, **busy, compute=1.9).bottleneck == "decode"
    assert about(16, 1, **busy, compute=2.1).bottleneck == "compute"
    assert about(16, 2, **busy, compute=2.1).bottleneck == "decode"
    assert about(16, 2, **busy, compute=2.1).rates["compute"] == pytest.approx(2400 / 2.1)


def test_no_step_is_slowest_before_the_first_frames() -> None:
    assert about(2, 0).bottleneck == "" and about(2, 0).rates == {}


def test_the_line_of_progress_shows_figures_computed_by_hand() -> None:
    found = about(16, 1, read=1.2, decode=19.2, transfer=0.02, compute=0.01, write=1.2, wait=9.0)
    state = found.bottleneck, found.rates
    now = Progress("a", 0, 1, 1200, 4000, 0, 950.04, *state)
    assert _text(now, _slowest) == "1200/4000 frames, 950/s, slowest: decode"
    assert _text(now, _steps) == (
        "1200/4000 frames, 950/s, slowest: decode 1.0k/s "
        "(read 16k, transfer 60k, compute 120k, write 16k)"
    )


def test_a_terminal_of_80_columns_shows_all_of_a_bar(monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("FORCE_COLOR", "1")
    found = about(16, 1, read=1.2, decode=19.2, compute=0.01, write=1.2)
    state = 1200, 4000, 17, 11_400.0, found.bottleneck, found.rates
    for name in ("drive", "rosbag2_2026_11_03-14_22_07_0_front_left"):
        for logs in (1, 300):
            with _bars() as show:
                show(Progress(name, 0, logs, *state, logs_done=100, logs_failed=10))
            plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", capsys.readouterr().err)
            assert name[:7] in plain
            many = "100/300 logs, 10 failed; " in plain and "1200/4000 frames" in plain
            assert many or "1200/4000 frames, 11k/s, slowest: decode, 17 not ok" in plain


def test_long_steps_are_reported_in_a_line(monkeypatch, capsys) -> None:
    lines = _Lines()
    for number in range(3):
        lines(Progress("a", 0, 40, 0, 0, 0, None, doing=f"{number} of 39 logs are done"))
        monkeypatch.setattr("jaxdet.cli.progress.LINE_EVERY_S", 0 if number == 0 else 99)
    assert capsys.readouterr().err == "0/40 logs; a: 1 of 39 logs are done\n"


def test_the_end_of_a_log_is_reported_once(capsys) -> None:
    lines = _Lines()
    for number, done in ((0, 20), (0, 20), (1, 0), (1, 20), (1, 20)):
        lines(Progress("ab"[number], number, 2, done, 20, 0, None))
    assert capsys.readouterr().err == "[1/2] a: 20/20 frames\n[2/2] b: 20/20 frames\n"
    for camera in ("front", "front", "back"):
        lines(Progress(f"a {camera}", 0, 1, 20, 20, 0, None))
    assert capsys.readouterr().err == "a front: 20/20 frames\na back: 20/20 frames\n"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no terminals on this system")
def test_a_closed_terminal_does_not_end_the_run(monkeypatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    ours, theirs = os.openpty()
    with os.fdopen(theirs, "w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with reporting(silent=False) as show:
            assert show
            show(Progress("a", 0, 2, 10, 20, 0, None))
            os.close(ours)
            for log in "aab":
                show(Progress(log, "ab".index(log), 2, 20, 20, 0, None))
        tell("and the lines after it")
        monkeypatch.undo()
        with suppress(OSError):
            terminal.close()


def test_each_log_has_a_line_and_equal_warnings_are_printed_once() -> None:
    logs = [LogSummary(f"drive_{number:03}", ()) for number in range(300)]
    for number, log in enumerate(logs):
        log.frames, log.obstacles, log.status = 10, number, Counter(ok=9, no_color=1)
        log.warnings = [*[f"of {number} alone"] * (number < 40), "no frame has depth"]
        log.notes = ["no map: no frame has a pose"]
    logs[7].error = "drive_007: torn"
    logs[8].short_rectangles = 3
    lines = summary_lines(Summary("jax", 16, logs, 20.0), Path("out"))
    assert lines[0].split() == ["log", "frames", "not", "ok", "status"]
    assert lines[1].split() == ["drive_007", "10", "1", "failed"]
    assert lines[13] == "and 288 more, see summary.json of each log"
    assert len(lines) == 14 + 12 + 1 + 2
    lines = summary_lines(Summary("jax", 16, logs, 20.0), Path("out"), every=True)
    assert len(lines) == 300 + 12 + 1 + 1 + 2
    assert lines[3] == "drive_003: 10 frames (9 ok, 1 no_color), 3 obstacles"
    assert lines[7] == "drive_007: failed after 10 frames"
    first = "drive_000, drive_001, drive_002 and 296 more"
    assert lines[300] == f"warning    {first}: no frame has depth"
    assert lines[301] == "warning    drive_000: of 0 alone"
    assert lines[312] == "warning    28 more, see summary.json of each log"
    assert lines[313] == f"note       {first}: no map: no frame has a pose"
    assert lines[-2].endswith("; 1 of 300 logs failed") and lines[-1] == "results: out (tables)"
    few = Summary("jax", 16, logs[:MANY_LOGS], 20.0)
    assert "  frames     10 (9 ok, 1 no_color)" in summary_lines(few, Path("out"))
    (line,) = [line for line in summary_lines(few, Path("out")) if "rectangles" in line]
    assert line.startswith("  rectangles 3 of 8 start more than 2 cm behind the nearest point")


def test_floors_found_only_per_frame_are_not_reported_as_unknown() -> None:
    searched = "each frame is searched alone; %d of 18 sampled frames show their floor"
    for count, text in ((18, "estimated per frame"), (0, "unknown")):
        record = GroundRecord("none", message=searched % count, frames_used=count)
        assert ground_text([record]) == f"{text} ({searched % count})"


@pytest.mark.parametrize(
    "rate, shown", [(0.21, "0.2"), (9.6, "9.6"), (42.0, "42"), (1540.0, "1.5k"), (97_400.0, "97k")]
)
def test_rates_are_rounded(rate: float, shown: str) -> None:
    assert _thousands(rate) == shown


@pytest.mark.parametrize(
    ("error", "text"),
    [
        ("/d/drive.mcap: torn", "/d/drive.mcap: torn"),
        ("/d/images/depth/1.png: torn", "/d/images/depth/1.png: torn"),
        ("/a/drive.mcap: the truth is of others", "d/drive: /a/drive.mcap: the truth is of others"),
        ("d/drive: KeyError: x", "d/drive: KeyError: x"),
        ("d/drive, frames 0 to 9: odd", "d/drive, frames 0 to 9: odd"),
        ("workers can't be started", "d/drive: workers can't be started"),
    ],
)
def test_a_failure_names_its_log(error: str, text: str) -> None:
    paths = ["/d/drive.mcap", "/d/images"]
    assert failure({"log": "d/drive", "paths": paths, "error": error}) == text
