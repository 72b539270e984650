"""Results on the disk: what a commit flushes before what, and what a manifest says of files.

A power cut loses what was not flushed, in any order.
"""

import errno
import json
import os
from pathlib import Path

import pytest

from jaxdet.errors import OutputError
from jaxdet.results.durable import write_whole
from jaxdet.results.manifest import made_by, make_manifest, result_files
from jaxdet.results.writer import write_json
from tests.committed import commit


def test_a_commit_is_on_the_disk_step_by_step(tmp_path, monkeypatch):
    output = tmp_path / "results"
    commit(output, "old")
    calls: list[tuple[str, Path, Path | None]] = []
    fsync, replace = os.fsync, os.replace

    def flushed(handle):
        path = Path(os.readlink(f"/proc/self/fd/{handle}"))
        fsync(handle)
        calls.append(("fsync", path, None))

    def moved(source, target, **more):
        replace(source, target, **more)
        calls.append(("replace", Path(source), Path(target)))

    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "replace", moved)
    commit(output, "new")

    working = output / ".jaxdet"
    journal = next(
        i for i, c in enumerate(calls) if c[0] == "replace" and c[2] == working / "commit"
    )
    before = {c[1] for c in calls[:journal] if c[0] == "fsync"}
    moves = [(i, c[1], c[2]) for i, c in enumerate(calls) if c[0] == "replace" and i > journal]
    out = [i for i, source, _ in moves if source.parent == output or source.parent.parent == output]
    arrived = [(i, source, target) for i, source, target in moves if working in source.parents]
    assert len(out) == 7 and len(arrived) == 7

    def flushes(path, first, last):
        return any(c[:2] == ("fsync", path) for c in calls[first:last])

    for _, source, _ in arrived:  # what is to move, and its name, and then the journal's content
        assert source in before and source.parent in before, source
    assert calls[journal][1] in before and working in before
    assert flushes(working, journal, out[0]), "the journal's name, before old results leave"
    assert flushes(output, out[-1], arrived[0][0]), "old results are gone, before new ones arrive"
    assert arrived[-1][2] == output / "manifest.json"
    for folder in (output, output / "pictures"):
        assert flushes(folder, arrived[-2][0], arrived[-1][0]), "new results, before their manifest"
    assert flushes(output, arrived[-1][0], None), "the manifest, before the journal goes"


def test_what_fails_on_the_way_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "plan"
    write_whole(path, b"old")

    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_names_that_lead_out_of_the_folder_are_no_results(tmp_path):
    output, outside = tmp_path / "out", tmp_path / "outside.png"
    output.mkdir()
    outside.touch()
    files = {"../outside.png": {}, str(outside): {}}
    (output / "manifest.json").write_text(json.dumps({"files": files}), encoding="utf-8")
    assert result_files(output) == ("manifest.json",)


def test_results_of_another_size_were_made_by_nobody(tmp_path):
    (tmp_path / "summary.json").write_text("{}")
    about = make_manifest({"run": "abc"}, {"summary.json": tmp_path / "summary.json"})
    write_json(tmp_path / "manifest.json", about)
    assert made_by(tmp_path) == "abc"
    (tmp_path / "summary.json").write_text("{} ")
    assert made_by(tmp_path) is None
