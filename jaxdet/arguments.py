"""What callers give a function is checked where it comes in; errors name the argument."""

import dataclasses
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin

from jaxdet.errors import ConfigError, InputError, JaxdetError

if TYPE_CHECKING:
    import numpy as np

Kind = TypeVar("Kind")
_MOST = 1 << 24
"""Entries of an array that is converted: a pose each for many more frames than a batch has."""
_WORDS = {bool: "True or False", float: "a number", int: "a whole number", str: "a text"}
_NAMES: dict[type, str] = {Integral: "whole number", Real: "number"}


def of_type(name: str, value: Any, kind: type[Kind], error: type[JaxdetError] = InputError) -> Kind:
    """A value of a type, and of no other.

    Raises:
        JaxdetError: It is of another; by default an InputError.
    """
    if not isinstance(value, kind):
        wanted = _NAMES.get(kind, kind.__name__)
        problem = f"{type(value).__name__} is no {wanted}"
        raise error(problem, topic=name, remedy=f"give a {wanted}")
    return value


def number(name: str, value: Any) -> float:
    """A real number.

    Raises:
        InputError: It is none, or too large for one of 64 bits.
    """
    try:
        return float(of_type(name, value, Real))
    except OverflowError as error:
        raise InputError(
            "is too large a number", topic=name, remedy="give a smaller one"
        ) from error


def whole_number(name: str, value: Any) -> int:
    """A whole number.

    Raises:
        InputError: It is none.
    """
    return int(of_type(name, value, Integral))


def named_type(value: Any) -> str:
    """What a wrong value is, for an error: a text itself, of others the type."""
    return repr(value[:40]) if isinstance(value, str) else f"of type {type(value).__name__}"


def numeric(name: str, values: Any) -> "np.ndarray":
    """Values as an array of numbers or truth values; of arrays no copy.

    Raises:
        InputError: They are something else.
    """
    import numpy as np

    try:
        found = np.asarray(values)
    except Exception as error:  # whatever an object's __array__ does
        raise _no_numbers(name, values) from error
    if found.dtype.kind not in "biuf":
        raise _no_numbers(name, values)
    return found


def numbers(name: str, values: Any, kind: type) -> "np.ndarray":
    """Values as an array of one type.

    Raises:
        InputError: They are no numbers.
    """
    import numpy as np

    try:
        size = getattr(values, "size", 0)
        if not isinstance(size, Integral) or size <= _MOST:  # of a tensor it is a method
            return np.asarray(values, kind)
    except Exception as error:  # likewise
        raise _no_numbers(name, values) from error
    raise InputError(f"an array of shape {values.shape}", topic=name, remedy="give fewer numbers")


def _no_numbers(name: str, values: Any) -> InputError:
    problem = f"{type(values).__name__} is no array of numbers"
    return InputError(problem, topic=name, remedy="give NumPy arrays")


def check_fields(part: Any) -> None:
    """Refuses a configuration whose fields are not of their types.

    Args:
        part: A dataclass.

    Raises:
        ConfigError: A field is of another type than it says.
    """
    section = type(part).__name__.removesuffix("Config").removesuffix("Options").lower()
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if not fits(value, field.type):
            raise ConfigError(
                f"{type(value).__name__} is not what it takes",
                topic=f"{section}.{field.name.replace('_', '-')}".lstrip("."),
                remedy=f"give {_words(field.type)}",
            )


def fits(value: Any, kind: Any) -> bool:
    """Whether a value is of a type, as annotations of fields have them."""
    if isinstance(kind, UnionType):
        return any(fits(value, one) for one in get_args(kind))
    if get_origin(kind) is tuple:
        each = get_args(kind)
        many = isinstance(value, tuple | list) and len(value) == len(each)
        return many and all(map(fits, value, each))
    if kind in (float, int):
        number = isinstance(value, Real if kind is float else Integral)
        small = not isinstance(value, Integral) or abs(int(value)) < 1 << 63
        return number and small and not isinstance(value, bool)
    return isinstance(value, kind)


def _words(kind: Any) -> str:
    """A type, for people."""
    if isinstance(kind, UnionType):
        return " or ".join(_words(one) for one in get_args(kind))
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} numbers"
    return "None" if kind is NoneType else _WORDS.get(kind, f"a {kind.__name__}")
