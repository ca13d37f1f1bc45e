"""The aircraft of the page: the leader with its path, and the fleet that follows."""

from typing import Annotated, Literal

from pydantic import Field

from testbed.scenario.faults import Fault
from testbed.scenario.fields import (
    Degrees,
    Metres,
    MetresPerSecond,
    Name,
    Number,
    Offset,
    Seconds,
    Section,
    Whole,
)
from testbed.scenario.pilots import Autopilot, ByFormation, CommandedBy, VirtualAutopilot
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


class Straight(Section):
    """A straight line at constant speed."""

    kind: Literal["straight"] = Field(description="A straight line.")
    climb_mps: MetresPerSecond = Field(0.0, description="Vertical part of the speed, m/s.")


class Circle(Section):
    """A circle; with a climb, a helix."""

    kind: Literal["circle"] = Field(description="A circle, or with a climb a helix.")
    radius_m: Metres = Field(gt=0, description="Radius, m.")
    direction: Literal["clockwise", "anticlockwise"] = Field(
        "clockwise", description="Sense of the turn seen from above."
    )
    climb_mps: MetresPerSecond = Field(0.0, description="Vertical part of the speed, m/s.")


class FigureEight(Section):
    """A level figure-eight from its crossing."""

    kind: Literal["figure-eight"] = Field(description="A figure-eight.")
    radius_m: Metres = Field(gt=0, description="Radius of its tightest turn, m.")
    direction: Literal["clockwise", "anticlockwise"] = Field(
        "clockwise", description="Sense of the first loop seen from above."
    )


class Weave(Section):
    """Straight on with a cosine to the side."""

    kind: Literal["weave"] = Field(description="Straight on, weaving to the right and back.")
    amplitude_m: Metres = Field(gt=0, description="Half the width, m.")
    period_s: Seconds = Field(gt=0, description="Period, s.")


class SpeedChange(Section):
    """A straight line at a speed that swings about its mean."""

    kind: Literal["speed-change"] = Field(description="A straight line at a swinging speed.")
    amplitude_mps: MetresPerSecond = Field(gt=0, description="Amplitude of the speed, m/s.")
    period_s: Seconds = Field(gt=0, description="Period, s.")


Curve = Annotated[
    Straight | Circle | FigureEight | Weave | SpeedChange, Field(discriminator="kind")
]


class Virtual(Section):
    """A leader that is a formula: exact position, velocity and acceleration, and nobody in it."""

    kind: Literal["virtual"] = Field(description="A virtual leader on a curve.")
    speed_mps: MetresPerSecond = Field(
        gt=0, description="Ground speed along the curve; of a weave, ahead, m/s."
    )
    curve: Curve = Field(description="The curve, from the leader's start along its course.")


Vehicle = Literal["jsbsim", "ideal"]
Path = Annotated[Mission | Replay | Virtual, Field(discriminator="kind")]


class Start(Section):
    """Where the leader is when the clock starts."""

    north_m: Metres = Field(0.0, description="North of the origin, m.")
    east_m: Metres = Field(0.0, description="East of the origin, m.")
    altitude_m: Metres = Field(100.0, description="Altitude above the origin, m.")
    course_deg: Degrees = Field(
        0.0, ge=-360, le=360, description="Course over the ground, degrees clockwise from north."
    )


class Battery(Section):
    """How an electric aircraft begins; a sagging battery gives less thrust."""

    state_of_charge: Number = Field(
        1.0, gt=0, le=1, description="Charge at the start, 0 to 1 of a full battery."
    )


class Craft(Section):
    """What every aircraft of a page has."""

    name: Name = Field(description="Name in logs, views, offsets and gains.")
    aircraft: str = Field(
        min_length=1, description="Airframe: a name in aircraft/, or the path of a folder."
    )
    vehicle: Vehicle = Field(
        "jsbsim",
        description="What computes its motion: jsbsim, the aircraft behind its autopilot; or "
        "ideal, the extended unicycle (1) to (4) of [HBH23] itself.",
    )
    autopilot: Autopilot = Field(
        VirtualAutopilot(),
        description="What flies it: virtual; or ardupilot, the real one, or a map with that kind.",
    )
    commanded_by: CommandedBy = Field(
        ByFormation(),
        description="Who gives it commands: formation, the page's own controller or path; or "
        "external, a program that speaks MAVLink, or a map with that kind.",
    )
    tune: str = Field(
        "autopilot",
        min_length=1,
        description="Autopilot parameters: <tune>.param of the airframe, or the path of a file.",
    )
    battery: Battery = Field(Battery(), description="Its battery, if the airframe has one.")
    sensors: Sensors = Field(
        TRUTH,
        description="What its autopilot believes: truth, gps-ins, pixhawk, degraded, or a map of "
        "errors, with like: pixhawk only of what differs.",
    )
    faults: tuple[Fault, ...] = Field((), description="What breaks in it, and when.")


class Leader(Craft):
    """The first aircraft: what it is, where it starts, and what it flies."""

    name: Name = Field("leader", description="Name in logs and views.")
    start: Start = Field(
        Start(), description="Where it is at time 0, m and degrees; a replay has its own."
    )
    path: Path = Field(description="What it flies.")


class Follower(Craft):
    """An aircraft of the formation."""

    start_m: Offset = Field(
        description="Start [forward, right, down] of the leader's start along its course, m."
    )
