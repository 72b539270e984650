"""Logs at an address, as plain values: a dict for each log, which can be sent to other machines.

``{"log": "monday/drive_1", "name": "monday--drive_1", "url": "s3://bucket/logs", "files": [...]}``:
``log`` is the log's name in tables, ``name`` the name of its folder of results; ``url`` is empty
for local logs. A log may have ``remarks`` on its files. Each of ``files`` has a ``key`` (for
local logs the path), a ``size``, and a ``tag``, which identifies the version that was listed.
"""

import hashlib
import re
from collections.abc import Iterable, Sequence
from itertools import pairwise
from os import PathLike
from pathlib import PurePath, PurePosixPath
from typing import Any

from jaxdet.errors import ConfigError, InputError, printable
from jaxdet.fleet.place import Entry, address, input_entry, is_url, open_place

Log = dict[str, Any]
_SHARE = re.compile(r"(\d{1,6})/(\d{1,6})", re.ASCII)


def list_logs(
    inputs: Iterable[str | PathLike[str]] | str | PathLike[str], *, join: bool = True
) -> list[Log]:
    """List the logs at addresses, folders and files, ordered by name.

    In a bucket the splits that one ``metadata.yaml`` of rosbag2 lists are one log; every other
    ``.mcap``, ``.db3`` or ``.bag`` file is a separate log. If a folder holds a recording in several
    formats, one of them is used, preferably MCAP. Folders of images are not read from buckets. For
    ``join`` see :func:`jaxdet.find_logs`.

    Raises:
        InputError: An input holds no log.
        ConfigError: Two logs have the same name, or an address is wrong.
    """
    items = [inputs] if isinstance(inputs, str | PathLike) else [*inputs]
    logs = [log for item in items if is_url(item) for log in _in_bucket(address(item), join)]
    if local := [item for item in items if not is_url(item)]:
        logs += _local([address(item) for item in local], join)
    logs.sort(key=lambda log: log["name"])
    for one, other in pairwise(logs):
        if one["name"] == other["name"]:
            remedy = "name a folder that holds both, or pass each its own --output"
            raise ConfigError(f"two logs have the name {one['name']}", remedy=remedy)
    return logs


def size_of(log: Log) -> int:
    """Return the total size of the files of a log [bytes]."""
    return sum(int(file["size"]) for file in log["files"])


def entries_of(log: Log) -> list[Entry]:
    """Return the files of a log, without empty fields of their tags.

    Fields may be empty if the files of all logs were in one table, which has the same columns for
    all tags.
    """
    return [
        Entry(file["key"], int(file["size"]), {k: v for k, v in file["tag"].items() if v})
        for file in log["files"]
    ]


def share_of(logs: Sequence[Log], share: str) -> list[Log]:
    """Return the logs of the K-th of N shares, by SHA-256 of their names.

    The share of a log doesn't depend on the other logs.

    Raises:
        ConfigError: ``share`` is not K/N with K from 1 to N.
    """
    found = _SHARE.fullmatch(share)
    number, of = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= number <= of:
        remedy = "pass one from 1/4 to 4/4 to each of four machines, for instance"
        raise ConfigError(f"--share {share} is not K/N with K from 1 to N", remedy=remedy)
    return [log for log in logs if _digest(log["name"]) % of == number - 1]


def _digest(name: str) -> int:
    return int.from_bytes(hashlib.sha256(name.encode()).digest()[:8])


def _in_bucket(url: str, join: bool) -> list[Log]:
    from jaxdet.io.files import left_out_text, listed_recordings, recording_name
    from jaxdet.io.folders.recording import APPLE_DOUBLE
    from jaxdet.io.splits import METADATA, listed_in

    place = open_place(url)
    entries: dict[PurePath, Entry] = {PurePosixPath(entry.key): entry for entry in place.list()}
    if not entries and (found := _one_object(url)):
        return [found]
    lists = [path for path in entries if join and path.name == METADATA]
    contents = ((path.parent, place.get(str(path))) for path in lists)
    listed: dict[PurePath, frozenset[str]] = {
        folder: listed_in(found[0]) for folder, found in contents if found
    }
    seen = [path for path in entries if not path.name.startswith(APPLE_DOUBLE)]
    groups, left = listed_recordings(seen, listed)
    logs = []
    for paths in groups:
        joined, folder = len(paths) > 1, paths[0].parent
        name = folder / recording_name(paths[0], joined=joined)
        files = [*paths, folder / METADATA] if joined else paths
        logs.append(_log(str(name), url, [entries[path] for path in files]))
    if not logs:
        remedy = "name a prefix of MCAP, .db3 or .bag files; folders of images must be local"
        raise InputError("no logs found", path=url, remedy=remedy)
    note = left_out_text([(printable(str(path)), why) for path, why in left])
    logs[0]["remarks"] = {"note": note, "about": ""}
    return logs


def _one_object(url: str) -> Log | None:
    """Return the log at an address that is an object, not a prefix; None if there is no log."""
    from jaxdet.io.files import listed_recordings, recording_name

    folder, _, name = url.rpartition("/")
    path = PurePosixPath(name)
    if not listed_recordings([path], {})[0] or folder.endswith(":/"):
        return None
    found = [entry for entry in open_place(folder).list() if entry.key == name]
    return _log(recording_name(path, joined=False), folder, found) if found else None


def _log(name: str, url: str, entries: Iterable[Entry]) -> Log:
    from jaxdet.results.names import log_name

    files = [entry._asdict() for entry in entries]
    name = printable(name)
    return {"log": name, "name": log_name(name), "url": url, "files": files}


def _local(paths: Sequence[str], join: bool) -> list[Log]:
    from jaxdet.io import find_logs
    from jaxdet.results.manifest import fingerprint

    logs = []
    for found in find_logs(paths, join=join):
        files = [input_entry(fingerprint(path.absolute())) for path in found.paths]
        remarks = {"note": found.note, "about": found.about}
        logs.append({**_log(found.name, "", files), "remarks": remarks})
    return logs
