"""Turn the names of aircraft into identifiers for formats that allow fewer characters."""

from __future__ import annotations

import re
from collections.abc import Sequence


def identifiers(names: Sequence[str]) -> tuple[str, ...]:
    """Turn names into distinct identifiers of letters, digits and single underscores.

    They begin with a letter, as names of protobuf fields and ROS 2 topics do. A name that is an
    identifier stays as it is; another one that would become the same gets a number.

    Args:
        names: distinct.
    """
    taken = {name for name in names if _plain(name) == name}
    found = []
    for name in names:
        plain = _plain(name)
        unique, count = plain, 1
        while unique in taken and unique != name:
            count += 1
            unique = f"{plain}_{count}"
        taken.add(unique)
        found.append(unique)
    return tuple(found)


def changed_names(names: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return the names that are no identifiers, each with the identifier that it becomes."""
    pairs = zip(names, identifiers(names), strict=True)
    return tuple((name, found) for name, found in pairs if name != found)


def _plain(name: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return plain if plain[:1].isalpha() else f"aircraft_{plain}"
