"""HTML representations of objects in notebooks."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

MOST_ROWS = 20
"""Maximum number of rows in a table; a line below it states how many more there are."""


def table(title: str, columns: Mapping[str, Sequence[Any]]) -> str:
    """Format a table as HTML, with at most ``MOST_ROWS`` rows.

    Args:
        title: Text above the table.
        columns: Values by column heading, of equal length; floats have two decimals, and None is an
            empty cell.
    """
    rows = list(zip(*columns.values(), strict=True))
    lines = [_row("th", columns)]
    lines += [_row("td", map(_text, row)) for row in rows[:MOST_ROWS]]
    more = len(rows) - MOST_ROWS
    rest = f"<p>and {more} more</p>" if more > 0 else ""
    return f"<p><b>{escape(title)}</b></p><table>{''.join(lines)}</table>{rest}"


def _row(tag: str, cells: Iterable[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"


def _text(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.2f}" if isinstance(value, float) else str(value)
