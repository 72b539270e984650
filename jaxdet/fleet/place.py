"""Places for logs and results: a folder, or a prefix of a bucket in S3, Google Cloud or Azure.

A :class:`Folder` and a :class:`Bucket` have the same methods. Two methods decide races: ``create``
writes a file only if none exists, ``swap`` only if the file is unchanged since it was read.
Credentials come from the environment variables that the services' own programs use. An address with
credentials is refused, so that no credentials get into a file, a log line or an error.
"""

import fcntl
import os
import re
import secrets
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

from jaxdet.errors import ConfigError, InputError, OutputError
from jaxdet.results.durable import write_whole, writing
from jaxdet.results.layout import FLEET

RANGE_BYTES = 64 << 20
"""Number of bytes per request of a fetch."""
CONNECTIONS = 16
"""Maximum number of simultaneous requests of a fetch."""
_PIECE_BYTES = 4 << 20
"""Minimum number of bytes of a response that are written to disk at a time."""
_MULTIPART_BYTES = 1 << 30
"""Size above which a file is uploaded in parts [bytes]; it becomes visible after the last part."""
_URL = re.compile(r"(s3|gs|az):/+(.*)", re.DOTALL | re.IGNORECASE)
_SECRET = re.compile(r"(?<=:/)(/*)(?:[^/\s@]*@|[^/\s]*:\S*@)|[?#][^\s\"')]*")
"""User parts of addresses, whose passwords may contain slashes, and queries."""
_RESPONSE = re.compile(r"(?:<\?xml[^>]*>\s*)?<Error>.*?(?:</Error>|$)", re.DOTALL)
"""Error in a response of a store. It may name the key and what was signed with it."""
_REASON = re.compile(r"<(?:Code|Message)>([^<]*)<")
_REMEDY = "check the address, the keys in the environment, and who may read and write there"

Tag = Mapping[str, str]
"""Identity of one version of a file, as its place reports it."""


class Entry(NamedTuple):
    """File in a listing: its path relative to the place, its size [bytes] and its version."""

    key: str
    size: int
    tag: Tag


def input_entry(about: Mapping[str, Any]) -> Entry:
    """Return the entry of a file in ``fetched`` or ``inputs`` of a manifest.

    Args:
        about: ``path``, ``size`` and the fields of the tag for a file of a bucket; for a local file
            its :func:`jaxdet.results.manifest.fingerprint`.
    """
    if "fingerprint" in about:
        tag = {"e_tag": f"{about['mtime_ns']}-{about['fingerprint']}"}
    else:
        tag = _tag_of(about)
    return Entry(about["path"], about.get("size", 0), tag)


def scrub(text: str) -> str:
    """Remove possible credentials from an address or an error: user parts, queries, keys.

    >>> scrub("GET s3://key:secret@bucket/logs?sig=123 failed")
    'GET s3://bucket/logs failed'
    >>> scrub("403: <Error><Code>AccessDenied</Code><AWSAccessKeyId>AKID</AWSAccessKeyId></Error>")
    '403: AccessDenied'
    """
    text = _RESPONSE.sub(lambda found: ": ".join(_REASON.findall(found[0])), text)
    return _SECRET.sub(r"\1", text)


def is_url(text: str | os.PathLike[str]) -> bool:
    """Return whether an address names a bucket; as a ``Path`` it has one slash after the colon."""
    return bool(_URL.match(os.fspath(text)))


def address(text: str | os.PathLike[str]) -> str:
    """Return the canonical form of an address.

    Raises:
        ConfigError: The address holds credentials, names no bucket, or is of an unsupported kind.
    """
    text = os.fspath(text)
    if not (found := _URL.fullmatch(text)):
        if re.match(r"[a-z][a-z0-9+]*:/", text, re.IGNORECASE):
            remedy = "pass a folder, s3://BUCKET/PATH, gs://BUCKET/PATH or az://CONTAINER/PATH"
            raise ConfigError("unsupported kind of address", path=scrub(text), remedy=remedy)
        return str(Path(text).absolute())
    url = f"{found[1].lower()}://{found[2].rstrip('/')}"
    if scrub(url) != url:
        problem = "an address with credentials or a query is refused"
        remedy = "set keys in the environment, for instance AWS_ACCESS_KEY_ID"
        raise ConfigError(problem, path=scrub(url), remedy=remedy)
    if not found[2].strip("/"):
        raise ConfigError("names no bucket", path=url, remedy="pass s3://BUCKET/PATH, for instance")
    return url


