"""Reports of faults of jaxdet itself, for its developers."""

import traceback
from collections.abc import Iterable

import jaxdet
from jaxdet.errors import printable
from jaxdet.results.versions import source_digest, versions


def crash_report(error: BaseException, inputs: Iterable[object] = ()) -> str:
    """Return the inputs, the versions and the traceback, every line fit for a terminal."""
    lines = [*map(str, inputs), "", f"jaxdet {jaxdet.__version__}, source {source_digest()}"]
    lines += [f"{name} {version}" for name, version in versions().items()]
    lines += ["", *"".join(traceback.format_exception(error)).splitlines()]
    return "\n".join(map(printable, lines)).lstrip("\n") + "\n"
