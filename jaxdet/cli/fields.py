"""What the fields of a configuration say of themselves."""

import ast
import dataclasses
import inspect
import textwrap
import typing
from collections.abc import Iterator
from itertools import pairwise
from typing import Any


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


def is_angle(name: str, hint: Any) -> bool:
    """Whether a field is an angle in radians: its flag has no ``-rad`` and takes a unit."""
    return name.endswith("_rad") and (hint is float or float in typing.get_args(hint))


def angle_flags(kind: type, prefix: str = "") -> Iterator[str]:
    """The flags of the angles of a dataclass and its parts, by their field's name."""
    hints = typing.get_type_hints(kind, include_extras=True)
    for field in dataclasses.fields(kind):
        hint, notes = hints[field.name], ()
        if typing.get_origin(hint) is typing.Annotated:
            hint, *notes = typing.get_args(hint)
        if dataclasses.is_dataclass(hint):
            unnamed = any(getattr(note, "name", None) == "" for note in notes)
            inner = prefix if unnamed else f"{prefix}{field.name}."
            yield from angle_flags(typing.cast(type, hint), inner)
        elif is_angle(field.name, hint):
            yield f"--{prefix}{field.name}".replace("_", "-")
