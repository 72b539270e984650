"""From the words of the command line to a dataclass, with one line for each way to be wrong."""

import dataclasses
import difflib
import typing
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from pathlib import Path
from typing import Any, TypeVar

from jaxdet.angles import parse_angle
from jaxdet.cli.fields import Option, default_of, options_of
from jaxdet.cli.usage import takes, usage
from jaxdet.config_file import meant
from jaxdet.errors import ConfigError

Command = TypeVar("Command")
Given = dict[tuple[str, ...], Any]
_KINDS = {int: "a whole number", float: "a number"}


def parse_flags(
    kind: type[Command],
    args: Sequence[str],
    prog: str,
    description: str,
    common: Sequence[str] | None = None,
    defaults: Mapping[str, Any] | None = None,
) -> Command:
    """The dataclass that the flags say, see :mod:`jaxdet.cli.fields`.

    A flag may be given as ``--flag value`` or ``--flag=value``, with ``_`` for ``-``; the last one
    counts. Angles take a number with its unit, ``10deg`` or ``0.17rad``; their flags with ``-rad``
    at the end take plain radians as well. ``None`` unsets what may be unset. After ``--`` nothing
    is a flag.

    Args:
        kind: The command's dataclass.
        args: The words.
        prog: The command's name in the help.
        description: What it does.
        common: What ``--help`` shows of its sections (:func:`jaxdet.cli.usage.usage`), where
            ``--help-all`` shows all; None: ``--help`` shows all.
        defaults: Values of fields, in place of their own defaults.

    Raises:
        ConfigError: A flag is unknown or missing, or a value is none or out of its range.
        SystemExit: Help was asked for.
    """
    defaults = defaults or {}
    options = list(options_of(kind, defaults))
    words = args[: args.index("--")] if "--" in args else args
    helps = {"-h", "--help"} | ({"--help-all"} if common is not None else set())
    asked = [word for word in words if word in helps]
    if asked:
        print(usage(options, prog, description, common, whole="--help-all" in asked), end="")
        raise SystemExit(0)
    see = f"see {prog} --help"
    given = _Words(options, see).read(args)
    missing = [option for option in options if option.default is MISSING]
    missing = [option for option in missing if option.path not in given]
    if missing:
        lacks = ", ".join(f"{option.flag} {takes(option)}".strip() for option in missing)
        raise ConfigError(f"missing: {lacks}", remedy=see)
    return _made(kind, defaults, given)


class _Words:
    """Which words are flags and which are their values."""

    def __init__(self, options: Sequence[Option], see: str) -> None:
        self.positional = [option for option in options if not option.flag]
        self.flags = {name: option for option in options for name in _names(option)}
        self.known = [flag for flag, option in self.flags.items() if flag != f"{option.flag}-rad"]
        self.see = see

    def read(self, args: Sequence[str]) -> Given:
        """What is given, by the path of its option."""
        given: Given = {}
        words, loose = deque(args), []
        while words:
            word = words.popleft()
            if word == "--":
                loose += words
                break
            if not word.startswith("-") or word == "-":
                loose.append(word)
                continue
            name, equals, value = word.partition("=")
            name = name.replace("_", "-")
            option = self.flags.get(name)
            if option is None:
                raise ConfigError(f"no flag {name}", remedy=f"{self._meant(name)}{self.see}")
            if option.kind is bool:
                if equals:
                    raise ConfigError(f"{name} takes no value", remedy=self.see)
                given[option.path] = option.switches[name]
                continue
            taken = [value] if equals else _values(option, words)
            given[option.path] = self._value(option, name, taken)
        for option in self.positional:
            count = len(loose) if _many(option) else 1
            taken, loose = loose[:count], loose[count:]
            if taken or _many(option):
                given[option.path] = self._value(option, takes(option), taken)
        if loose:
            raise ConfigError(f"{loose[0]!r} is one argument too many", remedy=self.see)
        return given

    def _value(self, option: Option, name: str, words: list[str]) -> Any:
        kind, text = option.kind, " ".join(words)
        if option.optional and words == ["None"]:
            return None
        if not words and option.flag:
            raise ConfigError(f"{name} lacks its value, {takes(option)}", remedy=self.see)
        if typing.get_origin(kind) is tuple:
            kind, *others = typing.get_args(kind)
            if ... not in others and len(words) != len(others) + 1:
                raise ConfigError(f"{name} takes {takes(option)}, not {text!r}", remedy=self.see)
            return tuple(self._one(option, name, kind, word) for word in words)
        return self._one(option, name, kind, words[0])

    def _one(self, option: Option, name: str, kind: Any, word: str) -> Any:
        if typing.get_origin(kind) is typing.Literal:
            choices = typing.get_args(kind)
            if word not in choices:
                remedy = f"{meant(word, choices)}it takes {', '.join(choices)}"
                raise ConfigError(f"{name} {word!r} is unknown", remedy=remedy)
            return word
        if option.angle:
            try:
                return float(word) if name.endswith("-rad") else parse_angle(word)
            except ValueError:
                pass
            try:
                return parse_angle(word)
            except ValueError as error:
                raise ConfigError(f"{name} {word!r}: {error}") from None
        if kind in _KINDS:
            try:
                return kind(word)
            except ValueError:
                problem = f"{name} {word!r} is not {_KINDS[kind]}"
                raise ConfigError(problem, remedy=self.see) from None
        return Path(word) if kind is Path else word

    def _meant(self, name: str) -> str:
        """``did you mean X or Y? `` where known flags are near."""
        section, _, word = name.lstrip("-").rpartition(".")
        tails = {flag: flag.lstrip("-").rpartition(".") for flag in self.known}
        near = [flag for flag, (_, _, tail) in tails.items() if tail.startswith(word)]
        if not near:
            close = difflib.get_close_matches(word, [tail for _, _, tail in tails.values()])
            near = [flag for flag, (_, _, tail) in tails.items() if tail in close[:1]]
        own = [flag for flag in near if tails[flag][0] == section]
        return f"did you mean {' or '.join((own or near)[:3])}? " if near else ""


def _names(option: Option) -> list[str]:
    """The flags of an option."""
    if option.kind is bool:
        return list(option.switches)
    return [option.flag] * bool(option.flag) + [f"{option.flag}-rad"] * option.angle


def _many(option: Option) -> bool:
    return ... in typing.get_args(option.kind)


def _values(option: Option, words: deque[str]) -> list[str]:
    """The words that are a flag's values, taken from those that follow it."""
    parts = typing.get_args(option.kind) if typing.get_origin(option.kind) is tuple else (str,)
    most = len(words) if _many(option) else len(parts)
    taken: list[str] = []
    while words and len(taken) < most and not words[0].startswith("--"):
        taken.append(words.popleft())
        if option.optional and taken == ["None"]:
            break
    return taken


def _made(
    kind: type[Command], defaults: Mapping[str, Any], given: Given, path: tuple[str, ...] = ()
) -> Command:
    """The dataclass with what is given, else its defaults."""
    values, hints = {}, typing.get_type_hints(kind)
    for field in dataclasses.fields(typing.cast(Any, kind)):
        here, default = (*path, field.name), default_of(field, defaults)
        if dataclasses.is_dataclass(hints[field.name]):
            inner = dict(vars(default)) if default is not MISSING else {}
            values[field.name] = _made(hints[field.name], inner, given, here)
        else:
            values[field.name] = given.get(here, default)
    return kind(**values)
