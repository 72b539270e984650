"""``jaxdet help``: pages about jaxdet, which are in the package."""

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
"""All pages, by kind and in the order of need."""


def main(args: list[str]) -> int:
    """Shows a page, or a command's options, or lists them; returns the exit code.

    Raises:
        ConfigError: There is no such page.
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
        known = ", ".join(texts)
        problem = f"no page {args[0]!r}"
        raise ConfigError(problem, remedy=f"{meant(args[0], [*texts, *COMMANDS])}there are {known}")
    show(texts[args[0]])
    return 0


def pages() -> dict[str, str]:
    """The pages as Markdown, by name."""
    folder = files("jaxdet") / "help"
    names = (name for kind in KINDS.values() for name in kind)
    return {name: (folder / f"{name}.md").read_text(encoding="utf-8") for name in names}


def title_of(text: str) -> str:
    """The first line of a page, without its mark."""
    return text.partition("\n")[0].lstrip("# ")


def show(text: str) -> None:
    """Writes a page: laid out and in the user's pager on a terminal, as it is elsewhere."""
    if not sys.stdout.isatty():
        print(text, end="")
        return
    from rich.console import Console

    console = Console(width=min(100, Console().width))
    os.environ.setdefault("LESS", "-FRX")  # as git does: colours, and no paging of a short page
    with console.pager(styles=True):
        console.print(laid_out(text))


def laid_out(text: str) -> "Markdown":
    """A page for a terminal; in tables words that are too long go on in the next line."""
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
