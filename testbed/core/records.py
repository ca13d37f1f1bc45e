"""The records that all packages share.

A field is declared once, in a named tuple of arrays (`VehicleState`, `FbwaCommand`, ...), which the
public API, observers and own laws see. `record_of` makes the numpy dtype of it: MOTION, COMMAND,
AIRCRAFT, FOLLOWER, LINK and so on; a field annotated with `Logged` is also a column of the log, of
its exports and of `FlightData`. The state of a run is a few arrays of these records; kernels read
and write them in place, a log sample is a copy of them, and `fields_of` views them as named tuples.

The leading axis of every array counts aircraft: row 0 is the leader, rows 1 to n are the followers
in the order of the scenario's fleet. Units are SI and radians; vectors are resolved in the local
north-east-down frame (NED) of the scenario's origin unless a name has another one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntFlag
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Generic,
    NamedTuple,
    Protocol,
    TypeAlias,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import is_interpreted
from testbed.core.field_docs import document_fields
from testbed.core.flags import LimiterFlag, Saturation

Array = NDArray[np.float64]
ByteArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]
UIntArray = NDArray[np.uint32]
Indices = NDArray[np.intp]  # row numbers
Vectors: TypeAlias = Annotated[Array, 3]  # three numbers for each element

Records: TypeAlias = Any  # a structured array
# What kernels take and give; numba infers the types.
Record: TypeAlias = Any  # one element of a structured array, its fields as attributes
Vector: TypeAlias = Any  # three numbers: a tuple, or a field of a record
Values: TypeAlias = Any  # a tuple of numbers and vectors

_RecordT = TypeVar("_RecordT")
_NumbersT = TypeVar("_NumbersT")  # an array, or a number
AXES = "north", "east", "down"
FEW = 100  # numbers of a record that are printed


class Logged:
    """Annotate a field of a record with its names in the log, one for each of its numbers.

    Args:
        names: their last word is the unit, as in `roll_rad`, unless they are dimensionless.
        per_aircraft: the field has a value about each aircraft of the run, under one name.
        bits: what the bits of the field are; None: it is a number.
    """

    def __init__(
        self, *names: str, per_aircraft: bool = False, bits: type[IntFlag] | None = None
    ) -> None:
        self.names, self.per_aircraft, self.bits = names, per_aircraft, bits


def logged_ned(quantity: str, unit: str) -> Logged:
    """Name the components of a vector in the log: position_north_m, position_east_m, …."""
    return Logged(*(f"{quantity}_{axis}_{unit}" for axis in AXES))


def allocate(dtype: np.dtype[Any], *shape: int) -> Records:
    """Allocate records, all zero."""
    records: Records = np.zeros(shape, dtype=dtype)
    # without the compiler a plain record has no attributes
    return records.view(np.recarray) if is_interpreted() else records


def allocate_rows(dtype: np.dtype[Any], rows: int, *shape: int) -> tuple[Records, list[Records]]:
    """Allocate records (R, ...), all zero, and an array of each row that is no view of them."""
    memory = bytearray(rows * math.prod(shape) * dtype.itemsize)
    each = len(memory) // rows
    arrays = [np.ndarray((rows, *shape), dtype, memory)]
    arrays += [np.ndarray(shape, dtype, memory, row * each) for row in range(rows)]
    whole, *alone = [array.view(np.recarray) if is_interpreted() else array for array in arrays]
    return whole, alone


def fields_of(kind: type[_RecordT], records: Records, **others: Any) -> _RecordT:  # noqa: ANN401
    """View the fields of records as a named tuple of arrays.

    Args:
        kind: the named tuple, whose fields are fields of the records.
        records: (...,)
        others: fields that come from elsewhere.
    """
    names = kind._fields  # type: ignore[attr-defined]
    return kind(*(others[n] if n in others else np.asarray(records[n]) for n in names))


def write_fields(records: Records, values: Any, **others: Any) -> None:  # noqa: ANN401
    """Copy the arrays of a named tuple into the fields of the same names.

    Args:
        records: (...,)
        values: the named tuple.
        others: names of fields by names of the tuple, where they differ.
    """
    for name, array in zip(values._fields, values, strict=True):
        records[others.get(name, name)] = array


@document_fields
@dataclass(frozen=True, slots=True)
class NedOrigin:
    """Where the local NED frame touches the earth (WGS 84)."""

    latitude_deg: float = 38.0  # degrees, geodetic
    longitude_deg: float = 0.0  # degrees, east positive
    elevation_m: float = 300.0  # m, of the ground above sea level


@document_fields
@dataclass(frozen=True, slots=True)
class Airframe:
    """Properties of an airframe that determine the effect of wind, wakes and the ground."""

    span: float  # m
    area: float  # m², of the wing
    arm: float  # m, distance of the wind samples ahead of and behind the centre of gravity
    mass: float  # kg
    lift_slope: float  # 1/rad, of the lift coefficient
    stall_angle: float = math.inf  # rad, angle of attack of the largest lift; infinite: no stall
    contact_radius: float = 0.0  # m, of the part farthest from the centre of gravity


def join_names(names: Sequence[str]) -> str:
    """Join names; of many, the first few and their number."""
    return ", ".join(names if len(names) <= 6 else (*names[:5], f"… {len(names)} in all"))


def short_repr(kind: type[_RecordT]) -> type[_RecordT]:
    """Shorten the repr of a record of arrays to a few numbers, or shapes."""

    def text(record: Any) -> str:  # noqa: ANN401 - a named tuple
        few = sum(map(np.size, record)) <= FEW
        parts = [
            f"{name}={each!r}" if few else f"{name} {'×'.join(map(str, np.shape(each)))}"
            for name, each in zip(record._fields, record, strict=True)
        ]
        return f"{kind.__name__}({', '.join(parts)})"

    kind.__repr__ = text  # type: ignore[method-assign]
    return kind


_BODY_RATES = Logged("roll_rate_radps", "pitch_rate_radps", "yaw_rate_radps")
_WIND_GRADIENT = Logged(*(f"wind_gradient_{axis}_radps" for axis in ("roll", "pitch", "yaw")))


@document_fields
@short_repr
class VehicleState(NamedTuple):
    """The motion of N aircraft: the truth, or an autopilot's estimate of it."""

    # (N, 3) m, north, east, down from the origin
    position_ned: Annotated[Vectors, logged_ned("position", "m")]
    # (N, 3) m/s over the ground, north, east, down
    velocity_ned: Annotated[Vectors, logged_ned("velocity", "mps")]
    # (N, 3) m/s², derivative of velocity_ned
    acceleration_ned: Annotated[Vectors, logged_ned("acceleration", "mps2")]
    # (N, 3) roll, pitch, yaw, rad
    euler: Annotated[Vectors, Logged("roll_rad", "pitch_rad", "yaw_rad")]
    # (N, 3) p, q, r, rad/s, about body axes forward, right, down
    rates_body: Annotated[Vectors, _BODY_RATES]
    airspeed: Annotated[Array, Logged("airspeed_mps")]  # (N,) true airspeed, m/s
    # (N,) m/s, what a pitot tube measures
    equivalent_airspeed: Annotated[Array, Logged("equivalent_airspeed_mps")]