@cache
def open_place(url: str) -> "Place":
    """Open a place by its address; a folder need not exist yet.

    Raises:
        ConfigError: The address is wrong, or obstore is not installed.
    """
    url = address(url)
    return Bucket(url) if is_url(url) else Folder(url)


def probe(place: "Place") -> None:
    """Check that a place honours conditional writes.

    Raises:
        ConfigError: The place ignores conditions, so two machines could both create a file.
    """
    key = f"{FLEET}/probe-{secrets.token_hex(8)}"
    try:
        first, second, stale = place.create(key, b"1"), place.create(key, b"2"), True
        if found := place.get(key):
            place.put(key, b"3")
            stale = place.swap(key, b"4", found[1])
    finally:
        place.delete([key])
    if not first or second or stale:
        problem = "this store ignores conditional writes (If-None-Match, If-Match)"
        remedy = "results of several machines could mix there: use another store"
        raise ConfigError(problem, path=place.url, remedy=remedy)


class Bucket:
    """A prefix of a bucket, accessed with obstore."""

    def __init__(self, url: str) -> None:
        self.url, self.store = url, _store(url)

    def list(self, under: str = "") -> Iterator[Entry]:
        """Yield the files below a folder, in no order."""
        import obstore

        with self._reached(under):
            for page in obstore.list(self.store, under or None, chunk_size=1000):
                yield from (Entry(one["path"], one["size"], _tag_of(one)) for one in page)

    def get(self, key: str) -> tuple[bytes, Tag] | None:
        """Return a small file and its tag; None if it is missing."""
        import obstore

        with self._reached(key):
            try:
                found = obstore.get(self.store, key)
                return bytes(found.bytes()), _tag_of(found.meta)
            except FileNotFoundError:
                return None

    def put(self, key: str, content: bytes | Path) -> None:
        """Write a file completely or not at all."""
        import obstore

        large = isinstance(content, Path) and content.stat().st_size > _MULTIPART_BYTES
        with self._reached(key):
            obstore.put(self.store, key, content, use_multipart=large)

    def create(self, key: str, content: bytes) -> bool:
        """Write a file if there is none; return whether it was written."""
        return self._put_if(key, content, "create")

    def swap(self, key: str, content: bytes, tag: Tag) -> bool:
        """Replace a file if it still has this tag; return whether it was replaced."""
        return self._put_if(key, content, dict(tag))

    def _put_if(self, key: str, content: bytes, mode: Any) -> bool:
        import obstore
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        with self._reached(key):
            try:
                obstore.put(self.store, key, content, mode=mode, use_multipart=False)
            except (AlreadyExistsError, PreconditionError, FileNotFoundError) as error:
                if mode == "create" and isinstance(error, FileNotFoundError):
                    raise  # there is no such bucket
                # If the response to a request is lost, obstore repeats the request, which then
                # finds the object that it created itself.
                found = self.get(key)
                return found is not None and found[0] == content
        return True

    def fetch(self, entry: Entry, path: Path, stop: Event) -> None:
        """Copy a file to local disk, until ``stop`` is set.

        Raises:
            InputError: The file was removed or replaced since it was listed.
        """
        with writing(path), path.open("wb") as file, ThreadPoolExecutor(CONNECTIONS) as pool:
            os.truncate(file.fileno(), entry.size)

            def copy(start: int) -> None:
                if not stop.is_set():
                    self._range(entry, start, file.fileno(), stop)

            try:
                deque(pool.map(copy, range(0, entry.size, RANGE_BYTES)), 0)
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise

    def _range(self, entry: Entry, start: int, file: int, stop: Event) -> None:
        """Copy one range into an open file at its place."""
        import obstore
        from obstore.exceptions import PreconditionError

        end = min(start + RANGE_BYTES, entry.size)
        options: Any = {"range": (start, end), "if_match": entry.tag.get("e_tag")}
        with self._reached(entry.key):
            try:
                found = obstore.get(self.store, entry.key, options=options)
                for piece in found.stream(min_chunk_size=_PIECE_BYTES):
                    if stop.is_set():
                        return
                    with writing(Path("local disk")):
                        start += os.pwrite(file, piece, start)
            except (FileNotFoundError, PreconditionError):
                found = None
        if not found or start != end or found.meta["size"] != entry.size:
            problem = "was removed or replaced while it was fetched"
            raise InputError(problem, path=f"{self.url}/{entry.key}")

    def delete(self, keys: Iterable[str]) -> None:
        """Remove files; missing files are ignored."""
        import obstore

        with self._reached():
            for key in keys:
                with suppress(FileNotFoundError):
                    obstore.delete(self.store, key)

    @contextmanager
    def _reached(self, key: str = "") -> Iterator[None]:
        """Turn errors of the store into errors of jaxdet, without credentials."""
        from obstore.exceptions import BaseError

        try:
            yield
        except (BaseError, OSError, ValueError) as error:
            text = scrub(str(error)).partition("\n")[0]
            path = f"{self.url}/{key}" if key else self.url
            raise OutputError(f"can't be used ({text})", path=path, remedy=_REMEDY) from None


