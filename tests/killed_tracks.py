"""Ends ``jaxdet track`` at each system call of its commit; see ``tests/test_tracks_folder.py``.

Says how many there were, and fails where a folder holds what it must not.
"""

import json
import shutil
import sys
from functools import partial
from pathlib import Path

from jaxdet.results.manifest import sha256
from jaxdet.tracks import folder as tracks_folder
from tests.killed import killed_at

MADE = "track_links.parquet", "tracks.parquet", "tracks_log.png"


def track(folder: Path, made: Path) -> None:
    """What ``jaxdet track`` does once its files are made."""
    with tracks_folder._staging(folder) as staging:
        for name in MADE:
            shutil.copy(made / name, staging / name)
        tracks_folder._commit(staging, folder)


def digests(folder: Path) -> dict[str, str]:
    """The files of a folder but those of the working folder, which may be there."""
    names = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {str(name): sha256(folder / name) for name in names if name.parts[0] != ".jaxdet"}


def state(folder: Path, old: dict[str, str], new: dict[str, str]) -> str:
    """Which tracks a folder holds; all else in it is as it was."""
    found = digests(folder)
    if manifest := found.pop("manifest.json", None):
        assert manifest in (old["manifest.json"], new["manifest.json"])
        files = json.loads((folder / "manifest.json").read_text("utf-8"))["files"]
        assert {name: about["sha256"] for name, about in files.items()} == found
        return "old" if manifest == old["manifest.json"] else "new"
    tracks = {name: found.pop(name) for name in MADE if name in found}
    assert found == {name: old[name] for name in old.keys() - {*MADE, "manifest.json"}}
    assert tracks.items() <= old.items() or tracks.items() <= new.items(), "old beside new"
    return "parts"


def main(before: Path, after: Path) -> None:
    """Each system call once: the tracks of a folder become those of another."""
    old, new = digests(before), digests(after)
    assert old.keys() == new.keys() and old["tracks.parquet"] != new["tracks.parquet"]
    call, ended, seen = 0, True, set()
    while ended:
        folder = Path(shutil.copytree(before, before.with_name(f"{call}")))
        ended = killed_at(call, partial(track, folder, after))
        seen.add(state(folder, old, new))
        track(folder, after)
        assert state(folder, old, new) == "new" and not (folder / ".jaxdet").exists()
        shutil.rmtree(folder)
        call += 1
    assert seen == {"old", "parts", "new"}, seen
    print(f"{call - 1} calls")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
