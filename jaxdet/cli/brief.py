"""The short help of a command: its options in a line or two; --help-all has every setting."""

import dataclasses
import re
import textwrap
import types
import typing
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import tyro

from jaxdet.cli.fields import field_texts, is_angle

WIDTH, INDENT = 100, 31
_UNITS = {"_m": "M", "_s": "S", "_hz": "HZ", "_mib": "MIB"}


class Option(NamedTuple):
    """A flag as help shows it."""

    name: str
    """Section and field, ``ground.max_depth_m``."""
    flag: str
    """With what it takes, ``--ground.max-depth-m M``."""
    text: str
    """Its first sentence, and its default."""


def brief_help(start: Any, prog: str, description: str, common: Sequence[str]) -> str:
    """The help of a command.

    Args:
        start: The command, a dataclass instance with its defaults.
        prog: Its name.
        description: What it does, and examples.
        common: The fields of its sections that are shown, ``ground.max_depth_m``, or sections all
            of whose fields are, ``run``.

    Returns:
        Lines of at most ``WIDTH`` columns; the command's own fields come first.
    """
    every = list(_options(start, ""))
    sections = {option.name.partition(".")[0] for option in every if "." in option.name}
    own = [o for o in every if "." not in o.name or o.name.partition(".")[0] in common]
    settings = [option for name in common for option in every if option.name == name]
    hidden = len(every) - len(own) - len(settings)
    words = [_positional(start), *(o.flag for o in own if not o.text.endswith("]")), "[OPTIONS]"]
    lines = [f"usage: {prog} {' '.join(filter(None, words))}", "", description.rstrip(), ""]
    lines += ["options:", *_rows([*own, *settings])]
    if hidden:
        of = ", ".join(sorted(sections - set(common)))
        rest = f"Its other {hidden} settings, of {of}"
        lines += _rows([Option("", "--help-all", rest)])
    return "\n".join(lines) + "\n"


def _options(value: Any, prefix: str, shown: str | None = None) -> Iterator[Option]:
    """All flags of a dataclass instance; ``shown`` is what they begin with on the command line."""
    hints = typing.get_type_hints(type(value), include_extras=True)
    texts = field_texts(type(value))
    for field in dataclasses.fields(value):
        bare, notes = _bare(hints[field.name])
        if tyro.conf.Positional in notes:
            continue
        default, name = getattr(value, field.name), field.name
        argument = next((n for n in notes if hasattr(n, "metavar") and hasattr(n, "name")), None)
        if dataclasses.is_dataclass(bare):
            unnamed = argument is not None and argument.name == ""
            flag = prefix if unnamed else f"{prefix}{name}."
            yield from _options(default, f"{name}." if not prefix else f"{prefix}{name}.", flag)
            continue
        before = prefix if shown is None else shown
        section = prefix
        if field.metadata.get("short"):
            before = section = ""
        angle = is_angle(name, bare)
        flag = f"--{before}{name.removesuffix('_rad') if angle else name}".replace("_", "-")
        text = _first_sentence(texts.get(name, ""))
        takes = "TOPIC" if text.startswith("Topic") else _metavar(name, bare)
        takes = (argument.metavar if argument else None) or takes
        if default is None or default is False:
            text += "  []"
        elif default is not tyro.MISSING and (default or not angle):
            text += f"  [{_plain(default)}{'rad' * angle}]"
        yield Option(f"{section}{name}", f"{flag} {takes}".strip(), text)


def _bare(hint: Any) -> tuple[Any, list[Any]]:
    if typing.get_origin(hint) is typing.Annotated:
        bare, *notes = typing.get_args(hint)
        return bare, notes
    return hint, []


def _metavar(name: str, kind: Any) -> str:
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        kind = next(part for part in typing.get_args(kind) if part is not type(None))
    if is_angle(name, kind):
        return "ANGLE"
    if typing.get_origin(kind) is typing.Literal:
        return "{" + ",".join(map(str, typing.get_args(kind))) + "}"
    if typing.get_origin(kind) is tuple:
        return f"{len(typing.get_args(kind))} NUMBERS"
    if kind is bool:
        return ""
    unit = next((text for end, text in _UNITS.items() if name.endswith(end)), None)
    return unit or {int: "N", float: "X"}.get(kind, name.rpartition("_")[2].upper())


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _first_sentence(text: str) -> str:
    text = re.sub(r" \(:\w+:`[^`]*`\)| \[rad\]|`", "", text)
    return re.split(r"(?<=[a-z0-9\])])[.;]\s|\.$", text, maxsplit=1)[0]


def _positional(start: Any) -> str:
    hints = typing.get_type_hints(type(start), include_extras=True)
    for hint in hints.values():
        _, notes = _bare(hint)
        if tyro.conf.Positional in notes:
            return next(n.metavar for n in notes if getattr(n, "metavar", None))
    return ""


def _rows(options: Sequence[Option]) -> list[str]:
    rows = []
    for option in options:
        flag, text = f"  {option.flag}", option.text.removesuffix("  []")
        lines = textwrap.wrap(text, WIDTH - INDENT, max_lines=2, placeholder=" ...")
        if len(flag) > INDENT - 2:
            rows.append(flag)
        else:
            lines[0] = f"{flag:<{INDENT}}{lines[0]}"
            rows.append(lines.pop(0))
        rows += [" " * INDENT + line for line in lines]
    return rows
