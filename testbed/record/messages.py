"""What a log says of aircraft: the one table from which writer, reader and schemas come.

A topic is made of columns: which array of a `Frame` they come from, and the names of the fields,
which carry units. Beside these a log has Foxglove's own messages: `/tf`, `/tf_static`,
`/<aircraft>/fix` and `/events`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

LOG_SCHEMA = 3  # of the log; raised when a topic or field changes its meaning or goes

DOUBLE, FIXED32, BOOL = "double", "fixed32", "bool"


@dataclass(frozen=True, slots=True)
class Column:
    """An array of a frame, agents on its leading axis, as fields of a message."""

    source: str  # path from Frame
    names: tuple[str, ...]  # one for each component, or the one name of the list
    type: str = DOUBLE
    per_aircraft: bool = False  # one field that lists a number for every aircraft
    unwritten: str | None = None  # source whose values it has where nothing was written


@dataclass(frozen=True, slots=True, eq=False)  # hashed at every chunk
class Topic:
    """A stream `/<aircraft>/<name>` of one message for each aircraft (or follower) and frame."""

    name: str
    followers_only: bool
    columns: tuple[Column, ...]

    @property
    def message(self) -> str:
        """Full name of the message type."""
        return f"testbed.{self.name.capitalize()}"

    @property
    def fields(self) -> tuple[tuple[str, Column], ...]:
        """Field names in order, numbered from 1, each with the column it belongs to."""
        return tuple((name, column) for column in self.columns for name in column.names)


def _ned(quantity: str, unit: str) -> tuple[str, ...]:
    return tuple(f"{quantity}_{axis}_{unit}" for axis in ("north", "east", "down"))


def _motion(who: str, *, unwritten: str | None = None) -> tuple[Column, ...]:
    columns = (
        Column(f"{who}.position_ned", _ned("position", "m")),
        Column(f"{who}.velocity_ned", _ned("velocity", "mps")),
        Column(f"{who}.acceleration_ned", _ned("acceleration", "mps2")),
        Column(f"{who}.euler", ("roll_rad", "pitch_rad", "yaw_rad")),
        Column(f"{who}.rates_body", ("roll_rate_radps", "pitch_rate_radps", "yaw_rate_radps")),
        Column(f"{who}.airspeed", ("airspeed_mps",)),
        Column(f"{who}.equivalent_airspeed", ("equivalent_airspeed_mps",)),
    )
    if unwritten is None:
        return columns
    return tuple(replace(c, unwritten=c.source.replace(who, unwritten)) for c in columns)


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
            "air.rates_body",
            ("air_roll_rate_radps", "air_pitch_rate_radps", "air_yaw_rate_radps"),
        ),
        Column("air.roll_coefficient", ("air_roll_coefficient",)),
        # not a number where there is no battery
        Column("air.state_of_charge", ("state_of_charge",)),
        Column("air.battery_voltage", ("battery_v",)),
        Column("surfaces.aileron", ("aileron",)),
        Column("surfaces.elevator", ("elevator",)),
        Column("surfaces.rudder", ("rudder",)),
        Column("surfaces.throttle", ("throttle",)),
        Column("lost", ("lost",), BOOL),
    ),
)
# Written only in chunks in which an estimate differs from the state of its aircraft.
ESTIMATE = Topic("estimate", followers_only=False, columns=_motion("estimate", unwritten="truth"))
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
        # whose place it takes to be its own, in the order of the run's names; the leader's is 0
        Column("formation.place", ("place",), FIXED32),
        # The age of what the follower used of each aircraft, in the order of the run's names; not
        # a number where it used nothing.
        Column("formation.age_s", ("age_s",), per_aircraft=True),
    ),
)
# The error of the formation where everyone were where it believes to be. Written only in chunks in
# which it differs from the true one.
BELIEVED = Topic(
    "believed",
    followers_only=True,
    columns=(
        Column(
            "formation.believed_ned", _ned("believed_error", "m"), unwritten="formation.error_ned"
        ),
    ),
)
# Messages since the start on the links to a follower from each aircraft, in the order of the run's
# names. Written from the chunk on in which the first was not delivered.
NETWORK = Topic(
    "network",
    followers_only=True,
    columns=(
        Column("links.sent", ("sent_count",), FIXED32, per_aircraft=True),
        # of these, those that arrive, be it later
        Column("links.delivered", ("delivered_count",), FIXED32, per_aircraft=True),
    ),
)
TOPICS = (STATE, ESTIMATE, COMMAND, FORMATION, BELIEVED, NETWORK)
