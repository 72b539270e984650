"""Scene files in TOML or JSON."""

import json
import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

from jaxdet.errors import ConfigError, InputError
from jaxdet.sim.scene import Scene


def read_scene(path: str | Path) -> Scene:
    """Read a scene from a TOML or JSON file with the fields of :class:`Scene`.

    Raises:
        ConfigError: A field is unknown or a value is wrong.
        InputError: The file can't be read.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        data = tomllib.loads(text) if str(path).endswith(".toml") else json.loads(text)
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read scene: {error}", path=str(path)) from error
    return _build(Scene, data, str(path))


def write_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene as TOML, from which :func:`read_scene` restores an equal scene.

    Raises:
        InputError: The file can't be written.
    """
    lines = [f"{f.name} = {_value(getattr(scene, f.name))}" for f in fields(scene)]
    try:
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"can't be written ({error.strerror})", path=str(path)) from error


def _value(value: Any) -> str:
    """Format a TOML value; tables are inline, one line per object."""
    if is_dataclass(value) and not isinstance(value, type):
        pairs = [(f.name, getattr(value, f.name)) for f in fields(value)]
        return "{ " + ", ".join(f"{k} = {_value(v)}" for k, v in pairs if v is not None) + " }"
    if isinstance(value, tuple):
        rows = [_value(item) for item in value]
        if any(is_dataclass(item) for item in value):
            return "[\n  " + ",\n  ".join(rows) + ",\n]"
        return "[" + ", ".join(rows) + "]"
    return json.dumps(value) if isinstance(value, str) else repr(value)


def _build(kind: Any, data: Any, where: str) -> Any:
    """Convert parsed TOML to the dataclass or tuple type ``kind``."""
    if NoneType in get_args(kind):
        if data is None:
            return None
        kind = get_args(kind)[0]
    if isinstance(kind, type) and is_dataclass(kind) and isinstance(data, dict):
        hints = get_type_hints(kind)
        unknown = sorted(set(data) - {f.name for f in fields(kind)})
        if unknown:
            raise ConfigError(f"unknown field {unknown[0]!r}", path=where, remedy="see jaxdet.sim")
        values = {k: _build(hints[k], v, f"{where}: {k}") for k, v in data.items()}
        try:
            return kind(**values)
        except TypeError as error:
            raise ConfigError(str(error), path=where) from error
    if isinstance(data, list):
        return tuple(_build(get_args(kind)[0], item, where) for item in data)
    if isinstance(data, dict) or is_dataclass(kind):
        expected = "a table" if is_dataclass(kind) else "a value"
        raise ConfigError(f"expected {expected}, got {type(data).__name__}", path=where)
    return data
