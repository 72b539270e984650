"""Angles as users write them: a number with its unit."""

import math
import re
from typing import Any

_ANGLE = re.compile(r"(?P<number>[-+]?[0-9.]+(?:e[-+]?[0-9]+)?)\s*(?P<unit>deg|°|rad)")


def parse_angle(text: Any) -> float:
    """Return the angle [rad] that a text such as ``10deg`` states.

    Raises:
        ValueError: The text is not a number followed by ``deg`` or ``rad``.

    Example:
        >>> parse_angle("0.17rad"), parse_angle("-180deg") == -math.pi
        (0.17, True)
    """
    match = _ANGLE.fullmatch(str(text).strip().lower())
    try:
        number = float(match["number"]) if match else math.nan
    except ValueError:
        number = math.nan
    if not match or not math.isfinite(number):
        raise ValueError("expected an angle with its unit, for instance 10deg or 0.17rad")
    return number if match["unit"] == "rad" else math.radians(number)