@document_fields
@short_repr
class OwnState(NamedTuple):
    """What n followers' laws know of the followers themselves: their autopilots' estimates."""

    position_ned: Vectors  # (n, 3) m, north, east, down from the origin
    velocity_ned: Vectors  # (n, 3) m/s over the ground, north, east, down
    acceleration_ned: Vectors  # (n, 3) m/s², derivative of velocity_ned
    euler: Vectors  # (n, 3) roll, pitch, yaw, rad
    rates_body: Vectors  # (n, 3) p, q, r, rad/s, about body axes forward, right, down
    airspeed: Array  # (n,) true airspeed, m/s
    equivalent_airspeed: Array  # (n,) m/s, what a pitot tube measures
    # (n, 3) m/s, velocity of the air, north, east, down: of a navigation filter the horizontal wind
    # that it estimates; where there is none, the wind at the aircraft
    wind_ned: Vectors


def followers(state: VehicleState) -> VehicleState:
    """View the rows (n) of the followers."""
    return VehicleState(*(each[1:] for each in state))


@document_fields
@short_repr
class AirData(NamedTuple):
    """True state besides the motion; logged and drawn, never an input of a controller.

    The wind is that of the tick, at the aircraft's position, and acts from then on. Flow angles,
    like the airspeeds of the motion, are of the flight model's step that ended at the tick: in the
    wind of the autopilot period before.
    """

    alpha: Annotated[Array, Logged("alpha_rad")]  # (N,) angle of attack, rad
    beta: Annotated[Array, Logged("beta_rad")]  # (N,) sideslip, rad
    # (N,) revolutions per second of the first propeller; NaN without one
    propeller_rps: Annotated[Array, Logged("propeller_rps")]
    wind_ned: Annotated[Vectors, logged_ned("wind", "mps")]  # (N, 3) m/s, velocity of the air
    # (N, 3) rad/s, rotation of the air about body axes
    wind_gradient_rates: Annotated[Vectors, _WIND_GRADIENT]
    # (N,) rolling-moment coefficient of wakes
    wake_delta_cl: Annotated[Array, Logged("wake_delta_cl")]
    # (N,) 0..1 of the battery; NaN without a battery
    state_of_charge: Annotated[Array, Logged("state_of_charge")]
    # (N,) V at its terminals; NaN without a battery
    battery_voltage: Annotated[Array, Logged("battery_v")]


