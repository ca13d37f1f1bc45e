"""The `leader` and `fleet` sections: aircraft, their autopilots, commands, sensors and paths."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from testbed.core.ranges import VELOCITY
from testbed.scenario.faults import AnyFault
from testbed.scenario.fields import (
    SMALLEST,
    Degrees,
    Duration,
    Flag,
    Length,
    Metres,
    MetresPerSecond,
    Name,
    Number,
    Offset,
    Seconds,
    Section,
    Speed,
    Whole,
    within,
)
from testbed.scenario.reference_fields import AircraftReference, DataReference, TuneReference
from testbed.scenario.sensors import TRUTH, Sensors

Timeout = Annotated[Seconds, Field(ge=SMALLEST, le=3600)]


class ByFormation(Section):
    """Commands of the formation controller, or of a leader those of its path."""

    kind: Literal["formation"] = Field("formation", description="The controller of this scenario.")

    @model_serializer
    def _kind(self) -> str:
        return self.kind


class External(Section):
    """Commands of an external program over MAVLink."""

    kind: Literal["external"] = Field(
        "external", description="An external program, over --mavlink."
    )
    failsafe_s: Timeout = Field(
        1.5, description="It loiters at its position after this time without a command, s."
    )
    lockstep: Flag = Field(
        False,
        description="true: the run waits for its command at every control period; false: it goes "
        "on with the last one.",
    )
    timeout_s: Timeout = Field(
        30.0,
        description="In lockstep the run fails after this time without a command, s of wall-clock "
        "time.",
    )


class VirtualAutopilot(Section):
    """The testbed's implementation of ArduPlane's fly-by-wire A."""

    kind: Literal["virtual"] = Field("virtual", description="The testbed's fly-by-wire A.")
    gyro_filter: Literal["aircraft", "sitl"] = Field(
        "aircraft",
        description="aircraft: INS_GYRO_FILTER as on a flight controller; sitl: as in SITL at "
        "rates.physics_hz, for comparisons with it: INS_GYRO_FILTER times physics_hz / 1000.",
    )

    @model_serializer
    def _kind(self) -> str | dict[str, str]:
        if self.gyro_filter == "aircraft":
            return self.kind
        return {"kind": self.kind, "gyro_filter": self.gyro_filter}


class ArduPlane(Section):
    """ArduPlane as a separate process, with the testbed's flight model as its physics."""

    kind: Literal["ardupilot"] = Field("ardupilot", description="An ArduPlane process.")
    start: Flag = Field(
        True,
        description="true: the run starts the program of --arduplane or of the environment "
        "variable ARDUPLANE; false: it waits for one that is started elsewhere.",
    )
    instance: Annotated[Whole, Field(ge=0, le=250)] | None = Field(
        None,
        description="Its option -I, a number: ports are 9002, 5501 and 5760 plus ten times this; "
        "by default one with free ports, or with start: false the index of the aircraft, the "
        "leader's is 0.",
    )
    timeout_s: Timeout = Field(
        60.0, description="The run fails after this time without an answer, s of wall-clock time."
    )

    @model_validator(mode="before")
    @classmethod
    def _refuse_program(cls, data: Any) -> Any:  # noqa: ANN401 - unchecked
        if isinstance(data, Mapping) and "binary" in data:
            raise PydanticCustomError(
                "program",
                "has the key binary, but no scenario names a program (leave it out, and write "
                "--arduplane PATH, or set the environment variable ARDUPLANE)",
            )
        return data

    def fixed_instance(self, row: int) -> int | None:
        """Return the instance of the aircraft of this row; None: any with free ports."""
        if self.instance is None and not self.start:  # the user needs to know which one to start
            return row
        return self.instance


@dataclass(frozen=True)
class _OrKind:
    """Accept a word for the map of that kind with defaults."""

    words: tuple[str, ...]

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(
            lambda value: {"kind": value} if isinstance(value, str) else value, handler(source)
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [{"enum": list(self.words)}, handler(schema)]}


CommandedBy = Annotated[
    Annotated[ByFormation | External, Field(discriminator="kind")],
    _OrKind(("formation", "external")),
]
Autopilot = Annotated[
    Annotated[VirtualAutopilot | ArduPlane, Field(discriminator="kind")],
    _OrKind(("virtual", "ardupilot")),
]


