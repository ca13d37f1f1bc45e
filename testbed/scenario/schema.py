"""The schema of a scenario as a frozen object and as JSON schema."""

from collections.abc import Mapping
from typing import Any, Self, TypeVar

from pydantic import PrivateAttr, ValidationError, model_validator

from testbed.core.errors import InputError
from testbed.scenario.arguments import check_argument, with_changes
from testbed.scenario.checks import cross_check
from testbed.scenario.control import BUILT_IN
from testbed.scenario.expect import without_windows
from testbed.scenario.fields import raise_findings
from testbed.scenario.network import Window
from testbed.scenario.pattern import Pattern
from testbed.scenario.sections import Header, Sections
from testbed.scenario.set_keys import SetKeys
from testbed.scenario.single_aircraft import SingleAircraft

SCHEMA_VERSION = 2
SECOND_HALF = "second_half"  # window of a flight that reaches no other one


class Scenario(Sections):
    """A scenario: everything that determines the numbers of a run."""

    _set_keys: SetKeys = PrivateAttr(SetKeys())

    @property
    def set_keys(self) -> SetKeys:
        """The keys that the user has set; none where it is not known."""
        return self._set_keys

    def with_set_keys(self, keys: SetKeys) -> Self:
        """Return the scenario with these as the keys that the user has set."""
        copy = self.model_copy()
        copy._set_keys = keys
        return copy

    @model_validator(mode="before")
    @classmethod
    def _resolve_controller(cls, data: Any) -> Any:  # noqa: ANN401 - any YAML value
        """Write what the controller leaves open: bounded speed, and origin of extrapolation."""
        if not isinstance(data, Mapping):
            return data
        controller, air = data.get("controller", {}), data.get("air")
        if not isinstance(controller, Mapping):
            return data
        wind = air.get("wind") if isinstance(air, Mapping) else None
        blows = isinstance(wind, Mapping) and (wind.get("speed_mps") or wind.get("file"))
        chosen = {"bounded_speed": "airspeed" if blows else "ground_speed"}
        if controller.get("law", BUILT_IN) == BUILT_IN:
            chosen["extrapolate_from"] = "receipt"
        chosen = {key: word for key, word in chosen.items() if controller.get(key) is None}
        return {**data, "controller": {**controller, **chosen}} if chosen else data

    @model_validator(mode="after")
    def _cross_check(self) -> Self:
        raise_findings(cross_check(self))
        return self


FlightT = TypeVar("FlightT", bound=Scenario | SingleAircraft)


def set_duration(scenario: Scenario, duration_s: float) -> Scenario:
    """Return the scenario with another duration, in s, without what does not fit into it.

    A window that has begun by then ends with the run; windows and faults that begin later are
    dropped, and bounds of these windows. Where no window remains of some, the second half of the
    flight is one, `second_half`, so that every flight has its errors. Published numbers remain for
    complete windows only, and the expectation, which is of the whole flight, for no shorter one.

    Args:
        scenario: which stays as it is.
        duration_s: s.

    Raises:
        InputError: the duration is not above 0, is above a day, or does not fit the scenario.
    """
    duration_s = check_argument("duration_s", duration_s, Header, "duration_s")
    data = scenario.model_dump(by_alias=True)
    header, begin = data["scenario"], scenario.scenario.begin
    windows = scenario.scenario.windows
    complete = {name for name, (_, end) in windows.items() if end <= duration_s}
    if duration_s < header["duration_s"]:
        header["expectation"] = ""
    header["duration_s"] = duration_s
    header["windows"] = {
        name: (start, min(end, duration_s))
        for name, (start, end) in windows.items()
        if start < duration_s
    }
    if header["published"] is not None:
        for key in ("rms_m", "mean_rms_m", "percent_error"):
            table = header["published"][key]
            header["published"][key] = {name: table[name] for name in table if name in complete}
    data["expect"] = without_windows(
        data["expect"], windows.keys() - header["windows"].keys(), any_left=bool(header["windows"])
    )
    if windows and not header["windows"]:
        start_s = begin.at_s if begin else 0.0
        header["windows"] = {SECOND_HALF: ((start_s + duration_s) / 2.0, duration_s)}
    paths = [("leader",), *(("fleet", str(index)) for index in range(len(data["fleet"])))]
    dropped = {}
    for path, aircraft in zip(paths, (data["leader"], *data["fleet"]), strict=True):
        late = [k for k, one in enumerate(aircraft["faults"]) if (one["at_s"] or 0) > duration_s]
        aircraft["faults"] = [one for k, one in enumerate(aircraft["faults"]) if k not in late]
        dropped[(*path, "faults")] = late
    try:
        changed = Scenario.model_validate(data)
        return changed.with_set_keys(scenario.set_keys.without_faults(dropped, scenario))
    except ValidationError as error:
        reason = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise InputError(f"duration_s: {duration_s:g} s: {reason}") from None