def air_data(aircraft: Records) -> AirData:
    """View the air data of AIRCRAFT (...,), whose wind is the wind of the records itself."""
    wind = {name: np.asarray(aircraft["wind"][name]) for name in WIND.names or ()}
    return fields_of(AirData, aircraft["air"], **wind)


@document_fields
class WindInput(NamedTuple):
    """Wind on N airframes: its mean and gradients over each airframe."""

    wind_ned: Vectors  # (N, 3) m/s, velocity of the air, averaged over the wing
    # (N, 3) rad/s, rotation of the air about body axes: ∂w/∂y, −∂w/∂x, ∂v/∂x
    wind_gradient_rates: Vectors
    wake_delta_cl: Array  # (N,) rolling-moment coefficient of wakes, right wing down


@document_fields
@short_repr
class FbwaCommand(NamedTuple, Generic[_NumbersT]):
    """A fly-by-wire-A command: the stick inputs of ArduPlane's mode FBWA.

    Of N aircraft its fields are arrays; of one aircraft they are numbers.
    """

    pitch: Annotated[_NumbersT, Logged("pitch_rad")]  # (N,) rad, nose up positive
    roll: Annotated[_NumbersT, Logged("roll_rad")]  # (N,) rad, right wing down positive
    throttle: Annotated[_NumbersT, Logged("throttle")]  # (N,) 0..1


@document_fields
class UnicycleCommand(NamedTuple):
    """Inputs of the extended unicycle, computed by a formation law; [HBH23] eqs. (2), (3)."""

    speed: Array  # (n,) u, commanded ground speed, m/s: ṡ = p (u − s)
    omega: Vectors  # (n, 3) ω, rad/s: (0, pitch rate, yaw rate) of the zero-roll velocity frame
    speed_desired: Array  # (n,) s_d, desired ground speed, m/s
    direction: Vectors  # (n, 3) y_d, desired direction, unit vector, north, east, down
    limiter_flags: ByteArray  # (n,) bit set of LimiterFlag; 0: no limit acted


