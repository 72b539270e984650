"""Versions of jaxdet, of its source and of packages that results depend on, for records."""

import hashlib
import os
import platform
import traceback
from collections.abc import Iterable, Iterator
from functools import cache

import jaxdet
from jaxdet.errors import printable

PACKAGES = ("jax", "jaxlib", "warp-lang", "numpy", "opencv-python-headless", "pyarrow", "mcap")
_CODE = (".py", ".h", ".json")
"""Suffixes of Python files, of the kernels' C++ headers and of learnt tables."""


@cache
def versions() -> dict[str, str | None]:
    """Return versions of Python and of packages that results depend on; None if not installed."""
    found = {name: version(name) for name in PACKAGES}
    return {"python": platform.python_version(), **found}


@cache
def version(name: str) -> str | None:
    """Return the version of a package; None if it is not installed."""
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed  # imported here, as it takes long

    try:
        return installed(name)
    except PackageNotFoundError:
        return jaxdet.__version__ if name == "jaxdet" else None


@cache
def source_digest() -> str:
    """Return a checksum of jaxdet's own code, as two builds of a version may differ.

    Returns:
        16 hexadecimal digits of the SHA-256 of the names and contents of all files that decide
        results. The computation takes about 10 ms.
    """
    from importlib.util import find_spec

    hashed = hashlib.sha256()
    for package in ("jaxdet", "jaxdet_kernels"):
        spec = find_spec(package)
        for folder in (spec and spec.submodule_search_locations) or ():
            for path in sorted(_code(folder)):
                with open(path, "rb") as file:
                    content = file.read()
                name = package + path[len(folder) :].replace(os.sep, "/")
                hashed.update(f"{name} {len(content)}\n".encode())
                hashed.update(content)
    return hashed.hexdigest()[:16]


def crash_report(error: BaseException, inputs: Iterable[object] = ()) -> str:
    """Return the report of a bug in jaxdet: inputs, versions and traceback, printable."""
    lines = [*map(str, inputs), "", f"jaxdet {jaxdet.__version__}, source {source_digest()}"]
    lines += [f"{name} {version}" for name, version in versions().items()]
    lines += ["", *"".join(traceback.format_exception(error)).splitlines()]
    return "\n".join(map(printable, lines)).lstrip("\n") + "\n"


def _code(folder: str) -> Iterator[str]:
    for entry in os.scandir(folder):
        if entry.is_dir():
            yield from _code(entry.path)
        elif entry.name.endswith(_CODE):
            yield entry.path
