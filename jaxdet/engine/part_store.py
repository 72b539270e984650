"""A place for parts that several machines share: a folder, or a bucket of objects."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.errors import ConfigError, OutputError
from jaxdet.results.durable import write_whole, writing

_MAKE_ROOM = "make room or give another --parts"
_SECRET = re.compile(r"(?<=://)[^@]*:[^@]*@|\?.*")


class PartStore(NamedTuple):
    """A place for parts; other processes can be given it."""

    url: str
    """A folder, or what :meth:`pyarrow.fs.FileSystem.from_uri` takes."""
    folder: str = ""
    """In that place."""

    def __str__(self) -> str:
        """The address without keys."""
        return _SECRET.sub("", self.url) if "://" in self.url else self.url

    def within(self, name: str) -> "PartStore":
        """A folder in this one."""
        return self._replace(folder=f"{self.folder}/{name}" if self.folder else name)

    def names(self) -> set[str]:
        """What is in it, files and folders.

        Raises:
            OutputError: The place can't be reached; so do all methods.
        """
        from pyarrow.fs import FileSelector

        system, place = _opened(self.url)
        with self._reached():
            found = system.get_file_info(FileSelector(self._path(place), allow_not_found=True))
        return {info.base_name for info in found}

    def get(self, name: str) -> bytes | None:
        """The content of a file; None: there is none."""
        system, place = _opened(self.url)
        with self._reached():
            try:
                path = self._path(place, name)
                with system.open_input_stream(path, compression=None) as file:
                    return file.read()
            except (FileNotFoundError, NotADirectoryError):
                return None

    def put(self, name: str, content: bytes) -> None:
        """Writes a file: it is there as a whole, or not."""
        from pyarrow.fs import LocalFileSystem

        system, place = _opened(self.url)
        path = self._path(place, name)
        if isinstance(system, LocalFileSystem):
            with writing(Path(path), _MAKE_ROOM):
                Path(path).parent.mkdir(parents=True, exist_ok=True)
            write_whole(Path(path), content, remedy=_MAKE_ROOM)
            return
        with self._reached(), system.open_output_stream(path, compression=None) as file:
            file.write(content)

    def _path(self, place: str, name: str = "") -> str:
        return "/".join(part for part in (place, self.folder, name) if part)

    @contextmanager
    def _reached(self) -> Iterator[None]:
        import pyarrow as pa

        try:
            yield
        except (OSError, pa.ArrowException) as error:
            raise self.unreached(error) from error

    def unreached(self, error: Exception) -> OutputError:
        """The error of a place that can't be reached."""
        text = getattr(error, "strerror", None) or str(error).replace(self.url, str(self))
        remedy = "check the address, and who may read and write there"
        return OutputError(f"can't be used ({text})", path=str(self), remedy=remedy)


@cache
def _opened(url: str) -> tuple[Any, str]:
    """The file system of an address, and the path there.

    Raises:
        ConfigError: It is no address that is known.
        OutputError: It can't be reached.
    """
    import pyarrow as pa
    from pyarrow.fs import FileSystem

    try:
        found, path = FileSystem.from_uri(url if "://" in url else str(Path(url).absolute()))
    except OSError as error:
        raise PartStore(url).unreached(error) from None
    except (ValueError, pa.ArrowException) as error:
        shown = str(PartStore(url))
        raise ConfigError(
            f"--parts {shown}: {str(error).replace(url, shown)}",
            remedy="give a folder, s3://BUCKET/PATH, gs://BUCKET/PATH or abfs://CONTAINER/PATH",
        ) from None
    return found, path.rstrip("/")