@document_fields
@short_repr
class ActuatorCommand(NamedTuple):
    """Normalised servo commands of an autopilot."""

    aileron: Annotated[Array, Logged("aileron")]  # (N,) -1..1, positive rolls right
    elevator: Annotated[Array, Logged("elevator")]  # (N,) -1..1, positive pitches up
    rudder: Annotated[Array, Logged("rudder")]  # (N,) -1..1, positive yaws right
    throttle: Annotated[Array, Logged("throttle")]  # (N,) 0..1


@document_fields
class Broadcast(NamedTuple):
    """Messages of N aircraft: their own estimates with time stamps of their own clocks."""

    stamp_s: Array  # (N,) sender's time of the measurement
    position_ned: Vectors  # (N, 3) m, north, east, down from the origin
    velocity_ned: Vectors  # (N, 3) m/s over the ground
    acceleration_ned: Vectors  # (N, 3) m/s²
    euler: Vectors  # (N, 3) roll, pitch, yaw, rad
    euler_rates: Vectors  # (N, 3) their rates, rad/s


@document_fields
class Messages(NamedTuple):
    """The newest message of each of N aircraft that each of n followers has received."""

    stamp_s: Array  # (n, N) s, sender's time of the measurement; NaN: no message yet
    received_s: Array  # (n, N) s, receiver's time of the arrival; NaN: no message yet
    position_ned: Vectors  # (n, N, 3) m, north, east, down from the origin
    velocity_ned: Vectors  # (n, N, 3) m/s over the ground, north, east, down
    acceleration_ned: Vectors  # (n, N, 3) m/s², north, east, down
    euler: Vectors  # (n, N, 3) roll, pitch, yaw, rad
    euler_rates: Vectors  # (n, N, 3) derivatives of roll, pitch, yaw, rad/s


@document_fields
class Inbox(NamedTuple):
    """What n followers' laws know of N aircraft: the newest messages, and what they say."""

    stamp_s: Array  # (n, N) s, sender's time of the measurement; NaN: no message yet
    received_s: Array  # (n, N) s, receiver's time of the arrival; NaN: no message yet
    position_ned: Vectors  # (n, N, 3) m, north, east, down from the origin
    velocity_ned: Vectors  # (n, N, 3) m/s over the ground, north, east, down
    acceleration_ned: Vectors  # (n, N, 3) m/s², north, east, down
    euler: Vectors  # (n, N, 3) roll, pitch, yaw, rad
    euler_rates: Vectors  # (n, N, 3) derivatives of roll, pitch, yaw, rad/s
    turn_rate: Array  # (n, N) rad/s, rate of the course, from velocity and acceleration
    failed: BoolArray  # (n, N) the sender declares that it has failed
    # (n, N, K) what the sender's law has sent, see `law.Outputs`; NaN: nothing yet, as always of
    # the leader
    payload: Vectors


@document_fields
@short_repr
class FormationState(NamedTuple):
    """Outputs of the controllers of n followers, and their formation errors.

    Slots and errors are computed from the truth, and are not fed back.
    """

    # (n, 3) m, the desired position q_g + χ_i
    slot_ned: Annotated[Vectors, logged_ned("slot", "m")]
    error_ned: Annotated[Vectors, logged_ned("error", "m")]  # (n, 3) m, position − slot
    speed: Annotated[Array, Logged("speed_mps")]  # (n,) ground speed, m/s
    speed_desired: Annotated[Array, Logged("speed_desired_mps")]  # (n,) s_d, m/s
    # (n,) commanded airspeed, u + s_a − s after its limiter, m/s
    airspeed_command: Annotated[Array, Logged("airspeed_command_mps")]
    course: Annotated[Array, Logged("course_rad")]  # (n,) rad
    course_desired: Annotated[Array, Logged("course_desired_rad")]  # (n,) rad
    flight_path_angle: Annotated[Array, Logged("flight_path_angle_rad")]  # (n,) rad
    flight_path_angle_desired: Annotated[Array, Logged("flight_path_angle_desired_rad")]  # (n,) rad
    # (n,) bit set of LimiterFlag
    limiter_flags: Annotated[ByteArray, Logged("limiter_bits", bits=LimiterFlag)]
    # (n,) bit set of Saturation
    saturations: Annotated[ByteArray, Logged("saturation_bits", bits=Saturation)]
    # (n,) slot of the follower, a row of the N
    slot_index: Annotated[UIntArray, Logged("slot_index")]
    # (n, n + 1) age of the message of aircraft j that follower i used, s; NaN: none
    age_s: Annotated[Array, Logged("age_s", per_aircraft=True)]
    # (n, 3) m, formation error computed from the estimates; equals error_ned where they are exact
    estimated_error_ned: Annotated[Vectors, logged_ned("estimated_error", "m")]


