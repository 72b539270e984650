"""Configuration files: TOML, and the ``config.json`` of earlier results."""

import dataclasses
import json
import os
import tomllib
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

from jaxdet.config import Config
from jaxdet.config_changes import changed
from jaxdet.errors import ConfigError, meant
from jaxdet.io.options import LogOptions
from jaxdet.presets import DEFAULT_PRESET, PRESETS, preset

SECTIONS = tuple(part.name for part in dataclasses.fields(Config)) + ("log",)

ConfigSource = Config | Mapping[str, Any] | str | PathLike[str]
"""A configuration, its sections as a dictionary, or the name of a preset or a file."""


class Settings(NamedTuple):
    """Configuration and log options, from a preset and the file that changes it."""

    config: Config
    log: LogOptions
    """Options for reading logs."""
    preset: str
    """Name of the preset."""


def find_config(source: ConfigSource) -> Config:
    """Return the configuration of a preset, a dictionary or a file.

    Args:
        source: ``wheeled``, ``mine.toml``, ``results/config.json``, or the same sections as a
            dictionary: ``{"preset": "d435", "ground": {"max_depth_m": 3.0}}``.

    Raises:
        ConfigError: The preset or file does not exist, or a setting is invalid.
    """
    if isinstance(source, Config):
        return source
    if isinstance(source, Mapping):
        table = {str(key): value for key, value in source.items()}
        return _settings(_checked_table(table, ""), "").config
    if not isinstance(source, str | PathLike):
        expected = "a Config, the name of a preset, a dictionary or a file"
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
        path: TOML file with the sections ``[ground]``, ``[surface]``, ... and ``[log]`` and
            optionally ``preset``, or the ``config.json`` of results; None: only the preset.
        preset_name: Base preset, which overrides the file's.

    Raises:
        ConfigError: The preset or a key in the file is unknown, or a value is invalid.
    """
    return _settings(read_table(path) if path else {}, str(path), preset_name)


def _settings(table: dict[str, Any], where: str, preset_name: str | None = None) -> Settings:
    named = table.pop("preset", DEFAULT_PRESET)
    name = named if preset_name is None else preset_name
    try:
        config, log = preset(name), LogOptions()
    except ConfigError as error:
        path = where if preset_name is None else ""
        raise ConfigError(error.problem, path=path, remedy=error.remedy) from None
    for section, values in table.items():
        if section == "log":
            log = changed(log, values, section, where)
        else:
            part = changed(getattr(config, section), values, section, where)
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
        raise ConfigError(f"not a text file: {error}", path=where) from error
    if path.suffix.lower() == ".json":
        return _of_results(text, where)
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # e.g. numbers of 5,000 digits, nested lists
        raise ConfigError(f"invalid TOML: {error}", path=where) from error
    return _checked_table(table, where)


def _checked_table(table: dict[str, Any], where: str) -> dict[str, Any]:
    """Return the table after checking that its keys are sections or ``preset``."""
    for key, value in table.items():
        if key == "preset" and isinstance(value, str):
            continue
        if key == "preset":
            problem, remedy = (
                f"preset must be a string, got {value!r}",
                f'preset = "{DEFAULT_PRESET}"',
            )
            raise ConfigError(problem, path=where, remedy=f"write {remedy}")
        if not isinstance(value, dict):
            problem = f"{key} = {value!r} is outside of a section"
            raise ConfigError(problem, path=where, remedy=_place(key))
        if key not in SECTIONS:
            sections = ", ".join(f"[{name}]" for name in SECTIONS)
            remedy = f"{meant(key, SECTIONS)}use {sections}"
            raise ConfigError(f"unknown section [{key}]", path=where, remedy=remedy)
    return table


def _place(key: str) -> str:
    """Return the remedy for a key outside of a section: the sections that have it."""
    if key in SECTIONS:
        return f"write [{key}] and its keys below"
    parts = vars(Config()) | {"log": LogOptions()}
    keys = {key, f"{key}_rad"}  # the key of an angle may lack its unit
    having = [name for name, part in parts.items() if keys & vars(part).keys()]
    where = " or ".join(f"[{name}]" for name in having or SECTIONS)
    return f"write it below {where}"


def _of_results(text: str, where: str) -> dict[str, Any]:
    """Return the sections of a ``config.json`` and its preset, without values that are unset."""
    try:
        table = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"invalid JSON: {error}", path=where) from error
    if not isinstance(table, dict) or not all(
        isinstance(table.get(name), dict) for name in SECTIONS
    ):
        raise ConfigError(
            "not the config.json of a run", path=where, remedy="pass a config.json or a TOML file"
        )
    sections: dict[str, Any] = {
        name: {key: value for key, value in table[name].items() if value is not None}
        for name in SECTIONS
    }
    named = table.get("preset")
    return sections | ({"preset": named} if named in PRESETS else {})