Point = tuple[Metres, Metres, Metres]
MAX_LEGS = 10_000  # of a mission with all its laps


class Waypoints(Section):
    """Straight legs between points; each turn begins early enough to end on the next leg."""

    kind: Literal["waypoints"] = Field(description="Straight legs between points.")
    points_m: tuple[Point, ...] = Field(
        min_length=1, description="Waypoints [north, east, altitude], m from the origin."
    )
    laps: Whole = Field(1, ge=1, le=MAX_LEGS, description="Number of times the points are flown.")


class Level(Section):
    """Full circles of a loiter at one altitude."""

    altitude_m: Metres = Field(description="Altitude above the origin, m.")
    turns: Number = Field(
        ge=SMALLEST, le=MAX_LEGS, description="Number of full circles at this altitude."
    )


class Loiter(Section):
    """Circle flown at one altitude after the other."""

    kind: Literal["loiter"] = Field(description="A circle.")
    centre_m: tuple[Metres, Metres] = Field(
        description="Centre of the circle [north, east], m from the origin."
    )
    radius_m: Length = Field(ge=0.1, description="Radius, m.")
    direction: Literal["clockwise", "anticlockwise"] = Field(
        "clockwise", description="Direction of the turn, seen from above."
    )
    levels: tuple[Level, ...] = Field(
        min_length=1, description="Altitudes in order; the last is held."
    )


Leg = Annotated[Waypoints | Loiter, Field(discriminator="kind")]


class Mission(Section):
    """Mission flown by a simulated aircraft under guidance."""

    kind: Literal["mission"] = Field(description="Legs flown by the guidance of the leader.")
    airspeed_mps: Speed = Field(ge=0.1, description="Airspeed to hold, m/s.")
    bank_limit_deg: Degrees = Field(
        30.0, ge=SMALLEST, lt=80, description="Largest bank angle command of the guidance, degrees."
    )
    climb_limit_mps: Speed = Field(
        1.5,
        ge=SMALLEST,
        description="Climb rate between the levels of a loiter, m/s; on a leg it follows from the "
        "points.",
    )
    waypoint_radius_m: Length = Field(
        90.0,
        ge=SMALLEST,
        description="Largest distance from a waypoint at which its turn begins, m.",
    )
    legs: tuple[Leg, ...] = Field(
        min_length=1, description="Legs in order; the last is flown until the end of the run."
    )


class Replay(Section):
    """Recorded flight: the leader moves along a recorded trajectory."""

    kind: Literal["replay"] = Field(description="A recorded flight.")
    file: DataReference = Field(
        description="CSV file of the flight: a path from this file, or a name in scenarios/data.",
    )


class Straight(Section):
    """Straight line at constant speed."""

    kind: Literal["straight"] = Field(description="Straight line.")
    climb_mps: Annotated[MetresPerSecond, within(VELOCITY)] = Field(
        0.0, description="Vertical speed, m/s."
    )


class Circle(Section):
    """Circle, or with a climb a helix."""

    kind: Literal["circle"] = Field(description="Circle, or with a climb a helix.")
    radius_m: Length | None = Field(
        None, ge=0.1, description="Radius, m; either this or bank_deg is needed."
    )
    bank_deg: Degrees | None = Field(
        None,
        ge=0.1,
        le=60,
        description="Bank of a coordinated turn on the circle, degrees, in place of radius_m.",
    )
    direction: Literal["clockwise", "anticlockwise"] = Field(
        "clockwise", description="Direction of the turn, seen from above."
    )
    climb_mps: Annotated[MetresPerSecond, within(VELOCITY)] = Field(
        0.0, description="Vertical speed, m/s."
    )

    @model_serializer(mode="wrap")
    def _given_size(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in handler(self).items() if value is not None}


class FigureEight(Section):
    """Level figure-eight, from its crossing."""

    kind: Literal["figure-eight"] = Field(description="Level figure-eight.")
    radius_m: Length = Field(ge=0.1, description="Radius of its tightest turn, m.")
    direction: Literal["clockwise", "anticlockwise"] = Field(
        "clockwise", description="Direction of the first loop, seen from above."
    )