@document_fields
class FaultState(NamedTuple):
    """Active faults of N aircraft; surfaces in the order of `control_surfaces.SURFACES`."""

    power: Array  # (N,) 0..1, share of the throttle that reaches the motor
    stuck: Annotated[BoolArray, 5]  # (N, 5) stuck surfaces
    stuck_at: Annotated[Array, 5]  # (N, 5) -1..1, their positions; NaN: where they were
    floating: Annotated[BoolArray, 5]  # (N, 5) floating surfaces
    floats: Annotated[Array, 5]  # (N, 5) their deflection per angle of the flow, rad/rad
    frozen: BoolArray  # (N,) the autopilot is frozen: servos hold the last command
    charge: Array  # (N,) 0..1 to which the battery drops now; NaN: no drop
    pitot_blocked: BoolArray  # (N,)
    pitot_drained: BoolArray  # (N,) the drain of a blocked pitot tube is open
    gps_lost: BoolArray  # (N,)
    gps_jump: Vectors  # (N, 3) m NED, error of every fix
    transmitter_off: BoolArray  # (N,)


def fault_state(faults: Records) -> FaultState:
    """View records of FAULTS.

    Flags are bytes in them, because kernels read no array of bool.
    """
    flags = {name: np.asarray(faults[name]).view(np.bool_) for name in ("stuck", "floating")}
    return fields_of(FaultState, faults, **flags)


@document_fields
@short_repr
class LinkCounters(NamedTuple):
    """Messages on the links from N aircraft to their n followers since the start."""

    sent: Annotated[UIntArray, Logged("sent_count", per_aircraft=True)]  # (n, N)
    # (n, N) of these, those that arrived or will arrive
    delivered: Annotated[UIntArray, Logged("delivered_count", per_aircraft=True)]


def record_of(kind: type, *more: tuple[Any, ...], without: Sequence[str] = ()) -> np.dtype[Any]:
    """Return the dtype of one element of the arrays of a named tuple, or of one tuple of numbers.

    Args:
        kind: the named tuple; an array with several numbers for each element, or a tuple of
            numbers, is annotated with their number.
        more: further fields, as of a dtype.
        without: fields that the records do not have.
    """
    fields: list[tuple[Any, ...]] = []
    for name, (one, marks) in _declarations(kind).items():
        if name not in without:
            inner = [mark for mark in marks if isinstance(mark, int)]
            # kernels read no array of bool
            fields.append((name, "u1" if one == "?" and inner else one, *inner))
    return np.dtype([*fields, *more], align=True)


def logged_fields(kind: type) -> dict[str, tuple[str, Logged]]:
    """Return the logged fields of a named tuple, each with the dtype of its numbers."""
    return {
        name: (one, mark)
        for name, (one, marks) in _declarations(kind).items()
        for mark in marks
        if isinstance(mark, Logged)
    }


