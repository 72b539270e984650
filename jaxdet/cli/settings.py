"""Configuration of a command: preset, then file, then flags."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from jaxdet.config_file import Settings, read_settings
from jaxdet.errors import ConfigError


def defaults(args: Sequence[str]) -> Settings:
    """Return the configuration of preset and file, before other flags override it.

    Args:
        args: Arguments of the command, of which only ``--preset`` and ``--config`` are read.

    Raises:
        ConfigError: The preset or a key in the file is unknown, or a value is invalid.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--preset")
    parser.add_argument("--config")
    try:
        found = parser.parse_known_args(list(args))[0]
    except argparse.ArgumentError as error:
        raise ConfigError(str(error).removeprefix("argument "), remedy="see --help") from error
    if found.config == "":
        raise ConfigError("--config: expected a file, got ''", remedy="see --help")
    return read_settings(Path(found.config) if found.config else None, found.preset)
