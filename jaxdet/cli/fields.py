"""Command-line flags from the fields of a command's dataclass and of the dataclasses in it.

The field ``max_depth_m`` in ``ground`` becomes ``--ground.max-depth-m``. Field metadata change
this: ``positional`` makes an argument without a flag; ``short`` leaves the names of the enclosing
fields out of the flag, or out of all flags of a nested dataclass; ``takes`` sets the name of the
value in help texts. Fields without a default are required.
"""

import ast
import dataclasses
import inspect
import textwrap
import types
import typing
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

LETTERS = {
    "--verbose": "-v",
    "--debug": "-vv",
    "--output": "-o",
    "--quiet": "-q",
    "--overwrite": "-y",
}
"""Short flags by long flag, for every command that has the long flag; the same as in ffmpeg,
``rosbag``, ``mcap``."""


class Option(NamedTuple):
    """A field that can be set on the command line."""

    path: tuple[str, ...]
    """Field names from the command's dataclass to this field."""
    section: str
    """Section in which help lists the option; empty for the command's own options."""
    flag: str
    """Flag such as ``--ground.max-depth-m``, for angles without ``-rad``; empty if positional."""
    kind: Any
    """Type, without None."""
    optional: bool
    """Whether None is a valid value."""
    default: Any
    """Default value; ``dataclasses.MISSING`` if the option is required."""
    owner: type
    """Dataclass of the field."""
    takes: str
    """Name of the value in help texts; if empty, it follows from the name and type."""

    @property
    def name(self) -> str:
        """Name of the field."""
        return self.path[-1]

    @property
    def letter(self) -> str:
        """Short form of the flag; empty for most flags."""
        return LETTERS.get(self.flag, "")

    @property
    def text(self) -> str:
        """Docstring of the field."""
        return field_texts(self.owner).get(self.name, "")

    @property
    def angle(self) -> bool:
        """Whether the value is an angle, passed as a number with a unit."""
        return self.name.endswith("_rad") and self.kind is float

    @property
    def switches(self) -> dict[str, bool]:
        """The two flags of a boolean option and the values they set; empty for other options."""
        if self.kind is not bool:
            return {}
        prefix, dot, name = self.flag.rpartition(".")
        off = f"{prefix}.no-{name}" if dot else f"--no-{self.flag.removeprefix('--')}"
        return {self.flag: True, off: False}


def options_of(
    kind: type,
    defaults: Mapping[str, Any],
    path: tuple[str, ...] = (),
    section: str = "",
    prefix: str = "--",
) -> Iterator[Option]:
    """Yield the options of a dataclass, in the order of its fields.

    Args:
        kind: The dataclass.
        defaults: Default values by field name, which override those of the dataclass.
        path: Field names from the command's dataclass to ``kind``.
        section: Section of the command in which help lists the options.
        prefix: Prefix of the flags.
    """
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        hint, here = hints[field.name], (*path, field.name)
        default, short = default_of(field, defaults), field.metadata.get("short", False)
        flag = ("--" if short else prefix) + field.name.replace("_", "-")
        if dataclasses.is_dataclass(hint):
            inner = dict(vars(default)) if default is not MISSING else {}
            start = prefix if short else f"{flag}."
            part = typing.cast(type, hint)
            yield from options_of(part, inner, here, field.name, start)
            continue
        parts = typing.get_args(hint) if _is_union(hint) else (hint,)
        (bare,) = (part for part in parts if part is not types.NoneType)
        takes = field.metadata.get("takes", "")
        of = "" if short else section
        optional = types.NoneType in parts
        option = Option(here, of, flag, bare, optional, default, kind, takes)
        if option.angle:
            option = option._replace(flag=flag.removesuffix("-rad"))
        yield option._replace(flag="") if field.metadata.get("positional") else option


def default_of(field: dataclasses.Field, defaults: Mapping[str, Any]) -> Any:
    """Return the default of a field; ``dataclasses.MISSING`` if the field is required."""
    if field.name in defaults:
        return defaults[field.name]
    return field.default if field.default_factory is MISSING else field.default_factory()


@cache
def field_texts(kind: type) -> dict[str, str]:
    """Return the docstrings of a dataclass's fields by name, each on one line."""
    try:
        source = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
    except (OSError, TypeError, SyntaxError):
        return {}
    body = source.body if isinstance(source, ast.ClassDef) else []
    texts = {}
    for field, after in pairwise(body):
        match field, after:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                texts[name] = " ".join(text.split())
    return texts


def _is_union(hint: Any) -> bool:
    return typing.get_origin(hint) in (typing.Union, types.UnionType)
