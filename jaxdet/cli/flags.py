"""Parsing of command-line arguments into a dataclass, with one-line errors."""

import argparse
import dataclasses
import difflib
import re
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING
from pathlib import Path
from typing import Any, TypeVar

from jaxdet.angles import parse_angle
from jaxdet.cli.fields import Option, default_of, options_of
from jaxdet.cli.usage import takes, usage
from jaxdet.config_file import Settings, read_settings
from jaxdet.errors import ConfigError, meant

Command = TypeVar("Command")
_KINDS = {int: "a whole number", float: "a number"}
_ALIKE = 0.75
"""Similarity threshold of :func:`difflib.get_close_matches` for suggested flags."""
_ELSEWHERE = {"duration": "stop", "end": "stop", "force": "overwrite", "jobs": "workers"}
"""Flags of other programs, and their equivalents here."""


def parse_flags(
    kind: type[Command],
    args: Sequence[str],
    prog: str,
    description: str,
    common: Sequence[str] | None = None,
    defaults: Mapping[str, Any] | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
) -> Command:
    """Parse arguments into the dataclass of a command, see :mod:`jaxdet.cli.fields`.

    A flag is written ``--flag value`` or ``--flag=value``, with ``-`` or ``_`` in its name; some
    have a letter (``-o value``). If a flag is repeated, the last value counts. Angles are numbers
    with a unit, ``10deg`` or ``0.17rad``; their flags with the ending ``-rad`` also accept plain
    radians. ``None`` unsets an optional value. Arguments after ``--`` are never flags.

    Args:
        kind: Dataclass of the command.
        args: Command-line arguments.
        prog: Name of the command in help texts.
        description: Description of the command for its help.
        common: Options listed by ``--help`` (:func:`jaxdet.cli.usage.usage`), while ``--help-all``
            lists all; None lists all in both.
        defaults: Default values by field name, which override those of the dataclass.
        groups: Flags by heading of ``--help`` (:func:`jaxdet.cli.usage.usage`).

    Raises:
        ConfigError: A flag is unknown or missing, or a value is invalid.
        SystemExit: Help was printed.
    """
    defaults = defaults or {}
    options = list(options_of(kind, defaults))
    words = args[: args.index("--")] if "--" in args else args
    help_flags = [word for word in words if word in ("-h", "--help", "--help-all")]
    if help_flags:
        everything = "--help-all" in help_flags
        print(usage(options, prog, description, common, groups, whole=everything), end="")
        raise SystemExit(0)
    see = f"see {prog} --help"
    given = _Parser(options, see).read(args)
    missing = [option for option in options if option.default is MISSING]
    missing = [option for option in missing if given.get(".".join(option.path)) in (None, [], ())]
    if missing:
        names = ", ".join(f"{option.flag} {takes(option)}".strip() for option in missing)
        raise ConfigError(f"missing: {names}", remedy=see)
    return _build(kind, defaults, given)


def read_defaults(args: Sequence[str]) -> Settings:
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


