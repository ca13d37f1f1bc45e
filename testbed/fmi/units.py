"""Units of variables of an FMU, compared with those of the law's contract."""

from __future__ import annotations

from collections.abc import Mapping

# exponents of m, s and rad
_KNOWN: Mapping[str, tuple[int, int, int]] = {
    "m": (1, 0, 0),
    "s": (0, 1, 0),
    "rad": (0, 0, 1),
    "1": (0, 0, 0),
    "m/s": (1, -1, 0),
    "m/s2": (1, -2, 0),
    "rad/s": (0, -1, 1),
    "1/s": (0, -1, 0),
}
_SPELLINGS = {
    "m/s^2": "m/s2",
    "m/s**2": "m/s2",
    "m/s²": "m/s2",
    "m/(s2)": "m/s2",
    "m.s-1": "m/s",
    "m.s-2": "m/s2",
    "rad.s-1": "rad/s",
    "s-1": "1/s",
    "Hz": "1/s",
    "-": "1",
}
_M, _S, _RAD, _FACTOR, _OFFSET = 1, 2, 7, 8, 9  # of a definition
_OTHERS = 0, 3, 4, 5, 6


def unit_fits(unit: str, expected: str, definitions: Mapping[str, tuple[float, ...]]) -> bool:
    """Return whether a unit is that of a field; a variable without a unit is of any.

    An angle may have no unit, as radians are 1.

    Args:
        unit: of a variable; "": none.
        expected: of the field.
        definitions: of the FMU, see `ModelDescription.units`.
    """
    name = _SPELLINGS.get(unit, unit)
    if not unit or name == expected:
        return True
    metres, seconds, radians = _KNOWN[expected]
    if name in _KNOWN:
        return _KNOWN[name][:2] == (metres, seconds) and (bool(radians) or not _KNOWN[name][2])
    if (found := definitions.get(unit)) is None:
        return False
    same = found[_M] == metres and found[_S] == seconds and found[_RAD] in (0, radians)
    return (
        same
        and not any(found[k] for k in _OTHERS)
        and found[_FACTOR] == 1.0
        and found[_OFFSET] == 0.0
    )
