"""The command and the real engine through S3: results equal those of one machine."""

import json
import re
from pathlib import Path

import pytest

from jaxdet import open_results
from jaxdet.cli import main
from jaxdet.fleet import download, result_files
from jaxdet.fleet.place import open_place
from jaxdet.sim import SimConfig, write_log

SAME = ("frames.parquet", "obstacles.parquet", "tracks.parquet", "track_links.parquet")
SAME += ("map.npz", "map.png", "tracks.png", "pictures/")


@pytest.fixture(params=["folder", pytest.param("bucket", marks=pytest.mark.fleet)])
def results(request, tmp_path):
    """Return the address of results in a bucket or a folder."""
    if request.param == "folder":
        return str(tmp_path / "results")
    return request.getfixturevalue("bucket") + "/results"


def test_tracks_are_added_to_existing_results(results, tmp_path):
    log = tmp_path / "a.mcap"
    write_log(log, SimConfig(frames=4, width=160, height=120))
    command = ["run", str(log), "-o", results, "--share", "1/1", "--pictures", "0", "-q"]
    assert main(command) == 0
    before = download(results, "a", tmp_path / "before")
    assert main([*command, "--tracks"]) == 0
    after = download(results, "a", tmp_path / "after")
    assert not (before / "tracks.parquet").exists() and main(["verify", str(after)]) == 0
    new = {path.name for path in after.iterdir()} - {path.name for path in before.iterdir()}
    assert new >= {"tracks.parquet", "track_links.parquet"}
    keys = [entry.key for entry in open_place(results).list()]
    assert main([*command, "--tracks"]) == 0
    assert [entry.key for entry in open_place(results).list()] == keys
    attempts = {key.split("/")[1] for key in keys if key.startswith("a/")}
    assert len(attempts) == 2 or not results.startswith("s3:")


@pytest.mark.fleet
def test_results_equal_those_of_one_machine(bucket, tmp_path, capsys):
    logs, how = tmp_path / "logs", ["--pictures", "1", "--tracks"]
    for seed in (1, 2):
        path = logs / f"day/run_{'ab'[seed - 1]}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_log(path, SimConfig(frames=4, width=160, height=120, seed=seed))
        open_place(f"{bucket}/logs").put(f"day/{path.name}", path)
    bad = logs / "day/bad.mcap"
    bad.write_bytes(b"no log")
    open_place(f"{bucket}/logs").put("day/bad.mcap", bad)
    alone = main(["run", str(logs), "-o", str(tmp_path / "alone"), *how])
    command = ["run", f"{bucket}/logs", "-o", f"{bucket}/results", *how]
    command += ["--spool", str(tmp_path / "spool")]
    assert main(command) == alone == 1
    assert re.search("error: day/bad: .*bad.mcap", capsys.readouterr().err)
    names = ["day--run_a", "day--run_b"]
    assert [url.split("/")[4] for url in result_files(f"{bucket}/results")] == names
    for name in names:
        ours = download(f"{bucket}/results", name, tmp_path / "ours" / name)
        theirs, log = tmp_path / "alone" / name, logs / f"{name.replace('--', '/')}.mcap"
        for folder in (ours, theirs):
            assert main(["verify", str(folder), "--against", str(log)]) == 0
        files = {path.relative_to(ours).as_posix() for path in ours.rglob("*") if path.is_file()}
        assert files == {p.relative_to(theirs).as_posix() for p in theirs.rglob("*") if p.is_file()}
        same = [file for file in files if file.startswith(SAME)]
        assert len(same) == len(SAME)
        assert not [
            file for file in same if (ours / file).read_bytes() != (theirs / file).read_bytes()
        ]
    capsys.readouterr()
    assert main([*command, "--json"]) == 1
    reports = json.loads(capsys.readouterr().out)["logs"]
    assert {log["log"]: log["state"] for log in reports} == {
        "day/bad": "failed",
        "day/run_a": "there",
        "day/run_b": "there",
    }
    assert not [*(tmp_path / "spool").rglob("*.mcap")]


def test_results_of_shares_are_recognized_by_a_run_on_one_machine(tmp_path, capsys):
    """A run on one machine recognizes the results of shares, and vice versa."""
    logs, out = tmp_path / "logs", str(tmp_path / "out")
    for seed in range(3):
        logs.mkdir(exist_ok=True)
        write_log(logs / f"{seed}.mcap", SimConfig(frames=2, width=160, height=120, seed=seed))
    command = ["run", str(logs), "-o", out, "--pictures", "0"]
    for share in ("1/2", "2/2"):
        assert main([*command, "--share", share]) == 0
    capsys.readouterr()
    assert main(command) == 0
    assert "3 logs processed earlier" in capsys.readouterr().out
    assert main([*command, "--share", "1/1"]) == 0
    assert "3 logs: 3 there" in capsys.readouterr().out
    assert main([*command, "--ground.max-depth-m", "3", "--share", "1/1"]) == 2
    assert main(["verify", out]) == 0


def test_a_share_joins_the_files_listed_in_metadata_even_after_a_pause(tmp_path, capsys):
    logs, out = tmp_path / "logs", str(tmp_path / "out")
    logs.mkdir()
    for number in range(2):
        start = (1_700_000_000 + 5 * number) * 10**9
        sim = SimConfig(frames=2, width=160, height=120, start_ns=start)
        write_log(logs / f"r_{number}.mcap", sim)
    listed = "relative_file_paths:\n  - r_0.mcap\n  - r_1.mcap\n"
    (logs / "metadata.yaml").write_text(listed)
    command = ["run", str(logs), "-o", out, "--pictures", "0"]
    assert main([*command, "--share", "1/1"]) == 0
    assert "1 logs: 1 done; 4 frames" in capsys.readouterr().out
    assert main(["verify", out]) == 0
    (about,) = open_results(out).logs
    assert about.paths == (logs / "r_0.mcap", logs / "r_1.mcap")
    assert "joined 2 files listed in metadata.yaml" in about.summary["notes"]
    assert main(command) == 0
    assert "1 log processed earlier: 4 frames" in capsys.readouterr().out


def test_recipes_are_valid_yaml():
    yaml = pytest.importorskip("yaml")
    page = Path(__file__).parents[2] / "jaxdet/help/fleets.md"
    blocks = re.findall(r"```text\n(apiVersion.*?)```", page.read_text(encoding="utf-8"), re.S)
    assert [yaml.safe_load(block)["kind"] for block in blocks] == ["Job", "RayJob"]
