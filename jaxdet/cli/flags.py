"""From dataclasses to flags: tyro, with each field's docstring as flowing text.

tyro shows an attribute docstring that goes over several lines with the line breaks of the
source. So flags are parsed into twins of the dataclasses, whose fields carry the docstring as
one line, and the twins are turned back. A field with ``short`` in its metadata gets a flag without
the name of what it is in.
"""

import ast
import dataclasses
import inspect
import textwrap
import typing
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, TypeVar

import tyro

Command = TypeVar("Command")


def parse_flags(start: Command, args: Sequence[str], prog: str, description: str) -> Command:
    """The dataclass instance ``start``, changed as the flags say.

    Args:
        start: Defaults; ``tyro.MISSING`` where a value must be given.
        args: The arguments.
        prog: The command's name in the help.
        description: What it does.

    Raises:
        ConfigError: A value is out of its range.
        SystemExit: Help was asked for (0), or a flag is unknown (2).
    """
    twin = _to_twin(start)
    parsed = tyro.cli(type(twin), args=args, default=twin, prog=prog, description=description)
    return _from_twin(parsed)


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
    texts = _field_texts(kind)
    fields = []
    for field in dataclasses.fields(kind):
        hint = _hint(hints[field.name], texts.get(field.name))
        if field.metadata.get("short"):
            hint = Annotated[hint, tyro.conf.arg(prefix_name=False)]
        fields.append((field.name, hint))
    namespace = {"__doc__": kind.__doc__, "origin": kind}
    return dataclasses.make_dataclass(kind.__name__, fields, frozen=True, namespace=namespace)


def _hint(hint: Any, text: str | None) -> Any:
    bare, *notes = typing.get_args(hint) if typing.get_origin(hint) is Annotated else (hint,)
    if dataclasses.is_dataclass(bare):
        bare = _twin(typing.cast(type, bare))
    elif text:
        notes.append(tyro.conf.arg(help=text))
    for note in notes:
        bare = Annotated[bare, note]
    return bare


def _field_texts(kind: type) -> dict[str, str]:
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
