"""``jaxdet complete``: tab completion for bash, zsh and fish.

``jaxdet complete bash`` prints the line to add to the shell's start-up file. The shell then calls
``jaxdet complete`` with the command line in ``COMP_LINE`` and, in bash, the cursor position in
``COMP_POINT``, and reads one candidate per line.
"""

import os
import re
import typing
from importlib import import_module

from jaxdet.cli.fields import Option, options_of
from jaxdet.cli.help import pages
from jaxdet.cli.main import COMMANDS
from jaxdet.presets import PRESETS

SCRIPTS = {
    "bash": """\
complete -o default -C 'jaxdet complete' jaxdet
""",
    "zsh": """\
_jaxdet() {
  local -a found
  found=("${(@f)$(COMP_LINE="${(j: :)words[1,CURRENT]}" jaxdet complete)}")
  compset -P '*='
  if [[ -n "$found" ]]; then compadd -- $found; else _files; fi
}
compdef _jaxdet jaxdet
""",
    "fish": """\
complete -c jaxdet -a '(env COMP_LINE=(commandline -cp) jaxdet complete)'
""",
}
"""Set-up code by shell. The shell completes file names if there are no candidates."""


def main(args: list[str]) -> int:
    """Print the set-up code of a shell, or the completions of ``COMP_LINE``; return 0."""
    if args and args[0] in SCRIPTS:
        print(SCRIPTS[args[0]], end="")
        return 0
    line = os.environ.get("COMP_LINE", "")
    line = line[: int(os.environ.get("COMP_POINT", len(line)))]
    *words, typed = re.split("[ =]", line)  # shells also start a new word after "="
    for word in candidates([word for word in words if word], typed):
        print(word)
    return 0


def candidates(words: list[str], typed: str) -> list[str]:
    """Return the completions of a partly typed word; empty if it is a file name or another value.

    Args:
        words: Preceding words, starting with ``jaxdet``.
        typed: The letters typed so far; may be empty.
    """
    match words:
        case [] | [_]:
            choices = [*COMMANDS, "--help", "--version"]
        case [_, "help"]:
            choices = [*pages(), *COMMANDS]
        case [_, command, *_] if command in COMMANDS and command != "help":
            choices = _command_choices(command, words[-1], typed)
        case _:
            choices = []
    return [word for word in choices if word.startswith(typed)]


def _command_choices(command: str, last: str, typed: str) -> list[str]:
    """Return the values of the preceding flag, or the flags of the command if a flag is typed."""
    kind = getattr(import_module(f"jaxdet.cli.{command}"), f"{command.capitalize()}Command")
    options = list(options_of(kind, {}))
    for option in options:
        if last == option.flag and not option.switches:
            return list(map(str, _values(option)))
    flags = [f for option in options for f in (*(option.switches or [option.flag]), option.letter)]
    return [*filter(None, flags), "--help", "--help-all"] if typed.startswith("-") else []


def _values(option: Option) -> tuple[object, ...]:
    """Return the possible values of an option if they are a fixed set of names."""
    if option.flag == "--preset":
        return tuple(PRESETS)
    return typing.get_args(option.kind) if typing.get_origin(option.kind) is typing.Literal else ()
