"""``jaxdet config``: writes all parameters as a TOML file for editing."""

import json
import textwrap
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from jaxdet.cli.fields import field_texts
from jaxdet.cli.flags import parse_flags
from jaxdet.config_file import find_config
from jaxdet.errors import ConfigError
from jaxdet.presets import DEFAULT_PRESET, PRESETS

DESCRIPTION = """\
Writes all parameters of a preset or of an earlier run as TOML, each with a comment: a file to edit
for jaxdet run --config.
"""


@dataclass(frozen=True)
class ConfigCommand:
    """Arguments of ``jaxdet config``."""

    source: str | None = field(
        default=None, metadata={"positional": True, "takes": "PRESET or FILE"}
    )
    """Preset, TOML file, or config.json of earlier results; by default the preset ``wheeled``."""
    output: Path | None = None
    """File to write; by default the text is printed."""


def main(args: list[str]) -> int:
    """Run the command; return the exit code.

    Raises:
        ConfigError: The source is neither a preset nor a file, or the output file exists.
    """
    command = parse_flags(ConfigCommand, args, "jaxdet config", DESCRIPTION)
    text = to_toml(command.source or DEFAULT_PRESET)
    if command.output is None:
        print(text, end="")
        return 0
    try:
        with command.output.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        problem, remedy = "the file exists already", "choose another file, or remove this one first"
        raise ConfigError(problem, path=str(command.output), remedy=remedy) from None
    return 0


def to_toml(source: str) -> str:
    """Return a configuration as TOML, with the description of each parameter as a comment."""
    config = find_config(source)
    lines = [f"# Parameters of {source}, for jaxdet run --config."]
    if source in PRESETS:
        lines.append(f"preset = {json.dumps(source)}")
    for section in fields(config):
        part = getattr(config, section.name)
        lines += ["", f"[{section.name}]"]
        texts = field_texts(type(part))
        for one in fields(part):
            lines += textwrap.wrap(" ".join(texts.get(one.name, "").split()), 98, **_COMMENT)
            lines.append(_line(one.name, getattr(part, one.name)))
    return "\n".join(lines) + "\n"


_COMMENT: dict[str, Any] = {"initial_indent": "# ", "subsequent_indent": "# "}


def _line(name: str, value: Any) -> str:
    """Return the TOML line of a parameter; without a value it is commented out."""
    if value is None:
        return f"# {name} ="
    return f"{name} = {json.dumps(list(value) if isinstance(value, tuple) else value)}"
