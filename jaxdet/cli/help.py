"""``jaxdet help``: shows the pages of the documentation, which are part of the package."""

import os
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.resources import files
from typing import TYPE_CHECKING, Any, ClassVar

from jaxdet.cli.main import COMMANDS
from jaxdet.errors import ConfigError, meant

if TYPE_CHECKING:
    from rich.markdown import Markdown

KINDS = {
    "guide": ("start", "logs", "calibration", "tuning", "tracks", "exports", "recipes", "fleets"),
    "reference": ("tables", "queries", "runs", "api"),
    "background": ("method", "paper"),
}
"""All pages, by kind, in the order in which users need them."""


def main(args: list[str]) -> int:
    """Show a page or the options of a command, or list all pages; return the exit code.

    Raises:
        ConfigError: The page does not exist.
    """
    texts = pages()
    if args and args[0] in COMMANDS and args[0] not in texts:
        command: Callable[[list[str]], int] = import_module(f"jaxdet.cli.{args[0]}").main
        return command(["--help"])
    if not args or args[0] in ("-h", "--help"):
        print("usage: jaxdet help PAGE or COMMAND")
        for kind, names in KINDS.items():
            print(f"\n{kind}:")
            print("\n".join(f"  {name:<12} {title_of(texts[name])}" for name in names))
        print("\ncommands:")
        print("\n".join(f"  {name:<12} {text}" for name, text in COMMANDS.items()))
        return 0
    if args[0] not in texts:
        remedy = f"{meant(args[0], [*texts, *COMMANDS])}choose one of {', '.join(texts)}"
        raise ConfigError(f"unknown page {args[0]!r}", remedy=remedy)
    show(texts[args[0]])
    return 0


def pages() -> dict[str, str]:
    """Return all pages as Markdown, by name."""
    folder = files("jaxdet") / "help"
    names = (name for kind in KINDS.values() for name in kind)
    return {name: (folder / f"{name}.md").read_text(encoding="utf-8") for name in names}


def title_of(text: str) -> str:
    """Return the first line of a page, without "#"."""
    return text.partition("\n")[0].lstrip("# ")


def show(text: str) -> None:
    """Print a page: formatted and in the user's pager on a terminal, else as Markdown."""
    if not sys.stdout.isatty():
        print(text, end="")
        return
    from rich.console import Console

    console = Console(width=min(100, Console().width))
    # the defaults of git: colours, and no pager for short pages
    os.environ.setdefault("LESS", "-FRX")
    with console.pager(styles=True):
        console.print(formatted(text))


def formatted(text: str) -> "Markdown":
    """Format a page for a terminal; long words in tables are wrapped."""
    from rich.markdown import Markdown, TableElement

    class Table(TableElement):
        def __rich_console__(self, *where: Any) -> Iterator[Any]:
            for table in super().__rich_console__(*where):
                for column in getattr(table, "columns", ()):
                    column.overflow = "fold"
                yield table

    class Page(Markdown):
        elements: ClassVar[dict] = Markdown.elements | {"table_open": Table}

    return Page(text)