def _tag_of(about: Mapping[str, Any]) -> Tag:
    return {name: about[name] for name in ("e_tag", "version") if about.get(name)}


def _store(url: str) -> Any:
    try:
        from obstore.exceptions import BaseError
        from obstore.store import from_url
    except ImportError:
        remedy = "install it with: pip install 'jaxdet[cloud]'"
        raise ConfigError("buckets need obstore", path=url, remedy=remedy) from None
    try:
        return from_url(url)
    except (BaseError, ValueError) as error:
        text = scrub(str(error)).partition("\n")[0]
        raise ConfigError(f"can't be opened ({text})", path=url, remedy=_REMEDY) from None


class Folder:
    """A folder of a local or shared file system, whose files are read without a local copy."""

    def __init__(self, url: str) -> None:
        self.url, self.root = url, Path(url)

    def list(self, under: str = "") -> Iterator[Entry]:
        for folder, _, names in os.walk(self.root / under):
            for path in (Path(folder, name) for name in names if not name.startswith(".")):
                with suppress(FileNotFoundError):
                    about = path.stat()
                    yield Entry(path.relative_to(self.root).as_posix(), about.st_size, _tag(about))

    def get(self, key: str) -> tuple[bytes, Tag] | None:
        try:
            with (self.root / key).open("rb") as file:
                return file.read(), _tag(os.fstat(file.fileno()))
        except (FileNotFoundError, NotADirectoryError):
            return None

    def put(self, key: str, content: bytes | Path) -> None:
        with self._made(key) as path:
            write_whole(path, content if isinstance(content, bytes) else content.read_bytes())

    def create(self, key: str, content: bytes) -> bool:
        with self._made(key) as path:
            new = path.with_name(f".{secrets.token_hex(8)}")
            write_whole(new, content)
            try:
                path.hardlink_to(new)
            except FileExistsError:
                return False
            finally:
                new.unlink()
        return True

    def swap(self, key: str, content: bytes, tag: Tag) -> bool:
        with self._made(key) as path, locked(self.root):
            found = self.get(key)
            if found is None or found[1] != tag:
                return False
            write_whole(path, content)
        return True

    def delete(self, keys: Iterable[str]) -> None:
        for path in (self.root / key for key in keys):
            with writing(path):
                path.unlink(missing_ok=True)

    @contextmanager
    def _made(self, key: str) -> Iterator[Path]:
        path = self.root / key
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield path


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes that lock it, also on other machines.

    The lock is on a file that is open for writing: NFS locks folders on one machine only.
    """
    path = folder / FLEET / "lock"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _tag(about: os.stat_result) -> Tag:
    return {"e_tag": f"{about.st_size}-{about.st_mtime_ns}-{about.st_ino}"}


Place = Bucket | Folder