def _declarations(kind: type) -> dict[str, tuple[str, tuple[Any, ...]]]:
    """Return the dtype of the numbers, and the annotations, of each field of a named tuple."""
    found = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        array, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        found[name] = _ONE.get(array, "f8"), tuple(marks)
    return found


# Of arrays and numbers that are not float64.
_ONE = {BoolArray: "?", ByteArray: "u1", UIntArray: "u4", bool: "?", int: "i8"}

MOTION = record_of(VehicleState)  # the truth, or an autopilot's estimate of it
WIND = record_of(WindInput)
AIR = record_of(AirData, without=WindInput._fields)  # the wind is in a record of its own
COMMAND = record_of(FbwaCommand)
ACTUATORS = record_of(ActuatorCommand)
FAULTS = record_of(FaultState)
MESSAGE = record_of(Broadcast)
# One aircraft at one moment, as kernels, observers and logs see it.
AIRCRAFT = np.dtype(
    [
        ("truth", MOTION),
        ("estimate", MOTION),
        ("wind", WIND),
        ("air", AIR),
        ("command", COMMAND),  # given to the autopilot
        ("control", COMMAND),  # computed by the formation law or the leader's guidance
        ("guided", "?"),  # `command` is an attitude target in GUIDED, not a stick input in FBWA
        ("surfaces", ACTUATORS),
        ("faults", FAULTS),
        ("stopped", "?"),  # its model has failed, or is stepped no more
        ("down", "?"),  # on the ground, or its model has stopped
        ("lost", "?"),  # it has been down or has collided: it flies no more
    ],
    align=True,
)
# One follower: its formation, and the inputs of the extended unicycle.
FOLLOWER = record_of(
    FormationState,
    ("speed_command", "f8"),  # u, commanded ground speed, m/s
    ("omega", "f8", 3),  # ω, rad/s, in the zero-roll velocity frame
    ("direction", "f8", 3),  # y_d, unit vector
    without=("age_s",),
)
# What a follower has received of one aircraft, what it used of that, and counters.
LINK = record_of(
    Messages,
    ("number", "i8"),  # of the newest message; -1: none
    ("measured_s", "f8"),  # s, true time of its content; nan: none
    ("age_s", "f8"),  # s, age of what the last control step used; nan: not used
    *((name, "u4") for name in LinkCounters._fields),
)


@document_fields
@dataclass(frozen=True, slots=True)
class Event:
    """An event of the log, the view and the table."""

    time_s: float  # s since the start
    level: str  # "info", "warning" or "error"
    source: str  # name of an aircraft, or "run"
    text: str  # a sentence without its time and source


@document_fields
class Sample(NamedTuple):
    """All data of one logged tick."""

    tick: int  # of the base rate
    time_s: float  # s since the start
    truth: VehicleState  # (N)
    estimate: VehicleState  # (N)
    air: AirData  # (N)
    command: FbwaCommand[Array]  # (N)
    surfaces: ActuatorCommand  # (N)
    formation: FormationState  # (n)
    links: LinkCounters  # (n, N)
    # (N,) lost now or before: on the ground, stopped or collided
    lost: Annotated[BoolArray, Logged("lost")]
    events: tuple[Event, ...] = ()  # since the sample before
    faults: FaultState | None = None  # (N) active faults; None: the scenario has none
    # (n, L) numbers of a user's law, (n,) where there is one; None: none
    law: Array | None = None
    # AIRCRAFT (N,), FOLLOWER (n,) and LINK (n, N) that the fields above are views of; None: the
    # fields are separate arrays
    records: tuple[Records, Records, Records] | None = None

    def __repr__(self) -> str:
        """Name the time and the number of aircraft."""
        lost = int(np.count_nonzero(self.lost))
        return f"<Sample: {self.time_s:g} s; {len(self.lost)} aircraft, {lost} lost>"


