"""Division of integers as all of the reference rounds it."""

from typing import Any


def rounded(a: Any, b: Any) -> Any:
    """``a / b`` rounded, halves up, of integers or arrays of them; b positive."""
    return (2 * a + b) // (2 * b)
