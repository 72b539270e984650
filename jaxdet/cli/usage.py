"""Help texts of commands: a selection of the options in short form, or all in full."""

import math
import re
import shutil
import textwrap
import typing
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from typing import Any

from jaxdet.cli.fields import Option

WIDTH, INDENT = 100, 31
NARROW, NARROWEST, NARROW_INDENT = 72, 32, 8
"""In terminals with fewer than ``NARROW`` columns, descriptions are shown below their flags,
indented by ``NARROW_INDENT``. Help is never narrower than ``NARROWEST`` columns."""
_UNITS = {"_m": "M", "_s": "S", "_hz": "HZ", "_mib": "MIB"}


def usage(
    options: Sequence[Option],
    prog: str,
    description: str,
    common: Sequence[str] | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
    *,
    whole: bool = False,
) -> str:
    """Return the help of a command.

    Args:
        options: All options of the command.
        prog: Name of the command.
        description: Description and examples.
        common: Options to list, such as ``ground.max_depth_m``, or sections to list completely,
            such as ``run``; None lists all. The command's own options come first.
        groups: Flags by heading of the short help; other flags come last.
        whole: List all options with their full descriptions.

    Returns:
        Text of at most ``WIDTH`` columns, fewer on a narrower terminal or if ``COLUMNS`` is less.
    """
    shown = [option.section for option in options] if common is None else common
    own = [o for o in options if o.flag and (not o.section or o.section in shown)]
    rest = [o for o in options if o.flag and o not in own]
    words = [*(o for o in options if not o.flag), *(o for o in own if o.default is MISSING)]
    needed = [f"{o.flag} {takes(o)}".strip() for o in words]
    head = _wrapped(f"usage: {' '.join([prog, *needed, '[OPTIONS]'])}", "       ")
    lines = [head, "", _about(description), ""]
    positional = [o for o in words if not o.flag]
    if positional:
        lines += ["arguments:", *(_row(takes(o), o.text) for o in positional), ""]
    if whole or common is None:
        lines += ["options:", *(_row(_flags(o), _described(o, whole=True)) for o in own)]
        lines.append(_row("-h, --help", "This text"))
        for name in dict.fromkeys(o.section for o in rest):
            members = [o for o in rest if o.section == name]
            about = " ".join((members[0].owner.__doc__ or "").split("\n\n")[0].split())
            lines += ["", _wrapped(f"{name}: {about}", "  ")]
            lines += [_row(_flags(o), _described(o, whole=True)) for o in members]
        return "\n".join(lines) + "\n"
    chosen = [o for name in common for o in rest if f"{o.section}.{o.name}" == name]
    left = {o.flag: o for o in [*own, *chosen]}
    for heading, flags in (groups or {}).items():
        lines.append(f"{heading}:")
        lines += [*(_row(_flags(o), _described(o), 2) for o in map(left.pop, flags)), ""]
    lines += ["options:", *(_row(_flags(o), _described(o), 2) for o in left.values())]
    hidden = ", ".join(sorted({o.section for o in rest}))
    if len(rest) > len(chosen):
        text = f"The other {len(rest) - len(chosen)} settings: {hidden}"
        lines.append(_row("--help-all", text))
    return "\n".join(lines) + "\n"


def takes(option: Option) -> str:
    """Return the name of an option's value in help texts; empty for a switch."""
    kind, name = option.kind, option.name
    if option.takes or kind is bool:
        return option.takes
    if option.angle:
        return "ANGLE"
    if typing.get_origin(kind) is typing.Literal:
        return "{" + ",".join(map(str, typing.get_args(kind))) + "}"
    if typing.get_origin(kind) is tuple:
        return f"{len(typing.get_args(kind))} NUMBERS"
    if option.text.startswith("Topic"):
        return "TOPIC"
    unit = next((text for end, text in _UNITS.items() if name.endswith(end)), None)
    return unit or {int: "N", float: "X"}.get(kind, name.rpartition("_")[2].upper())


def _flags(option: Option) -> str:
    """Return the flag; if the option is on by default, also the flag that turns it off."""
    names = list(option.switches) if option.default is not False else []
    names = names or [f"{option.flag} {takes(option)}".strip()]
    return ", ".join(filter(None, [option.letter, *names]))


def _described(option: Option, *, whole: bool = False) -> str:
    """Return the docstring of an option, or its first sentence, with the default."""
    text = re.sub(r" \(:\w+:`[^`]*`\)| \[rad\]|`", "", option.text)
    text = text.removesuffix(".")
    if not whole:
        text = re.split(r"(?<=[a-z0-9\])])[.;]\s", text, maxsplit=1)[0]
    default = option.default
    if isinstance(default, bool):
        return f"{text}  [on]" if default else text
    if default is MISSING or default is None or isinstance(default, tuple):
        return text
    if option.angle:
        return f"{text}  [{round(math.degrees(default), 2):g}deg]" if default else text
    return f"{text}  [{f'{default:g}' if isinstance(default, float) else default}]"


def _row(flag: str, text: str, most: int | None = None) -> str:
    """Return a flag and its description in at most ``most`` lines of ``WIDTH`` columns."""
    columns = _columns()
    indent = INDENT if columns >= NARROW else NARROW_INDENT
    flag, start = f"  {flag}", " " * indent
    most = most and (most if columns == WIDTH else 2 * most)
    lines = _lines(text, columns - indent, max_lines=most, placeholder=" ...") or [""]
    if len(flag) > indent - 2:
        return "\n".join([flag, *(start + line for line in lines)])
    return f"{flag:<{indent}}" + f"\n{start}".join(lines)


def _about(description: str) -> str:
    """Wrap the paragraphs of a description; lists keep their lines."""
    parts = description.rstrip().split("\n\n")
    return "\n\n".join(part if "\n  " in f"\n{part}" else _wrapped(part) for part in parts)


def _wrapped(text: str, indent: str = "") -> str:
    return "\n".join(_lines(text, _columns(), subsequent_indent=indent))


def _lines(text: str, columns: int, **how: Any) -> list[str]:
    return textwrap.wrap(text, columns, break_on_hyphens=False, break_long_words=False, **how)


def _columns() -> int:
    """Return the width of the help: the width of the terminal, within limits."""
    return min(WIDTH, max(NARROWEST, shutil.get_terminal_size((WIDTH, 24)).columns))
