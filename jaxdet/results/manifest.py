"""``manifest.json``: files of a log's results, with checksums, and the inputs of the results.

The manifest is written last, so a folder without it holds no complete results.
"""

import hashlib
import os
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxdet.errors import InputError, printable
from jaxdet.results.durable import sha256
from jaxdet.results.json_files import (
    AGAIN,
    COUNT,
    TEXT,
    check_shape,
    leads_out,
    read_json,
    to_json,
    write_json,
)
from jaxdet.results.layout import MANIFEST

FORMAT = 2
_SHAPE = {"files": {TEXT: {"size": COUNT, "sha256": TEXT}}, "log": TEXT, "inputs": [dict]}
_ENDS_BYTES = 64 << 10


def fingerprint(path: Path) -> dict[str, Any]:
    """Return path, size, time of the last change and a checksum of an input file.

    The checksum is SHA-256 of the size, the first and the last 64 KiB, where MCAP has its header,
    first messages, chunk index and statistics. It differs for another recording, and after the file
    was cut, continued or had chunks moved. It does not show changes of bytes in the middle, but the
    time of the last change and the chunks' own checksums may show them. The checksum of a folder of
    images is computed from its files' names and sizes.

    Args:
        path: The file or folder.

    Returns:
        Values for JSON, without size, time and checksum if the file can't be read.
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
    """Return size, latest change and checksum of the files in a folder and its subfolders."""
    hashed, size, latest = hashlib.sha256(), 0, 0
    for file in sorted([*path.glob("*"), *path.glob("*/*")]):
        if not file.is_file():
            continue
        about = file.stat()
        line = f"{file.relative_to(path)} {about.st_size}\n"
        hashed.update(line.encode("utf-8", "surrogateescape"))
        size, latest = size + about.st_size, max(latest, about.st_mtime_ns)
    return {"size": size, "mtime_ns": latest, "fingerprint": hashed.hexdigest()}


def same_inputs(one: Iterable[Mapping[str, Any]], other: Iterable[Mapping[str, Any]]) -> bool:
    """Return whether files have the same size, modification time and checksum; paths may differ.

    A file that could not be read differs from every file.

    Args:
        one: Fingerprints of a log's files, see :func:`fingerprint`.
        other: Fingerprints of the same log at another time.
    """
    which = ("size", "mtime_ns", "fingerprint")
    before, now = ([[file.get(name) for name in which] for file in files] for files in (one, other))
    return before == now and not any(None in file for file in now)


def write_manifest(folder: Path, about: Mapping[str, Any], leave_out: Collection[str] = ()) -> None:
    """Write the manifest of the files in a folder.

    Args:
        folder: Folder of a log's results, before it is moved to its final path.
        about: Additional entries: versions, ``log``, ``inputs`` and ``run``, the digest of the
            configuration.
        leave_out: Names of files that are not results.

    Raises:
        OutputError: The disk is full or broken.
    """
    found = {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}
    files = {
        name: {"size": path.stat().st_size, "sha256": sha256(path)}
        for name, path in sorted(found.items())
        if name != MANIFEST and name not in leave_out
    }
    write_json(folder / MANIFEST, _sealed({"format": FORMAT, **about, "files": files}))


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read the manifest of a log's folder.

    Raises:
        InputError: The manifest is missing or was changed, or the folder holds something that is
            not a regular file.
    """
    _check_regular(folder)
    found = read_json(folder / MANIFEST)
    files, path = found.get("files"), folder / MANIFEST
    if found.get("format") != FORMAT:
        problem = f"has format {printable(str(found.get('format')))[:40]} of results, not {FORMAT}"
        raise InputError(problem, path=str(path), remedy="run jaxdet run again")
    try:
        as_written = to_json(_sealed(found)).encode() == path.read_bytes()
    except (OSError, ValueError, RecursionError):  # removed meanwhile, or not written by jaxdet
        as_written = False
    if not as_written or not isinstance(files, dict) or any(map(leads_out, files)):
        raise InputError("was changed", path=str(path), remedy=AGAIN)
    check_shape(found, _SHAPE, path)
    return found


def _sealed(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return a manifest with a checksum of itself at its end."""
    found = {key: value for key, value in manifest.items() if key != "sha256"}
    return {**found, "sha256": hashlib.sha256(to_json(found).encode()).hexdigest()}


def _check_regular(folder: Path) -> None:
    """Check that a folder of results holds files and folders only.

    Raises:
        InputError: It holds a pipe, a device or a socket, or a link to one.
    """
    for path in folder.rglob("*"):
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError("is not a regular file", path=str(path), remedy="remove it")
