"""Command line: help, exit codes, precedence of settings, standard output and error."""

import gc
import json
import math
import os
import re
import resource
import shutil
import subprocess
import sys
import typing
from dataclasses import fields
from pathlib import Path

import pytest

from jaxdet.cli import main
from jaxdet.cli.flags import read_defaults
from jaxdet.cli.help import pages
from jaxdet.cli.progress import reporting
from jaxdet.cli.run import RunCommand, first_time, parse
from jaxdet.cli.terminal import on_terminal
from jaxdet.config import Config
from jaxdet.engine import RunOptions
from jaxdet.engine.startup import Caches
from jaxdet.errors import ConfigError, OutputError
from jaxdet.io import LogOptions
from jaxdet.presets import PRESETS
from jaxdet.sim import SimConfig, load_truth, write_log
from tests.test_workers import same_results

Captured = pytest.CaptureFixture[str]
PITCH = ("--ground.camera-height-m", "0.3", "--ground.camera-pitch")


@pytest.fixture(scope="module")
def sim_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli") / "sim.mcap"
    write_log(path, SimConfig(frames=2, width=160, height=120))
    return path


def test_help_names_every_command(capsys: Captured) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert all(f"\n  {name} " in text for name in ("run", "info", "sim", "doctor"))
    assert main([]) == 2


@pytest.mark.parametrize("command", ["run", "info", "sim", "doctor"])
@pytest.mark.parametrize("flag", ["-h", "--help", "--help-all"])
def test_each_command_has_help(command: str, flag: str, capsys: Captured) -> None:
    assert main([command, flag]) == 0
    assert f"usage: jaxdet {command}" in capsys.readouterr().out


