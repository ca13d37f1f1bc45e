"""Numbers in text, by one grammar for command lines, tables, YAML and parameter files.

Python's `float` and `int` also read `1_0`, `nan`, `infinity` and the digits of other scripts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

SMALLEST = 1e-6
"""Smallest number where one must be positive: far below it one acts as 0, or quotients overflow."""

TIME_UNITS: Mapping[str, float] = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}
"""Seconds by the unit of a time: seconds, minutes, hours, days, weeks."""

_WHOLE = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_MAX_DIGITS = 40  # of a whole number


def parse_number(text: str) -> float | None:
    """Read a decimal number such as 4, -0.35 or 1e-3; None: it is not one, or not finite."""
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


def parse_whole(text: str) -> int | None:
    """Read a whole number of at most 40 digits; None: it is not one."""
    return int(text) if len(text) <= _MAX_DIGITS and _WHOLE.fullmatch(text) else None


def parse_quantity(text: str, units: Mapping[str, float]) -> float | None:
    """Read a decimal number with one of these units behind it, such as 30d or 1.5 h.

    Args:
        text: of the user.
        units: factors by unit.

    Returns:
        The number times its factor; None: it is none, is negative, or has another unit.
    """
    match = re.fullmatch(rf"([0-9]+(?:\.[0-9]+)?) ?({'|'.join(units)})", text)
    value = None if match is None else parse_number(match[1])
    return None if match is None or value is None else value * units[match[2]]