def set_seed(scenario: FlightT, seed: int) -> FlightT:
    """Return the scenario with another seed.

    Raises:
        InputError: it is not a whole number from 0 to 2^63 - 1.
    """
    seed = check_argument("seed", seed, Header, "seed")
    changed = with_changes(scenario, scenario=with_changes(scenario.scenario, seed=seed))
    if isinstance(changed, Scenario) and isinstance(scenario, Scenario):
        return changed.with_set_keys(scenario.set_keys)
    return changed


def unreached_windows(scenario: Scenario, duration_s: float) -> dict[str, str]:
    """Return windows that begin after a duration, s, with their times as text, by name."""
    return {
        name: _window_text(name, window)
        for name, window in scenario.scenario.windows.items()
        if window[0] >= duration_s
    }


def cut_windows(scenario: Scenario, duration_s: float) -> list[str]:
    """Return windows that begin before a duration, s, and end after it, as text."""
    return [
        _window_text(name, window)
        for name, window in scenario.scenario.windows.items()
        if window[0] < duration_s < window[1]
    ]


def _window_text(name: str, window: Window) -> str:
    return f"{name} ({window[0]:g} to {window[1]:g} s)"


def describe_unreached(windows: Mapping[str, str], duration_s: float) -> str:
    """Describe windows of `unreached_windows` in one line."""
    return (
        f"the run ends at {duration_s:g} s, before these windows begin, which have no RMS errors: "
        f"{', '.join(windows.values())}"
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON schema of a scenario file, for completion and hints in an editor.

    Only the keys that distinguish kinds are required: a file that extends another may leave out
    the rest. `testbed validate` decides.
    """
    schema: dict[str, Any] = _without_required(Scenario.model_json_schema(by_alias=True))
    pattern = _without_required(Pattern.model_json_schema(by_alias=True))
    schema["$defs"] |= {**pattern.pop("$defs"), "Pattern": pattern}
    fleet = schema["properties"]["fleet"]
    schema["properties"]["fleet"] = {
        **{key: fleet.pop(key) for key in ("title", "description")},
        "anyOf": [fleet, {"$ref": "#/$defs/Pattern"}],
    }
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "Testbed scenario"
    schema["properties"] = {
        "extends": {
            "type": "string",
            "title": "Extends",
            "description": "Name or path of the scenario that this file changes: maps merge, lists "
            "and scalars replace, null removes a key. question, expectation and published are not "
            "inherited when the scenario is renamed.",
        },
        **schema["properties"],
    }
    return schema


def _without_required(schema: Any) -> Any:  # noqa: ANN401 - nested plain data
    if isinstance(schema, list):
        return [_without_required(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    result = {key: _without_required(value) for key, value in schema.items() if key != "required"}
    kinds = [key for key in schema.get("required", ()) if key in ("kind", "example")]
    return {**result, "required": kinds} if kinds else result
