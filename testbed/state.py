"""The vocabulary every room shares: immutable records of arrays over aircraft.

The leading axis of every array counts aircraft. Row 0 is the leader, rows 1..n are the followers
in the order of the scenario's fleet. Arrays are contiguous, in SI units and radians; vectors are
resolved in the local north-east-down frame (NED) of the scenario's origin unless a name says
otherwise. An observer must not write into an array it is given. Records that are made at
every tick are named tuples, which are cheap and which numba knows. The loop makes them once and
writes the next tick into them: who keeps one copies it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.uint8]
Truths = NDArray[np.bool_]
Counts = NDArray[np.uint32]

_RecordT = TypeVar("_RecordT")
FEW = 100  # numbers of a record that are printed


@dataclass(frozen=True, slots=True)
class Origin:
    """Where the local NED frame touches the earth (WGS 84)."""

    latitude_deg: float = 38.0
    longitude_deg: float = 0.0
    elevation_m: float = 300.0


@dataclass(frozen=True, slots=True)
class Airframe:
    """What the air has to know of an aircraft."""

    span: float  # m
    area: float  # m², of the wing
    arm: float  # m, how far ahead of and behind the centre of gravity the air is felt
    mass: float  # kg
    lift_slope: float  # 1/rad, of the lift coefficient
    stall_angle: float = math.inf  # rad, of attack, where lift is largest; infinite: it only grows


def listed(names: Sequence[str]) -> str:
    """Names, or of many the first few and how many there are."""
    return ", ".join(names if len(names) <= 6 else (*names[:5], f"… {len(names)} in all"))


def briefly(kind: type[_RecordT]) -> type[_RecordT]:
    """Print a record of arrays, in a notebook, as its numbers if they are few, else its shapes."""

    def text(record: Any) -> str:  # noqa: ANN401 - a named tuple
        few = sum(each.size for each in record) <= FEW
        parts = [
            f"{name}={each!r}" if few else f"{name} {'×'.join(map(str, each.shape))}"
            for name, each in zip(record._fields, record, strict=True)
        ]
        return f"{kind.__name__}({', '.join(parts)})"

    kind.__repr__ = text  # type: ignore[method-assign]
    return kind


@briefly
class VehicleState(NamedTuple):
    """The motion of N aircraft: the truth, or an autopilot's estimate of it."""

    position_ned: Array  # (N, 3) m from the origin
    velocity_ned: Array  # (N, 3) m/s over the ground
    acceleration_ned: Array  # (N, 3) m/s², derivative of velocity_ned
    euler: Array  # (N, 3) roll, pitch, yaw, rad
    rates_body: Array  # (N, 3) p, q, r, rad/s
    airspeed: Array  # (N,) true airspeed, m/s
    equivalent_airspeed: Array  # (N,) m/s, what a pitot tube measures


def followers(state: VehicleState) -> VehicleState:
    """The rows behind the leader's, (n) as views."""
    return VehicleState(*(each[1:] for each in state))


@briefly
class AirData(NamedTuple):
    """What the truth knows beside the motion; logged and drawn, never given to a controller."""

    alpha: Array  # (N,) angle of attack, rad
    beta: Array  # (N,) sideslip, rad
    propeller_rps: Array  # (N,) revolutions per second
    wind_ned: Array  # (N, 3) m/s, velocity of the air
    rates_body: Array  # (N, 3) rad/s, its turn about body axes
    roll_coefficient: Array  # (N,) what a wake adds to that of the rolling moment
    state_of_charge: Array  # (N,) 0..1 of the battery; not a number where there is none
    battery_voltage: Array  # (N,) V at its terminals; not a number where there is none


class AirFelt(NamedTuple):
    """What the air does to N airframes: its motion, averaged and differenced over each of them."""

    wind_ned: Array  # (N, 3) m/s, velocity of the air, averaged over the wing
    rates_body: Array  # (N, 3) rad/s, turn of the air about body axes: ∂w/∂y, −∂w/∂x, ∂v/∂x
    roll_coefficient: Array  # (N,) rolling-moment coefficient of what is no turn, right wing down


@briefly
class FbwaCommand(NamedTuple):
    """A fly-by-wire-A command: what a pilot's sticks say to ArduPlane in that mode."""

    pitch: Array  # (N,) rad, nose up positive
    roll: Array  # (N,) rad, right wing down positive
    throttle: Array  # (N,) 0..1


class UnicycleCommand(NamedTuple):
    """What a formation law decides: the inputs of the extended unicycle, [HBH23] eqs. (2), (3)."""

    speed: Array  # (n,) u, commanded ground speed, m/s: ṡ = p (u − s)
    turn: Array  # (n, 3) ω, rad/s, in the zero-roll velocity frame; the first component is zero
    speed_desired: Array  # (n,) s_d, m/s
    direction: Array  # (n, 3) y_d, unit vector
    guards: Flags  # (n,) bit set of formation.flags.Guard


@briefly
class Surfaces(NamedTuple):
    """What an autopilot sends to its servos, normalised."""

    aileron: Array  # (N,) -1..1, positive rolls right
    elevator: Array  # (N,) -1..1, positive pitches up
    rudder: Array  # (N,) -1..1, positive yaws right
    throttle: Array  # (N,) 0..1


class Broadcast(NamedTuple):
    """What N aircraft tell each other: their own estimates, stamped by their own clocks."""

    stamp_s: Array  # (N,) sender's time of the measurement
    position_ned: Array  # (N, 3)
    velocity_ned: Array  # (N, 3)
    acceleration_ned: Array  # (N, 3)
    euler: Array  # (N, 3) roll, pitch, yaw, rad
    euler_rates: Array  # (N, 3) their rates, rad/s