class Weave(Section):
    """Straight line with a sinusoidal lateral offset."""

    kind: Literal["weave"] = Field(description="Straight line with a sinusoidal lateral offset.")
    amplitude_m: Length = Field(ge=0.001, description="Amplitude of the offset, half its width, m.")
    period_s: Duration = Field(ge=0.1, description="Period, s.")


class SpeedChange(Section):
    """Straight line at a sinusoidal speed."""

    kind: Literal["speed-change"] = Field(description="Straight line at a sinusoidal speed.")
    amplitude_mps: Speed = Field(ge=0.001, description="Amplitude of the speed, m/s.")
    period_s: Duration = Field(ge=0.1, description="Period, s.")


Curve = Annotated[
    Straight | Circle | FigureEight | Weave | SpeedChange, Field(discriminator="kind")
]


class Virtual(Section):
    """Virtual leader: exact position, velocity and acceleration of a curve."""

    kind: Literal["virtual"] = Field(description="Virtual leader on a curve.")
    speed_mps: Speed = Field(
        ge=0.1, description="Ground speed along the curve, of a weave along its axis, m/s."
    )
    curve: Curve = Field(description="Curve from the start of the leader, along its course.")


Vehicle = Literal["jsbsim", "unicycle"]
Path = Annotated[Mission | Replay | Virtual, Field(discriminator="kind")]


class Start(Section):
    """Position and course of the leader at time 0."""

    north_m: Metres = Field(0.0, description="North of the origin, m.")
    east_m: Metres = Field(0.0, description="East of the origin, m.")
    altitude_m: Metres = Field(100.0, description="Altitude above the origin, m.")
    course_deg: Degrees = Field(
        0.0, ge=-360, le=360, description="Course over the ground, degrees clockwise from north."
    )


class Battery(Section):
    """Battery of an electric aircraft; a low battery gives less thrust."""

    state_of_charge: Number = Field(
        1.0, ge=SMALLEST, le=1, description="Charge at the start, 0 to 1 of a full battery."
    )
    cells: Whole | None = Field(
        None,
        ge=1,
        le=24,
        description="Cells in series, a number; by default those of the airframe. Each adds "
        "voltage, and so thrust.",
    )


class AircraftSection(Section):
    """Keys of every aircraft."""

    name: Name = Field(description="Name in logs, views, offsets and gains.")
    aircraft: AircraftReference = Field(
        description="Airframe: a name in aircraft/, or the path of a folder."
    )
    vehicle: Vehicle = Field(
        "jsbsim",
        description="Model of its motion: jsbsim, a flight model with an autopilot; or unicycle, "
        "the extended unicycle (1) to (4) of [HBH23].",
    )
    autopilot: Autopilot = Field(
        VirtualAutopilot(),
        description="Autopilot: virtual, or ardupilot, or a map with that kind.",
    )
    commanded_by: CommandedBy = Field(
        ByFormation(),
        description="Source of its commands: formation, the controller of this scenario (of a "
        "leader its path); or external, a program that sends MAVLink, or a map with that kind.",
    )
    tune: TuneReference = Field(
        "autopilot",
        description="Autopilot parameters: <tune>.param of the airframe, or the path of a file.",
    )
    battery: Battery = Field(Battery(), description="Battery, if the airframe has one.")
    fuel_burn: Flag = Field(
        False,
        description="true: its engines burn fuel, and its mass falls; false: its mass is that of "
        "its trim throughout.",
    )
    sensors: Sensors = Field(
        TRUTH,
        description="Errors of its state estimate: truth, gps-ins, pixhawk, degraded, or a map; a "
        "map with preset: pixhawk changes that preset.",
    )
    faults: tuple[AnyFault, ...] = Field(
        (), description="Faults of this aircraft, and when they begin."
    )


class Leader(AircraftSection):
    """The aircraft that the formation follows."""

    name: Name = Field("leader", description="Name in logs and views.")
    start: Start = Field(
        Start(), description="Position and course at time 0, m and degrees; a replay has its own."
    )
    path: Path = Field(description="Path of the leader.")


class Follower(AircraftSection):
    """An aircraft of the formation."""

    start_m: Offset = Field(
        description="Start relative to the leader's start [forward, right, down], along its "
        "course, m."
    )
