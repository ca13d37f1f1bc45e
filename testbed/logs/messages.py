"""Topics and fields of a log, from which writer, reader and schemas are made.

A topic consists of columns. A column names the array of a `Sample` it comes from and the message
fields its components become; field names end in their unit. A log also has Foxglove's own
messages: `/tf`, `/tf_static`, `/<aircraft>/fix` and `/events`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from testbed.core.identifiers import identifiers

LOG_SCHEMA = 6  # raised when a topic or field is renamed, removed, required or of another meaning

DOUBLE, FIXED32, BOOL = "double", "fixed32", "bool"  # protobuf types


@dataclass(frozen=True, slots=True)
class Column:
    """One array of a sample, aircraft or followers on its leading axis, as message fields."""

    source: str  # path from Sample: "truth.position_ned"
    names: tuple[str, ...]  # one field for each component
    type: str = DOUBLE
    per_aircraft: bool = False  # one field, a message with a value by the name of each aircraft
    default_source: str | None = None  # the column whose values hold where nothing was written


@dataclass(frozen=True, slots=True, eq=False)  # hashed by identity, at every chunk
class Topic:
    """Messages `/<aircraft>/<name>`: one for each aircraft, or follower, and sample."""

    name: str
    followers_only: bool
    columns: tuple[Column, ...]

    @property
    def message_type(self) -> str:
        """Full protobuf name: testbed.EstimatedError."""
        return "testbed." + self.name.title().replace("_", "")

    @property
    def fields(self) -> tuple[tuple[str, Column], ...]:
        """Field names with their columns, in the order of the field numbers from 1 on."""
        return tuple((name, column) for column in self.columns for name in column.names)


def aircraft_fields(names: Sequence[str]) -> dict[str, int]:
    """Number the fields of a message with a value for each aircraft.

    The numbers are those whose tags have the same length: 2 bytes up to 2032 aircraft.
    """
    first = 16 if len(names) <= 2032 else 2048
    return {name: first + k for k, name in enumerate(identifiers(names))}


def _ned(quantity: str, unit: str) -> tuple[str, ...]:
    return tuple(f"{quantity}_{axis}_{unit}" for axis in ("north", "east", "down"))


def _motion(record: str, *, default: str | None = None) -> tuple[Column, ...]:
    """The columns of a `VehicleState`; unwritten values are those of the record `default`."""
    columns = (
        Column(f"{record}.position_ned", _ned("position", "m")),
        Column(f"{record}.velocity_ned", _ned("velocity", "mps")),
        Column(f"{record}.acceleration_ned", _ned("acceleration", "mps2")),
        Column(f"{record}.euler", ("roll_rad", "pitch_rad", "yaw_rad")),
        Column(f"{record}.rates_body", ("roll_rate_radps", "pitch_rate_radps", "yaw_rate_radps")),
        Column(f"{record}.airspeed", ("airspeed_mps",)),
        Column(f"{record}.equivalent_airspeed", ("equivalent_airspeed_mps",)),
    )
    if default is None:
        return columns
    return tuple(replace(c, default_source=c.source.replace(record, default)) for c in columns)


STATE = Topic(
    "state",
    followers_only=False,
    columns=(
        *_motion("truth"),
        Column("air.alpha", ("alpha_rad",)),
        Column("air.beta", ("beta_rad",)),
        Column("air.propeller_rps", ("propeller_rps",)),
        Column("air.wind_ned", _ned("wind", "mps")),
        Column(
            "air.wind_gradient_rates",
            ("wind_gradient_roll_radps", "wind_gradient_pitch_radps", "wind_gradient_yaw_radps"),
        ),
        Column("air.wake_delta_cl", ("wake_delta_cl",)),
        # NaN without a battery
        Column("air.state_of_charge", ("state_of_charge",)),
        Column("air.battery_voltage", ("battery_v",)),
        Column("surfaces.aileron", ("aileron",)),
        Column("surfaces.elevator", ("elevator",)),
        Column("surfaces.rudder", ("rudder",)),
        Column("surfaces.throttle", ("throttle",)),
        Column("lost", ("lost",), BOOL),
    ),
)
# Written only in chunks in which an estimate differs from the true state.
ESTIMATE = Topic("estimate", followers_only=False, columns=_motion("estimate", default="truth"))
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
        Column("formation.airspeed_command", ("airspeed_command_mps",)),
        Column("formation.course", ("course_rad",)),
        Column("formation.course_desired", ("course_desired_rad",)),
        Column("formation.flight_path_angle", ("flight_path_angle_rad",)),
        Column("formation.flight_path_angle_desired", ("flight_path_angle_desired_rad",)),
        Column("formation.limiter_flags", ("limiter_bits",), FIXED32),
        Column("formation.saturations", ("saturation_bits",), FIXED32),
        # the slot that it flies in, as a row of the run's names; 0 is the leader's
        Column("formation.slot_index", ("slot_index",), FIXED32),
        # age of the data used of each aircraft; NaN: unused
        Column("formation.age_s", ("age_s",), per_aircraft=True),
    ),
)
# The formation error computed from the estimates. Written only in chunks in which it differs from
# the true error.
ESTIMATED_ERROR = Topic(
    "estimated_error",
    followers_only=True,
    columns=(
        Column(
            "formation.estimated_error_ned",
            _ned("estimated_error", "m"),
            default_source="formation.error_ned",
        ),
    ),
)
# Message counts since the start on the links to a follower, by sender. Written from the chunk with
# the first lost message on.
NETWORK = Topic(
    "network",
    followers_only=True,
    columns=(
        Column("links.sent", ("sent_count",), FIXED32, per_aircraft=True),
        # of those sent, the ones that arrive, however late
        Column("links.delivered", ("delivered_count",), FIXED32, per_aircraft=True),
    ),
)
TOPICS = (STATE, ESTIMATE, COMMAND, FORMATION, ESTIMATED_ERROR, NETWORK)
