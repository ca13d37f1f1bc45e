"""Comparison of a metrics document with the bounds that its scenario expects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

Document = Mapping[str, Any]

_SIDES = {"min": "below", "max": "above"}
_UNITS = {"_m": " m", "_s": " s", "percent_error": " %"}


def check_expectations(document: Document, expect: Mapping[str, Any]) -> dict[str, Any]:
    """Compare the numbers of a run with bounds.

    A bound of a window or a follower replaces the general one, and a bound of a follower in a
    window replaces these. A number that is missing is outside its bounds, except in a window that
    the run did not reach and for an aircraft that was lost.

    Args:
        document: of metrics.json.
        expect: of the scenario, as plain data: bounds `min` and `max` by quantity, window and
            follower.

    Returns:
        `checked` and `violated`, the numbers of comparisons, and `bounds`, a list of them: `key` of
        the bound, `quantity`, `window`, `follower`, `side`, `bound`, `value`, `met`.
    """
    found = [
        each for quantity, bounds in expect.items() for each in _compare(document, quantity, bounds)
    ]
    return {
        "checked": len(found),
        "violated": sum(not each["met"] for each in found),
        "bounds": found,
    }


def compares_flights(bounds: Mapping[str, Any]) -> bool:
    """Return whether there is a bound that needs no golden table."""
    return any(
        compares_flights(each) if isinstance(each, Mapping) else side in _SIDES
        for side, each in bounds.items()
    )


def _compare(document: Document, quantity: str, bounds: Mapping[str, Any]) -> Iterator[Document]:
    for window, follower, value in _numbers(document, quantity):
        for key in _applying(bounds, window, follower):
            *_, side = key
            bound = _at(bounds, key)
            met = value is not None and (value >= bound if side == "min" else value <= bound)
            yield {
                "key": [quantity, *key],
                "quantity": quantity,
                "window": window,
                "follower": follower,
                "side": side,
                "bound": bound,
                "value": value,
                "met": met,
            }


def _numbers(
    document: Document, quantity: str
) -> Iterator[tuple[str | None, str | None, float | None]]:
    """Yield window, follower and value of a quantity's numbers; None: of all.

    A quantity that windows have is read from them only, unless the whole flight has one number of
    it, as of the smallest separation.
    """
    windows = document["windows"]
    places: list[tuple[str | None, Any]] = [
        (name, numbers[quantity])
        for name, numbers in windows.items()
        if quantity in numbers and numbers["covered_s"]
    ]
    one = quantity in document and not isinstance(document[quantity], Mapping)
    if one or not any(quantity in numbers for numbers in windows.values()):
        places = [(None, document[quantity])]
    if quantity == "left_speed_set":
        places = [(None, {name: each["times"] for name, each in document[quantity].items()})]
    lost = document["lost_at_s"]
    for window, values in places:
        by_follower = values if isinstance(values, Mapping) else {None: values}
        for follower, value in by_follower.items():
            if value is not None or follower is None or lost[follower] is None:
                yield window, follower, value


def _applying(
    bounds: Mapping[str, Any], window: str | None, follower: str | None
) -> Iterator[tuple[str, ...]]:
    """Yield the keys of the most specific bounds of a number, per side."""
    one_name = [(name,) for name in (window, follower) if name is not None]
    both = [(window, follower)] if window is not None and follower is not None else []
    for side in _SIDES:
        for level in (both, one_name, [()]):
            keys = [(*names, side) for names in level]
            found = [key for key in keys if _at(bounds, key) is not None]
            if found:
                yield from found
                break


def _at(bounds: Mapping[str, Any], key: tuple[str, ...]) -> Any:  # noqa: ANN401 - nested plain data
    """Return the value at a key path, or None."""
    value: Any = bounds
    for name in key:
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def violations(document: Document) -> list[Document]:
    """Return the bounds that a run's numbers violate."""
    return [each for each in document.get("expect", {}).get("bounds", ()) if not each["met"]]


def bound_key(bound: Document) -> str:
    """Return the key of a bound in the scenario: `expect.rms_m.circles.max`."""
    return ".".join(("expect", *bound["key"]))


def describe_violation(bound: Document) -> str:
    """Describe a violated bound: `uav1 in circles: 0.226 m, above 0.2 m`."""
    followers = [bound["follower"]] if bound["follower"] else []
    where = [f"in {bound['window']}"] if bound["window"] else []
    unit = next((unit for end, unit in _UNITS.items() if bound["quantity"].endswith(end)), "")
    value = "no value" if bound["value"] is None else f"{bound['value']:.4g}{unit}"
    start = f"{' '.join([*followers, *where])}: " if followers or where else ""
    side = "not within" if bound["value"] is None else _SIDES[bound["side"]]
    return f"{start}{value}, {side} {bound['bound']:g}{unit}"
