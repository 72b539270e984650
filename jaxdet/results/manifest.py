"""``manifest.json``: what a results folder holds and what it was made of, each with a checksum.

It is the last file to arrive in the folder and the first to leave it, so a folder without it holds
no whole results.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxdet.errors import InputError
from jaxdet.results.durable import sha256
from jaxdet.results.summary import to_json

MANIFEST = "manifest.json"
WORKING = ".jaxdet"
"""The working folder of a run, in the folder of its results."""
RESULTS = ("frames.parquet", "obstacles.parquet", "config.json", "summary.json", MANIFEST)
"""Files of all results."""
FORMAT = 1
_ENDS_BYTES = 64 << 10


def fingerprint(path: Path) -> dict[str, Any]:
    """What tells an input file from another: path, size, time of the last change, a checksum.

    The checksum is SHA-256 of the size, the first and the last 64 KiB, where MCAP has its header,
    first messages, chunk index and statistics. It sees another recording, a file cut or gone on
    with, and chunks that moved. Bytes changed in the middle it does not see: those the time of
    the last change may tell, and the chunks' own checksums. Of a folder of images it is that of
    its files' names and sizes.

    Args:
        path: The file or folder.

    Returns:
        What JSON can hold; without size, time and checksum where the file can't be read.
    """
    found: dict[str, Any] = {"path": os.fsencode(path).decode("utf-8", "backslashreplace")}
    try:
        if path.is_dir():
            return found | _folder(path)
        with path.open("rb") as file:
            about = os.fstat(file.fileno())
            hashed = hashlib.sha256(about.st_size.to_bytes(8, "little"))
            hashed.update(file.read(_ENDS_BYTES))
            file.seek(max(about.st_size - _ENDS_BYTES, 0))
            hashed.update(file.read(_ENDS_BYTES))
    except OSError:
        return found
    return {
        **found,
        "size": about.st_size,
        "mtime_ns": about.st_mtime_ns,
        "fingerprint": hashed.hexdigest(),
    }


def _folder(path: Path) -> dict[str, Any]:
    """Bytes, latest change and checksum of a folder's files and those of the folders in it."""
    hashed, size, latest = hashlib.sha256(), 0, 0
    for file in sorted([*path.glob("*"), *path.glob("*/*")]):
        if not file.is_file():
            continue
        about = file.stat()
        line = f"{file.relative_to(path)} {about.st_size}\n"
        hashed.update(line.encode("utf-8", "surrogateescape"))
        size, latest = size + about.st_size, max(latest, about.st_mtime_ns)
    return {"size": size, "mtime_ns": latest, "fingerprint": hashed.hexdigest()}


def make_manifest(about: Mapping[str, Any], files: Mapping[str, Path]) -> dict[str, Any]:
    """The manifest of results.

    Args:
        about: The versions that made them, and the inputs.
        files: The files by their names in the results folder.

    Returns:
        What JSON can hold: ``files`` with size and SHA-256 of each, and ``sha256`` of all else
        that is in the manifest.
    """
    return _sealed({"format": FORMAT, **about, "files": _checksums(files)})


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a results folder.

    Raises:
        InputError: It is missing, or not as it was written, to the byte.
    """
    path = folder / MANIFEST
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        problem = "is missing: the results are not whole, or of a version that wrote none"
        raise InputError(problem, path=str(path), remedy="run jaxdet run again") from None
    found = _read(path)
    if not isinstance(found.get("files"), dict) or to_json(_sealed(found)).encode() != content:
        raise InputError("was changed", path=str(path), remedy="run jaxdet run again")
    return found


def made_by(folder: Path) -> str | None:
    """The ``run`` in the manifest of a folder that holds whole results; None: they are not whole.

    It is a checksum of all that decides what a run makes. Files are known by their sizes.
    """
    try:
        manifest = read_manifest(folder)
        sizes = {name: (folder / name).stat().st_size for name in manifest["files"]}
    except (InputError, OSError):
        return None
    told = {name: about["size"] for name, about in manifest["files"].items()}
    return manifest.get("run") if sizes == told else None


def changed_manifest(folder: Path, gone: Iterable[str], come: Mapping[str, Path]) -> dict[str, Any]:
    """The manifest of a folder whose files change.

    Args:
        folder: The results folder.
        gone: Names of files that will not be results any more.
        come: The files that will be, by their names.

    Returns:
        As of :func:`make_manifest`.

    Raises:
        InputError: The manifest is missing, or not as it was written.
    """
    manifest = read_manifest(folder)
    kept = {name: about for name, about in manifest["files"].items() if name not in {*gone}}
    manifest["files"] = dict(sorted({**kept, **_checksums(come)}.items()))
    return _sealed(manifest)


def _checksums(files: Mapping[str, Path]) -> dict[str, Any]:
    return {
        name: {"size": path.stat().st_size, "sha256": sha256(path)}
        for name, path in sorted(files.items())
    }


def _sealed(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest with a checksum of itself at its end."""
    found = {key: value for key, value in manifest.items() if key != "sha256"}
    return {**found, "sha256": hashlib.sha256(to_json(found).encode()).hexdigest()}


def result_files(folder: Path) -> tuple[str, ...]:
    """The names of the files in a folder that are results; other files there are the user's.

    They are in the manifest, or of older versions, which wrote none, in the summary.
    """
    names: Iterable[str] = RESULTS
    known, logs = _read(folder / MANIFEST).get("files"), _read(folder / "summary.json").get("logs")
    if isinstance(known, dict):
        names = (*names, *known)
    else:
        names = (*names, *(name for log in logs or () for name in _of_log(log)))
    pictures = (f"tracks_{log.get('file_name')}.png" for log in logs or ())
    names = (*names, "tracks.parquet", "track_links.parquet", *pictures)  # of jaxdet track
    inside = (name for name in dict.fromkeys(names) if not _leaves(name))
    return tuple(name for name in inside if (folder / name).is_file())


def is_like_result(name: str) -> bool:
    """Whether a file's name in the folder is one that maps, pictures and tracks have."""
    maps = name.startswith("map_") and name.endswith((".npz", ".png"))
    return maps or (name.startswith(("tracks_", "pictures/")) and name.endswith(".png"))


def files_like_results(folder: Path) -> tuple[str, ...]:
    """The names of the files in a folder that are named so, whoever made them."""
    found = (path.relative_to(folder).as_posix() for path in folder.glob("*"))
    inside = (path.relative_to(folder).as_posix() for path in folder.glob("pictures/*"))
    return tuple(sorted(name for name in (*found, *inside) if is_like_result(name)))


def _of_log(log: Mapping[str, Any]) -> list[str]:
    made = [f"{log['map']}.npz", f"{log['map']}.png"] if log.get("map") else []
    return [*made, *(log.get("pictures") or ())]


def _leaves(name: str) -> bool:
    """Whether a name leads out of the folder."""
    return Path(name).is_absolute() or ".." in Path(name).parts


def _read(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
