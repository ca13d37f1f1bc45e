"""The aircraft of the page: the leader with its path, and the fleet that follows."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from testbed.scenario.fields import (
    Degrees,
    Metres,
    MetresPerSecond,
    Name,
    Number,
    Offset,
    Section,
    Whole,
)
from testbed.scenario.sensors import TRUTH, Sensors

Point = tuple[Metres, Metres, Metres]


class Waypoints(Section):
    """Legs from point to point, the turn begun early enough to meet the next leg."""

    kind: Literal["waypoints"] = Field(description="Legs from point to point.")
    points_m: tuple[Point, ...] = Field(
        min_length=1, description="Waypoints [north, east, altitude], m from the origin."
    )
    laps: Whole = Field(1, ge=1, description="How often the points are flown, a number.")


class Level(Section):
    """A stretch of a loiter at one altitude."""

    altitude_m: Metres = Field(description="Altitude above the origin, m.")
    turns: Number = Field(gt=0, description="Full circles at this altitude, a number.")


class Loiter(Section):
    """A circle, level after level."""

    kind: Literal["loiter"] = Field(description="A circle.")
    centre_m: tuple[Metres, Metres] = Field(
        description="Centre of the circle [north, east], m from the origin."
    )
    radius_m: Metres = Field(gt=0, description="Radius, m.")
    direction: Literal["clockwise", "anticlockwise"] = Field(
        "clockwise", description="Sense of the turn seen from above."
    )
    levels: tuple[Level, ...] = Field(
        min_length=1, description="Altitudes flown in order; the last is kept."
    )


Leg = Annotated[Waypoints | Loiter, Field(discriminator="kind")]


class Mission(Section):
    """A path flown by guidance: the leader is a simulated aircraft."""

    kind: Literal["mission"] = Field(description="Legs flown by the leader's own guidance.")
    airspeed_mps: MetresPerSecond = Field(gt=0, description="Airspeed to hold, m/s.")
    bank_limit_deg: Degrees = Field(
        30.0, gt=0, lt=80, description="Largest bank that guidance asks for, degrees."
    )
    climb_limit_mps: MetresPerSecond = Field(
        1.5,
        gt=0,
        description="Rate between the levels of a circle, m/s; a leg's climb follows its points.",
    )
    waypoint_radius_m: Metres = Field(
        90.0, gt=0, description="A turn begins no farther from its waypoint than this, m."
    )
    legs: tuple[Leg, ...] = Field(
        min_length=1, description="Flown in order; the last goes on until the end of the run."
    )


class Replay(Section):
    """A recorded flight: the leader moves as the record says."""

    kind: Literal["replay"] = Field(description="A recorded flight.")
    file: str = Field(
        min_length=1,
        description="CSV of the flight: relative to this page, or a name in scenarios/data.",
    )


Path = Annotated[Mission | Replay, Field(discriminator="kind")]


class Start(Section):
    """Where the leader is when the clock starts."""

    north_m: Metres = Field(0.0, description="North of the origin, m.")
    east_m: Metres = Field(0.0, description="East of the origin, m.")
    altitude_m: Metres = Field(100.0, description="Altitude above the origin, m.")
    course_deg: Degrees = Field(
        0.0, ge=-360, le=360, description="Course over the ground, degrees clockwise from north."
    )


class Leader(Section):
    """The first aircraft: what it is, where it starts, and what it flies."""

    name: Name = Field("leader", description="Name in logs and views.")
    aircraft: str = Field(
        min_length=1, description="Airframe: a name in aircraft/, or the path of a folder."
    )
    tune: str = Field(
        "autopilot",
        min_length=1,
        description="Autopilot parameters: <tune>.param of the airframe, or the path of a file.",
    )
    sensors: Sensors = Field(
        TRUTH, description="What its autopilot believes: truth, gps-ins, or a map of errors."
    )
    start: Start = Field(
        Start(), description="Where it is at time 0, m and degrees; a replay has its own."
    )
    path: Path = Field(description="What it flies.")


class Follower(Section):
    """An aircraft of the formation."""

    name: Name = Field(description="Name in logs, views, offsets and gains.")
    aircraft: str = Field(
        min_length=1, description="Airframe: a name in aircraft/, or the path of a folder."
    )
    vehicle: Literal["jsbsim"] = Field("jsbsim", description="What computes its motion.")
    autopilot: Literal["virtual"] = Field("virtual", description="What flies it.")
    commanded_by: Literal["formation"] = Field("formation", description="Who gives it commands.")
    tune: str = Field(
        "autopilot",
        min_length=1,
        description="Autopilot parameters: <tune>.param of the airframe, or the path of a file.",
    )
    start_m: Offset = Field(
        description="Start [forward, right, down] of the leader's start along its course, m."
    )
    sensors: Sensors = Field(
        TRUTH, description="What its autopilot believes: truth, gps-ins, or a map of errors."
    )
