"""``jaxdet complete``: tab completion for bash, zsh and fish.

``jaxdet complete bash`` prints the line for the shell's start-up file. What it sets up calls
``jaxdet complete`` with the line in ``COMP_LINE`` and, in bash, the place of the cursor in
``COMP_POINT``, and reads a candidate per line.
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
"""Set-up for each shell. Where there are no candidates, files are offered."""


def main(args: list[str]) -> int:
    """Print the set-up for a shell, or the candidates; return 0."""
    if args and args[0] in SCRIPTS:
        print(SCRIPTS[args[0]], end="")
        return 0
    line = os.environ.get("COMP_LINE", "")
    line = line[: int(os.environ.get("COMP_POINT", len(line)))]
    *before, begun = re.split("[ =]", line)  # shells begin a word after = too
    for word in candidates([word for word in before if word], begun):
        print(word)
    return 0


def candidates(before: list[str], begun: str) -> list[str]:
    """What the word that was begun may become; nothing where it is a file or a value.

    Args:
        before: The words before it, from ``jaxdet`` on.
        begun: Its first letters, or none.
    """
    match before:
        case [] | [_]:
            known = [*COMMANDS, "--help", "--version"]
        case [_, "help"]:
            known = [*pages(), *COMMANDS]
        case [_, command, *_] if command in COMMANDS and command != "help":
            known = _of_command(command, before[-1], begun)
        case _:
            known = []
    return [word for word in known if word.startswith(begun)]


def _of_command(command: str, last: str, begun: str) -> list[str]:
    """Values of the flag before, else flags where one was begun."""
    kind = getattr(import_module(f"jaxdet.cli.{command}"), f"{command.capitalize()}Command")
    options = list(options_of(kind, {}))
    for option in options:
        if last == option.flag and not option.switches:
            return list(map(str, _values(option)))
    flags = [f for option in options for f in (*(option.switches or [option.flag]), option.letter)]
    return [*filter(None, flags), "--help", "--help-all"] if begun.startswith("-") else []


def _values(option: Option) -> tuple[object, ...]:
    """All that an option may be, where these are a few names."""
    if option.flag == "--preset":
        return tuple(PRESETS)
    return typing.get_args(option.kind) if typing.get_origin(option.kind) is typing.Literal else ()
