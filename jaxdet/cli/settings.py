"""Where a configuration comes from: preset, then a TOML file, then flags."""

import argparse
import dataclasses
import tomllib
import types
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from jaxdet.config import Config
from jaxdet.errors import ConfigError
from jaxdet.io.options import LogOptions
from jaxdet.presets import preset

DEFAULT_PRESET = "wheeled"
SECTIONS = tuple(part.name for part in dataclasses.fields(Config)) + ("log",)

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Section = TypeVar("Section", bound="DataclassInstance")


def defaults(args: Sequence[str]) -> tuple[Config, LogOptions, str]:
    """The configuration that the flags then change.

    Args:
        args: The command's arguments; only ``--preset`` and ``--config`` are looked at.

    Returns:
        The method, how to read logs, and the preset's name.

    Raises:
        ConfigError: The preset or a key of the file is unknown, or a value doesn't fit.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--preset")
    parser.add_argument("--config")
    try:
        found = parser.parse_known_args(list(args))[0]
    except argparse.ArgumentError as error:
        raise ConfigError(str(error), remedy="see --help") from error
    table = read_toml(Path(found.config)) if found.config else {}
    name = found.preset or table.pop("preset", DEFAULT_PRESET)
    table.pop("preset", None)
    config, log = preset(name), LogOptions()
    path = found.config or ""
    for section, values in table.items():
        if section == "log":
            log = changed(log, values, section, path)
        else:
            part = changed(getattr(config, section), values, section, path)
            config = dataclasses.replace(config, **{section: part})
    return config, log, name


def read_toml(path: Path) -> dict[str, Any]:
    """The sections of a configuration file, and perhaps a ``preset``.

    Raises:
        ConfigError: It can't be read, or has an unknown section.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"can't be read ({error.strerror})", path=str(path)) from error
    except (ValueError, RecursionError) as error:  # numbers of 5,000 digits, lists in lists
        raise ConfigError(f"is not TOML: {error}", path=str(path)) from error
    for key, value in table.items():
        if key == "preset" and isinstance(value, str):
            continue
        if key not in SECTIONS or not isinstance(value, dict):
            known = ", ".join(f"[{name}]" for name in SECTIONS)
            raise ConfigError(f"no section [{key}]", path=str(path), remedy=f"use {known}")
    return table


def changed(section: Section, values: Mapping[str, Any], name: str, path: str) -> Section:
    """A configuration section with these values.

    Raises:
        ConfigError: A key is unknown or a value doesn't fit; names both and the file.
    """
    hints = typing.get_type_hints(type(section))
    for key, value in values.items():
        if key not in hints:
            known = ", ".join(hints) or "nothing"
            problem = f"no key {key!r} in [{name}]"
            raise ConfigError(problem, path=path, remedy=f"it takes {known}")
        if not _fits(value, hints[key]):
            wanted = getattr(hints[key], "__name__", str(hints[key]))
            raise ConfigError(f"[{name}] {key} = {value!r} is not {wanted}", path=path)
    clean = {key: _as(value, hints[key]) for key, value in values.items()}
    try:
        return dataclasses.replace(section, **clean)
    except ConfigError as error:
        raise ConfigError(error.problem, path=path, remedy=error.remedy) from error


def _fits(value: Any, hint: Any) -> bool:
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, part) for part in typing.get_args(hint))
    if origin is tuple:
        parts = typing.get_args(hint)
        same = isinstance(value, list) and len(value) == len(parts)
        return same and all(_fits(v, part) for v, part in zip(value, parts, strict=True))
    if origin is typing.Literal:
        return value in typing.get_args(hint)
    if hint in (float, int) and isinstance(value, int):
        return not isinstance(value, bool) and abs(value) < 1 << 63
    return isinstance(value, hint)


def _as(value: Any, hint: Any) -> Any:
    if isinstance(value, list):
        return tuple(float(part) for part in value)
    wants_float = hint is float or float in typing.get_args(hint)
    return float(value) if wants_float and isinstance(value, int) else value


def given(logs: Sequence[str]) -> Sequence[str]:
    """The logs named on the command line.

    Raises:
        ConfigError: There are none.
    """
    if not logs:
        raise ConfigError("no log given", remedy="name MCAP files, folders or globs, see --help")
    return logs
