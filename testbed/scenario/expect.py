"""Bounds of the numbers of a run: what a scenario expects of its metrics.json."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    WithJsonSchema,
    model_serializer,
)
from pydantic_core import PydanticCustomError

from testbed.core.numbers import parse_percent
from testbed.scenario.fields import Finding, KeyPath, Number, Section
from testbed.scenario.problems import did_you_mean


def _refuse_number(value: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Refuse a number in place of bounds: it could be either one."""
    if isinstance(value, bool | int | float | str):
        raise PydanticCustomError(
            "bounds",
            "is {value}, not a map of bounds (write {bounds}, or max or min as the key)",
            {"value": str(value), "bounds": f"{{max: {value}}}"},
        )
    return value


def _check_change(value: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Check a number of 0 or more, or a percentage such as 5%."""
    number = parse_percent(value) if isinstance(value, str) else value
    if isinstance(number, bool) or not isinstance(number, int | float) or not number >= 0.0:
        raise PydanticCustomError("change", "must be a number of 0 or more, or a percentage (5%)")
    return value if isinstance(value, str) else float(value)


Change = Annotated[
    Any,
    BeforeValidator(_check_change),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number", "minimum": 0},
                {"type": "string", "pattern": r"^[0-9.]+ *%$"},
            ]
        }
    ),
]
"""How far a number may be from that of its golden table: in its unit, or as a percentage."""


class _WithoutMissing(Section):
    """A section that is written without the keys that it does not have."""

    @model_serializer(mode="wrap")
    def _without_missing(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if value is not None}


class Bounds(_WithoutMissing):
    """Smallest and largest accepted value of a number, in the unit of the quantity."""

    min: Number | None = Field(None, description="Smallest accepted value.")
    max: Number | None = Field(None, description="Largest accepted value.")
    not_above: Change | None = Field(
        None,
        description="How far it may be above its golden table: in the unit, or as 5%. A number "
        "that is better passes.",
    )
    not_below: Change | None = Field(
        None, description="How far it may be below its golden table, in the same way."
    )

    @property
    def empty(self) -> bool:
        """Whether there is no bound."""
        return all(getattr(self, side) is None for side in SIDES)

    @property
    def of_table(self) -> bool:
        """Whether there is a bound that a golden table decides."""
        return self.not_above is not None or self.not_below is not None


OfOne = Annotated[Bounds, BeforeValidator(_refuse_number)]


class NamedBounds(Bounds):
    """Bounds of a number for each follower or window; a name has bounds of its own."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, OfOne]

    @property
    def named(self) -> Mapping[str, Bounds]:
        """Bounds by name."""
        return self.__pydantic_extra__


OfNamed = Annotated[NamedBounds, BeforeValidator(_refuse_number)]


class WindowBounds(NamedBounds):
    """Bounds of a number for each window and follower; windows and followers may have their own."""

    __pydantic_extra__: dict[str, OfNamed]  # type: ignore[assignment]  # narrower


OfWindows = Annotated[WindowBounds, BeforeValidator(_refuse_number)]


class Expect(_WithoutMissing):
    """Bounds by quantity, named as in metrics.json."""

    rms_m: OfWindows | None = Field(
        None, description="RMS error of each follower in each window, m."
    )
    max_error_m: OfWindows | None = Field(
        None, description="Largest error of each follower in each window, m."
    )
    estimated_rms_m: OfWindows | None = Field(
        None, description="RMS error by the followers' own estimates, in each window, m."
    )
    mean_rms_m: OfNamed | None = Field(
        None, description="Mean RMS error of all followers in each window, m."
    )
    estimated_mean_rms_m: OfNamed | None = Field(
        None, description="Mean RMS error by the followers' own estimates, in each window, m."
    )
    percent_error: OfNamed | None = Field(
        None, description="RMS error in percent of the length of the offset, in each window, %."
    )
    min_separation_m: OfOne | None = Field(
        None, description="Smallest distance of the centres of two aircraft in the run, m."
    )
    joined_at_s: OfNamed | None = Field(
        None, description="Time at which each follower first reached its slot, s."
    )
    relative_position_error_m: OfNamed | None = Field(
        None,
        description="RMS error of each follower's estimated position relative to the leader, m.",
    )
    left_speed_set: OfNamed | None = Field(
        None, description="How often the speed of each follower left its bounds, a number."
    )

    @property
    def bounds(self) -> Mapping[str, Bounds]:
        """Bounds by quantity, of those that have any."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: bounds for name, bounds in values.items() if bounds is not None}


SIDES = ("min", "max", "not_above", "not_below")
# those of which golden tables have numbers
TABLE_QUANTITIES = (
    *("rms_m", "mean_rms_m", "estimated_mean_rms_m", "min_separation_m"),
    *("joined_at_s", "relative_position_error_m"),
)
WINDOW_QUANTITIES = (
    *("rms_m", "max_error_m", "estimated_rms_m"),
    *("mean_rms_m", "estimated_mean_rms_m", "percent_error"),
)


def check_expect(
    expect: Expect, windows: Sequence[str], followers: Sequence[str]
) -> Iterator[Finding]:
    """Find bounds of windows and followers that do not exist, and bounds that contradict."""
    for quantity, bounds in expect.bounds.items():
        at: KeyPath = ("expect", quantity)
        of_windows = quantity in WINDOW_QUANTITIES
        if of_windows and not windows:
            yield at, "is a number of a window, and scenario.windows has none (write one there)"
            continue
        yield from _contradictions(at, bounds)
        names = [*(windows if of_windows else ()), *([] if _is_mean(bounds, at) else followers)]
        yield from _named(at, bounds, names, followers)


def _is_mean(bounds: Bounds, at: KeyPath) -> bool:
    """Return whether a quantity is one number per window, not one per follower."""
    return at[-1] in WINDOW_QUANTITIES and not isinstance(bounds, WindowBounds)


def _named(
    at: KeyPath, bounds: Bounds, names: Iterable[str], followers: Sequence[str]
) -> Iterator[Finding]:
    """Check bounds by name, and below a window those by follower."""
    if not isinstance(bounds, NamedBounds):
        return
    known = list(names)
    for name, own in bounds.named.items():
        if name not in known:
            kinds = "windows and followers are" if set(known) - set(followers) else "followers are"
            if known and not set(known) & set(followers):
                kinds = "windows are"
            hint = did_you_mean(name, [*known, *SIDES])
            names = f" ({kinds} {', '.join(known)})" if known else f" (write {', '.join(SIDES)})"
            yield (*at, name), f"is not {', '.join(SIDES)} or a name here{hint}{names}"
            continue
        yield from _contradictions((*at, name), own)
        yield from _named((*at, name), own, [] if name in followers else followers, followers)


def _contradictions(at: KeyPath, bounds: Bounds) -> Iterator[Finding]:
    named = bounds.named if isinstance(bounds, NamedBounds) else {}
    if bounds.of_table and at[1] not in TABLE_QUANTITIES:
        yield (
            at,
            (
                "is in no golden table, of which not_above and not_below are (write min or max, or "
                f"another quantity: {', '.join(TABLE_QUANTITIES)})"
            ),
        )
    if bounds.empty and not named:
        yield at, "has no bounds (write {max: 1}, for example)"
    elif bounds.min is not None and bounds.max is not None and bounds.min > bounds.max:
        yield (*at, "min"), f"{bounds.min:g} is above max, {bounds.max:g} (write less, or more)"


def without_windows(expect: Mapping[str, Any], lost: Iterable[str], *, any_left: bool) -> Any:  # noqa: ANN401
    """Return bounds, as plain data, without those of lost windows."""
    removed = set(lost)
    remaining = {
        quantity: {name: own for name, own in bounds.items() if name not in removed}
        if quantity in WINDOW_QUANTITIES
        else bounds
        for quantity, bounds in expect.items()
    }
    return {
        quantity: bounds
        for quantity, bounds in remaining.items()
        if bounds and (any_left or quantity not in WINDOW_QUANTITIES)
    }


def unchecked(expect: Expect, windows: Iterable[str], lost: Collection[str]) -> list[str]:
    """Return the keys of bounds that are not checked without some windows.

    Args:
        expect: the bounds.
        windows: names of all windows.
        lost: names of those that are not reached.
    """
    keys = []
    for quantity, bounds in expect.bounds.items():
        if quantity in WINDOW_QUANTITIES and set(lost) >= set(windows):
            keys.append(f"expect.{quantity}")
        elif quantity in WINDOW_QUANTITIES and isinstance(bounds, NamedBounds):
            keys += [f"expect.{quantity}.{name}" for name in bounds.named if name in lost]
    return keys
