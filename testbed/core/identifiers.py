"""Turn the names of aircraft into identifiers for formats that allow fewer characters."""

from __future__ import annotations

import re
from collections.abc import Sequence


def identifiers(names: Sequence[str]) -> tuple[str, ...]:
    """Turn names into distinct identifiers of letters, digits and single underscores.

    They begin with a letter, as names of protobuf fields and ROS 2 topics do; a name that is an
    identifier stays as it is, unless an earlier name became the same one.
    """
    found: dict[str, None] = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
        if not plain[:1].isalpha():
            plain = f"aircraft_{plain}"
        unique, count = plain, 1
        while unique in found:
            count += 1
            unique = f"{plain}_{count}"
        found[unique] = None
    return tuple(found)
