"""Results that are committed without a run, for tests of what a commit leaves behind."""

from pathlib import Path

from jaxdet.engine.workspace import Workspace
from jaxdet.results.manifest import make_manifest
from jaxdet.results.writer import write_json

NAMES = ("config.json", "frames.parquet", "obstacles.parquet", "pictures/a.png", "summary.json")


def commit(output: Path, text: str) -> None:
    """A run that writes ``text`` into each of its files."""
    with Workspace(output, {"of": text}, overwrite=True, say=lambda line: None) as work:
        if work.done is not None:
            return
        names = (*NAMES, f"map_{text}.png")
        files = {name: work.result / name for name in names}
        for path in files.values():
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        files |= write_json(work.result / "manifest.json", make_manifest({}, files))
        work.commit(files, text)
