"""Stub of the engine: logs are texts with instructions for the process that runs them.

Recorded logs are run by the real engine.
"""

import hashlib
import json
import os
import signal
import time
import uuid
from collections import Counter
from pathlib import Path

from jaxdet.engine import runner
from jaxdet.engine.process_log import write_failure
from jaxdet.engine.runner import record_of
from jaxdet.results.manifest import fingerprint
from jaxdet.results.record import digest
from jaxdet.results.summary import LogSummary, Summary

JOURNAL = "JAXDET_TEST_JOURNAL"
"""Environment variable of the folder that receives a file ``LOG@PID@NUMBER`` per computation."""


def install() -> None:
    from jaxdet import engine

    engine.__dict__["run_one"] = run_one


def computed(journal: Path, name: str = "") -> list[str]:
    """Return the names of computed logs, one per computation."""
    found = sorted(path.name.partition("@")[0] for path in journal.iterdir())
    return [log for log in found if name in ("", log)]


def run_one(log_path, folder, how):
    """Write a table that depends only on the log, and a summary that does not."""
    paths = list(map(Path, log_path))
    content = b"".join(one.read_bytes() for one in paths)
    name = how["name"].replace("/", "+")
    if content.startswith(b"\x89MCAP"):
        return runner.run_one(log_path, folder, how)
    before = 0
    if journal := os.environ.get(JOURNAL):
        before = len(computed(Path(journal), name))
        Path(journal, f"{name}@{os.getpid()}@{uuid.uuid4().hex}").touch()
    for word in content[:200].decode(errors="replace").split():
        verb, _, number = word.partition("=")
        if verb == "kill" and before < int(number):
            os.kill(os.getpid(), signal.SIGKILL)
        if verb == "sleep":
            time.sleep(float(number))
        if verb == "fail" and before >= int(number or 0):
            return {"error": "no depth", **_NONE}
        if verb == "crash":
            failed = LogSummary(how["name"], (), error=f"send {Path(folder).name}/report.txt")
            Path(folder).mkdir()
            Path(folder, "report.txt").write_text("traceback")
            about = {"run": digest(record_of(how)), "inputs": list(map(fingerprint, paths))}
            write_failure(Path(folder), {**about, **how["about"]}, [failed])
            return {"error": failed.error, **_NONE}
        if verb == "bug":
            raise KeyError("bug")
    folder = Path(folder)
    (folder / "pictures").mkdir(parents=True)
    rows = hashlib.sha256(content + json.dumps(how.get("config"), sort_keys=True).encode())
    (folder / "obstacles.parquet").write_text(rows.hexdigest())
    (folder / "pictures/000000.png").write_bytes(rows.digest())
    lost = ["frame 1"] if b"lose" in content and not before else []
    of = how["name"], tuple(map(str, paths))
    logs = [LogSummary(*of, frames=3, status=Counter(ok=3), obstacles=2, lost=lost)]
    if b"rear" in content:
        logs.append(LogSummary(*of, error=f"{log_path[0]}: rear camera: no depth"))
    about = {**Summary("jax", 1, logs).to_dict(), "it": uuid.uuid4().hex}
    (folder / "summary.json").write_text(json.dumps(about))
    write_manifest(folder, paths, how)
    return {"error": logs[-1].error, "frames": 3, "obstacles": 2, "lost": lost, "warnings": []}


_NONE = {"frames": 0, "obstacles": 0, "lost": [], "warnings": []}


def write_manifest(folder: Path, inputs: list[Path], how: dict) -> None:
    paths = [path for path in folder.rglob("*") if path.is_file()]
    files = {
        path.relative_to(folder).as_posix(): {
            "size": path.stat().st_size,
            "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        }
        for path in paths
    }
    about = {"run": digest(record_of(how)), "inputs": list(map(fingerprint, inputs))}
    about |= how.get("about") or {}
    (folder / "manifest.json").write_text(json.dumps({**about, "files": files}))


def check_complete(folder: Path) -> str:
    """Assert that a folder agrees with its manifest; return its table."""
    manifest = json.loads((folder / "manifest.json").read_text())
    assert len(manifest["files"]) == 3
    for name, about in manifest["files"].items():
        content = (folder / name).read_bytes()
        assert hashlib.sha256(content).hexdigest() == about["sha256"], name
    return (folder / "obstacles.parquet").read_text()


def check_results(url: str, name: str, scratch: Path) -> str:
    """Copy the results of a log from a bucket to a new folder, and check that they are complete."""
    from jaxdet.fleet import download

    return check_complete(download(url, name, scratch / uuid.uuid4().hex))
