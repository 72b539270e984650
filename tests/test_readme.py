"""The README's example in Python; tests/test_help_pages.py runs all of its snippets."""

import re
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"


def test_it_is_short():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 110


def test_the_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    assert len(example.splitlines()) <= 12
    exec(compile(example, str(README), "exec"), {})
    lines = capsys.readouterr().out.splitlines()
    counts = [int(line.split()[2]) for line in lines if line.startswith("frame ")]
    assert len(counts) == 8
    assert min(counts) >= 1
    assert len(lines) == 8 + sum(counts)
