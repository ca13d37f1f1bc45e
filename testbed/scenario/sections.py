"""Sections of a scenario, without checks of sections against each other."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from testbed.core.ranges import ORIGIN_ELEVATION, ORIGIN_LATITUDE, ORIGIN_LONGITUDE
from testbed.core.start_time import EXAMPLE
from testbed.scenario.air import Air
from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.control import Controller, Formation
from testbed.scenario.expect import Expect
from testbed.scenario.fields import (
    MAX_DURATION_S,
    SMALLEST,
    Degrees,
    Flag,
    Hertz,
    Length,
    Metres,
    Name,
    Number,
    Percent,
    Seconds,
    Section,
    Speed,
    StartTime,
    Whole,
    within,
)
from testbed.scenario.network import Network, Window
from testbed.scenario.reference_fields import ScenarioReference

Distance = Annotated[Length, Field(ge=SMALLEST)]


class Origin(Section):
    """Origin of the local north-east-down frame (WGS 84)."""

    latitude_deg: Annotated[Degrees, within(ORIGIN_LATITUDE)] = Field(
        38.0,
        description="Latitude, degrees.",
        json_schema_extra={
            "reason": "east is an arc along the parallel of the origin; nearer a pole parallels "
            "shrink by more than 0.17 % per km"
        },
    )
    longitude_deg: Annotated[Degrees, within(ORIGIN_LONGITUDE)] = Field(
        0.0, description="Longitude, degrees; 180 equals -180."
    )
    elevation_m: Annotated[Number, within(ORIGIN_ELEVATION)] = Field(
        300.0,
        json_schema_extra={"unit": "m"},
        description="Elevation of the ground above sea level, m.",
    )


class Published(Section):
    """Published table, printed beside the results."""

    source: str = Field(min_length=1, description="Source of the numbers.")
    rms_m: Mapping[Name, tuple[Metres, ...]] = Field(
        {}, description="RMS error by window, one number per follower in fleet order, m."
    )
    mean_rms_m: Mapping[Name, Metres] = Field({}, description="Mean RMS error by window, m.")
    percent_error: Mapping[Name, Percent] = Field(
        {}, description="RMS error in percent of the length of the offset, by window, %."
    )
    differs: tuple[Annotated[str, Field(min_length=1)], ...] = Field(
        (),
        description="Keys in which this scenario differs from the published set-up; with any, the "
        "numbers are not compared. --set adds the keys that it changes.",
    )


class Begin(Section):
    """Another flight that this one begins with."""

    scenario: ScenarioReference = Field(description="Name or path of its scenario.")
    at_s: Seconds = Field(ge=SMALLEST, le=MAX_DURATION_S, description="Time of both flights, s.")


class Header(Section):
    """Name, question, duration, seed and windows of the run."""

    model_config = ConfigDict(populate_by_name=True)

    @model_validator(mode="before")
    @classmethod
    def _remove_windows(cls, data: Any) -> Any:  # noqa: ANN401 - any YAML value
        """Leave out windows that are null: none are inherited that it could remove."""
        if isinstance(data, Mapping) and data.get("windows", ()) is None:
            return {key: data[key] for key in data if key != "windows"}
        return data

    schema_version: Literal[2] = Field(alias="schema", description="Version of this schema: 2.")
    name: Name = Field(description="Name of the scenario and of the folder of its runs.")
    question: str = Field("", description="Question that the run answers.")
    expectation: str = Field("", description="Expected answer.")
    duration_s: Seconds = Field(ge=SMALLEST, le=MAX_DURATION_S, description="Length of the run, s.")
    seed: Whole = Field(1, ge=0, lt=2**63, description="Seed of every random stream, a number.")
    engine: Literal["auto", "jsbsim", "compiled"] = Field(
        "auto",
        description="What steps the flight models: compiled functions, JSBSim, or auto: compiled "
        "functions where they are proved equal to JSBSim.",
    )
    begin: Begin | None = Field(
        None,
        description="Flight that this one begins with: motion, autopilots, controllers, filters "
        "and messages are its own at that time; all else is that of this scenario.",
    )
    origin: Origin = Field(Origin(), description="Origin of the local frame on the earth.")
    windows: Mapping[Name, Window] = Field(
        {}, description="Windows [from, to] for which errors are reported, s."
    )
    published: Published | None = Field(
        None, description="Published table, printed beside the results."
    )


class Rates(Section):
    """Rates of the loops; each divides physics_hz."""

    physics_hz: Hertz = Field(100, description="Steps of the flight model, Hz.")
    autopilot_hz: Hertz = Field(50, description="Autopilots, Hz.")
    control_hz: Hertz = Field(25, description="Formation controllers, Hz.")
    broadcast_hz: Hertz = Field(25, description="Messages of each aircraft, Hz.")
    log_hz: Hertz = Field(25, description="Samples for the log, the view and the metrics, Hz.")
    synchronous: Flag = Field(
        True,
        description="true: all aircraft act at the same times; false: each with its own phase, "
        "drawn from the seed.",
    )


class Limits(Section):
    """Limits of separation, airspeed, angle of attack and formation error, and the response."""

    collision_m: Distance | None = Field(
        None,
        description="Distance of the centres of two aircraft below which both are lost, m; not "
        "checked by default.",
    )
    separation_m: Distance | None = Field(
        None,
        description="Distance of the centres of two aircraft below which the log has a warning, m; "
        "not checked by default.",
    )
    min_separation_m: Annotated[Length, Field(ge=0)] | None = Field(
        None,
        description="Distance of the centres of two aircraft below which separation is lost: an "
        "error, and exit code 1, m; by default a wingspan, the larger of the two; 0: not checked.",
    )
    overspeed_mps: Annotated[Speed, Field(ge=SMALLEST)] | None = Field(
        None,
        description="Equivalent airspeed above which, for 0.5 s, a flight model exceeds its "
        "envelope, m/s; by default 1.5 times AIRSPEED_MAX of its autopilot.",
    )
    stall_deg: Annotated[Degrees, Field(ge=SMALLEST, le=180)] | None = Field(
        None,
        description="Angle of attack above which, for 0.5 s, a flight model exceeds its envelope, "
        "degrees; by default that of maximum lift.",
    )
    formation_lost_m: Distance | None = Field(
        100.0,
        description="A follower more than this beyond its closest distance to its slot, for 5 s, "
        "is out of formation, m; null: not checked.",
    )
    on_loss: Literal["stop", "continue"] = Field(
        "stop",
        description="When an aircraft is lost (ground contact, collision or numerical failure): "
        "stop the run, or continue without it.",
    )
    on_limit_exceeded: Literal["stop", "continue"] = Field(
        "continue",
        description="Beyond min_separation_m, overspeed_mps, stall_deg or formation_lost_m: stop "
        "the run, or continue.",
    )
    on_violation: Literal["stop", "continue"] = Field(
        "continue",
        description="When a bound of expect is violated whatever follows: stop the run, or "
        "continue.",
    )


class Log(Section):
    """Files that a run writes."""

    mcap: Flag = Field(True, description="Write run.mcap: true or false.")
    start_time: StartTime | None = Field(
        None,
        description="Time of the log's first sample, ISO 8601 with a time zone, such as "
        f"{EXAMPLE}; null: 1970-01-01T00:00:00Z.",
    )


class Sections(Section):
    """All sections of a scenario."""

    scenario: Header = Field(description="Name, question, duration, seed and windows.")
    rates: Rates = Field(Rates(), description="Rates of the loops, Hz.")
    leader: Leader = Field(description="The aircraft that the formation follows.")
    fleet: tuple[Follower, ...] = Field(
        min_length=1, description="The followers in order: a list, or a pattern."
    )
    formation: Formation = Field(description="Offsets, graph and gains of the formation.")
    controller: Controller = Field(Controller(), description="Control law of the followers.")
    network: Network = Field(Network(), description="Radio between the aircraft.")
    air: Air = Field(Air(), description="Wind, turbulence, gusts and wakes.")
    limits: Limits = Field(Limits(), description="Limits, and what happens beyond them.")
    expect: Expect = Field(
        Expect(), description="Bounds of the numbers of the run; outside them the exit code is 3."
    )
    log: Log = Field(Log(), description="Files that the run writes.")

    @property
    def name(self) -> str:
        """Return the name of the scenario."""
        return self.scenario.name

    @property
    def published(self) -> dict[str, Any] | None:
        """Return the published numbers to compare with, ready for JSON; None: there are none."""
        published = self.scenario.published
        return published.model_dump(mode="json") if published else None

    @property
    def aircraft_names(self) -> tuple[str, ...]:
        """Return the names of all aircraft, the leader first, then the fleet in order."""
        return tuple(each.name for each in self.aircraft)

    @property
    def aircraft(self) -> tuple[Leader | Follower, ...]:
        """Return all aircraft, the leader first, then the fleet in order."""
        return (self.leader, *self.fleet)