def test_help_of_run_lists_presets_and_every_parameter(capsys: Captured) -> None:
    main(["run", "--help-all"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert ", ".join(PRESETS) in text
    for flag in ("--cluster.depth-gap-m", "--features.max-corners", "--log.color-from-depth"):
        assert flag in text


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the terminal wide enough for the full width of the help."""
    monkeypatch.setenv("COLUMNS", "120")


def test_help_is_short_and_help_all_is_complete(capsys: Captured) -> None:
    for command, most in (("run", 64), ("info", 34), ("sim", 34)):
        main([command, "--help"])
        brief = capsys.readouterr().out
        assert len(brief.splitlines()) <= most
        assert max(map(len, brief.splitlines())) <= 100
        main([command, "--help-all"])
        whole = capsys.readouterr().out
        flags = set(re.findall(r"^  (--[\w.-]+)", brief, re.M)) - {"--help-all"}
        assert len(flags) > 5
        assert [flag for flag in flags if flag not in whole] == []


@pytest.mark.parametrize("columns", [1, 40, 80, 200])
def test_help_is_as_wide_as_the_terminal(
    columns: int, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    main(["sim", "--help-all"])
    text = capsys.readouterr().out
    lines = [line for line in text.splitlines() if "{" not in line and not line.startswith("  -")]
    wide = max(map(len, lines))
    assert wide <= max(min(columns, 100), 50) and wide > min(columns, 100) - 12
    assert "Number of colour frames" in text and text.startswith("usage: jaxdet sim PATH [OPTIONS]")


def test_short_flags_equal_long_ones(tmp_path: Path, capsys: Captured) -> None:
    command = parse(["-q", "a", "-o", "x", "-y", "b", "--", "-o", "--c_d"])
    assert command.logs == ("a", "b", "-o", "--c_d")
    assert (command.output, command.run.overwrite, command.quiet) == (Path("x"), True, True)
    assert parse(["a", "-o=x"]).output == Path("x")
    main(["run", "--help"])
    text = capsys.readouterr().out
    assert "\n  -o, --output DIR  " in text and "\n  -y, --overwrite  " in text
    assert "\n  -q, --quiet  " in text
    for name in ("track", "sim", "export"):
        main([name, "--help"])
        assert ("-q, --quiet  " in (out := capsys.readouterr().out)) == (name != "export")
        assert ("-o, --output PATH  " in out) == (name == "export")
    log = tmp_path / "a.mcap"
    for args in (["-q"], ["-qy"], ["-q", "-y"]):
        code = main(["sim", str(log), "--frames", "1", "--width", "64", "--height", "48", *args])
        assert code == (2 if args == ["-qy"] else 0)
    assert "unknown flag -qy; see" in capsys.readouterr().err


def test_progress_on_a_dumb_terminal_is_printed_in_complete_lines(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Terminals such as Emacs' shell cannot overwrite a line."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert on_terminal()
    monkeypatch.setenv("TERM", "dumb")
    assert not on_terminal()
    with reporting(False) as progress:
        assert type(progress).__name__ == "_Lines"


def test_short_help_of_sim_refers_to_the_list_of_scenes(capsys: Captured) -> None:
    main(["sim", "--help"])
    assert re.search(r"--help-all lists more scenes", capsys.readouterr().out)


def test_help_of_run_explains_the_formats_of_times(capsys: Captured) -> None:
    main(["run", "--help"])
    out = capsys.readouterr().out
    assert "12.5s into the log, at 2024-05-01T10:00:00Z, or at a stamp [ns]" in out


def test_help_shows_angles_in_degrees(capsys: Captured) -> None:
    main(["sim", "--help"])
    text = capsys.readouterr().out
    assert "[10deg]" in text and "rad]" not in text


def test_help_command_shows_commands_and_pages(capsys: Captured) -> None:
    assert main(["track", "--help"]) == 0
    want = capsys.readouterr().out
    assert main(["help", "track"]) == 0
    assert capsys.readouterr().out == want
    assert main(["help"]) == 0
    listed = capsys.readouterr().out
    assert all(f"\n  {name} " in listed for name in ("logs", "api", "run", "doctor"))


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("jaxdet ", {"run", "export", "--version"}),
        ("jaxdet in", {"info"}),
        ("jaxdet export results --to f", {"foxglove"}),
        ("jaxdet run drive.mcap --preset ", {"wheeled", "d435", "zed"}),
        ("jaxdet run drive.mcap --preset=d4", {"d435", "d455"}),
        ("jaxdet export results --to=", {"foxglove", "html"}),
        ("jaxdet run drive.mcap --ground.camera-p", {"--ground.camera-pitch"}),
        ("jaxdet run drive.mcap --quiet --outp", {"--output"}),
        ("jaxdet run drive.mcap -", {"-o", "-q", "--output", "--quiet"}),
        ("jaxdet run drive.mcap --output ", set()),
        ("jaxdet run ", set()),
        ("jaxdet help cal", {"calibration"}),
        ("jaxdet fly --", set()),
    ],
)
def test_the_last_word_of_a_command_is_completed(
    line: str, offered: set[str], capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COMP_LINE", line + " --quiet")
    monkeypatch.setenv("COMP_POINT", str(len(line)))
    assert main(["complete", "jaxdet", "", ""]) == 0
    found = capsys.readouterr().out.splitlines()
    assert offered <= set(found) and bool(found) == bool(offered)
    assert all(word.startswith(re.split("[ =]", line)[-1]) for word in found)


SHELLS = {
    "bash": (
        ["--norc"],
        """eval "$(jaxdet complete bash)" && complete -p jaxdet | grep -q "jaxdet complete" &&
        COMP_LINE="jaxdet export results --to f" COMP_POINT=28 jaxdet complete jaxdet f --to""",
        ["foxglove"],
    ),
    "zsh": (
        ["-f"],
        """compdef() { [[ "$*" == "_jaxdet jaxdet" ]] }
        compadd() { shift; print -l -- "$@" }; compset() { }; _files() { print files }
        eval "$(jaxdet complete zsh)"
        words=(jaxdet export results --to f); CURRENT=5; _jaxdet
        words=(jaxdet run ""); CURRENT=3; _jaxdet""",
        ["foxglove", "files"],
    ),
    "fish": (
        ["--no-config"],
        """jaxdet complete fish | source; complete -C "jaxdet export results --to f" """,
        ["foxglove"],
    ),
}
"""Flags of the shell, a script, and the words that the script prints, by shell."""


@pytest.mark.parametrize("shell", SHELLS)
def test_words_are_completed_in_each_shell(shell: str, tmp_path: Path) -> None:
    if not shutil.which(shell):
        pytest.skip(f"no {shell} here")
    program = tmp_path / "jaxdet"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m jaxdet "$@"\n')
    program.chmod(0o755)
    flags, script, offered = SHELLS[shell]
    env = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}", "HOME": str(tmp_path)}
    command = [shell, *flags, "-c", script]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == offered, done.stderr


def test_page_on_tuning_has_the_depth_ranges_of_the_presets() -> None:
    rows = re.findall(r"(?m)^\| (`.*?) \| .* \| ([\d.]+) to ([\d.]+) \|$", pages()["tuning"])
    ranges = {name: row[1:] for row in rows for name in re.findall(r"`(\S+)`", row[0])}
    assert set(ranges) == set(PRESETS)
    for name, (nearest, farthest) in ranges.items():
        ground = PRESETS[name].ground
        assert (ground.min_depth_m, ground.max_depth_m) == (float(nearest), float(farthest))


@pytest.mark.parametrize("flag", ["--ground.camera-pitch", "--ground.camera-pitch-rad"])
def test_angles_are_given_in_degrees_or_radians(
    flag: str, tmp_path: Path, capsys: Captured
) -> None:
    def pitch(*words: str) -> float | None:
        height = ["--ground.camera-height-m", "0.3", "--ground.camera-pitch", "0deg"]
        return parse(["a", "--output", "x", *height, *words]).method.ground.camera_pitch_rad

    assert pitch(flag, "-10deg") == -math.radians(10)
    assert pitch(f"{flag}=0.17rad") == 0.17
    assert parse(["a", "--output", "x"]).method.surface.cell_rad == 0.0078
    file = tmp_path / "a.toml"
    file.write_text('[ground]\ncamera_height_m = 0.3\ncamera_pitch = "10deg"\n')
    of_file = parse(["a", "--output", "x", "--config", str(file)])
    assert of_file.method.ground.camera_pitch_rad == math.radians(10)
    if flag.endswith("-rad"):
        assert pitch(flag, "0.17") == 0.17
    else:
        assert main(["run", "a", "--output", "x", flag, "0.17"]) == 2
        assert "expected an angle with its unit" in " ".join(capsys.readouterr().err.split())


SECTIONS = {field.name: type(getattr(Config(), field.name)) for field in fields(Config)}
SECTIONS |= {"log": LogOptions, "run": RunOptions}
MAY_BE_NEGATIVE = {"canny_low", "canny_high", "camera_pitch_rad", "camera_roll_rad"}
MAY_BE_NEGATIVE |= {"color_offset_s", "pose_offset_s"}


@pytest.mark.parametrize("section", SECTIONS)
def test_implausible_numbers_are_usage_errors(section: str) -> None:
    """Flags, files and Python refuse -1, infinity and NaN for lengths and counts."""
    make = SECTIONS[section]
    height = {"camera_height_m": 0.3, "camera_pitch_rad": 0.0} if section == "ground" else {}
    hints = typing.get_type_hints(make)
    for name, hint in hints.items():
        numbers = {int: (-1,), float: (-1.0, math.nan, math.inf, 1e300)}
        kinds = [kind for kind in numbers if hint is kind or kind in typing.get_args(hint)]
        for value in [value for kind in kinds for value in numbers[kind]]:
            if name in MAY_BE_NEGATIVE and not math.isnan(value):
                continue
            if section == "log" and name == "color_from_depth":
                continue
            with pytest.raises(ConfigError):
                make(**height | {name: value})


def test_a_run_can_be_repeated_from_its_results(
    sim_log: Path, tmp_path: Path, capfd: Captured
) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    changed = ["--preset", "d455", "--ground.max-depth-m", "3", "--log.pair-tolerance-s", "0.2"]
    assert main(["run", str(sim_log), "--output", str(first), *changed, "--pictures", "0"]) == 0
    config = str(first / "sim" / "config.json")
    args = ["run", str(sim_log), "--output", str(again), "--config", config]
    assert parse(args[1:]).log.pair_tolerance_s == 0.2
    assert parse(args[1:]).preset == "d455"  # the preset that the results record
    assert main([*args, "--pictures", "0"]) == 0
    for name in ("frames.parquet", "obstacles.parquet"):
        assert (first / "sim" / name).read_bytes() == (again / "sim" / name).read_bytes()
    (first / "sim" / "config.json").write_text('{"ground": {}}')
    capfd.readouterr()
    assert main([*args, "--overwrite"]) == 2
    assert "not the config.json of a run" in capfd.readouterr().err


def test_doctor_names_the_extra_if_a_gpu_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    import jax

    from jaxdet.cli import doctor

    monkeypatch.setattr(jax, "devices", lambda: jax.local_devices(backend="cpu"))
    monkeypatch.setattr(doctor, "gpu_is_visible", lambda: True)
    assert "pip install 'jaxdet[cuda13]'" in doctor.jax_devices()[1]
    monkeypatch.setattr(doctor, "gpu_is_visible", lambda: False)
    assert "pip" not in doctor.jax_devices()[1]


def test_help_and_version_load_nothing_heavy() -> None:
    code = (
        "import sys; from jaxdet.cli import main; main(['--help']); main(['--version']);"
        "print(*[m for m in ('jax', 'warp', 'cv2', 'pyarrow', 'numpy') if m in sys.modules])"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == ""


def test_version_is_printed(capsys: Captured) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("jaxdet 0.")


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["fly"], 2, "unknown command 'fly'"),
        (["rum", "a"], 2, "unknown command 'rum'; did you mean run?"),
        (["help", "log"], 2, "unknown page 'log'; did you mean logs?"),
        (["run", "a", "--output", "x", "--batch-size", "0"], 2, "pass --batch-size 1 or more"),
        (["run", "a", "--output", "x", "--pictures", "-1"], 2, "pass --pictures 0 or more"),
        (["run", "a", "--output", "x", *PITCH, "10rad"], 2, "must be within 90°, got 573°"),
        (
            ["run", "a", "--output", "x", *PITCH, "1e999deg"],
            2,
            "'1e999deg': expected an angle with",
        ),
        (
            ["run", "a", "--output", "x", *PITCH, "1.2.3deg"],
            2,
            "'1.2.3deg': expected an angle with",
        ),
        (["run", "a", "--output", "x", *PITCH[2:], "0.1rad"], 2, "camera-height-m must be given"),
        (["run", "a", "--output", "x", *PITCH[:2]], 2, "camera-pitch must be given with"),
        (["run", "--output", "x"], 2, "missing: LOG...; see jaxdet run --help"),
        (["run"], 2, "missing: LOG..., --output DIR; see jaxdet run --help"),
        (["run", "missing.mcap", "--output", "x"], 1, "missing.mcap: no such file"),
        (["run", "a", "--output", "x", "--preset", "boat"], 2, "unknown preset 'boat'"),
        (["run", "a", "--output", "x", "--cluster.depth-gap-m", "-1"], 2, "from 0 to 5 m"),
        (["run", "a", "--output", "x", "--config", "none.toml"], 2, "none.toml"),
        (["run", "a", "--output", "x", "--start", "today"], 2, "--start: invalid time 'today'"),
        (["run", "a", "--output", "x", "--every", "0"], 2, "--every must be at least 1"),
        (["run", "a"], 2, "missing: --output DIR; see jaxdet run --help"),
        (["run", "a", "--output"], 2, "--output: expected one argument; see jaxdet run --help"),
        (
            ["run", "a", "--output", "--quiet"],
            2,
            "--output: expected one argument; see jaxdet run --help",
        ),
        (
            ["run", "a", "--output", "x", "--quiet=yes"],
            2,
            "--quiet: ignored explicit argument 'yes'",
        ),
        (["run", "a", "-output", "x"], 2, "unknown flag -output; did you mean --output?"),
        (["run", "a", "-o"], 2, "--output: expected one argument; see jaxdet run --help"),
        (["run", "a", "-o", "-q"], 2, "--output: expected one argument; see jaxdet run --help"),
        (["run", "a", "-ox"], 2, "unknown flag -ox; see jaxdet run --help"),
        (["verify", "a", "-q"], 2, "unknown flag -q; see jaxdet verify --help"),
        (
            ["run", "a", "--output", ""],
            2,
            "--output: expected a path, got ''; see jaxdet run --help",
        ),
        (
            ["run", "a", "-o", "x", "--config", ""],
            2,
            "--config: expected a file, got ''; see --help",
        ),
        (["run", "a", "-o", "x", "--config"], 2, "error: --config: expected one argument"),
        (["run", "a", "-o", "x", "--preset", ""], 2, "unknown preset ''; use one of wheeled"),
        (["run", "a", "-o", "x", "--end", "3"], 2, "unknown flag --end; did you mean --stop? see"),
        (
            ["run", "a", "-o", "x", "--force"],
            2,
            "unknown flag --force; did you mean --overwrite? see",
        ),
        (["run", "a", "-o", "x", "--loud"], 2, "unknown flag --loud; see jaxdet run --help"),
        (["version"], 2, "unknown command 'version'; did you mean --version?"),
        (["run", "a", "--output", "x", "--batchsize", "4"], 2, "did you mean --batch-size?"),
        (["run", "a", "--camera-height", "1"], 2, "did you mean --ground.camera-height-m?"),
        (["run", "a", "--ground.max-depth", "1"], 2, "did you mean --ground.max-depth-m?"),
        (["run", "a", "--batch-size", "four"], 2, "--batch-size: 'four' is not a whole number"),
        (["run", "a", "--ground.max-depth-m=4m"], 2, "'4m' is not a number"),
        (["run", "a", "--backend", "Jax"], 2, "--backend: unknown value 'Jax'; did you mean jax?"),
        (
            ["run", "a", "--log.color-intrinsics", "1", "2"],
            2,
            "color-intrinsics: expected 4 arguments; see",
        ),
        (["export", "r", "--to", "pdf"], 2, "--to: unknown value 'pdf'; use one of foxglove, ros2"),
        (["export"], 2, "missing: RESULTS, --to {foxglove,ros2,nav2,html,rerun,coco}, --output"),
        (["verify", "a", "b"], 2, "unexpected argument 'b'"),
        (
            ["doctor", "--jsn"],
            2,
            "unknown flag --jsn; did you mean --json? see jaxdet doctor --help",
        ),
    ],
)
def test_errors_are_one_line(
    args: list,
    code: int,
    message: str,
    capsys: Captured,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(args) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("jaxdet: error: ")
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_flag_is_an_error_that_suggests_the_nearest(capsys: Captured) -> None:
    assert main(["run", "a", "--output", "x", "--cluster.depth-gap", "1"]) == 2
    assert "--cluster.depth-gap-m" in capsys.readouterr().err


def test_values_may_begin_with_a_minus_sign(tmp_path: Path) -> None:
    T = ["-0.1", "-.2e1", "-1e-3", "0", "0", "0", "1"]
    words = ["--output=x", "--log.color_from_depth", *T, *PITCH, "-10deg", "--pictures", "3"]
    command = parse(["a", *words, "--log.no-tf", "--pictures", "2", "b", "--", "--c.mcap"])
    assert command.logs == ("a", "b", "--c.mcap")
    assert command.log.color_from_depth == (-0.1, -2.0, -1e-3, 0.0, 0.0, 0.0, 1.0)
    assert command.method.ground.camera_pitch_rad == -math.radians(10)
    assert (command.run.pictures, command.log.tf) == (2, False)
    assert (command.log.depth_aligned, command.output) == (None, Path("x"))
    again = ["a", "--output", "x", "--log.depth-aligned", "--log.no-depth-aligned"]
    assert parse(again).log.depth_aligned is False
    file = tmp_path / "a.toml"
    file.write_text('[log]\nodom = "/odom"\n')
    unset = ["a", "--output", "x", "--config", str(file), "--log.odom", "None"]
    assert (parse(unset[:-2]).log.odom, parse(unset).log.odom) == ("/odom", None)


def test_flags_override_the_file_which_overrides_the_preset(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(
        'preset = "d455"\n[cluster]\ndepth_gap_m = 1\nmin_points = 4\n'
        "[features]\nmax_corners = 77\n"
        "[log]\ncolor_intrinsics = [600, 600, 320, 240.5]\ntf = false\n"
    )
    args = ["a.mcap", "--output", "x", "--config", str(file), "--cluster.min-points", "7"]
    command = parse(args)
    assert isinstance(command, RunCommand)
    assert command.logs == ("a.mcap",)
    assert (command.method.cluster.depth_gap_m, command.method.cluster.min_points) == (1.0, 7)
    assert isinstance(command.method.cluster.depth_gap_m, float)
    assert command.method.ground == PRESETS["d455"].ground
    assert command.method.features.max_corners == 77
    assert command.log.color_intrinsics == (600.0, 600.0, 320.0, 240.5)
    assert (command.log.tf, parse([*args, "--log.tf"]).log.tf) == (False, True)
    assert parse([*args, "--preset=zed"]).method.ground == PRESETS["zed"].ground


def test_the_robots_width_sets_both_gaps() -> None:
    args = ["a.mcap", "--output", "x", "--preset", "paper", "--cluster.robot-width-m", "0.4"]
    assert parse(args).method.cluster.gaps_m == (0.4, 0.4)
    with pytest.raises(ConfigError, match="depth-gap-m must be unset"):
        parse([*args, "--cluster.depth-gap-m", "0.2"])
    assert parse([*args, "--cluster.robot-width-m", "None"]).method == PRESETS["paper"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "[cluster]\ngap = 1\n",
            r"bad.toml: unknown key 'gap' in \[cluster\]; use one of points, ",
        ),
        ("[ground]\nmax_depth = 1\n", r"unknown key 'max_depth' in .*; did you mean max_depth_m\?"),
        ("[ground]\ncamera_pitch = 1\n", r"camera_pitch = 1: expected an angle with its unit"),
        ("[clusters]\n", r"bad.toml: unknown section \[clusters\]; did you mean cluster\?"),
        (
            "cluster = 1\n",
            r"bad.toml: cluster = 1 is outside of a section; write \[cluster\] and its",
        ),
        (
            "max_depth_m = 1\n",
            r"max_depth_m = 1 is outside of a section; .* below \[ground\] or \[floor\]",
        ),
        ("camera_pitch = '9deg'\n", r"is outside of a section; write it below \[ground\]$"),
        ("every = 2\n", r"every = 2 is outside of a section; write it below \[log\]$"),
        (
            "boat = 2\n",
            r"boat = 2 is outside of a section; write it below \[ground\] or \[features\] or",
        ),
        ("preset = 3\n", r'preset must be a string, got 3; write preset = "wheeled"'),
        ("preset = 'boat'\n", r"bad.toml: unknown preset 'boat'; use one of wheeled"),
        ("[cluster]\nmin_points = 1.5\n", "min_points must be an integer, got 1.5"),
        ("[cluster]\nmin_points = true\n", "min_points must be an integer, got True"),
        ("[log]\nstart = 5\n", "start must be a string, got 5"),
        ("[log]\ncolor_intrinsics = [1, 2]\n", "must be a list of 4 numbers"),
        (
            "[ground]\ncamera_pitch = '1deg'\ncamera_pitch_rad = 0.1\n",
            "camera_pitch_rad is given twice",
        ),
        ("[ground]\nmin_depth_m = 9\n", "bad.toml: ground.min-depth-m must be"),
        (
            "[cluster]\nrobot_width_m = 0.4\nlateral_gap_m = 0.4\n",
            r"bad.toml: cluster.lateral-gap-m must be unset \(None\) if cluster.robot-width-m is",
        ),
        ("[cluster\n", "bad.toml: invalid TOML"),
    ],
)
def test_errors_in_configuration_files_name_file_and_key(
    text: str, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "bad.toml"
    for encoding in ("utf-8", "utf-8-sig"):  # editors on Windows write the second
        file.write_text(text, encoding)
        with pytest.raises(ConfigError, match=message):
            read_defaults(["--config", str(file)])


def test_run_prints_json_only_with_the_flag(sim_log: Path, tmp_path: Path, capfd: Captured) -> None:
    args = ["run", str(sim_log), "--output", str(tmp_path / "a"), "--backend", "reference"]
    assert main([*args, "--json", "--pictures", "1", "--truth", str(sim_log)]) == 0
    captured = capfd.readouterr()
    assert json.loads(captured.out)["frames"] == 2
    summary = json.loads((tmp_path / "a" / "sim" / "summary.json").read_text())
    assert json.loads(captured.out)["logs"] == summary["logs"]
    assert captured.err == ""
    assert main(args) == 2
    assert "--overwrite" in capfd.readouterr().err
    assert main([*args, "--overwrite", "--truth", str(sim_log)]) == 0
    captured = capfd.readouterr()
    assert "visible obstacles found" in captured.out
    score = json.loads((tmp_path / "a" / "sim" / "summary.json").read_text())["logs"][0]["score"]
    assert score["ignored"] and f"), {score['ignored']} not counted, F1 " in captured.out
    assert f"distance_m error {score['nearest_error_m'] * 100:.1f} cm" in captured.out
    assert -0.2 < score["nearest_bias_m"] < 0
    bias = f"bias {score['nearest_bias_m'] * 100:.1f} cm (too near)"
    assert f"cm (90th percentile), {bias}" in captured.out
    assert captured.out.endswith(f"results: {tmp_path / 'a'} (tables, 2 pictures, 1 map)\n")
    assert "2/2 frames" in captured.err
    assert main([*args, "--overwrite", "--quiet"]) == 0
    assert capfd.readouterr() == ("", "")


def test_score_states_how_many_frames_were_compared(
    sim_log: Path, tmp_path: Path, capfd: Captured
) -> None:
    part = tmp_path / "part.mcap"  # ground truth of the first of two frames
    write_log(part, SimConfig(frames=1, width=160, height=120))
    for truth, line in ((part, "truth      in 1 of 2 frames "), (sim_log, "truth      ")):
        args = ["--output", str(tmp_path / truth.stem), "--backend", "reference", "--pictures", "0"]
        assert main(["run", str(sim_log), *args, "--truth", str(truth)]) == 0
        text = (tmp_path / truth.stem / "sim" / "summary.json").read_text()
        score = json.loads(text)["logs"][0]["score"]
        assert f"{line}{score['found']} of {score['visible']} visible" in capfd.readouterr().out
        assert score["frames"] == (1 if truth == part else 2)
    write_log(tmp_path / "other.mcap", SimConfig(frames=1, width=160, height=120, start_ns=10**18))
    args = ["--output", str(tmp_path / "none"), "--backend", "reference", "--pictures", "0"]
    assert main(["run", str(sim_log), *args, "--truth", str(tmp_path / "other.mcap")]) == 0
    assert "truth      not compared in any of 2 frames\n" in capfd.readouterr().out
    size = {"width": 80, "height": 60}  # another image size and other timestamps
    write_log(tmp_path / "small.mcap", SimConfig(frames=1, start_ns=10**18, **size))
    args[1] = str(tmp_path / "small")
    assert main(["run", str(sim_log), *args, "--truth", str(tmp_path / "small.mcap")]) == 0
    assert "truth      not compared in any of 2 frames\n" in capfd.readouterr().out


def test_ground_truth_of_another_log_is_not_compared(
    sim_log: Path, tmp_path: Path, capfd: Captured
) -> None:
    """Timestamps and sizes match, but not the obstacles. The results are kept."""
    other = tmp_path / "other.mcap"
    write_log(other, SimConfig(scene="corridor", frames=2, width=160, height=120))
    args = ["--output", str(tmp_path / "out"), "--backend", "reference", "--pictures", "0"]
    assert main(["run", str(sim_log), *args, "--truth", str(other)]) == 1
    text = "other.mcap: the log's depth does not match the obstacles of the ground truth; pass the"
    out, err = capfd.readouterr()
    assert f"truth      not compared: {tmp_path}/{text}" in out and "2 frames" in out
    assert f"jaxdet: error: sim: no score: {tmp_path}/{text}" in err
    [log] = json.loads((tmp_path / "out" / "sim" / "summary.json").read_text("utf-8"))["logs"]
    assert log["error"] is None and log["frames"] == 2 and text in log["score"]["error"]
    assert main(["verify", str(tmp_path / "out"), "--sample", "0"]) == 0


def test_missing_ground_truth_is_an_error_before_the_run(
    sim_log: Path, tmp_path: Path, capfd: Captured
) -> None:
    command = ["run", str(sim_log), "--output", str(tmp_path / "out"), "--truth", "nothing.mcap"]
    assert main(command) == 1
    assert "nothing.mcap.truth.npz: cannot read ground truth" in capfd.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize("streams", ["", "2>/dev/full", "2>&-", "<&- >&- 2>&-"])
def test_a_run_succeeds_if_its_standard_streams_cannot_be_used(
    sim_log: Path, tmp_path: Path, streams: str
) -> None:
    """The reader of a pipe has ended, the disk is full, or streams are closed."""
    args = ["run", str(sim_log), "--backend", "reference", "--pictures", "0", "--output"]
    assert main([*args, str(tmp_path / "quiet"), "--quiet"]) == 0
    start = ["sh", "-c", f'exec "$@" {streams}', "sh", sys.executable, "-m", "jaxdet"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    reader, errors = os.pipe()
    os.close(reader)
    command = [*start, *args, str(tmp_path / "run")]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=errors, env=environment)
    os.close(errors)
    assert done.returncode == 0
    same_results(tmp_path / "run", tmp_path / "quiet")


def test_a_failed_log_sets_exit_status_1_and_the_others_are_done(
    sim_log: Path, tmp_path: Path, capfd: Captured
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"not a log")
    args = ["run", str(bad), str(sim_log), "--output", str(tmp_path / "out")]
    assert main([*args, "--backend", "reference"]) == 1
    captured = capfd.readouterr()
    assert captured.err.count("jaxdet: error: ") == 1
    assert "bad.mcap" in captured.err
    assert "2 frames" in captured.out


def test_a_failed_log_is_reported_even_if_tracking_fails(
    sim_log: Path, tmp_path: Path, capfd: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"nothing")

    def full(folder: Path, **how: object) -> None:
        raise OutputError("can't be written", path=str(folder))

    monkeypatch.setattr("jaxdet.tracks.track_results", full)
    logs = [str(sim_log), str(tmp_path / "bad.mcap")]
    how = ["--backend", "reference", "--quiet", "--tracks"]
    assert main(["run", *logs, "--output", str(tmp_path / "out"), *how]) == 1
    first, second = capfd.readouterr().err.splitlines()
    assert "bad.mcap" in first and second.endswith("out: can't be written")


def test_info_shows_which_topics_are_used_and_why(sim_log: Path, capsys: Captured) -> None:
    assert main(["info", str(sim_log)]) == 0
    text = capsys.readouterr().out
    for part in ("topics", "<- color", "<- depth", "calibration", "from estimate"):
        assert part in text
    assert "2 of 2 sampled frames show their floor" in text and "tf: 0.299 m up" in text
    assert main(["info", str(sim_log), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["logs"][0]["frames"] == 2


def test_sim_writes_hard_scenes_with_errors_of_the_mount(tmp_path: Path, capsys: Captured) -> None:
    path = tmp_path / "hard.mcap"
    args = ["sim", str(path), "--frames", "1", "--width", "64", "--height", "48"]
    errors = ["--depth-error", "1", "--mount-pitch-error-rad", "0.02", "--rock-rad", "0.01"]
    assert main([*args, "--scene", "corridor", *errors]) == 0
    truth = load_truth(path)
    assert truth.is_wall.sum() >= 3 and truth.camera_pitch[0] != pytest.approx(0.1745)


def test_the_first_run_reports_that_it_compiles(tmp_path: Path) -> None:
    caches = Caches(tmp_path / "jax", tmp_path / "warp")
    for _ in range(2):
        message = "compiling kernels for this machine (up to half a minute, once)"
        assert first_time(caches) == f"{message}; cached in {tmp_path / 'jax'}"
    (tmp_path / "jax" / "program").touch()
    assert first_time(caches) == first_time(Caches(None, None)) == ""


def test_a_cache_that_cannot_be_written_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from jaxdet.cli import doctor

    file = tmp_path / "file"
    file.touch()
    message = "can't be written to; set JAXDET_CACHE to a folder that can be, or to off"
    assert first_time(Caches(file / "jax", None)).endswith(f"not cached: {file / 'jax'} {message}")
    for name in ("JAX_COMPILATION_CACHE_DIR", "WARP_CACHE_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("JAXDET_CACHE", str(file))
    good, text = doctor.caches()
    assert not good and text.startswith(str(file)) and text.endswith(message)
    monkeypatch.setenv("JAXDET_CACHE", "off")
    assert doctor.caches() == (True, "jax not cached, warp not cached")


def test_sim_reports_its_progress(tmp_path: Path) -> None:
    numbers = []
    write_log(tmp_path / "x.mcap", SimConfig(frames=3, width=64, height=48), numbers.append)
    assert numbers == [1, 2, 3]


def test_sim_writes_a_log_and_its_truth(tmp_path: Path, monkeypatch, capsys: Captured) -> None:
    path = tmp_path / "new" / "s.mcap"
    args = ["sim", str(path), "--frames", "1", "--width", "64", "--height", "48"]
    assert main(args) == 0
    assert "1 frames" in capsys.readouterr().err
    assert path.is_file()
    path.write_bytes(b"precious")
    assert main(args) == 2
    assert "pass --overwrite" in capsys.readouterr().err
    assert path.read_bytes() == b"precious"
    before = sorted(path.parent.iterdir())

    def full(log: Path, *_: object) -> None:
        log.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("jaxdet.sim.write_log", full)
        assert main([*args, "--overwrite"]) == 1
    assert "can't be written (No space left on device)" in capsys.readouterr().err
    kept = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, kept[1]))  # closing any file fails
    try:
        assert main([*args, "--overwrite"]) == 1
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, kept)
    gc.collect()  # closing the files prints nothing
    assert capsys.readouterr().err.endswith("can't be written (File too large)\n")
    assert sorted(path.parent.iterdir()) == before and path.read_bytes() == b"precious"
    assert main([*args, "--overwrite"]) == 0
    assert path.stat().st_size > 1000 and sorted(path.parent.iterdir()) == before


def test_doctor_compares_the_backends(capfd: Captured) -> None:
    assert main(["doctor", "--json"]) == 0
    report = json.loads(capfd.readouterr().out)
    assert report["ok"]
    assert report["versions"]["jax"]
    assert "equal arrays" in report["checks"]["backends agree"]["found"]


def test_doctor_fails_if_a_check_fails(monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    from jaxdet.cli import doctor

    monkeypatch.setattr(doctor, "CHECKS", {"broken": lambda: 1 / 0})
    assert main(["doctor"]) == 1
    assert "FAILED: ZeroDivisionError" in capsys.readouterr().out


def test_a_full_disk_is_an_error_of_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    from jaxdet.cli import doctor

    def full(args: list[str]) -> int:
        raise OSError(28, "No space left on device", "out/frames.parquet")

    monkeypatch.setattr(doctor, "main", full)
    assert main(["doctor"]) == 1
    message = "jaxdet: error: out/frames.parquet: No space left on device\n"
    assert capsys.readouterr().err == message


def test_an_interrupt_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    from jaxdet.cli import doctor

    def interrupt(args: list[str]) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr(doctor, "main", interrupt)
    assert main(["doctor"]) == 130
    assert capsys.readouterr().err == "jaxdet: error: interrupted\n"
