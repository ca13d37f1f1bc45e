"""Numbers in text, by one grammar for command lines, tables, YAML and parameter files.

Python's `float` and `int` also read `1_0`, `nan`, `infinity` and the digits of other scripts.
"""

from __future__ import annotations

import math
import re

SMALLEST = 1e-6
"""Smallest number where one must be positive: far below it one acts as 0, or quotients overflow."""

_WHOLE = re.compile(r"[-+]?[0-9]+")
_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_MAX_DIGITS = 40  # of a whole number


def parse_number(text: str) -> float | None:
    """Read a decimal number such as 4, -0.35 or 1e-3; None: it is not one, or not finite."""
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    return value if math.isfinite(value) else None


def parse_percent(text: str) -> float | None:
    """Read a percentage such as 5% or 2.5 %; None: it is not one."""
    number, percent, rest = text.partition("%")
    return parse_number(number.rstrip(" ")) if percent and not rest else None


def parse_whole(text: str) -> int | None:
    """Read a whole number of at most 40 digits; None: it is not one."""
    return int(text) if len(text) <= _MAX_DIGITS and _WHOLE.fullmatch(text) else None
