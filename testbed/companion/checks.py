"""Every reason for which a companion does not engage, or leaves the formation."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import NamedTuple

from testbed.companion.flight_track import FlightTrack, largest
from testbed.companion.observation import (
    HEARTBEAT,
    STATE_MESSAGES,
    STATUS_MESSAGES,
    STICKS,
    Observation,
)
from testbed.companion.scenario_digest import NEEDED_PARAMETERS, UNREAD, split_digests
from testbed.mavlink.vehicle_control import FlightMode
from testbed.scenario.companion_flight import CompanionFlight

# EKF_STATUS_FLAGS: attitude, horizontal and vertical velocity, absolute position
EKF_NEEDED = {1: "attitude", 2: "velocity", 4: "climb rate", 16: "position", 32: "height"}
EKF_FORBIDDEN = {128: "constant position", 1024: "uninitialised", 32768: "GPS glitch"}
FIX_3D = 3  # GPS_FIX_TYPE
EARLIEST_MS = 1_577_836_800_000  # 2020-01-01
FASTEST_MPS = 150.0  # no aircraft of a formation is faster
GREATEST_HEIGHT_M = 10_000.0
LEAST_TRIM_THROTTLE = 1.0  # %: above it ArduPlane uses the throttle of SET_ATTITUDE_TARGET
TOLERANCE = 1e-3  # relative, of parameters that should be the scenario's


@dataclass(frozen=True, slots=True)
class EngagementLimits:
    """Bounds of a companion's flight.

    Attributes:
        flight: section `controller.companion.flight` of the scenario.
        leader: name of the leader.
        used: names of the aircraft that the law uses, the leader among them.
        same_parameters: names of aircraft whose limits and trims must equal the own ones.
        parameters: of the autopilot, as the scenario assumes them, by ArduPlane's present names.
        state_messages: that the own state is made of.
        reaches_aircraft: whether a link may lead to a real aircraft: then a fence and a receiver
            of the pilot's are needed, and the sticks are those of a pilot.
    """

    flight: CompanionFlight
    leader: str
    used: tuple[str, ...]
    same_parameters: tuple[str, ...] = ()
    parameters: Mapping[str, float] = field(default_factory=dict)
    state_messages: tuple[str, ...] = STATE_MESSAGES
    reaches_aircraft: bool = True


class Reason(Enum):
    """Why a companion does not engage, or leaves."""

    PILOT_MODE = "pilot-mode"
    STICK = "stick"
    STOPPING = "stopping"
    PAUSED = "paused"
    RESTARTED = "autopilot-restarted"
    HEARTBEAT = "heartbeat"
    STATE_AGE = "state-age"
    STATE_INVALID = "state-invalid"
    STATE_FROZEN = "state-frozen"
    STATE_JUMP = "state-jump"
    STATUS_AGE = "status-age"
    DISARMED = "disarmed"
    NO_FIX = "no-fix"
    EKF_FLAGS = "ekf-flags"
    EKF_VARIANCE = "ekf-variance"
    AIRSPEED = "airspeed"
    NO_FENCE = "no-fence"
    FENCE = "fence"
    NO_RECEIVER = "no-receiver"
    NO_PARAMETERS = "no-parameters"
    PARAMETERS = "parameters"
    LEADER_AGE = "leader-age"
    LEADER_JUMP = "leader-jump"
    LEADER_SPEED = "leader-speed"
    PEER_AGE = "peer-age"
    SCENARIO_DIFFERS = "scenario-differs"
    PARAMETERS_DIFFER = "parameters-differ"
    PEER_UNREAD = "peer-unread"
    NO_TIME = "no-time"
    TIME_JUMP = "time-jump"
    CLOCKS_APART = "clocks-apart"
    HEIGHTS_DIFFER = "heights-differ"


class Case(NamedTuple):
    """What a check looks at."""

    limits: EngagementLimits
    seen: Observation
    track: FlightTrack
    sticks_us: tuple[float, ...] | None = None  # at engagement; None: not engaged, or no receiver


Check = Callable[[Case], str]
"""Return what is wrong, in a few words with its number; empty: nothing is."""


class Ending(Enum):
    """What an aircraft does after an engagement has ended; the values are for the documentation."""

    ASKS_MODE = "LOITER or RTL"
    HOLDS = "no mode is asked for: holds, then circles where GUIDED was entered"
    PILOT = "flies in the mode that was chosen"
    NONE = "–"


@dataclass(frozen=True, slots=True)
class Row:
    """A reason.

    Attributes:
        when: it holds, for the documentation.
        check: of one observation.
        ending: of an engagement; NONE: it ends none.
        refuses: it stands against engagement, and the aircraft stays in the pilot's mode.
        lasts_s: for which it must hold to end an engagement.
    """

    when: str
    check: Check
    ending: Ending = Ending.ASKS_MODE
    refuses: bool = True
    lasts_s: float = 0.0

    @property
    def leaves(self) -> bool:
        """Whether it ends an engagement."""
        return self.ending is not Ending.NONE


def fresh_mode(case: Case) -> int | None:
    """Return the flight mode; None: it is not known now."""
    old = case.seen.age_s(HEARTBEAT) > case.limits.flight.status_age_s
    return None if old else case.seen.mode


def _pilot_mode(case: Case) -> str:
    mode = fresh_mode(case)
    return "" if mode is None or mode == FlightMode.GUIDED else f"mode {mode} by the pilot"


def _stick(case: Case) -> str:
    if case.sticks_us is None or case.seen.sticks_us is None or not case.limits.reaches_aircraft:
        return ""
    moved = max(abs(a - b) for a, b in zip(case.sticks_us, case.seen.sticks_us, strict=True))
    return f"stick moved by {moved:.0f} us" if moved > case.limits.flight.stick_us else ""


def _stopping(case: Case) -> str:
    return "companion is ending" if case.seen.stopping else ""


def _paused(case: Case) -> str:
    paused = case.track.pause_s
    return f"companion paused {paused:.1f} s" if paused > case.limits.flight.pause_s else ""


def _restarted(case: Case) -> str:
    return "autopilot restarted" if case.track.restarted else ""


def _heartbeat(case: Case) -> str:
    return _first_old(case, (HEARTBEAT,), case.limits.flight.status_age_s)


def _state_age(case: Case) -> str:
    bound, stalled = case.limits.flight.state_age_s, case.track.stalled_s
    if old := _first_old(case, case.limits.state_messages, bound):
        return old
    return f"autopilot's time stopped {stalled:.1f} s" if stalled > bound else ""


def _status_age(case: Case) -> str:
    return _first_old(case, STATUS_MESSAGES, case.limits.flight.status_age_s)


def _first_old(case: Case, messages: tuple[str, ...], bound_s: float) -> str:
    age, name = max((case.seen.age_s(each), each) for each in messages)
    if age <= bound_s:
        return ""
    return f"no {name}" + (f" {age:.1f} s" if math.isfinite(age) else "")


def _state_invalid(case: Case) -> str:
    seen = case.seen
    numbers = (*seen.position_ned, *seen.velocity_ned, seen.height_m, seen.airspeed_mps)
    if not all(map(math.isfinite, numbers)):
        return "own state has no number"
    fast = max(math.hypot(*seen.velocity_ned), abs(seen.airspeed_mps))
    if fast > FASTEST_MPS:
        return f"own speed {fast:.0f} m/s"
    high = max(abs(seen.height_m), abs(seen.position_ned[2]))
    return f"own height {high:.0f} m" if high > GREATEST_HEIGHT_M else ""


def _state_frozen(case: Case) -> str:
    frozen = case.track.frozen_s
    return f"position frozen {frozen:.1f} s" if frozen > case.limits.flight.frozen_s else ""


def _state_jump(case: Case) -> str:
    return _jump("position", case.track.own.excess_m, case)


def _jump(what: str, excess_m: float, case: Case) -> str:
    jumped = excess_m > case.limits.flight.position_jump_m
    return f"{what} jumped {excess_m:.0f} m" if jumped else ""


def _disarmed(case: Case) -> str:
    return "" if case.seen.armed else "not armed"


def _no_fix(case: Case) -> str:
    return "" if case.seen.fix_type >= FIX_3D else f"GPS fix type {case.seen.fix_type}"


def _ekf_flags(case: Case) -> str:
    flags = case.seen.ekf_flags
    bad = [f"no {name}" for bit, name in EKF_NEEDED.items() if not flags & bit]
    bad += [name for bit, name in EKF_FORBIDDEN.items() if flags & bit]
    return f"EKF: {bad[0]}" if bad else ""


def _ekf_variance(case: Case) -> str:
    variances = case.seen.ekf_variances
    if not variances:
        return "no EKF variances"
    worst = max(variances, key=lambda each: math.inf if math.isnan(each) else each)
    return "" if worst < case.limits.flight.ekf_variance else f"EKF variance {worst:.2f}"


def lowest_airspeed_mps(case: Case) -> float:
    """Return the airspeed below which a companion leaves, m/s."""
    own = case.limits.flight.low_airspeed_mps
    return case.seen.parameters.get("AIRSPEED_MIN", 0.0) if own is None else own


def _airspeed(case: Case) -> str:
    lowest, now = lowest_airspeed_mps(case), case.seen.airspeed_mps
    return f"airspeed {now:.1f} < {lowest:.1f} m/s" if now < lowest else ""


def _no_fence(case: Case) -> str:
    needed = case.limits.reaches_aircraft and case.limits.flight.fence is None
    return "scenario has no fence" if needed else ""


def _fence(case: Case) -> str:
    fence = case.limits.flight.fence
    if fence is None:
        return ""
    north, east, down = case.seen.position_ned
    if (away := math.hypot(north, east)) > fence.radius_m:
        return f"fence: {away:.0f} m from origin"
    inside = fence.floor_m <= -down <= fence.ceiling_m
    return "" if inside or math.isnan(down) else f"fence: height {-down:.0f} m"


def _no_receiver(case: Case) -> str:
    if not case.limits.reaches_aircraft:
        return ""
    if case.seen.sticks_us is None:
        return "no pilot's receiver"
    return _first_old(case, (STICKS,), case.limits.flight.status_age_s)


def _no_parameters(case: Case) -> str:
    missing = [name for name in NEEDED_PARAMETERS if name not in case.seen.parameters]
    if missing:
        return f"{missing[0]} unread"
    return "reads parameters" if _parameters_of(case.seen.digests) == UNREAD else ""


def _parameters(case: Case) -> str:
    own = case.seen.parameters
    if own.get("TRIM_THROTTLE", math.inf) <= LEAST_TRIM_THROTTLE:
        return f"TRIM_THROTTLE {own['TRIM_THROTTLE']:g}: no throttle"
    for name, wanted in case.limits.parameters.items():
        if name in own and not math.isclose(own[name], wanted, rel_tol=TOLERANCE, abs_tol=1e-6):
            return f"{name} {own[name]:.4g} not {wanted:.4g}"
    return ""


def _leader_age(case: Case) -> str:
    return _old_peer(case, case.limits.leader)


def _peer_age(case: Case) -> str:
    texts = (_old_peer(case, name) for name in case.limits.used if name != case.limits.leader)
    return next(filter(None, texts), "")


def _old_peer(case: Case, name: str) -> str:
    age = case.seen.peer(name).age_s
    if age <= case.limits.flight.leader_age_s:
        return ""
    return f"{name} silent" + (f" {age:.1f} s" if math.isfinite(age) else "")


def _received(case: Case) -> list[str]:
    """Return the used aircraft whose last message is not too old to count."""
    bound = case.limits.flight.leader_age_s
    return [name for name in case.limits.used if case.seen.peer(name).age_s <= bound]


def _leader_jump(case: Case) -> str:
    leader = case.limits.leader
    known = all(map(math.isfinite, case.seen.peer(leader).position_ned))
    if not known and leader in _received(case):
        return f"{leader} has no position"
    return _jump(leader, case.track.peer_excess_m(leader), case)


def _leader_speed(case: Case) -> str:
    if case.limits.leader not in _received(case):
        return ""
    low, high = case.limits.flight.leader_speed_mps
    speed = math.hypot(*case.seen.peer(case.limits.leader).velocity_ned)
    return "" if low <= speed <= high else f"{case.limits.leader} at {speed:.0f} m/s"


def _scenario_differs(case: Case) -> str:
    return _other_digest(case, 0, _received(case), "scenario")


def _parameters_differ(case: Case) -> str:
    if _parameters_of(case.seen.digests) == UNREAD:
        return ""
    return _other_digest(case, 1, _same_parameters(case, read=True), "parameters")


def _peer_unread(case: Case) -> str:
    unread = _same_parameters(case, read=False)
    return f"{unread[0]} reads its parameters" if unread else ""


def _same_parameters(case: Case, *, read: bool) -> list[str]:
    return [
        name
        for name in _received(case)
        if name in case.limits.same_parameters
        and (_parameters_of(case.seen.peer(name).digests) != UNREAD) is read
    ]


def _parameters_of(digests: int) -> int:
    return split_digests(digests)[1]


def _other_digest(case: Case, part: int, names: list[str], what: str) -> str:
    own = split_digests(case.seen.digests)[part]
    for name in names:
        if split_digests(case.seen.peer(name).digests)[part] != own:
            return f"{name} has other {what}"
    return ""


def _no_time(case: Case) -> str:
    base_ms = case.seen.base_ms
    if base_ms is None or base_ms < 0:
        return "autopilot has no GPS time"
    if case.limits.reaches_aircraft and base_ms < EARLIEST_MS:
        return "GPS time is before 2020"
    return ""


def _time_jump(case: Case) -> str:
    jump = case.track.time_jump_s
    return f"GPS time jumped {jump:.2f} s" if jump > case.limits.flight.clock_jump_s else ""


def _clocks_apart(case: Case) -> str:
    offsets = {name: case.seen.peer(name).offset_s for name in _received(case)}
    name, offset = largest({n: each for n, each in offsets.items() if math.isfinite(each)})
    apart = abs(offset) > case.limits.flight.clock_offset_s
    return f"{name}'s clock is {offset:+.2f} s off" if apart else ""


def _heights_differ(case: Case) -> str:
    name, apart = largest(case.track.heights_m)
    differ = abs(apart) > case.limits.flight.height_difference_m
    return f"{name} {-apart:+.1f} m high on the ground" if differ else ""


REASONS: Mapping[Reason, Row] = {
    Reason.PILOT_MODE: Row(
        "the pilot, or a failsafe, changes the mode",
        _pilot_mode,
        Ending.PILOT,
        refuses=False,
    ),
    Reason.STOPPING: Row("the companion is ended, by a signal or an error", _stopping),
    Reason.PAUSED: Row(
        "the companion's process did not run for `pause_s`, as after SIGSTOP or with a processor "
        "that other programs take",
        _paused,
        Ending.HOLDS,
    ),
    Reason.HEARTBEAT: Row(
        "no HEARTBEAT of the autopilot for `status_age_s`: the mode is not known",
        _heartbeat,
        Ending.HOLDS,
    ),
    Reason.STICK: Row(
        "the pilot moves roll, pitch or yaw by `stick_us` from where it was at engagement",
        _stick,
        refuses=False,
        lasts_s=0.1,
    ),
    Reason.RESTARTED: Row("the autopilot's time since boot goes back", _restarted),
    Reason.STATE_AGE: Row(
        "a message of the own state is older than `state_age_s`, or the autopilot's time does not "
        "go on",
        _state_age,
    ),
    Reason.STATE_INVALID: Row(
        "the own state has NaN, a speed above 150 m/s or a height above 10 km", _state_invalid
    ),
    Reason.STATE_FROZEN: Row(
        "the own position is the same for `frozen_s` of flight above 3 m/s", _state_frozen
    ),
    Reason.STATE_JUMP: Row(
        "the own position is more than `position_jump_m` from where its velocity led",
        _state_jump,
    ),
    Reason.STATUS_AGE: Row(
        "EKF_STATUS_REPORT, GPS_RAW_INT or SYSTEM_TIME is older than `status_age_s`", _status_age
    ),
    Reason.DISARMED: Row("the aircraft is not armed", _disarmed),
    Reason.NO_FIX: Row("the GPS has no 3D fix", _no_fix),
    Reason.EKF_FLAGS: Row(
        "the EKF lacks attitude, velocity, position or height, or has constant position or a GPS "
        "glitch",
        _ekf_flags,
    ),
    Reason.EKF_VARIANCE: Row("a variance of the EKF reaches `ekf_variance`", _ekf_variance),
    Reason.AIRSPEED: Row(
        "the airspeed is below `low_airspeed_mps`, by default AIRSPEED_MIN, for 1 s",
        _airspeed,
        lasts_s=1.0,
    ),
    Reason.NO_FENCE: Row(
        "the scenario has no `fence`, and a link may reach an aircraft", _no_fence, Ending.NONE
    ),
    Reason.FENCE: Row("the aircraft is outside `fence`", _fence),
    Reason.NO_RECEIVER: Row(
        "no RC_CHANNELS of a receiver for `status_age_s`, where a link may reach an aircraft",
        _no_receiver,
    ),
    Reason.NO_PARAMETERS: Row(
        "a limit or trim has not been read from the autopilot", _no_parameters, Ending.NONE
    ),
    Reason.PARAMETERS: Row(
        "TRIM_THROTTLE is at most 1, so that ArduPlane ignores commanded throttle, or a parameter "
        "is not that of the scenario's aircraft",
        _parameters,
    ),
    Reason.LEADER_AGE: Row("no message of the leader for `leader_age_s`", _leader_age),
    Reason.LEADER_JUMP: Row(
        "the leader's position is more than `position_jump_m` from where its velocity led, or is "
        "no number",
        _leader_jump,
    ),
    Reason.LEADER_SPEED: Row(
        "the leader's ground speed is outside `leader_speed_mps`", _leader_speed
    ),
    Reason.PEER_AGE: Row(
        "no message of another aircraft that the law uses for `leader_age_s`",
        _peer_age,
        Ending.NONE,
    ),
    Reason.SCENARIO_DIFFERS: Row(
        "an aircraft that the law uses has another scenario", _scenario_differs
    ),
    Reason.PARAMETERS_DIFFER: Row(
        "an aircraft of the same kind has other limits or trims", _parameters_differ
    ),
    Reason.PEER_UNREAD: Row(
        "an aircraft of the same kind has not read its parameters, as after a start in flight",
        _peer_unread,
        Ending.NONE,
    ),
    Reason.NO_TIME: Row("the autopilot has no GPS time", _no_time),
    Reason.TIME_JUMP: Row("the GPS time jumps by `clock_jump_s`", _time_jump),
    Reason.CLOCKS_APART: Row(
        "the time of an aircraft that the law uses is `clock_offset_s` off for 1 s",
        _clocks_apart,
        lasts_s=1.0,
    ),
    Reason.HEIGHTS_DIFFER: Row(
        "on the ground the heights of two aircraft differ by `height_difference_m`",
        _heights_differ,
        Ending.NONE,
    ),
}
"""All reasons; of several that hold at once the first one is reported."""


def find_reasons(case: Case, *, engaged: bool) -> dict[Reason, str]:
    """Return what stands against engagement, or against going on, with what is wrong."""
    found = {}
    for reason, row in REASONS.items():
        if (row.leaves if engaged else row.refuses) and (text := row.check(case)):
            found[reason] = text
    return found
