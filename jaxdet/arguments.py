"""Checks of arguments at the public entry points; errors name the argument."""

import dataclasses
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin

from jaxdet.errors import ConfigError, InputError, JaxdetError

if TYPE_CHECKING:
    import numpy as np

Kind = TypeVar("Kind")
_MOST = 1 << 24
"""Maximum number of entries in a converted array: one pose each for a million frames."""
_WORDS = {bool: "True or False", float: "a number", int: "an integer", str: "a string"}
_NAMES: dict[type, str] = {Integral: "integer", Real: "number"}


def of_type(name: str, value: Any, kind: type[Kind], error: type[JaxdetError] = InputError) -> Kind:
    """Return the value if it has the type.

    Raises:
        JaxdetError: The value has another type; an InputError by default.
    """
    if not isinstance(value, kind):
        expected = _NAMES.get(kind, kind.__name__)
        raise error(f"expected {expected}, got {type(value).__name__}", topic=name)
    return value


def number(name: str, value: Any) -> float:
    """Return a real number as a float.

    Raises:
        InputError: The value is not a number, or exceeds 64 bits.
    """
    try:
        return float(of_type(name, value, Real))
    except OverflowError as error:
        raise InputError("number is too large", topic=name, remedy="pass a smaller one") from error


def whole_number(name: str, value: Any) -> int:
    """Return an integer.

    Raises:
        InputError: The value is not an integer.
    """
    return int(of_type(name, value, Integral))


def named_type(value: Any) -> str:
    """Describe an invalid value for an error: strings by their text, other values by their type."""
    return repr(value[:40]) if isinstance(value, str) else f"of type {type(value).__name__}"


def numeric(name: str, values: Any) -> "np.ndarray":
    """Return values as an array of numbers or booleans, without copying arrays.

    Raises:
        InputError: The values are neither numbers nor booleans.
    """
    import numpy as np

    try:
        array = np.asarray(values)
    except Exception as error:  # __array__ of any object may raise anything
        raise _no_numbers(name, values) from error
    if array.dtype.kind not in "biuf":
        raise _no_numbers(name, values)
    return array


def numbers(name: str, values: Any, kind: type) -> "np.ndarray":
    """Return values as an array of the given type.

    Raises:
        InputError: The values are not numbers, or there are too many.
    """
    import numpy as np

    try:
        size = getattr(values, "size", 0)
        if not isinstance(size, Integral) or size <= _MOST:  # the size of a tensor is a method
            return np.asarray(values, kind)
    except Exception as error:  # see numeric()
        raise _no_numbers(name, values) from error
    problem = f"shape {values.shape} is too large"
    raise InputError(problem, topic=name, remedy="pass fewer numbers")


def _no_numbers(name: str, values: Any) -> InputError:
    return InputError(f"expected an array of numbers, got {type(values).__name__}", topic=name)


def check_fields(part: Any) -> None:
    """Check the types of the fields of a configuration.

    Args:
        part: A dataclass.

    Raises:
        ConfigError: A field does not have its annotated type.
    """
    section = type(part).__name__.removesuffix("Config").removesuffix("Options").lower()
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if not fits(value, field.type):
            literal = get_origin(field.type) is Literal
            shown = repr(value) if literal else type(value).__name__
            raise ConfigError(
                f"expected {_type_text(field.type)}, got {shown}",
                topic=f"{section}.{field.name.replace('_', '-')}".lstrip("."),
            )


def fits(value: Any, kind: Any) -> bool:
    """Return whether a value has the type of a field's annotation."""
    if isinstance(kind, UnionType):
        return any(fits(value, one) for one in get_args(kind))
    if get_origin(kind) is Literal:
        return value in get_args(kind)
    if get_origin(kind) is tuple:
        each = get_args(kind)
        many = isinstance(value, tuple | list) and len(value) == len(each)
        return many and all(map(fits, value, each))
    if kind in (float, int):
        number = isinstance(value, Real if kind is float else Integral)
        small = not isinstance(value, Integral) or abs(int(value)) < 1 << 63
        return number and small and not isinstance(value, bool)
    return isinstance(value, kind)


def _type_text(kind: Any) -> str:
    """Return a type in words."""
    if isinstance(kind, UnionType):
        return " or ".join(_type_text(one) for one in get_args(kind))
    if get_origin(kind) is Literal:
        return " or ".join(map(repr, get_args(kind)))
    if get_origin(kind) is tuple:
        return f"{len(get_args(kind))} numbers"
    return "None" if kind is NoneType else _WORDS.get(kind, f"a {kind.__name__}")
