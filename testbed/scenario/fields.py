"""The building blocks of the page: a strict base, numbers with their unit, gains per direction.

Sections are written without `from __future__ import annotations`: pydantic would have to evaluate
each annotation from its text, whenever anything starts.
"""

from collections.abc import Iterable, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict, WithJsonSchema
from pydantic_core import PydanticCustomError


class Section(BaseModel):
    """A part of a page: frozen, and an unknown key is an error."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=False
    )


def refuse(problems: Iterable[tuple[tuple[str | int, ...], str]]) -> None:
    """Refuse a page whose parts do not go together.

    Args:
        problems: for each the path to it, keys and indices from the top, and what is wrong.

    Raises:
        PydanticCustomError: there are any; with all of them, as `explain` takes them.
    """
    found = list(problems)
    if found:
        text = "; ".join(f"{'.'.join(map(str, path))}: {what}" for path, what in found)
        raise PydanticCustomError("cross", "{text}", {"text": text, "problems": found})


Number = Annotated[float, Strict()]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]

Metres = Annotated[Number, Field(json_schema_extra={"unit": "m"})]
Seconds = Annotated[Number, Field(json_schema_extra={"unit": "s"})]
Degrees = Annotated[Number, Field(json_schema_extra={"unit": "deg"})]
MetresPerSecond = Annotated[Number, Field(json_schema_extra={"unit": "m/s"})]
PerSecond = Annotated[Number, Field(json_schema_extra={"unit": "1/s"})]
Percent = Annotated[Number, Field(json_schema_extra={"unit": "%"})]
Hertz = Annotated[Whole, Field(gt=0, le=10_000, json_schema_extra={"unit": "Hz"})]


def _per_direction(value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
    """Spread a scalar over north, east and down; take the diagonal of a diagonal matrix."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value, value, value)
    if isinstance(value, Sequence) and not isinstance(value, str) and len(value) == 3:
        rows = [row for row in value if isinstance(row, Sequence) and not isinstance(row, str)]
        if not rows:
            return value
        if [len(row) for row in rows] == [3, 3, 3]:
            if any(rows[i][j] != 0 for i in range(3) for j in range(3) if i != j):
                raise PydanticCustomError(
                    "gain", "a matrix must be diagonal (write [north, east, down])"
                )
            return tuple(rows[i][i] for i in range(3))
    raise PydanticCustomError(
        "gain",
        "must be a number, three numbers [north, east, down], or a diagonal matrix of 3 x 3",
    )


_WEIGHT: dict[str, Any] = {"type": "number", "minimum": 0}
_GAIN_SCHEMA: dict[str, Any] = {
    "anyOf": [
        _WEIGHT,
        {"type": "array", "items": _WEIGHT, "minItems": 3, "maxItems": 3},
        {
            "type": "array",
            "items": {"type": "array", "items": _WEIGHT, "minItems": 3, "maxItems": 3},
            "minItems": 3,
            "maxItems": 3,
        },
    ]
}
NotNegative = Annotated[Number, Field(ge=0)]
Gain = Annotated[
    tuple[NotNegative, NotNegative, NotNegative],
    BeforeValidator(_per_direction),
    WithJsonSchema(_GAIN_SCHEMA),
]
"""A position gain per inertial direction, always a triple once read."""

Offset = tuple[Metres, Metres, Metres]
"""Three lengths in m; the field that uses it says along which axes."""