@document_fields
@dataclass(frozen=True, slots=True)
class RunInfo:
    """Description of a run, for observers before the first sample."""

    scenario_name: str  # scenario.name
    # returns the text of the resolved scenario; making it would take a tenth of a short flight
    make_yaml: Callable[[], str] = field(compare=False)
    names: tuple[str, ...]  # N aircraft, the leader first
    aircraft: tuple[str, ...]  # N airframe names, "rascal110"
    wingspan_m: tuple[float, ...]  # N
    origin: NedOrigin  # of the NED frame
    base_rate_hz: int  # Hz, of the ticks
    sample_rate_hz: int  # Hz, of the samples
    duration_s: float  # s, planned
    seed: int  # of all random streams
    speed_bounds_mps: tuple[tuple[float, float], ...]  # n
    kappa_mps: tuple[float, ...]  # n, margin of the slots' speeds to those bounds
    roll_limit_rad: tuple[float, ...]  # n, of the FBWA command
    leader_path_ned: Array  # (k, 3) the leader's path as commanded, for drawing; may be empty
    windows: Mapping[str, tuple[float, float]]  # name -> window, s
    versions: Mapping[str, str]  # testbed, jsbsim, numpy, python, schema
    directory: Path | None = None  # the run directory, if there is one
    # m/s, velocity of the medium that the speed bounds refer to: zero for the ground.
    bounded_in_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # n speed barriers h: number of the example in [HBH23], and ν; 0 and 0 for an own function;
    # empty for an own law
    barriers: tuple[tuple[int, float], ...] = ()
    # of n barriers the samples of an own function, by `formation.barrier.sample_barrier`; empty
    # rows for the paper's, and empty without an own function
    barrier_samples: tuple[tuple[float, ...], ...] = ()
    estimated: bool = False  # whether any estimate differs from the truth
    start_unix_ns: int = 0  # ns since 1970 (UTC) at time 0, as the log's times begin
    # JSBSim's methods of integration by state, see `vehicle.environment.Integrators`; empty without
    # flight models
    integrators: Mapping[str, str] = field(default_factory=dict)
    engine: str = ""  # what steps the flight models: "compiled" or "jsbsim"; "" without them
    law_numbers: tuple[str, ...] = ()  # L names of the numbers that a user's law logs
    # files of code that the scenario uses, by name
    code: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def scenario_yaml(self) -> str:
        """Text of the resolved scenario."""
        return self.make_yaml()

    def __repr__(self) -> str:
        """Name scenario, aircraft, seed and duration."""
        return (
            f"<RunInfo of {self.scenario_name}: {join_names(self.names)}; seed {self.seed},"
            f" {self.duration_s:g} s planned, samples at {self.sample_rate_hz} Hz>"
        )


class Observer(Protocol):
    """Observe the samples of a run.

    Each sample is a copy, which the observer may keep. With a class attribute `zero_copy = True`
    the arrays are the loop's own: they change at the next tick and must be copied where needed.
    """

    def begin(self, info: RunInfo) -> None:
        """Prepare; called once before the first sample."""

    def observe(self, sample: Sample) -> None:
        """Take one sample; called at the log rate in order of time."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Finish with the metrics and the events after the last sample; called once."""


def mark_unknown(
    aircraft: Records, followers: Records, links: Records, parts: Sequence[str]
) -> None:
    """Set what a recording does not have to NaN.

    Args:
        aircraft: (N,) of AIRCRAFT; written.
        followers: (n,) of FOLLOWER; written, with the slots in order.
        links: (n, N) of LINK; written.
        parts: of an aircraft, all of whose numbers are unknown.
    """
    for name in parts:
        part = aircraft[name]
        for each in part.dtype.names or ():
            part[each] = math.nan
    aircraft["wind"]["wake_delta_cl"] = 0.0
    for name, (dtype, *_) in (FOLLOWER.fields or {}).items():
        if dtype.base == np.float64:
            followers[name] = math.nan
    followers["slot_index"] = np.arange(1, len(followers) + 1)
    links["age_s"] = math.nan
