"""The flags of a command: every field of its dataclass, and of the dataclasses in it.

``max_depth_m`` in ``ground`` is ``--ground.max-depth-m``. Metadata of a field changes that:
``positional``, it has no flag; ``short``, the flag (of a dataclass: its flags) lacks the names of
what it is in; ``takes``, what help calls its value. Fields without a default must be given.
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
"""Short forms, in every command that has the flag: as in ffmpeg, ``rosbag`` and ``mcap``."""


class Option(NamedTuple):
    """A field that the command line can set."""

    path: tuple[str, ...]
    """Names of the fields that lead to it."""
    section: str
    """The part of the command that help counts it to; empty: to the command itself."""
    flag: str
    """``--ground.max-depth-m``; empty where it is positional. Of angles without ``-rad``."""
    kind: Any
    """Its type without None."""
    optional: bool
    """Whether None is a value."""
    default: Any
    """``dataclasses.MISSING``: it must be given."""
    owner: type
    """The dataclass that it is a field of."""
    takes: str
    """What help calls its value; empty: by its name and type."""

    @property
    def name(self) -> str:
        """Of the field."""
        return self.path[-1]

    @property
    def letter(self) -> str:
        """The short form of its flag; mostly empty."""
        return LETTERS.get(self.flag, "")

    @property
    def text(self) -> str:
        """What its docstring says."""
        return field_texts(self.owner).get(self.name, "")

    @property
    def angle(self) -> bool:
        """Whether it is in radians: its flag takes a number with a unit."""
        return self.name.endswith("_rad") and self.kind is float

    @property
    def switches(self) -> dict[str, bool]:
        """The flags of a truth value, and what each sets."""
        if self.kind is not bool:
            return {}
        before, dot, name = self.flag.rpartition(".")
        off = f"{before}.no-{name}" if dot else f"--no-{self.flag.removeprefix('--')}"
        return {self.flag: True, off: False}


def options_of(
    kind: type,
    defaults: Mapping[str, Any],
    path: tuple[str, ...] = (),
    section: str = "",
    before: str = "--",
) -> Iterator[Option]:
    """The options of a dataclass, in the order of its fields.

    Args:
        kind: The dataclass.
        defaults: Values of fields, in place of their own defaults.
        path: The fields that lead to it.
        section: The part of the command that it is in.
        before: What its flags begin with.
    """
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        hint, here = hints[field.name], (*path, field.name)
        default, short = default_of(field, defaults), field.metadata.get("short", False)
        flag = ("--" if short else before) + field.name.replace("_", "-")
        if dataclasses.is_dataclass(hint):
            inner = dict(vars(default)) if default is not MISSING else {}
            start = before if short else f"{flag}."
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
    """What a field is where it isn't given; ``dataclasses.MISSING``: it must be."""
    if field.name in defaults:
        return defaults[field.name]
    return field.default if field.default_factory is MISSING else field.default_factory()


@cache
def field_texts(kind: type) -> dict[str, str]:
    """The string after each annotated name in the class body, without its line breaks."""
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
