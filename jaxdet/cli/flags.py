"""From the words of the command line to a dataclass, with one line for each way to be wrong."""

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
from jaxdet.errors import ConfigError, meant

Command = TypeVar("Command")
_KINDS = {int: "a whole number", float: "a number"}
_ALIKE = 0.75
"""Of two words, as :mod:`difflib` has it: of shorter ones fewer letters may differ."""
_ELSEWHERE = {"duration": "stop", "end": "stop", "force": "overwrite", "jobs": "workers"}
"""Flags of other programs, and ours for it."""


def parse_flags(
    kind: type[Command],
    args: Sequence[str],
    prog: str,
    description: str,
    common: Sequence[str] | None = None,
    defaults: Mapping[str, Any] | None = None,
    groups: Mapping[str, Sequence[str]] | None = None,
) -> Command:
    """Return the dataclass of the flags, see :mod:`jaxdet.cli.fields`.

    A flag may be given as ``--flag value`` or ``--flag=value``, with ``_`` for ``-``, some as a
    letter (``-o value``); the last one counts. Angles take a number with its unit, ``10deg`` or
    ``0.17rad``; their flags with ``-rad`` at the end take plain radians as well. ``None`` unsets
    what may be unset. After ``--`` nothing is a flag.

    Args:
        kind: The command's dataclass.
        args: The words.
        prog: The command's name in the help.
        description: What it does.
        common: What ``--help`` shows of its sections (:func:`jaxdet.cli.usage.usage`), where
            ``--help-all`` shows all; None: both show all.
        defaults: Values of fields, in place of their own defaults.
        groups: Flags by the headings of ``--help`` (:func:`jaxdet.cli.usage.usage`).

    Raises:
        ConfigError: A flag is unknown or missing, or a value is none or out of its range.
        SystemExit: Help was asked for.
    """
    defaults = defaults or {}
    options = list(options_of(kind, defaults))
    words = args[: args.index("--")] if "--" in args else args
    asked = [word for word in words if word in ("-h", "--help", "--help-all")]
    if asked:
        everything = "--help-all" in asked
        print(usage(options, prog, description, common, groups, whole=everything), end="")
        raise SystemExit(0)
    see = f"see {prog} --help"
    given = _Parser(options, see).read(args)
    missing = [option for option in options if option.default is MISSING]
    missing = [option for option in missing if given.get(".".join(option.path)) in (None, [], ())]
    if missing:
        lacks = ", ".join(f"{option.flag} {takes(option)}".strip() for option in missing)
        raise ConfigError(f"missing: {lacks}", remedy=see)
    return _made(kind, defaults, given)


class _Parser(argparse.ArgumentParser):
    """Reads the words; what is wrong with them is one line.

    Args:
        options: What they may say.
        see: What the errors end with.
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
        """What is given, by the path of its option."""
        end = args.index("--") if "--" in args else len(args)
        words = [_for_argparse(word, self.letters) for word in args[:end]]
        found, unknown = self.parse_known_intermixed_args([*words, *args[end:]])
        if unknown:
            name = unknown[0].partition("=")[0]
            if name.startswith("-"):
                raise ConfigError(f"no flag {name}", remedy=f"{self._meant(name)}{self.see}")
            raise ConfigError(f"{name!r} is one argument too many", remedy=self.see)
        return vars(found)

    def error(self, message: str) -> typing.NoReturn:
        """Says what argparse found."""
        raise ConfigError(message.removeprefix("argument "), remedy=self.see)

    def _meant(self, name: str) -> str:
        """``did you mean X or Y? `` where known flags are near."""
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
    """Whole flags with ``-`` for ``_``; with a space before it ``-10deg`` or ``-1e-3`` is none."""
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
    """What reads a word that is a value of an option, or a part of it.

    Args:
        option: The option.
        plain: An angle may be a number without a unit, in radians.
    """
    kind = typing.get_args(option.kind)[0] if _is_tuple(option) else option.kind
    choices = typing.get_args(kind) if typing.get_origin(kind) is typing.Literal else ()

    def read(word: str) -> Any:
        word = word.strip()
        if option.optional and word == "None":
            return None
        if choices and word not in choices:
            known = f"{meant(word, choices)}it takes {', '.join(choices)}"
            raise argparse.ArgumentTypeError(f"{word!r} is unknown; {known}")
        if kind is Path and not word:
            raise argparse.ArgumentTypeError("'' is no path")
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


def _made(
    kind: type[Command],
    defaults: Mapping[str, Any],
    given: Mapping[str, Any],
    path: tuple[str, ...] = (),
) -> Command:
    """The dataclass with what is given, else its defaults."""
    values, hints = {}, typing.get_type_hints(kind)
    for field in dataclasses.fields(typing.cast(Any, kind)):
        here, default = (*path, field.name), default_of(field, defaults)
        if dataclasses.is_dataclass(hints[field.name]):
            inner = dict(vars(default)) if default is not MISSING else {}
            values[field.name] = _made(hints[field.name], inner, given, here)
        else:
            value = given.get(".".join(here), default)
            values[field.name] = tuple(value) if isinstance(value, list) else value
    return kind(**values)