class _Parser(argparse.ArgumentParser):
    """Argument parser that raises each error as a one-line ConfigError.

    Args:
        options: Options of the command.
        see: Reference to the help, at the end of each error.
    """

    def __init__(self, options: Sequence[Option], see: str) -> None:
        super().__init__(
            usage="", argument_default=argparse.SUPPRESS, add_help=False, allow_abbrev=False
        )
        self.see = see
        for option in options:
            how: dict[str, Any] = {"dest": ".".join(option.path)}
            if not option.flag:
                count = "*" if _many(option) else "?"
                default = [] if _many(option) else None
                self.add_argument(nargs=count, default=default, type=_reader(option), **how)
            for flag, value in option.switches.items():
                self.add_argument(flag, action="store_const", const=value, **how)
            if option.flag and not option.switches:
                parts = typing.get_args(option.kind) if _is_tuple(option) else ()
                how["nargs"] = "+" if _many(option) else len(parts) or None
                self.add_argument(option.flag, type=_reader(option), **how)
            if option.angle:
                self.add_argument(f"{option.flag}-rad", type=_reader(option, plain=True), **how)
        self.flags = [flag for option in options for flag in option.switches or [option.flag]]
        self.letters = {option.letter: option.flag for option in options if option.letter}

    def read(self, args: Sequence[str]) -> dict[str, Any]:
        """Parse the arguments; return the values by option path, joined with dots."""
        end = args.index("--") if "--" in args else len(args)
        words = [_for_argparse(word, self.letters) for word in args[:end]]
        found, unknown = self.parse_known_intermixed_args([*words, *args[end:]])
        if unknown:
            name = unknown[0].partition("=")[0]
            if name.startswith("-"):
                raise ConfigError(f"unknown flag {name}", remedy=f"{self._meant(name)}{self.see}")
            raise ConfigError(f"unexpected argument {name!r}", remedy=self.see)
        return vars(found)

    def error(self, message: str) -> typing.NoReturn:
        """Raise an error of argparse as a ConfigError."""
        raise ConfigError(message.removeprefix("argument "), remedy=self.see)

    def _meant(self, name: str) -> str:
        """Return ``did you mean X or Y? `` if there are similar flags, else an empty string."""
        section, _, word = name.lstrip("-").rpartition(".")
        word = _ELSEWHERE.get(word, word)
        tails = {flag: flag.lstrip("-").rpartition(".") for flag in filter(None, self.flags)}
        near = [flag for flag, (_, _, tail) in tails.items() if tail.startswith(word)]
        if not near:
            known = [tail for _, _, tail in tails.values()]
            close = difflib.get_close_matches(word, known, cutoff=_ALIKE)
            near = [flag for flag, (_, _, tail) in tails.items() if tail in close[:1]]
        own = [flag for flag in near if tails[flag][0] == section]
        return f"did you mean {' or '.join((own or near)[:3])}? " if near else ""


def _for_argparse(word: str, letters: Mapping[str, str]) -> str:
    """Return a word as argparse needs it.

    In flags ``_`` becomes ``-``. Negative numbers get a leading space, so that they are not taken
    for flags.
    """
    flag, equals, value = word.partition("=")
    flag = letters.get(flag, flag)
    if flag.startswith("--"):
        return flag.replace("_", "-") + equals + value
    return f" {word}" if re.match(r"-[.\d]", word) else word


def _is_tuple(option: Option) -> bool:
    return typing.get_origin(option.kind) is tuple


def _many(option: Option) -> bool:
    return ... in typing.get_args(option.kind)


def _reader(option: Option, *, plain: bool = False) -> Callable[[str], Any]:
    """Return the function that converts a command-line word to a value of an option.

    Args:
        option: The option.
        plain: Accept an angle without a unit, in radians.
    """
    kind = typing.get_args(option.kind)[0] if _is_tuple(option) else option.kind
    choices = typing.get_args(kind) if typing.get_origin(kind) is typing.Literal else ()

    def read(word: str) -> Any:
        word = word.strip()
        if option.optional and word == "None":
            return None
        if choices and word not in choices:
            known = f"{meant(word, choices)}use one of {', '.join(choices)}"
            raise argparse.ArgumentTypeError(f"unknown value {word!r}; {known}")
        if kind is Path and not word:
            raise argparse.ArgumentTypeError("expected a path, got ''")
        try:
            if option.angle and not (plain and _is_number(word)):
                return parse_angle(word)
            return kind(word) if kind in (*_KINDS, Path) else word
        except ValueError as error:
            why = f": {error}" if option.angle else f" is not {_KINDS[kind]}"
            raise argparse.ArgumentTypeError(f"{word!r}{why}") from None

    return read


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _build(
    kind: type[Command],
    defaults: Mapping[str, Any],
    given: Mapping[str, Any],
    path: tuple[str, ...] = (),
) -> Command:
    """Build the dataclass from the parsed values and the defaults."""
    values, hints = {}, typing.get_type_hints(kind)
    for field in dataclasses.fields(typing.cast(Any, kind)):
        here, default = (*path, field.name), default_of(field, defaults)
        if dataclasses.is_dataclass(hints[field.name]):
            inner = dict(vars(default)) if default is not MISSING else {}
            values[field.name] = _build(hints[field.name], inner, given, here)
        else:
            value = given.get(".".join(here), default)
            values[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**values)
