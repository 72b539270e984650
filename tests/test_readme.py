"""The README: its example in Python, and the description on a package index.

tests/test_help_pages.py runs all of its snippets.
"""

import re
from pathlib import Path

import cv2
import pytest

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"


def test_readme_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 110


def test_the_python_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    assert len(example.splitlines()) <= 12
    exec(compile(example, str(README), "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    counts = [int(line.split()[2]) for line in lines if line.startswith("frame ")]
    assert len(counts) == 8
    assert min(counts) >= 1
    assert len(lines) == 8 + sum(counts)


def test_package_description_has_no_relative_links_or_pictures():
    builders = pytest.importorskip("hatchling.builders.wheel")
    shown = builders.WheelBuilder(str(ROOT)).metadata.core.readme
    text = README.read_text(encoding="utf-8")
    relative = r"\]\((?!https?://)"
    assert len(re.findall(relative, text)) > 10 and not re.search(relative, shown)
    assert "![" not in shown and "<img" not in shown
    headings = re.findall(r"^#.*", text, re.M)
    assert re.findall(r"^#.*", shown, re.M) == headings and "which settings matter" in shown


def test_the_picture_is_a_small_animation():
    (picture,) = re.findall(r"!\[.*?\]\((.*?)\)", README.read_text(encoding="utf-8"))
    assert (ROOT / picture).stat().st_size < 1_500_000
    moving, animation = cv2.imreadanimation(str(ROOT / picture))
    assert moving and len(animation.frames) == 60
    assert abs(sum(animation.durations) - 10_000) < 200  # [ms], in real time
    first, later = animation.frames[0], animation.frames[30]
    assert (cv2.absdiff(first, later) > 40).mean() > 0.05
