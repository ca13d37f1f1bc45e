"""What a log says: the one table of message types, from which writer, reader and schemas come.

Own messages are made of columns: which array of a `Frame` they come from, whether it counts
aircraft or followers, and the field names, which carry units. The Foxglove types are those parts
of https://docs.foxglove.dev/docs/visualization/message-schemas that are written here.
"""

from __future__ import annotations

from dataclasses import dataclass, field

LOG_SCHEMA = 1  # of the log; raised when a topic or field changes its meaning or goes

DOUBLE, INT32, INT64, STRING, ENUM, FIXED32 = (
    "double",
    "int32",
    "int64",
    "string",
    "enum",
    "fixed32",
)


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a proto3 message; `type` is a scalar's name or a message's full name."""

    number: int
    name: str
    type: str
    repeated: bool = False
    values: tuple[str, ...] = ()  # of an enum, from 0


@dataclass(frozen=True, slots=True)
class MessageType:
    """A proto3 message."""

    name: str  # in full: package.Name
    fields: tuple[Field, ...]


@dataclass(frozen=True, slots=True)
class Column:
    """An array of a frame, agents on its leading axis, as fields of a message."""

    source: str  # path from Frame
    names: tuple[str, ...]  # one for each component
    type: str = DOUBLE


@dataclass(frozen=True, slots=True)
class Topic:
    """A stream `/<aircraft>/<name>` of one message for each aircraft (or follower) and frame."""

    name: str
    followers_only: bool
    columns: tuple[Column, ...] = field(default=())

    @property
    def type(self) -> MessageType:
        """The message type: fields numbered in the order of the columns."""
        flat = [(name, column.type) for column in self.columns for name in column.names]
        return MessageType(
            f"testbed.{self.name.capitalize()}",
            tuple(Field(i, name, kind) for i, (name, kind) in enumerate(flat, start=1)),
        )


def _ned(quantity: str, unit: str) -> tuple[str, ...]:
    return tuple(f"{quantity}_{axis}_{unit}" for axis in ("north", "east", "down"))


def _motion(who: str) -> tuple[Column, ...]:
    return (
        Column(f"{who}.position_ned", _ned("position", "m")),
        Column(f"{who}.velocity_ned", _ned("velocity", "mps")),
        Column(f"{who}.acceleration_ned", _ned("acceleration", "mps2")),
        Column(f"{who}.euler", ("roll_rad", "pitch_rad", "yaw_rad")),
        Column(f"{who}.rates_body", ("roll_rate_radps", "pitch_rate_radps", "yaw_rate_radps")),
        Column(f"{who}.airspeed", ("airspeed_mps",)),
        Column(f"{who}.equivalent_airspeed", ("equivalent_airspeed_mps",)),
    )


STATE = Topic(
    "state",
    followers_only=False,
    columns=(
        *_motion("truth"),
        Column("air.alpha", ("alpha_rad",)),
        Column("air.beta", ("beta_rad",)),
        Column("air.propeller_rps", ("propeller_rps",)),
        Column("air.wind_ned", _ned("wind", "mps")),
        Column("surfaces.aileron", ("aileron",)),
        Column("surfaces.elevator", ("elevator",)),
        Column("surfaces.rudder", ("rudder",)),
        Column("surfaces.throttle", ("throttle",)),
    ),
)
# Written only where an aircraft's estimate differs from its state.
ESTIMATE = Topic("estimate", followers_only=False, columns=_motion("estimate"))
COMMAND = Topic(
    "command",
    followers_only=False,
    columns=(
        Column("command.pitch", ("pitch_rad",)),
        Column("command.roll", ("roll_rad",)),
        Column("command.throttle", ("throttle",)),
    ),
)
FORMATION = Topic(
    "formation",
    followers_only=True,
    columns=(
        Column("formation.slot_ned", _ned("slot", "m")),
        Column("formation.error_ned", _ned("error", "m")),
        Column("formation.speed", ("speed_mps",)),
        Column("formation.speed_desired", ("speed_desired_mps",)),
        Column("formation.speed_command", ("speed_command_mps",)),
        Column("formation.course", ("course_rad",)),
        Column("formation.course_desired", ("course_desired_rad",)),
        Column("formation.flight_path_angle", ("flight_path_angle_rad",)),
        Column("formation.flight_path_angle_desired", ("flight_path_angle_desired_rad",)),
        Column("formation.guards", ("guard_bits",), FIXED32),
        Column("formation.saturations", ("saturation_bits",), FIXED32),
    ),
)
TOPICS = (STATE, ESTIMATE, COMMAND, FORMATION)

# `/<follower>/link`: the age of what it used of each aircraft, in the order of the run's names;
# not a number where it used nothing.
LINK_SOURCE = "formation.age_s"
LINK = MessageType("testbed.Link", (Field(1, "age_s", DOUBLE, repeated=True),))

TIMESTAMP = MessageType(
    "google.protobuf.Timestamp", (Field(1, "seconds", INT64), Field(2, "nanos", INT32))
)
VECTOR3 = MessageType(
    "foxglove.Vector3", tuple(Field(i, axis, DOUBLE) for i, axis in enumerate("xyz", start=1))
)
QUATERNION = MessageType(
    "foxglove.Quaternion", tuple(Field(i, axis, DOUBLE) for i, axis in enumerate("xyzw", start=1))
)
FRAME_TRANSFORM = MessageType(
    "foxglove.FrameTransform",
    (
        Field(1, "timestamp", TIMESTAMP.name),
        Field(2, "parent_frame_id", STRING),
        Field(3, "child_frame_id", STRING),
        Field(4, "translation", VECTOR3.name),
        Field(5, "rotation", QUATERNION.name),
    ),
)
FRAME_TRANSFORMS = MessageType(
    "foxglove.FrameTransforms", (Field(1, "transforms", FRAME_TRANSFORM.name, repeated=True),)
)
LOCATION_FIX = MessageType(
    "foxglove.LocationFix",
    (
        Field(1, "latitude", DOUBLE),
        Field(2, "longitude", DOUBLE),
        Field(3, "altitude", DOUBLE),
        Field(4, "position_covariance", DOUBLE, repeated=True),
        Field(
            5,
            "position_covariance_type",
            ENUM,
            values=("UNKNOWN", "APPROXIMATED", "DIAGONAL_KNOWN", "KNOWN"),
        ),
        Field(6, "timestamp", TIMESTAMP.name),
        Field(7, "frame_id", STRING),
    ),
)
LEVELS = ("unknown", "debug", "info", "warning", "error", "fatal")
LOG = MessageType(
    "foxglove.Log",
    (
        Field(1, "timestamp", TIMESTAMP.name),
        Field(2, "level", ENUM, values=tuple(level.upper() for level in LEVELS)),
        Field(3, "message", STRING),
        Field(4, "name", STRING),
        Field(5, "file", STRING),
        Field(6, "line", FIXED32),
    ),
)
ALL = (
    TIMESTAMP,
    VECTOR3,
    QUATERNION,
    FRAME_TRANSFORM,
    FRAME_TRANSFORMS,
    LOCATION_FIX,
    LOG,
    LINK,
    *(topic.type for topic in TOPICS),
)
