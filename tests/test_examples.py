"""The examples of ``scripts/examples`` and the demo run."""

import ast
import json
import os
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import jaxdet
from jaxdet.sim import SimConfig, write_log

EXAMPLES = Path(__file__).resolve().parents[1] / "scripts/examples"


@pytest.fixture(scope="module")
def aligned_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("examples") / "aligned.mcap"
    write_log(path, SimConfig(frames=3, width=320, height=240, depth_form="aligned"))
    return path


def test_the_example_of_a_live_camera_runs(aligned_log, capsys):
    example = runpy.run_path(str(EXAMPLES / "live_camera.py"))
    with jaxdet.open_log(aligned_log) as log:
        source = [frame.depth for frame in log]
        detector = jaxdet.Detector(log.calibration.depth.K)
        example["watch"](source, detector, stop_at_m=5.0)
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert all("nearest 1." in line and line.endswith("STOP") for line in lines)


def test_the_notebook_runs_and_displays_its_results(tmp_path, monkeypatch):
    """Each cell runs, and its last expression has a representation for notebooks."""
    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((EXAMPLES / "first_look.ipynb").read_text("utf-8"))
    cells = ["".join(c["source"]) for c in notebook["cells"] if c["cell_type"] == "code"]
    names: dict[str, Any] = {}
    shown = []
    for cell in cells:
        *before, last = ast.parse(cell).body
        exec(compile(ast.Module(before, []), "notebook", "exec"), names)
        if isinstance(last, ast.Expr):
            shown.append(eval(compile(ast.Expression(last.value), "notebook", "eval"), names))
    log, count, frame, table = shown[-4:]
    assert "<td>320x240</td>" in log._repr_html_() and count == 4
    assert cv2.imdecode(np.frombuffer(frame._repr_png_(), np.uint8), cv2.IMREAD_COLOR).shape[2] == 3
    assert table.distance_m.tolist() == [obstacle.distance_m for obstacle in frame]
    log.close()


def test_the_demo_replaces_the_output_of_an_earlier_one(tmp_path):
    """The demo is run on a smaller log, and its script ``setup`` is replaced."""
    scripts, program = tmp_path / "clone/scripts", tmp_path / "venv/bin/jaxdet"
    for folder in (scripts, program.parent, tmp_path / "out"):
        folder.mkdir(parents=True)
    shutil.copy(EXAMPLES.parent / "demo", scripts)
    small = "--frames 2 --width 160 --height 120"
    for path, text in (
        (scripts / "setup", ""),
        (program, f'[ "$1" != sim ] || set -- "$@" {small}\nexec {sys.executable} -m jaxdet "$@"'),
    ):
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
    for name in ("sim.mcap", "sim.mcap.truth.npz", "report.html"):
        (tmp_path / "out" / name).write_text("of an earlier demo")
    root = EXAMPLES.parents[1]
    paths = {"PYTHONPATH": f"{root}:{root / 'kernels'}", "JAXDET_VENV": str(tmp_path / "venv")}
    done = subprocess.run(
        [scripts / "demo", tmp_path / "out"],
        env={**os.environ, **paths},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "visible obstacles found" in done.stdout and "tracks" in done.stdout
    page = done.stdout.splitlines()[-1].removeprefix("Open in a browser: ")
    assert Path(page).read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
