"""Bounds of the numbers of a run: what a scenario expects of its metrics.json."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
)
from pydantic_core import PydanticCustomError

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


class _WithoutMissing(Section):
    """A section that is written without the keys that it does not have."""

    @model_serializer(mode="wrap")
    def _without_missing(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if value is not None}


class Bounds(_WithoutMissing):
    """Smallest and largest accepted value of a number, in the unit of the quantity."""

    min: Number | None = Field(None, description="Smallest accepted value.")
    max: Number | None = Field(None, description="Largest accepted value.")


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

    @property
    def bounds(self) -> Mapping[str, Bounds]:
        """Bounds by quantity, of those that have any."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: bounds for name, bounds in values.items() if bounds is not None}


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
            hint = did_you_mean(name, [*known, "min", "max"])
            names = f" ({kinds} {', '.join(known)})" if known else " (write min or max)"
            yield (*at, name), f"is not min, max or a name here{hint}{names}"
            continue
        yield from _contradictions((*at, name), own)
        yield from _named((*at, name), own, [] if name in followers else followers, followers)


def _contradictions(at: KeyPath, bounds: Bounds) -> Iterator[Finding]:
    named = bounds.named if isinstance(bounds, NamedBounds) else {}
    if bounds.min is None and bounds.max is None and not named:
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
