"""Configuration files: TOML, and the ``config.json`` of earlier results."""

import dataclasses
import json
import os
import tomllib
import types
import typing
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from jaxdet.angles import parse_angle
from jaxdet.arguments import fits
from jaxdet.config import Config
from jaxdet.errors import ConfigError, meant
from jaxdet.io.options import LogOptions
from jaxdet.presets import DEFAULT_PRESET, PRESETS, preset

_WORDS = {str: "text in quotes", int: "an integer", float: "a number", bool: "true or false"}
SECTIONS = tuple(part.name for part in dataclasses.fields(Config)) + ("log",)

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Section = TypeVar("Section", bound="DataclassInstance")


class Settings(NamedTuple):
    """Settings of a file, on top of its preset."""

    config: Config
    log: LogOptions
    """Options for reading logs."""
    preset: str


def find_config(source: str | PathLike[str]) -> Config:
    """Return the configuration of a preset or a file.

    Args:
        source: ``wheeled``, ``mine.toml`` or ``results/config.json``.

    Raises:
        ConfigError: There is no such preset or file, or the file is invalid.
    """
    if not isinstance(source, str | PathLike):
        expected = "a Config, the name of a preset or a file"
        raise ConfigError(f"expected {expected}, got {type(source).__name__}", topic="config")
    name = os.fspath(source)
    if name in PRESETS:
        return preset(name)
    path = Path(name)
    try:
        named = path.suffix.lower() in (".toml", ".json") or path.exists()
    except OSError:  # too long for a file name
        named = False
    if isinstance(source, str) and not (name and named):
        preset(name)  # its error lists the presets
    return read_settings(path).config


def read_settings(path: Path | None, preset_name: str | None = None) -> Settings:
    """Read the settings of a file.

    Args:
        path: TOML with the sections ``[ground]``, ``[surface]``, ... and ``[log]`` and perhaps a
            ``preset``, or the ``config.json`` of results; None: only the preset.
        preset_name: Base preset, which overrides the file's.

    Raises:
        ConfigError: The preset or a key of the file is unknown, or a value doesn't fit.
    """
    table = read_table(path) if path else {}
    named = table.pop("preset", DEFAULT_PRESET)
    name = named if preset_name is None else preset_name
    try:
        config, log = preset(name), LogOptions()
    except ConfigError as error:
        where = str(path) if preset_name is None else ""
        raise ConfigError(error.problem, path=where, remedy=error.remedy) from None
    for section, values in table.items():
        if section == "log":
            log = changed(log, values, section, str(path))
        else:
            part = changed(getattr(config, section), values, section, str(path))
            config = dataclasses.replace(config, **{section: part})
    return Settings(config, log, name)


def read_table(path: Path) -> dict[str, Any]:
    """Read the sections of a configuration file, and its ``preset`` if set.

    Raises:
        ConfigError: The file can't be read, or has an unknown section.
    """
    where = str(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"can't be read ({error.strerror})", path=where) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"is not text: {error}", path=where) from error
    if path.suffix.lower() == ".json":
        return _of_results(text, where)
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # e.g. numbers of 5,000 digits, nested lists
        raise ConfigError(f"is not TOML: {error}", path=where) from error
    for key, value in table.items():
        if key == "preset" and isinstance(value, str):
            continue
        if key == "preset":
            problem, remedy = (
                f"preset = {value!r} is not text in quotes",
                f'preset = "{DEFAULT_PRESET}"',
            )
            raise ConfigError(problem, path=where, remedy=f"write {remedy}")
        if not isinstance(value, dict):
            raise ConfigError(f"{key} = {value!r} is in no section", path=where, remedy=_place(key))
        if key not in SECTIONS:
            sections = ", ".join(f"[{name}]" for name in SECTIONS)
            remedy = f"{meant(key, SECTIONS)}use {sections}"
            raise ConfigError(f"no section [{key}]", path=where, remedy=remedy)
    return table


def _place(key: str) -> str:
    """Return the remedy for a key outside of a section: the sections that have such a key."""
    if key in SECTIONS:
        return f"write [{key}] and its keys below"
    parts = vars(Config()) | {"log": LogOptions()}
    keys = {key, f"{key}_rad"}  # the key of an angle may lack its unit
    having = [name for name, part in parts.items() if keys & vars(part).keys()]
    where = " or ".join(f"[{name}]" for name in having or SECTIONS)
    return f"write it below {where}"


def _of_results(text: str, where: str) -> dict[str, Any]:
    """Return the sections of a ``config.json``, without unset values and other keys of its run."""
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"is not JSON: {error}", path=where) from error
    if not isinstance(table, dict) or not all(
        isinstance(table.get(name), dict) for name in SECTIONS
    ):
        raise ConfigError(
            "is not the config.json of a run", path=where, remedy="give that, or a TOML file"
        )
    sections: dict[str, Any] = {
        name: {key: value for key, value in table[name].items() if value is not None}
        for name in SECTIONS
    }
    named = table.get("preset")
    return sections | ({"preset": named} if named in PRESETS else {})


def changed(section: Section, values: Mapping[str, Any], name: str, path: str) -> Section:
    """Return a configuration section with these values.

    The key of an angle may lack its ``_rad`` if the value has a unit: ``camera_pitch = "10deg"``.

    Raises:
        ConfigError: A key is unknown or a value has the wrong type; the error names both.
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
            problem = f"no key {key!r} in [{name}]"
            raise ConfigError(problem, path=path, remedy=f"{meant(key, hints)}it takes {keys}")
        if field in clean:
            raise ConfigError(f"[{name}] {key} is given twice, as {field}", path=path)
        if not fits(parsed, hints[field]):
            raise ConfigError(f"[{name}] {key} = {value!r} is not {_said(hints[field])}", path=path)
        clean[field] = _as(parsed, hints[field])
    try:
        return dataclasses.replace(section, **clean)
    except ConfigError as error:
        raise ConfigError(error.problem, path=path, remedy=error.remedy) from error


def _said(hint: Any) -> str:
    """Return a type in words."""
    parts = [part for part in typing.get_args(hint) or (hint,) if part is not types.NoneType]
    if len(parts) == 1 and typing.get_origin(parts[0]) is tuple:
        return f"a list of {len(typing.get_args(parts[0]))} numbers"
    return " or ".join(_WORDS[part] for part in parts)


def _as(value: Any, hint: Any) -> Any:
    if isinstance(value, list):
        return tuple(float(part) for part in value)
    wants_float = hint is float or float in typing.get_args(hint)
    return float(value) if wants_float and isinstance(value, int) else value
