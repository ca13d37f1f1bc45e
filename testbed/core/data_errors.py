"""Errors of plain data that pydantic has checked, as one line: path and reason."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import ValidationError
from pydantic_core import ErrorDetails

MAX_WHOLE = 2**63  # larger whole numbers overflow in arrays
_MAX_KEY = 60  # characters
_EXPECTED = {
    "string_type": "text",
    "bool_type": "true or false",
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a map",
    "dataclass_type": "a map",
    "model_type": "a map",
}
_KINDS: Sequence[tuple[type, str]] = (
    (bool, "true or false"), (str, "text"), (int, "a number"), (float, "a number"),
    (list, "a list"), (dict, "a map"),
)  # fmt: skip


def describe_first(error: ValidationError) -> str:
    """Describe the first wrong value: `events[0].text: is a number, not text`."""
    first = error.errors(include_url=False)[0]
    place = [*first["loc"], *first.get("ctx", {}).get("key", ())]
    parts = (f"[{each}]" if isinstance(each, int) else f".{each[:_MAX_KEY]}" for each in place)
    return f"{''.join(parts).removeprefix('.')}: {_reason(first)}"


def _reason(error: ErrorDetails) -> str:
    kind, limits, value = error["type"], error.get("ctx", {}), error["input"]
    if kind in _EXPECTED:
        found = next((name for type_, name in _KINDS if isinstance(value, type_)), "null")
        return f"is {found}, not {_EXPECTED[kind]}"
    if kind in ("too_short", "too_long"):
        return (
            f"has {len(value)} elements, not {limits.get('min_length', limits.get('max_length'))}"
        )
    return {
        "missing": "is missing",
        "extra_forbidden": "is an unknown field",
        "unexpected_keyword_argument": "is an unknown field",
        "finite_number": f"is {value}, not a finite number",
        "greater_than_equal": f"is below {limits.get('ge')}",
        "less_than_equal": f"is above {limits.get('le')}",
    }.get(kind, error["msg"])
