"""The page: one frozen object composed of the rooms' sections. Schema 1."""

from collections.abc import Mapping
from typing import Literal, Self

from pydantic import ConfigDict, Field, model_validator

from testbed.scenario.air import Air
from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.checks import cross_check
from testbed.scenario.control import Controller, Formation
from testbed.scenario.fields import (
    Degrees,
    Flag,
    Hertz,
    Metres,
    Name,
    Percent,
    Seconds,
    Section,
    Whole,
    refuse,
)
from testbed.scenario.limits import Limits
from testbed.scenario.link import Window
from testbed.scenario.network import Network

SCHEMA_VERSION = 1


class OriginOnPage(Section):
    """Where the local north-east-down frame touches the earth (WGS 84)."""

    latitude_deg: Degrees = Field(38.0, ge=-85, le=85, description="Latitude, degrees.")
    longitude_deg: Degrees = Field(0.0, ge=-180, le=180, description="Longitude, degrees.")
    elevation_m: Metres = Field(300.0, description="Elevation of the ground above sea level, m.")


class Published(Section):
    """A published table to be printed beside ours."""

    source: str = Field(min_length=1, description="Where the numbers were printed.")
    rms_m: Mapping[Name, tuple[Metres, ...]] = Field(
        {}, description="RMS error by portion, one number per follower in fleet order, m."
    )
    mean_rms_m: Mapping[Name, Metres] = Field({}, description="Mean RMS error by portion, m.")
    percent_error: Mapping[Name, Percent] = Field(
        {}, description="RMS of the error against the offset's length by portion, %."
    )


class Header(Section):
    """What the run is, how long it is, and what it is asked."""

    model_config = ConfigDict(populate_by_name=True)

    schema_version: Literal[1] = Field(alias="schema", description="Version of the page: 1.")
    name: Name = Field(description="Name of the scenario; its runs are kept under this name.")
    question: str = Field("", description="The question the run answers.")
    expectation: str = Field("", description="The answer that is expected.")
    duration_s: Seconds = Field(gt=0, le=86_400, description="Length of the run, s.")
    seed: Whole = Field(1, ge=0, lt=2**63, description="Seed of every random stream, a number.")
    origin: OriginOnPage = Field(OriginOnPage(), description="Where the flight is on the earth.")
    portions: Mapping[Name, Window] = Field(
        {}, description="Windows [from, to] for which RMS errors are reported, s."
    )
    published: Published | None = Field(None, description="A table to be printed beside ours.")


class Rates(Section):
    """How often things happen; each rate divides physics_hz."""

    physics_hz: Hertz = Field(200, description="Steps of the flight model, Hz.")
    autopilot_hz: Hertz = Field(50, description="Autopilots, Hz.")
    control_hz: Hertz = Field(25, description="Formation controllers, Hz.")
    broadcast_hz: Hertz = Field(25, description="Messages of each aircraft, Hz.")
    log_hz: Hertz = Field(25, description="Frames for the log, the view and the metrics, Hz.")
    synchronous: Flag = Field(
        True,
        description="All aircraft act at the same moments: true; or each at a phase of its own, "
        "drawn from the seed: false.",
    )


class Log(Section):
    """What a run leaves behind."""

    mcap: Flag = Field(True, description="Write run.mcap: true or false.")


class Scenario(Section):
    """One page: everything that decides the numbers of a run."""

    scenario: Header = Field(description="What the run is.")
    rates: Rates = Field(Rates(), description="How often things happen, Hz.")
    leader: Leader = Field(description="The aircraft that everyone follows.")
    fleet: tuple[Follower, ...] = Field(
        min_length=1, description="The followers, in order: a list, or a pattern."
    )
    formation: Formation = Field(description="Offsets, graph and gains of the formation.")
    controller: Controller = Field(Controller(), description="How the followers are controlled.")
    network: Network = Field(Network(), description="The radio between the aircraft.")
    air: Air = Field(Air(), description="The air the aircraft fly in.")
    limits: Limits = Field(Limits(), description="When an aircraft counts as lost.")
    log: Log = Field(Log(), description="What the run leaves behind.")

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.scenario.name

    @property
    def aircraft_names(self) -> tuple[str, ...]:
        """Names of all aircraft, the leader first, then the fleet in order."""
        return tuple(each.name for each in self.aircraft)

    @property
    def aircraft(self) -> tuple[Leader | Follower, ...]:
        """All aircraft, the leader first, then the fleet in order."""
        return (self.leader, *self.fleet)

    @model_validator(mode="after")
    def _cross_check(self) -> Self:
        refuse(cross_check(self))
        return self
