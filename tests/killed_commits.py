"""Ends a commit at each of its system calls; started by ``tests/test_resume.py``.

Says how many there were, and fails where a folder holds what it must not.
"""

import json
import shutil
import sys
from functools import partial
from pathlib import Path

from tests.committed import commit
from tests.killed import killed_at

MINE = {"notes.txt": "mine", "pictures/mine.png": "mine too"}


def texts(output: Path) -> set[str]:
    """What the results in a folder hold, after a look at all that is there."""
    found = {path.relative_to(output): path for path in output.rglob("*") if path.is_file()}
    results = {name: path for name, path in found.items() if name.parts[0] != ".jaxdet"}
    for name, text in MINE.items():
        assert results.pop(Path(name)).read_text(encoding="utf-8") == text
    manifest = results.pop(Path("manifest.json"), None)
    held = {path.read_text(encoding="utf-8") for path in results.values()}
    assert len(held) <= 1, "old and new files beside each other"
    if manifest:
        files = json.loads(manifest.read_text(encoding="utf-8"))["files"]
        assert sorted(files) == sorted(map(str, results)), "a manifest of other files"
    return held if manifest else {f"parts of {text}" for text in held}


def main(folder: Path) -> None:
    """Each system call once, with and without old results."""
    seen: set[str] = set()
    for old in ("", "old"):
        call, ended = 0, True
        while ended:
            output = folder / f"{old}{call}"
            for name, text in MINE.items():
                (output / name).parent.mkdir(parents=True, exist_ok=True)
                (output / name).write_text(text, encoding="utf-8")
            if old:
                commit(output, old)
            ended = killed_at(call, partial(commit, output, "new"))
            between = texts(output)
            assert between <= {"old", "parts of old", "parts of new", "new"}, between
            seen |= between
            commit(output, "new")
            assert texts(output) == {"new"}
            assert not (output / ".jaxdet").exists()
            shutil.rmtree(output)
            call += 1
        print(f"{call - 1} calls")
    assert seen == {"old", "parts of old", "parts of new", "new"}, seen


if __name__ == "__main__":
    main(Path(sys.argv[1]))
