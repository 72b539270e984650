"""Copies of configurations with some values changed."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from jaxdet.angles import parse_angle
from jaxdet.arguments import fits
from jaxdet.config import Config
from jaxdet.errors import ConfigError, meant

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_WORDS = {str: "a string", int: "an integer", float: "a number", bool: "true or false"}

Section = TypeVar("Section", bound="DataclassInstance")


def with_changes(config: Config, changes: Mapping[str, Any]) -> Config:
    """Return a copy of a configuration with changes, which are passed as to :func:`jaxdet.preset`.

    Raises:
        ConfigError: A parameter is unknown or in several sections, or a value is invalid.
    """
    sections, grouped = vars(config), dict[str, dict[str, Any]]()
    for key, value in changes.items():
        name, values = key, value
        if key not in sections:
            homes = [part for part in sections if {key, f"{key}_rad"} & vars(sections[part]).keys()]
            name, values = _home(key, homes), {key: value}
        if not isinstance(values, Mapping):
            problem = f"{name}: expected a dictionary of parameters, got {value!r}"
            raise ConfigError(problem, remedy=f"pass {name}={{...}}, or the parameter itself")
        grouped[name] = grouped.get(name, {}) | {**values}
    parts = {name: changed(sections[name], values, name, "") for name, values in grouped.items()}
    return dataclasses.replace(config, **parts)


def _home(key: str, homes: list[str]) -> str:
    if "ground" in homes:
        return "ground"
    if len(homes) == 1:
        return homes[0]
    parts = vars(Config())
    if homes:
        remedy = f"name the section: {' or '.join(f'{name}={{{key!r}: ...}}' for name in homes)}"
        raise ConfigError(f"{key} is a parameter of several sections", remedy=remedy)
    known = [name for part in parts.values() for name in vars(part)]
    remedy = f"{meant(key, known)}`jaxdet run --help-all` lists them"
    raise ConfigError(f"unknown parameter or section {key!r}", remedy=remedy)


def changed(section: Section, values: Mapping[str, Any], name: str, path: str) -> Section:
    """Return a copy of a configuration section with other values.

    The key of an angle may lack its ``_rad`` if the value has a unit: ``camera_pitch = "10deg"``.

    Raises:
        ConfigError: A key is unknown or a value has the wrong type; the error names the key, the
            section ``name`` and, if not empty, the file ``path``.
    """
    hints, clean = typing.get_type_hints(type(section)), {}
    for key, value in values.items():
        field, parsed = key, value
        if f"{key}_rad" in hints or (key.endswith("_rad") and isinstance(value, str)):
            field = key if key in hints else f"{key}_rad"
            try:
                parsed = parse_angle(value)
            except ValueError as error:
                raise ConfigError(f"[{name}] {key} = {value!r}: {error}", path=path) from None
        if field not in hints:
            keys = ", ".join(hints) or "nothing"
            problem = f"unknown key {key!r} in [{name}]"
            raise ConfigError(problem, path=path, remedy=f"{meant(key, hints)}use one of {keys}")
        if field in clean:
            raise ConfigError(f"[{name}] {key} is given twice, as {field}", path=path)
        if not fits(parsed, hints[field]):
            expected = _type_text(hints[field])
            raise ConfigError(f"[{name}] {key} must be {expected}, got {value!r}", path=path)
        clean[field] = _converted(parsed, hints[field])
    try:
        return dataclasses.replace(section, **clean)
    except ConfigError as error:
        raise ConfigError(error.problem, path=path, remedy=error.remedy) from error


def _type_text(hint: Any) -> str:
    """Return the description of a type for an error."""
    parts = [part for part in typing.get_args(hint) or (hint,) if part is not types.NoneType]
    if len(parts) == 1 and typing.get_origin(parts[0]) is tuple:
        return f"a list of {len(typing.get_args(parts[0]))} numbers"
    return " or ".join(_WORDS[part] for part in parts)


def _converted(value: Any, hint: Any) -> Any:
    if isinstance(value, list):
        return tuple(float(part) for part in value)
    wants_float = hint is float or float in typing.get_args(hint)
    return float(value) if wants_float and isinstance(value, int) else value
