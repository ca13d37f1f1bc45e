"""Building blocks of the schema: a strict base class, numbers with units, gains per direction.

Modules with sections leave out `from __future__ import annotations`: pydantic would have to
evaluate each annotation from its text at every start.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, ClassVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    Strict,
    WithJsonSchema,
)
from pydantic_core import PydanticCustomError

from testbed.core.numbers import SMALLEST as SMALLEST
from testbed.core.ranges import MAX_DISTANCE_M as MAX_DISTANCE_M
from testbed.core.ranges import MAX_SPEED_MPS as MAX_SPEED_MPS
from testbed.core.ranges import Range
from testbed.core.start_time import start_unix_ns

KeyPath = tuple[str | int, ...]
"""Keys and list indices from the top of a file to a value."""
Finding = tuple[KeyPath, str]
"""A path, what is wrong there and what to write instead."""


class Section(BaseModel):
    """A map of a scenario: frozen; an unknown key is an error."""

    CONSTANT: ClassVar[bool] = True  # no state of a flight; see core/saved_state.py
    model_config = ConfigDict(
        defer_build=True,  # models are built when first used: a start is 0.02 s shorter
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        use_attribute_docstrings=False,
    )


def raise_findings(findings: Iterable[Finding]) -> None:
    """Raise one error for sections that contradict each other.

    Raises:
        PydanticCustomError: there is a finding; with all of them, for `explain`.
    """
    found = list(findings)
    if found:
        text = "; ".join(f"{'.'.join(map(str, path))}: {what}" for path, what in found)
        raise PydanticCustomError("cross", "{text}", {"text": text, "problems": found})


Number = Annotated[float, Strict()]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]


def _readable_time(text: str) -> str:
    try:
        start_unix_ns(text)
    except ValueError as error:
        raise PydanticCustomError("time", "{text}", {"text": str(error)}) from None
    return text


StartTime = Annotated[str, AfterValidator(_readable_time)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]

# Bounds of what no scenario needs more of: each number of a file has its own, or one of these.
# Those of columns of files, too, are in core/ranges.py.
MAX_DURATION_S = 86_400  # a day
MAX_RATE_PER_S = 1000.0  # gains of 1/s act within a millisecond
MAX_LOOP_GAIN = 100.0  # rad per rad, or throttle per m/s: full command for a hundredth of a unit
MAX_WEIGHT = 1e6  # ratios of gains, and parameters of functions
# A number that must be positive has SMALLEST as its lower bound, never `gt=0`.


def within(limits: Range) -> Any:  # noqa: ANN401 - the type of pydantic's `Field`
    """Return the bounds of a key that files can stand for."""
    return Field(ge=limits.low, le=limits.high)


Metres = Annotated[
    Number, Field(ge=-MAX_DISTANCE_M, le=MAX_DISTANCE_M, json_schema_extra={"unit": "m"})
]
"""A coordinate; lengths, which have no sign, are `Length`."""
Length = Annotated[Number, Field(le=MAX_DISTANCE_M, json_schema_extra={"unit": "m"})]
"""A length with a lower bound of its own."""
Seconds = Annotated[Number, Field(json_schema_extra={"unit": "s"})]
Duration = Annotated[Number, Field(le=MAX_DURATION_S, json_schema_extra={"unit": "s"})]
"""A time with a lower bound of its own."""
Instant = Annotated[Duration, Field(ge=0)]
"""A time of the run, s."""
Degrees = Annotated[Number, Field(json_schema_extra={"unit": "deg"})]
MetresPerSecond = Annotated[Number, Field(json_schema_extra={"unit": "m/s"})]
Speed = Annotated[Number, Field(le=MAX_SPEED_MPS, json_schema_extra={"unit": "m/s"})]
"""A speed with a lower bound of its own."""
PerSecond = Annotated[Number, Field(le=MAX_RATE_PER_S, json_schema_extra={"unit": "1/s"})]
Celsius = Annotated[Number, Field(json_schema_extra={"unit": "degC"})]
Percent = Annotated[Number, Field(json_schema_extra={"unit": "%"})]
Hertz = Annotated[Whole, Field(gt=0, le=10_000, json_schema_extra={"unit": "Hz"})]


def _zero_or_usable(value: float) -> float:
    if 0 < value < SMALLEST:
        raise PydanticCustomError(
            "small",
            "is {value} (write 0, or a number at least {smallest})",
            {"value": f"{value:g}", "smallest": f"{SMALLEST:g}"},
        )
    return value


ZeroOrUsable = AfterValidator(_zero_or_usable)
"""For numbers that divide, and of which 0 switches an effect off."""


def is_number(value: object) -> bool:
    """Return whether a value is a number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def merge_maps(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a map with changes: maps in it merge key by key, other values replace."""
    merged = dict(base)
    for key, value in changes.items():
        below = merged.get(key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            merged[key] = {**below, **value}
        else:
            merged[key] = value
    return merged


def _per_direction(value: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Repeat a scalar for north, east and down; take the diagonal of a diagonal matrix."""
    if is_number(value):
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


_WEIGHT: dict[str, Any] = {"type": "number", "minimum": 0, "maximum": MAX_WEIGHT}
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
NotNegative = Annotated[Number, Field(ge=0, le=MAX_WEIGHT)]
LoopGain = Annotated[Number, Field(ge=0, le=MAX_LOOP_GAIN)]
Gain = Annotated[
    tuple[NotNegative, NotNegative, NotNegative],
    BeforeValidator(_per_direction),
    WithJsonSchema(_GAIN_SCHEMA),
]
"""A position gain per direction (north, east, down), no unit."""

Offset = tuple[Metres, Metres, Metres]
"""Three lengths, m; the field that uses it names the axes."""
