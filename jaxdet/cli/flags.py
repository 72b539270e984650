"""From dataclasses to flags: tyro, with each field's docstring as flowing text.

tyro shows an attribute docstring that goes over several lines with the line breaks of the
source. So flags are parsed into twins of the dataclasses, whose fields carry the docstring as
one line, and the twins are turned back. A field with ``short`` in its metadata gets a flag without
the name of what it is in.
"""

import dataclasses
import typing
from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from jaxdet.angles import parse_angle
from jaxdet.cli.brief import brief_help
from jaxdet.cli.fields import angle_flags, field_texts, is_angle

Command = TypeVar("Command")


def parse_flags(
    start: Command,
    args: Sequence[str],
    prog: str,
    description: str,
    common: Sequence[str] | None = None,
) -> Command:
    """The dataclass instance ``start``, changed as the flags say.

    Angles (``*_rad``) have flags without that ending, which take a number with its unit, ``10deg``
    or ``0.17rad``. The flags that have it are understood as well, and take plain radians.

    Args:
        start: Defaults; ``tyro.MISSING`` where a value must be given.
        args: The arguments.
        prog: The command's name in the help.
        description: What it does.
        common: What ``--help`` shows of its sections (:func:`jaxdet.cli.brief.brief_help`), where
            ``--help-all`` shows all; None: ``--help`` shows all.

    Raises:
        ConfigError: A value is out of its range.
        SystemExit: Help was asked for (0), or a flag is unknown (2).
    """
    args = list(args)
    if common is not None:
        if {"-h", "--help"} & set(args):
            print(brief_help(start, prog, description, common), end="")
            raise SystemExit(0)
        args = ["--help" if arg == "--help-all" else arg for arg in args]
    args = _with_units(args, set(angle_flags(type(start))))
    twin = _to_twin(start)
    parsed = tyro.cli(type(twin), args=args, default=twin, prog=prog, description=description)
    return _from_twin(parsed)


def _with_units(args: list[str], angles: set[str]) -> list[str]:
    """Flags of angles by their field's name as those that take a unit."""
    said = list(args)
    for i, arg in enumerate(args):
        flag, equals, value = arg.partition("=")
        name = flag.replace("_", "-")
        if not (flag.startswith("--") and name in angles):
            continue
        said[i] = name.removesuffix("-rad")
        if equals:
            said[i] += f"={_radians(value)}"
        elif i + 1 < len(args):
            said[i + 1] = _radians(args[i + 1])
    return said


def _radians(value: str) -> str:
    try:
        return f"{float(value)!r}rad"
    except ValueError:
        return value


def _angle_text(value: float) -> list[str]:
    return [f"{value!r}rad"]


_ANGLE = PrimitiveConstructorSpec(
    nargs=1,
    metavar="ANGLE",
    instance_from_str=lambda words: parse_angle(words[0]),
    is_instance=lambda value: isinstance(value, float),
    str_from_instance=_angle_text,
)
_PERHAPS_ANGLE = dataclasses.replace(
    _ANGLE,
    instance_from_str=lambda words: None if words == ["None"] else parse_angle(words[0]),
    is_instance=lambda value: value is None or isinstance(value, float),
    str_from_instance=lambda value: ["None"] if value is None else _angle_text(value),
)


def _to_twin(value: Any) -> Any:
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    fields = dataclasses.fields(value)
    return _twin(type(value))(**{f.name: _to_twin(getattr(value, f.name)) for f in fields})


def _from_twin(value: Any) -> Any:
    origin = getattr(type(value), "origin", None)
    if origin is None:
        return value
    fields = dataclasses.fields(value)
    return origin(**{f.name: _from_twin(getattr(value, f.name)) for f in fields})


@cache
def _twin(kind: type) -> type:
    hints = typing.get_type_hints(kind, include_extras=True)
    texts = field_texts(kind)
    fields = []
    for field in dataclasses.fields(kind):
        hint = _hint(field.name, hints[field.name], texts.get(field.name))
        if field.metadata.get("short"):
            hint = Annotated[hint, tyro.conf.arg(prefix_name=False)]
        fields.append((field.name, hint))
    namespace = {"__doc__": kind.__doc__, "origin": kind}
    return dataclasses.make_dataclass(kind.__name__, fields, frozen=True, namespace=namespace)


def _hint(name: str, hint: Any, text: str | None) -> Any:
    bare, *notes = typing.get_args(hint) if typing.get_origin(hint) is Annotated else (hint,)
    if dataclasses.is_dataclass(bare):
        bare = _twin(typing.cast(type, bare))
    elif is_angle(name, bare):
        short = name.removesuffix("_rad").replace("_", "-")
        notes += [_ANGLE if bare is float else _PERHAPS_ANGLE, tyro.conf.arg(name=short, help=text)]
    elif text:
        notes.append(tyro.conf.arg(help=text))
    for note in notes:
        bare = Annotated[bare, note]
    return bare