class Inbox(NamedTuple):
    """The newest message of each of N aircraft that each of n followers has received."""

    stamp_s: Array  # (n, N) sender's time of the measurement; nan: nothing heard yet
    received_s: Array  # (n, N) receiver's time of the arrival; nan: nothing heard yet
    position_ned: Array  # (n, N, 3)
    velocity_ned: Array  # (n, N, 3)
    acceleration_ned: Array  # (n, N, 3)
    euler: Array  # (n, N, 3)
    euler_rates: Array  # (n, N, 3)


@briefly
class FormationState(NamedTuple):
    """What the controllers of the n followers did, and how far they are from where they should be.

    Slots and errors are the truth's: nothing of them is fed back.
    """

    slot_ned: Array  # (n, 3) m, the desired position q_g + χ_i
    error_ned: Array  # (n, 3) m, position − slot
    speed: Array  # (n,) ground speed, m/s
    speed_desired: Array  # (n,) s_d, m/s
    speed_command: Array  # (n,) u + s_a − s after its guard: the commanded airspeed, m/s
    course: Array  # (n,) rad
    course_desired: Array  # (n,) rad
    flight_path_angle: Array  # (n,) rad
    flight_path_angle_desired: Array  # (n,) rad
    guards: Flags  # (n,) bit set of formation.flags.Guard
    saturations: Flags  # (n,) bit set of formation.flags.Saturation
    place: Counts  # (n,) whose place of the formation it takes to be its own, a row of the N
    age_s: Array  # (n, n + 1) age of what agent i used of aircraft j, s; nan: not used
    # (n, 3) m, the error where everyone were where it believes to be; error_ned itself where all
    # estimates are exact
    believed_ned: Array


class Failing(NamedTuple):
    """What is broken now in N aircraft; surfaces in the order of `vehicle.breakage.SURFACES`."""

    power: Array  # (N,) 0..1, share of the throttle that reaches the motor
    stuck: Truths  # (N, 5) surfaces that do not move
    stuck_at: Array  # (N, 5) -1..1 where; nan: where they were
    floating: Truths  # (N, 5) surfaces that nothing holds
    floats: Array  # (N, 5) deflection of those per angle of the flow, rad/rad
    frozen: Truths  # (N,) the autopilot hangs: servos keep what they were told last
    charge: Array  # (N,) 0..1 to which the battery drops at this moment; nan: it does not
    pitot_blocked: Truths  # (N,)
    pitot_drained: Truths  # (N,) the drain of a blocked pitot tube is open
    gps_lost: Truths  # (N,)
    gps_jump: Array  # (N, 3) m NED, by which every fix is off
    mute: Truths  # (N,) sends nothing


@briefly
class LinkCounts(NamedTuple):
    """Messages on the links from N aircraft to their n followers since the start."""

    sent: Counts  # (n, N)
    delivered: Counts  # (n, N) of these, those that arrive


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened: shown in the log, the view and the table."""

    time_s: float
    level: str  # "info", "warning" or "error"
    source: str  # name of an aircraft, or "run"
    text: str


class Frame(NamedTuple):
    """Everything an observer sees of one logged tick."""

    tick: int  # of the base rate
    time_s: float
    truth: VehicleState  # (N)
    estimate: VehicleState  # (N)
    air: AirData  # (N)
    command: FbwaCommand  # (N)
    surfaces: Surfaces  # (N)
    formation: FormationState  # (n)
    links: LinkCounts  # (n, N)
    lost: Truths  # (N,) on the ground, broken or collided, now or before
    events: tuple[Event, ...] = ()
    failing: Failing | None = None  # (N) what is broken; None: the page breaks nothing


@dataclass(frozen=True, slots=True)
class RunInfo:
    """What an observer is told before the first frame."""

    scenario_name: str
    scenario_yaml: str  # the resolved page
    names: tuple[str, ...]  # N aircraft, the leader first
    aircraft: tuple[str, ...]  # N airframe names, "rascal110"
    wingspan_m: tuple[float, ...]  # N
    origin: Origin
    base_rate_hz: int
    frame_rate_hz: int
    duration_s: float
    seed: int
    speed_bounds_mps: tuple[tuple[float, float], ...]  # n
    kappa_mps: tuple[float, ...]  # n, how far slots should stay from those bounds
    roll_limit_rad: tuple[float, ...]  # n, of the FBWA command
    leader_path_ned: Array  # (k, 3) the leader's path as commanded, for drawing; may be empty
    portions: Mapping[str, tuple[float, float]]  # name -> window, s
    versions: Mapping[str, str]  # testbed, jsbsim, numpy, python, schema
    directory: Path | None = None  # the run directory, if there is one
    # What the speed bounds are measured against: the ground, or air that moves at this, m/s.
    bounded_in_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # n speed barriers h: number of its example in [HBH23] and ν; none of a law of one's own
    barriers: tuple[tuple[int, float], ...] = ()
    estimated: bool = False  # whether any aircraft flies by estimates that are not the truth
    # files of code that the page names as if they lay beside it, by that name
    code: Mapping[str, bytes] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Whose run it is, without its page."""
        return (
            f"<RunInfo of {self.scenario_name}: {listed(self.names)}; seed {self.seed},"
            f" {self.duration_s:g} s planned, frames at {self.frame_rate_hz} Hz>"
        )


class Observer(Protocol):
    """A watcher of a run. It sees frames, never the world, and cannot change either.

    Its frames are its own to keep, unless it has an attribute `borrows` that is true: then they are
    the loop's, which the next tick changes, and it costs nothing to hand them over.
    """

    def begin(self, info: RunInfo) -> None:
        """Prepare; called once before the first frame."""

    def observe(self, frame: Frame) -> None:
        """Take one frame; called at the log rate in order of time."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Finish: the metrics of the run and the events after the last frame; called once."""
