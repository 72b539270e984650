"""Rounded division of integers, for all steps of the reference."""

from typing import Any


def rounded(a: Any, b: Any) -> Any:
    """Return ``a / b`` rounded, halves up, for integers or arrays of them; b positive."""
    return (2 * a + b) // (2 * b)
